"""Data that are no recording, from the command line: no rig is needed."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.cli import main
from scipy.io import savemat
from scipy.signal import lfilter

TS = 0.05
COLUMNS = {
    "data.csv": "",
    "data.tsv": "",
    "data.mat": "",
    "data.npz": "",
    "data.dat": "--input 2 --signal 3 --time 1",
}


def made(seed: int = 1, N: int = 400) -> armrig.Dataset:
    """Return data of y(t) = 1.5 y(t-1) - 0.7 y(t-2) + u(t-1) + 0.5 u(t-2) + e(t)."""
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], N)
    A = [1, -1.5, 0.7]
    y = lfilter([0, 1, 0.5], A, u) + lfilter([1.0], A, 0.1 * rng.standard_normal(N))
    return armrig.Dataset(u=u, y=y, Ts=TS, input_unit="")


def write(path: Path, data: armrig.Dataset) -> Path:
    """Write u and y in the format of the name, with t in a text file."""
    t = [f"{k * TS:.2f}" for k in range(data.N)]
    rows = [f"{a} {b!r} {c!r}" for a, b, c in zip(t, data.u.tolist(), data.y.tolist(), strict=True)]
    text = "\n".join(["t u y", *rows])
    if path.suffix == ".mat":
        savemat(path, {"u": data.u, "y": data.y, "Ts": TS})
    elif path.suffix == ".npz":
        np.savez(path, u=data.u, y=data.y, Ts=TS)
    elif path.suffix == ".dat":
        path.write_text("\n".join(rows))
    elif path.suffix == ".tsv":
        path.write_text(text.replace(" ", "\t"))
    else:
        path.write_text(text.replace(" ", ";").replace(".", ","))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a folder with the same data in every kind of file, and other data of the same plant."""
    folder = tmp_path_factory.mktemp("own")
    for name in COLUMNS:
        write(folder / name, made())
    write(folder / "other.csv", made(seed=2))
    return folder


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


@pytest.mark.parametrize(("name", "columns"), COLUMNS.items())
def test_every_kind_of_file_gives_the_model_that_python_gives(
    name: str, columns: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fit = armrig.arx(made(), na=2, nb=2)

    found = facts(f"identify {name} --structure arx --na 2 --nb 2 {columns}", folder, capsys)

    expected = zip(fit.names, fit.theta, fit.std, fit.std_robust, strict=True)
    assert found["parameters"] == {
        n: {"value": v, "std": s, "std_robust": r} for n, v, s, r in expected
    }
    assert found["Ts"] == TS
    assert found["data"] == armrig.load_data(folder / name, **_python(columns)).source[5:]


def _python(columns: str) -> dict[str, str]:
    words = shlex.split(columns)
    return dict(zip([w.lstrip("-") for w in words[::2]], words[1::2], strict=True))


def test_few_samples_may_determine_a_delay_and_no_feedback(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run("check data.csv --to 4", folder, capsys)
    told = facts("check data.csv --to 4", folder, capsys)
    neither, _, why = run("check data.csv --to 0.5", folder, capsys)

    assert code == 0
    assert "open loop: not known: the test for feedback needs at least" in out
    assert "delay: nk = 1: no input delay" in out
    assert (told["open_loop"]["feedback"], told["delay"]["nk"]) == (None, 1)
    assert neither == 1
    assert "got 10" in why


def test_a_narrow_input_determines_no_delay_and_the_loop_is_reported_all_the_same(
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


def test_a_figure_without_spectral_analysis_says_why(
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


def _write_with_outliers(path: Path) -> None:
    """Write data with three outliers of y."""
    data = made()
    y = data.y.copy()
    y[[90, 200, 310]] += 1e4
    write(path, armrig.Dataset(u=data.u, y=y, Ts=TS))


def test_wrong_samples_are_marked_where_it_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _write_with_outliers(tmp_path / "data.csv")
    command = "identify data.csv --structure arx --na 2 --nb 2"

    _, spoilt, proposed = run(command, tmp_path, capsys)
    code, mended, said = run(f"{command} --hampel", tmp_path, capsys)

    assert "mark them missing (hampel)" in spoilt
    assert "armrig.hampel" not in spoilt
    assert "--hampel" in proposed[proposed.index("next:") :]
    assert code == 0
    assert "look wrong" not in mended
    assert "marked 3 of 400 samples of y missing as outliers (samples 90, 200, 310)" in said


def test_a_search_says_what_it_found_wrong_with_the_data(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _write_with_outliers(tmp_path / "data.csv")

    found = facts("identify data.csv --search --structure arx --max-order 2", tmp_path, capsys)

    assert "outliers" in {f["about"] for f in found["advice"]}
