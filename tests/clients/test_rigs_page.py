"""docs/rigs.md: its description is identified and emulated by its own commands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from armrig_core.rig.description import Description, Input, Model, Output, RigTable

from tests.clients import pages
from tests.clients.described_rig import record_all

PAGE = pages.DOCS / "rigs.md"
TEXT = PAGE.read_text(encoding="utf-8")
DESCRIPTION, MODEL, *_ = re.findall(r"```toml\n(.*?)```", TEXT, re.DOTALL)
PLANT = """
[model]
A = [[-22.0, 0.0], [6.5, -6.5]]
B = [[22.0], [0.0]]
C = [[0.0, 0.62]]
offset = [0.35]
"""
RUN = tuple(f"armrig {name}" for name in ("rigs", "sampling", "hints", "identify", "check"))


def test_the_rig_of_the_page_is_identified_and_then_emulated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The page does not name the circuit's poles, -22 and -6.5 1/s, which its commands find."""
    described = Description.of(DESCRIPTION.encode())
    plant = Description.of((DESCRIPTION + PLANT).encode())
    record_all(tmp_path, described, "led", plant=plant, first=(5.0, 0.01), random=(60.0, 0.05))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", str(tmp_path))
    first, second = TEXT.split(f"```toml\n{MODEL}```")
    file = Path("led.toml")
    compared = 0
    for part, text in ((first, DESCRIPTION), (second, DESCRIPTION + MODEL)):
        file.write_text(text, encoding="utf-8")
        page = Path("part.md")
        page.write_text(part, encoding="utf-8")
        compared += pages.run(page, capsys, atol=2e-3, commands=RUN)

    assert compared == 4


def test_the_table_names_every_key_of_a_description() -> None:
    keys = {f for kind in (RigTable, Input, Output, Model) for f in kind.__struct_fields__}
    table = TEXT.split("## The keys\n\n")[1].split("\n\n")[0]
    named = "".join(row.split("|")[1] for row in table.splitlines())

    assert keys == set(re.findall(r"`(?:\[\S+\] )?(\w+)`", named))
