"""Every key of the configuration is documented once, and as the daemon reads it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from armrig_core.errors import InputError
from armrig_core.rig.calibration import Made
from armrig_daemon.command_line import app
from armrig_daemon.config import Config, load
from armrig_daemon.configuration_reference import BEGIN, END, PAGE, example, page_tables, tables
from armrig_daemon.emulator.settings import EmulatorSettings
from typer.testing import CliRunner


def _leaves(kind: Any, before: str = "") -> Iterator[str]:
    """Yield the dotted name of each value that the schema has."""
    for field in msgspec.structs.fields(kind):
        if isinstance(field.type, type) and issubclass(field.type, msgspec.Struct):
            yield from _leaves(field.type, f"{before}{field.name}.")
        elif field.type != Made | None:  # `armrig calibrate` writes it
            yield f"{before}{field.name}"


def _with_all_keys(tmp_path: Path, *but: str) -> Config:
    """Return the configuration of the example with the # of each key taken away."""
    text = re.sub(rf"(?m)^#(?!{'|'.join(but)})(?=\S+ = )", "", example())
    path = tmp_path / "armrig.toml"
    path.write_text(text, encoding="utf-8")
    return load([path], {}, {})


def test_every_key_of_the_schema_is_documented_once() -> None:
    told = [f"{table}.{key.name}" for table, _, keys in tables() for key in keys]
    described = [(meaning, key.description) for _, meaning, keys in tables() for key in keys]

    arm = {f"emulator.arm.{name}" for name in ("J_1", "J_2", "N", "K_lin", "R_m", "K_m", "b_1")}
    assert len(told) == len(set(told))
    assert set(told) == {*_leaves(Config), "calibration.file", *arm} - {"emulator.arm"}
    assert all(meaning and description for meaning, description in described)


def test_the_unedited_example_equals_the_default_configuration(tmp_path: Path) -> None:
    path = tmp_path / "armrig.toml"
    path.write_text(example(), encoding="utf-8")

    assert load([path], {}, {}) == Config()


def test_the_values_of_the_example_are_the_defaults(tmp_path: Path) -> None:
    faults = ("friction_v", "motor_reversed", "loose_arm", "faulty_sensor", "sensor_fault")
    config = _with_all_keys(tmp_path, "file", "cpu", *faults, "fault_s")

    assert config.arm.parameters() == Config().arm.parameters()
    assert config.emulator.arm_parameters() == EmulatorSettings().arm_parameters()
    same = msgspec.structs.replace(
        config, arm=Config().arm, emulator=msgspec.structs.replace(config.emulator, arm={})
    )
    assert same == Config()


def _outside(allowed: str) -> list[float]:
    """Return a value below the lowest that is allowed, and one above the highest."""
    numbers = [float(x) for x in re.findall(r"-?\d[\d.]*", allowed)]
    low, high = numbers[0], numbers[1:]
    return [low if allowed.startswith("above ") else low - 1, *(2 * x for x in high)]


CASES = [
    (table, key.name, value)
    for table, _, keys in tables()
    for key in keys
    if re.fullmatch(r"(above )?-?\d\S*( to \S+| or more|, at most \S+|)", key.allowed)
    if "." not in key.name
    for value in _outside(key.allowed)
]


@pytest.mark.parametrize(("table", "name", "value"), CASES)
def test_a_documented_range_is_enforced(
    tmp_path: Path, table: str, name: str, value: float
) -> None:
    path = tmp_path / "armrig.toml"
    path.write_text(f"[{table}]\n{name} = {value:g}\n")

    with pytest.raises(InputError, match=name):
        load([path], {}, {})


def test_the_page_holds_the_tables_of_the_schema() -> None:
    text = PAGE.read_text(encoding="utf-8")

    assert text.split(BEGIN)[1].split(END)[0].strip() == page_tables().strip()


def test_the_command_prints_the_example() -> None:
    printed = CliRunner().invoke(app, ["config", "--example"])
    bare = CliRunner().invoke(app, ["config"])

    assert (printed.exit_code, printed.stdout) == (0, example() + "\n")
    _, *tables_of_keys = printed.stdout.split("\n[")
    wrapped = [line for table in tables_of_keys for line in table.splitlines() if line[0:2] == "# "]
    assert max(map(len, wrapped)) <= 88
    assert (bare.exit_code, bare.stdout) == (1, "")
    assert bare.stderr == (
        "armrigd: config: give --example or --check FILE, for example "
        "`armrigd config --example > armrig.toml`\n"
    )
