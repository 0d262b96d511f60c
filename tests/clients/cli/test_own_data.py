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

from tests.sampling import sampled

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


def test_a_sampling_time_that_is_given_overrides_the_times(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = "identify data.csv --input u --signal y --Ts 0.1 --structure oe --nb 2 --nf 2"

    code, out, said = run(line, folder, capsys)

    assert code == 0
    assert out.startswith("OE(nb=2, nf=2, nk=1) fits y to ")
    assert "u to y, Ts 0.1 s, N 400;" in out
    doubt, facts, *_ = said.splitlines()
    assert doubt.endswith("used the given Ts = 0.1 s, although the times are 0.05 s apart")
    assert facts.startswith(
        f"{folder}/data.csv: 400 samples, 0.1 s apart; the input is column u; the"
    )


def test_a_model_is_validated_on_other_data(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = "identify data.csv --structure arx --na 2 --nb 2 --validate other.csv --save model.json"
    at_once = facts(line, folder, capsys)["validation"]

    later = facts("validate other.csv --model model.json", folder, capsys)
    code, out, _ = run("validate other.csv --model model.json", folder, capsys)

    assert code == 0
    assert at_once["fit_percent"] == later["fit_percent"] > 80
    assert at_once["data"] == later["data"]
    assert f"samples of {folder}/other.csv (data {later['data'][:12]})" in out
    assert "Its residuals pass: white (p = " in out
    _, part, _ = run("validate other.csv --model model.json --to 10", folder, capsys)
    assert "estimated from 398 samples, validated on 200 samples of " in part


@pytest.mark.parametrize(
    "line",
    sampled(
        [
            "identify data.csv --structure arx --na 2 --nb 2",
            "identify data.csv --structure arx --na 2 --nb 2 --save saved.json",
            "identify data.csv --structure arx --save saved.json --validate other.csv",
            "validate data.csv --model next.json",
            "check data.csv",
            "sampling data.csv",
        ],
        4,
    ),
)
def test_each_command_ends_with_a_line_for_the_same_columns(
    line: str, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    armrig.arx(made(), na=2, nb=2).save(folder / "next.json")

    assert main([*line.split(), "--input", "u", "--to", "15"]) == 0

    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("next: armrig ")
    assert "--input u" in last
    assert "--to 15" in last
    assert main(shlex.split(last)[2:]) == 0


def test_a_signal_that_is_given_is_what_the_model_is_of(
    tmp_path: Path, three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("temp", "T2"):
        path = write(tmp_path / f"{name}.csv", made(seed=len(name)))
        path.write_text(path.read_text().replace("t;u;y", f"t;u;{name}"))
    run("identify temp.csv --signal temp --structure arx --save temp.json", tmp_path, capsys)
    armrig.arx(armrig.Dataset(u=made().u, y=made().y, Ts=0.01), na=2, nb=2).save(
        tmp_path / "y.json"
    )

    without = run("validate T2.csv --model temp.json", tmp_path, capsys)
    given = run("validate T2.csv --model temp.json --signal T2", tmp_path, capsys)
    angle = main(["validate", str(three_recordings[1]), "--model", str(tmp_path / "y.json")])

    assert without[0] == 1
    assert "signal temp: there is no such column; give --signal a name or a number" in without[2]
    assert given[0] == angle == 0


def test_a_search_tries_the_structures_on_them(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = "identify data.csv --search --max-order 2 --validate other.csv"

    found = facts(line, folder, capsys)

    assert found["search"]["models"]
    assert found["validation"]["p_no_dynamics_missing"] > 0.01


def test_a_search_tries_a_direct_term_where_the_data_show_one(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    u = made().u
    y = lfilter([1.0, 0.2], [1, -0.8], u) + 0.01 * np.random.default_rng(1).standard_normal(u.size)
    write(folder / "direct.csv", armrig.Dataset(u=u, y=y, Ts=0.5))
    line = "identify direct.csv --search --structure arx --max-order 2 --Ts 0.5"

    assert facts(line, folder, capsys)["orders"]["nk"] == 0
    assert facts(f"{line} --nk 1", folder, capsys)["orders"]["nk"] == 1


def test_feedback_and_delay_are_looked_for_in_them(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = facts("check data.mat", folder, capsys)
    _, out, _ = run("check data.mat", folder, capsys)

    assert found["delay"]["nk"] == armrig.delay(made()).nk == 1
    assert found["open_loop"]["p_value"] == armrig.open_loop(made()).p_value
    assert "handout" not in out
    assert out.splitlines()[1].startswith("open loop: no feedback found (Sims' F-test of ")


@pytest.mark.exhaustive
def test_hints_say_that_feedback_biases_them(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(1)
    r = np.where(np.cumsum(rng.random(2000) < 0.05) % 2, 1.0, -1.0)
    e = 0.1 * rng.standard_normal(2000)
    u, y, x = np.zeros(2000), np.zeros(2000), 0.0
    for k in range(2000):
        y[k] = x + e[k]
        u[k] = 3 * (r[k] - y[k])
        x = 0.9 * x + 0.1 * u[k]
    write(folder / "loop.csv", armrig.Dataset(u=u, y=y, Ts=TS))

    _, closed, said = run("hints loop.csv", folder, capsys)
    _, free, _ = run("hints data.csv", folder, capsys)

    assert "! feedback: u depends on y (p < 0.001)" in closed
    assert said.splitlines()[-1].startswith("next: armrig check ")
    assert "!" not in free


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


@pytest.mark.parametrize("command", ["identify --structure arx", "hints", "sampling", "check"])
def test_an_output_that_is_constant_is_refused(
    command: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = made()
    write(folder / "constant.csv", armrig.Dataset(u=data.u, y=np.full(400, 3.0), Ts=TS))

    code, out, said = run(f"{command} constant.csv", folder, capsys)

    assert (code, out) == (1, "")
    assert "y is constant, 3, so it responds to no input; give a column that varies" in said


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


@pytest.mark.parametrize(
    "line",
    [
        "identify data.csv --structure arx --plot figure.png",
        "validate other.csv --model plotted.json --plot figure.png",
        "check data.csv --plot figure.png",
    ],
    ids=lambda line: line.split()[0],
)
def test_figures_are_written_as_of_recordings(
    line: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("identify data.csv --structure arx --save plotted.json", folder, capsys)

    code, _, said = run(line, folder, capsys)

    assert code == 0
    assert "figure: " in said
    assert (folder / "figure.png").read_bytes().startswith(b"\x89PNG")
    (folder / "figure.png").unlink()


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


def test_what_is_missing_or_left_out_is_reported(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = write(tmp_path / "gaps.csv", made()).read_text().splitlines()
    lines[100] = lines[100].rpartition(";")[0] + ";"
    lines[200] = "9,95;;1,0"
    (tmp_path / "gaps.csv").write_text("\n".join(lines))

    code, _, said = run("identify gaps.csv --structure arx", tmp_path, capsys)

    assert code == 0
    assert "; 1 samples without y; left out 1 sample without" in said
    assert "399 samples, 0.05 s apart; the input is column u; the signal is column y" in said


def test_a_column_with_the_name_of_the_rigs_angle_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "data.csv", made())
    path.write_text(path.read_text().replace("t;u;y", "t;u;theta_1"))

    run("identify data.csv --signal theta_1 --structure arx", tmp_path, capsys)
    _, _, said = run("identify data.csv --signal theta_1 --structure arx", tmp_path, capsys)

    assert "theta_1 is assumed to be the rig's angle, which integrates its input; if it is" in said


def test_a_signal_of_a_recording_is_chosen_by_name(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(three_recordings[1])

    assert main(["identify", path, "--structure", "arx", "--signal", "alpha"]) == 0

    assert "u [V] to alpha [rad]" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--input u", "--input u applies to other data (.csv, .dat, .mat, .npz); /"),
        ("--Ts 0.01", "--Ts 0.01 applies to other data (.csv"),
        ("--time t", "--time t applies to other data (.csv"),
        ("--signal speed", "--signal speed: a recording has theta_1, alpha, velocity"),
    ],
)
@pytest.mark.parametrize("command", ["identify --structure arx", "check"])
def test_a_recording_says_its_columns_itself(
    command: str,
    options: str,
    said: str,
    three_recordings: tuple[Path, ...],
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main([*command.split(), str(three_recordings[1]), *options.split()]) == 2

    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    "command",
    ["info F", "greybox F", "split F", "simulate F", "report F", "compare F F"],
)
def test_what_needs_a_recording_says_so(
    command: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(folder / "data.csv")

    assert main(command.replace("F", path).split()) == 1

    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith(
        f"armrig: {path}: is not a recording of the rig; give a recording (*.mcap, or"
    )
    assert "hints, identify, validate and check also read other data (.csv, .dat, " in said.err


def test_a_replay_needs_a_recording(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(folder / "data.csv")]) == 1

    assert "not made by armrig; replay reads recordings of armrigd" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["data.log", "data.mcap", "data.xlsx", "data"])
@pytest.mark.parametrize("kind", ["csv", "mat", "npz"])
def test_the_content_and_not_the_suffix_decides_how_a_file_is_read(
    kind: str, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / f"a.{kind}", made()).rename(tmp_path / name)

    found = facts(f"identify ./{name} --structure arx --na 2 --nb 2", tmp_path, capsys)
    fit = armrig.arx(armrig.load_data(tmp_path / name), na=2, nb=2)

    assert [p["value"] for p in found["parameters"].values()] == fit.theta.tolist()


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


def about_20(folder: Path) -> None:
    """Write data about a point of operation, u = 3 and y = 20."""
    data = made()
    write(folder / "level.csv", data.replaced(step=None, u=data.u + 3, y=data.y + 20))


@pytest.mark.exhaustive
def test_means_are_taken_off_where_it_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    about_20(tmp_path)
    write(tmp_path / "data.csv", made())
    line = "level.csv --structure arx --na 2 --nb 2"
    fit = armrig.arx(armrig.detrend(armrig.load_data(tmp_path / "level.csv")), na=2, nb=2)

    _, _, without = run(f"identify {line}", tmp_path, capsys)
    _, _, no_level = run("identify data.csv --structure arx", tmp_path, capsys)
    _, _, taken = run(f"identify {line} --detrend", tmp_path, capsys)
    found = facts(f"identify {line} --detrend", tmp_path, capsys)

    y, u = 20 + made().y.mean(), 3 + made().u.mean()
    means = f"the mean of y is {y:.4g}, the mean of u is {u:.4g}"
    assert means in without
    assert "if y is not 0 at u = 0, subtract the means with --detrend" in without
    _, _, of_oe = run("identify level.csv --structure oe --nb 2 --nf 2", tmp_path, capsys)
    assert "estimate a level with --offset, or subtract the means with --detrend" in of_oe
    _, _, along = run("identify level.csv --structure oe --offset", tmp_path, capsys)
    assert "subtract the means" not in taken + along + no_level
    assert [p["value"] for p in found["parameters"].values()] == fit.theta.tolist()


def test_a_model_without_means_is_validated_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    about_20(tmp_path)
    run("identify level.csv --structure arx --detrend --save m.json", tmp_path, capsys)

    _, _, without = run("validate level.csv --model m.json", tmp_path, capsys)
    _, _, taken = run("validate level.csv --model m.json --detrend", tmp_path, capsys)

    assert (
        "the model was estimated from data minus their means: validate it with --detrend" in without
    )
    assert "the mean of" not in without
    assert "without their means" not in taken


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("--calibration c.toml data.csv", "--calibration applies to recordings; "),
        (
            "data.csv --input volt",
            "input volt: there is no such column; give --input a name or a number of",
        ),
        (
            "data.csv --input 4",
            "input 4: there is no such column; give --input a name or a number of 1 t, ",
        ),
        (
            "data.dat",
            "input u and signal y: there are no such columns, and the sampling time is not known "
            "(or give --Ts, in s); its columns have no names: give --input and --signal and --time",
        ),
        (
            "data.dat --input 2 --signal 3",
            "not known: give it in s (--Ts), or the column of times: its columns have no names: g",
        ),
        ("data.csv --Ts -1", "Ts=-1.0 must be finite and > 0, in s"),
        ("data.csv --Ts nan", "Ts=nan must be finite and > 0, in s"),
        ("data.csv --Ts much", "--Ts much: must be a number"),
        ("nothing.csv", "No such file or directory"),
        ("short.csv", "1 samples are too few"),
        (
            "book.xlsx --input u",
            "is not text, and not of another known kind; armrig reads",
        ),
        (
            "book.xlsx",
            "is not text, and not of another known kind; armrig reads",
        ),
    ],
)
@pytest.mark.parametrize(
    "command", ["identify --structure arx", "validate --model model.json", "check"]
)
def test_a_mistake_is_reported_in_a_line_or_two(
    command: str, line: str, said: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "short.csv").write_text("t;u;y\n0;1;2\n")
    (folder / "book.xlsx").write_bytes(b"\x01\x02\x00\x03")
    armrig.arx(made(), na=2, nb=2).save(folder / "model.json")
    if "short.csv" in line:
        line += " --Ts 1"
        said = "" if command != "identify --structure arx" else said

    code, out, err = run(f"{command} {line}", folder, capsys)

    assert code != 0
    assert out == ""
    assert said in err
    assert 1 <= err.count("\n") <= 2
    assert max(map(len, err.splitlines())) <= 320


def test_the_way_out_of_a_warning_is_an_option(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = made()
    write(tmp_path / "level.csv", data.replaced(step=None, y=data.y + 20))
    shifted = armrig.load_data(tmp_path / "level.csv")
    fit = armrig.oe(shifted, nb=2, nf=2, offset=True, stable=True)
    line = "level.csv --structure oe --nb 2 --nf 2"

    _, without, _ = run(f"identify {line}", tmp_path, capsys)
    found = facts(f"identify {line} --offset --stable", tmp_path, capsys)
    _, arx, _ = run("identify level.csv --structure arx --na 1 --nb 1", tmp_path, capsys)

    assert "which the model cannot represent: estimate it, too (option offset)\n" in without
    assert "remove the means (detrend), or take a structure with the option offset" in arx
    assert [p["value"] for p in found["parameters"].values()] == fit.theta.tolist()
    assert not any("cannot represent" in w for w in found["warnings"])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--structure arx --offset", "--offset goes with --structure armax or oe or bj"),
        ("--search --stable", "--stable does not go with --search, whose models are always stable"),
    ],
)
def test_an_option_of_one_estimate_is_refused_where_it_does_nothing(
    options: str, said: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run(f"identify data.csv {options}", folder, capsys)

    assert (code, out) == (2, "")
    assert said in err


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


def test_a_check_of_own_data_speaks_of_their_output(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run("check data.csv --verbose", folder, capsys)

    assert code == 0
    assert "before y has moved, all coefficients are small" in out
    assert "arm" not in out
    assert "rig" not in out


@pytest.mark.exhaustive
def test_hints_name_the_next_command_for_the_same_columns(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    columns = ["--input", "u", "--signal", "y", "--Ts", "0.1", "--to", "30"]

    assert main(["hints", "data.csv", *columns]) == 0
    [line] = [x for x in capsys.readouterr().err.splitlines() if x.startswith("next: ")]

    assert "--input u --signal y --Ts 0.1 --to 30" in line
    assert main(shlex.split(line)[2:]) == 0
