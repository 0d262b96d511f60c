"""Every option of a command reaches the function that does the command's work.

The work itself belongs to another room; here a function that records its arguments replaces it.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import armrig
import msgspec
import numpy as np
import pandas as pd
import pytest
import typer
from armrig.cli import app, main
from armrig_core.errors import OperationError
from armrig_core.rig.calibration import Calibration, Driver
from armrig_core.rig.calibration_file import toml_of
from scipy.io import loadmat

from tests.clients.made_recordings import of_the_arm, written

FILE, OTHER = "f.mcap", "other.mcap"
# Commands with the arguments that they need, and the functions that do their work.
WORK = {
    "dashboard": "armrig.dashboard.serving.dashboard",
    "lab": "armrig.rig.local_daemon.running",
    "demo": "armrig.cli.demo._record armrig.cli.demo.record_in_virtual_time",
    "record": "armrig.cli.runs._record_one armrig.cli.runs.record_many",
    "router": "armrig.lab.router.open_router",
    "conformance --device /dev/a": "os.execv",
    **dict.fromkeys(
        (f"batch {task} . -o t.parquet" for task in ("identify", "verify", "report")),
        "armrig.report.batch.batch.batch",
    ),
    "batch validate . -o t.parquet --model m.json": "armrig.report.batch.batch.batch",
    f"report {FILE}": "armrig.report.study.study armrig.report.handout_study.handout_study",
    f"report {FILE} --handout": "armrig.report.handout_study.handout_study",
    f"greybox {FILE}": "armrig.greybox",
    f"split {FILE}": "armrig.greybox",
    "integrate": "armrig.physics.recommend_step",
    f"identify {FILE} --search": "armrig.search",
    f"check {FILE}": "armrig.open_loop",
    f"linearity {FILE}": "armrig.linearity",
    f"validate {FILE} --model m.json": "armrig.residuals",
    f"compare {FILE} --model m.json": "armrig.compare",
    f"simulate {FILE} --model m.json": "armrig.compare",
}
VALUES = {
    **{"--rig": "7", "--connect": "tcp/a:1", "--config": "a.toml", "--directory": "a"},
    **{"--seconds": "7", "--seed": "5", "--port": "8899", "--baud": "9600", "--device": "/dev/b"},
    **{"--listen": "tcp/a:1", "--certificate": "c.pem", "--names": "n.toml", "-o": OTHER},
    **{"--workers": "3", "--scheduler": "tls://a:1", "--kind": "bla", "--reports": "pdfs"},
    **{"--structure": "bj", "--signal": "alpha", "--weights": "moesp", "--nk": "2"},
    **dict.fromkeys(("--na", "--nb", "--nc", "--nd", "--nf", "--order", "--max-order"), "3"),
    **{"--set": "R_m=4", "--omega": "5", "--amplitude": "1", "--span": "3", "--method": "heun"},
    **{"--tolerance": "0.02", "--free": "J_2", "--friction": "both", "--parts": "2,3"},
    **{"--from": "0.5", "--to": "2.5", "--level": "0.002", "--lags": "7", "--horizon": "3"},
    **{"--rig-file": "r.toml", "--point": "y=1"},
    **{"--model": "m2.json", "--calibration": "c.toml", "--validate": OTHER},
    **{"--poles": "3", "--zeros": "1", "--delay": "0.1", "--form": "P1D"},
}
OF_THE_OUTPUT = {
    *("--json", "--verbose", "--plot", "--save", "--open", "--foxglove", "--dashboard", "--force"),
    *("--questions", "--source", "--answers", "--h", "--jobs", "--assume", "--output"),
}
OF_TABLES = {"--hampel", "--input", "--Ts"}
"""Options of data that are no recording; the stored outputs have a table that needs them."""


def _described(value: Any) -> Any:
    """Return the content of an argument as a value that can be compared."""
    match value:
        case np.ndarray():
            return value.tolist()
        case dict():
            return {name: _described(item) for name, item in value.items()}
        case list() | tuple():
            return [_described(item) for item in value]
        case partial():
            return [value.func.__name__, value.args]
        case str() | bool() | int() | float() | Path() | range() | None:
            return value
    if isinstance(value, msgspec.Struct):
        return _described(msgspec.structs.asdict(value))
    if isinstance(value, armrig.Dataset):
        value = value.signals()
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: _described(getattr(value, f.name)) for f in fields(value) if f.repr}
    return type(value).__name__


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give the working folder with two recordings, two models, an input and a calibration."""
    monkeypatch.chdir(tmp_path)
    written(tmp_path, of_the_arm(armrig.telegraph(300, 0.1, seed=1)), FILE)
    written(tmp_path, of_the_arm(armrig.telegraph(210, 0.1, seed=2)), OTHER)
    data = armrig.load(FILE).dataset()
    armrig.arx(data, na=1, nb=1).save("m.json")
    armrig.arx(data, na=1, nb=2).save("m2.json")
    Path("c.toml").write_text(toml_of(Calibration(driver=Driver(gain=0.9))))
    return tmp_path


def _options(line: str) -> list[Any]:
    """Return the options of the command that a line begins with."""
    found: Any = typer.main.get_command(app())
    for word in line.split():
        found = getattr(found, "commands", {}).get(word, found)
    return [option for option in found.params if option.param_type_name == "option"]


@pytest.mark.parametrize("line", WORK)
@pytest.mark.usefixtures("folder")
def test_every_option_is_refused_or_reaches_its_function(
    line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[Any] = []

    def work(name: str, *arguments: Any, **named: Any) -> Any:
        calls.append([name, _described(arguments), _described(named)])
        raise OperationError("no work")

    def arguments(*options: str) -> Any:
        calls.clear()
        main([*shlex.split(line), *options])
        return list(calls)

    for name in WORK[line].split():
        monkeypatch.setattr(name, partial(work, name))
    plain = arguments()
    names = {option.opts[-1]: option.is_flag for option in _options(line)}

    assert plain
    for name in names.keys() - OF_THE_OUTPUT - OF_TABLES:
        assert arguments(name, *[] if names[name] else [VALUES[name]]) != plain, name


@pytest.mark.parametrize(
    ("options", "lines", "facts"),
    [
        ([], ["rig 7: U"], {"shared_url": None, "foxglove": None, "layouts": None}),
        (
            ["--share"],
            ["rig 7: U", "to watch and stop: S", "qr of S", "F"],
            {"shared_url": "S", "foxglove": None, "layouts": None},
        ),
        (
            ["--foxglove"],
            [
                "rig 7: U",
                "for Foxglove, to watch: W",
                "layouts for Foxglove and PlotJuggler: FOLDER/layouts-7",
            ],
            {"shared_url": None, "foxglove": "W", "layouts": "FOLDER/layouts-7"},
        ),
    ],
)
def test_the_dashboard_prints_its_addresses(
    options: list[str],
    lines: list[str],
    facts: dict[str, str | None],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    def serving(settings: Any) -> Any:
        shared = "S" if settings.share else ""
        return nullcontext(
            SimpleNamespace(url="U", browser_url="B", shared_url=shared, fingerprint="F")
        )

    opened: list[str] = []
    ended = SimpleNamespace(wait=lambda: None)
    fakes: dict[str, Any] = {
        "armrig.dashboard.serving.dashboard": serving,
        "armrig.dashboard.foxglove.foxglove": lambda *_, **__: nullcontext("W"),
        "armrig.dashboard.share.own_address": lambda: "10.1.2.3",
        "armrig.dashboard.share.qr_code": lambda url: f"qr of {url}",
        "platformdirs.user_state_dir": lambda _: str(tmp_path),
        "armrig.cli.rig.until_signal": lambda: nullcontext(ended),
        "webbrowser.open": opened.append,
    }
    for name, fake in fakes.items():
        monkeypatch.setattr(name, fake)

    assert main(["dashboard", "--rig", "7", *options]) == 0
    said = capsys.readouterr().out.replace(str(tmp_path), "FOLDER").splitlines()
    assert main(["dashboard", "--rig", "7", *options, "--json"]) == 0

    assert [line for line in said if line in lines] == lines
    assert len(said) == 2 + {"--share": 4, "--foxglove": 2}.get("".join(options), 0)
    told = json.loads(capsys.readouterr().out.replace(str(tmp_path), "FOLDER"))
    assert told == {"url": "U", **facts}
    assert opened == []


@pytest.mark.parametrize(
    ("name", "options", "read"),
    [
        ("a.csv", [], pd.read_csv),
        ("a.mat", ["--raw", "--signal", "alpha"], loadmat),
        ("a.parquet", ["--raw"], pd.read_parquet),
    ],
)
def test_the_options_of_export_select_signal_and_readings(
    name: str,
    options: list[str],
    read: Callable[[Path], Any],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = written(tmp_path, of_the_arm(np.full(100, 1.0), missing=slice(50, 53)))
    given = ["export", str(path), str(tmp_path / name), *options, "--from", "0.25"]

    assert main(given) == 0
    said = capsys.readouterr().out
    assert main([*given, "--json"]) == 0

    found = read(tmp_path / name)
    assert np.size(found["t"]) == 75
    assert ("theta_1_counts" in found) == ("--raw" in options)
    assert read is not loadmat or found["output"].item() == options[-1]
    assert said == f"{tmp_path / name}: 75 samples, 3 of them missing\n"
    facts = {"file": str(tmp_path / name), "samples": 75, "recording": armrig.load(path).sha256}
    assert json.loads(capsys.readouterr().out) == facts
