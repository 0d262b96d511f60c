"""Data that are no recording, from the command line: no rig is needed."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.cli import main
from scipy.signal import lfilter

from tests.plants import nonlinear_rig

TS = 0.05


def made(seed: int = 1, N: int = 400) -> armrig.Dataset:
    """Return data of y(t) = 1.5 y(t-1) - 0.7 y(t-2) + u(t-1) + 0.5 u(t-2) + e(t)."""
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], N)
    A = [1, -1.5, 0.7]
    y = lfilter([0, 1, 0.5], A, u) + lfilter([1.0], A, 0.1 * rng.standard_normal(N))
    return armrig.Dataset(u=u, y=y, Ts=TS, input_unit="")


def write(path: Path, data: armrig.Dataset) -> Path:
    """Write a table of t, u and y."""
    rows = zip(TS * np.arange(data.N), data.u.tolist(), data.y.tolist(), strict=True)
    path.write_text("\n".join(["t,u,y", *(f"{t:.2f},{u!r},{y!r}" for t, u, y in rows)]))
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Give a folder with a table."""
    write(tmp_path / "data.csv", made())
    return tmp_path


def run(line: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    """Return exit code, output and errors of a command in the folder."""
    code = main([str(folder / x) if "." in x and not x[0].isdigit() else x for x in line.split()])
    said = capsys.readouterr()
    assert "Traceback" not in said.err
    return code, said.out, said.err


def facts(line: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """Return a command's JSON output."""
    code, out, _ = run(f"{line} --json", folder, capsys)
    assert code == 0
    return dict(json.loads(out))


def test_a_model_of_a_file_has_the_names_of_its_columns_and_another_input_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng, N = np.random.default_rng(2), 500
    power, fan = (np.repeat(rng.choice([20.0, 60.0], N), hold)[:N] for hold in (15, 70))
    temp = lfilter([0, 0.005], [1, -0.9995], power) + lfilter([0, -0.03], [1, -0.99], fan)
    rows = np.column_stack([np.arange(N), power, fan, temp + 0.02 * rng.standard_normal(N)])
    names = "t [s],power [%],fan [%],temp [degC]"
    np.savetxt(tmp_path / "heater.csv", rows, delimiter=",", header=names, comments="")

    columns = "heater.csv --input power --signal temp"
    _, said, err = run(f"identify {columns} --structure oe --nb 1 --nf 1", tmp_path, capsys)

    assert "power [%] to temp [°C]" in said
    assert "not in the data, but switching like an input: fan" in err


@pytest.mark.exhaustive
@pytest.mark.parametrize("feedback", [0.0, 1.2])
def test_the_next_commands_come_to_an_end(
    feedback: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """A tank whose level settles slowly, and a loop: each command is named once."""
    rng, (u, x, y) = np.random.default_rng(3), np.zeros((3, 500))
    levels, v = np.repeat(rng.uniform(0.5, 5.0, 25), 20), 0.0
    for t in range(1, 500):
        x[t] = x[t - 1] + 0.1 * u[t - 1] - 0.13 * np.sqrt(max(x[t - 1], 0.0))
        v = 0.8 * v + 0.02 * rng.standard_normal()
        y[t] = x[t] + v
        u[t] = levels[t] - feedback * y[t]
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "tank.csv", armrig.Dataset(u=u, y=y, Ts=TS))

    line, lines = "hints tank.csv", list[str]()
    while line:
        assert line not in lines
        lines.append(line)
        assert main(shlex.split(line)) == 0
        _, _, after = capsys.readouterr().err.partition("next: armrig ")
        line = re.sub(" -o [^ ]+", "", after.partition("\n")[0])

    assert len(lines) > 1


def test_feedback_is_reported_though_a_narrow_input_shows_no_delay(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t = np.arange(600) * 0.01
    u = np.sin(3 * t) + np.sin(7 * t)
    y = lfilter([0, 0.1], [1, -0.9], u) + 0.01 * np.random.default_rng(1).standard_normal(600)
    write(folder / "narrow.csv", armrig.Dataset(u=u, y=y, Ts=0.01))

    code, out, _ = run("check narrow.csv --Ts 0.01", folder, capsys)
    told = facts("check narrow.csv --Ts 0.01 --json", folder, capsys)

    assert code == 0
    assert "no decision on feedback" in out
    assert "not known: u determines" in out
    assert told["delay"]["nk"] is None
    assert "u determines" in told["delay"]["remarks"][0]


def test_a_figure_without_spectral_analysis_states_the_reason(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    y = made(N=60).y
    write(folder / "constant.csv", armrig.Dataset(u=np.ones(60), y=y, Ts=TS))
    run("identify data.csv --structure arx --save plotted.json", folder, capsys)

    line = "validate constant.csv --model plotted.json --plot constant.png"
    code, _, said = run(line, folder, capsys)

    assert code == 0
    assert "the figure has no spectral analysis: " in said
    assert "u is constant" in said


def test_a_recording_under_another_name_is_a_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "data.csv"
    path.write_bytes(armrig.example_recording().path.read_bytes())

    assert main(["check", str(path), "--to", "5"]) == 0
    assert "handout 3.7" in capsys.readouterr().out
    assert main(["check", str(path), "--input", "u"]) != 0
    assert f"{path} is a recording" in capsys.readouterr().err
    with pytest.raises(armrig.FileError, match="is a recording and not a table"):
        armrig.load_data(path)
    with pytest.raises(armrig.FileError, match="is a recording, not a calibration"):
        armrig.load(armrig.example_recording().path, path)


def test_outliers_are_reported_and_marked_on_request(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = made()
    y = data.y + 1e4 * np.isin(np.arange(data.N), [90, 200, 310])
    write(tmp_path / "data.csv", armrig.Dataset(u=data.u, y=y, Ts=TS))
    command = "identify data.csv --structure arx --na 2 --nb 2"

    _, spoilt, proposed = run(command, tmp_path, capsys)
    code, mended, said = run(f"{command} --hampel", tmp_path, capsys)
    searched = facts("identify data.csv --search --structure arx --max-order 2", tmp_path, capsys)

    assert "outliers" in {f["about"] for f in searched["advice"]}
    assert "mark them missing (hampel)" in spoilt
    assert "armrig.hampel" not in spoilt
    assert "--hampel" in proposed[proposed.index("next:") :]
    assert code == 0
    assert "look wrong" not in mended
    assert "marked 3 of 400 samples of y missing as outliers (samples 90, 200, 310)" in said


def test_check_and_validate_name_a_nonlinear_rig(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = armrig.load_data(write(tmp_path / "data.csv", nonlinear_rig("dead zone", 1)))
    armrig.arx(data, na=1, nb=1).save(tmp_path / "m.json")

    for command in ("check data.csv", "validate data.csv --model m.json"):
        assert "NONLINEAR: a dead zone of u from" in run(command, tmp_path, capsys)[1]


EQUATIONS = """
import armrig

model = armrig.Ode(
    lambda t, x, u, p: [(p.k * u[0] - x[0]) / p.tau],
    output=lambda t, x, u, p: x[0],
    states=["temp"],
    parameters={"k": armrig.Parameter(2.0), "tau": armrig.Parameter(0.3, low=0.01)},
)
"""


def write_heater(path: Path, seed: int, order: str) -> None:
    """Write t, power, temp = power/(1 + 0.5 s), and fan, which does nothing, in an order."""
    rng, N, pole = np.random.default_rng(seed), 400, np.exp(-TS / 0.5)
    power, fan = (np.repeat(rng.uniform(0, 4, N), hold)[:N] for hold in (8, 5))
    temp = lfilter([0, 1 - pole], [1, -pole], power) + 0.01 * rng.standard_normal(N)
    columns = {"t": TS * np.arange(N), "power": power, "temp": temp, "fan": fan}
    rows = np.column_stack([columns[name] for name in order.split(",")])
    np.savetxt(path, rows, delimiter=",", header=order, comments="")


@pytest.mark.parametrize("other", ["second.csv", "@second"])
@pytest.mark.parametrize(
    "command", ["identify first.csv --structure oe --nb 1 --nf 1", "greybox first.csv --model m.py"]
)
def test_numbers_choose_the_columns_of_the_first_file_in_the_second_file(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: str,
    other: str,
) -> None:
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", str(tmp_path / "recordings"))
    monkeypatch.chdir(tmp_path)
    Path("m.py").write_text(EQUATIONS)
    write_heater(Path("first.csv"), 1, "t,power,temp,fan")
    write_heater(Path("second.csv"), 2, "t,fan,temp,power")
    assert main(["import", "second.csv"]) == 0
    capsys.readouterr()
    words = [*command.split(), "--input", "2", "--signal", "3", "--validate"]

    assert main([*words, other, "--json"]) == 0
    validation = json.loads(capsys.readouterr().out)["validation"]
    assert validation.get("temp", validation)["fit_percent"] > 95

    named = Path("first.csv").read_text().replace("power", "light")
    Path("renamed.csv").write_text(named)
    assert main([*words, "renamed.csv"]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == (
        "armrig: renamed.csv: columns 2 and 3 are light and temp, in the first file power and "
        "temp; give the columns of both files the same names"
    )
