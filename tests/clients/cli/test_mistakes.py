"""Mistakes that students make on the command line: each is answered with the way out."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from contextlib import redirect_stderr
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest
from armrig.cli import main
from armrig.excitation import step, telegraph

from tests.clients.fake_daemon import FakeDaemon
from tests.clients.made_recordings import of_the_arm, written

TS, N = 0.01, 400


def _table(path: Path, names: str, *columns: object, sep: str = ",", decimal: str = ".") -> None:
    """Write columns below their names; without names that line is missing."""
    rows = zip(*columns, strict=True)  # type: ignore[call-overload]
    lines = [sep.join(f"{x:.6g}".replace(".", decimal) for x in row) for row in rows]
    head = [names.replace(",", sep)] if names else []
    path.write_text("\n".join([*head, *lines]) + "\n")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a folder of recordings and tables, good ones and spoilt ones."""
    folder = tmp_path_factory.mktemp("mistakes")
    recording = of_the_arm(telegraph(1000, 0.05, seed=1))
    written(folder, recording, "est.mcap")
    written(folder, of_the_arm(step(200, at=50), experiment="step"), "step.mcap")
    written(folder, b"", "empty.mcap")
    written(folder, recording[: len(recording) // 2], "run.mcap.active")
    written(folder, b"%PDF-1.7 \xff", "report.pdf")
    rng = np.random.default_rng(1)
    t, u = TS * np.arange(N), 0.5 + 4.0 * rng.integers(0, 2, N)
    y = np.zeros(N)
    for k in range(1, N):
        y[k] = 0.9 * y[k - 1] + 0.1 * u[k - 1] + 0.01 * rng.standard_normal()
    _table(folder / "data.csv", "t,u,y", t, u, y)
    _table(folder / "swapped.csv", "t,u,y", t, y, u)
    _table(folder / "same.csv", "t,u,y", t, u, u)
    _table(folder / "constant.csv", "t,u,y", t, np.full(N, 2.5), y)
    _table(folder / "decimal.csv", "t,u,y", t, u + 0.1, y + 0.001, decimal=",")
    _table(folder / "noheader.csv", "", t, u, y)
    _table(folder / "one.csv", "y", y)
    _table(folder / "noTs.csv", "u,y", u, y)
    _table(folder / "other.csv", "tid,spenning,vinkel", t, u, y)
    (folder / "text.csv").write_text("t,u,y\n0,1,2\n0.01,1,off\n0.02,1,2\n")
    _table(folder / "high.csv", "u", np.full(50, 9.0))
    return folder


@pytest.fixture
def folder(made: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Work in that folder, with no daemon and no recordings."""
    monkeypatch.chdir(made)
    for name, value in (("XDG_RUNTIME_DIR", "run"), ("XDG_DATA_HOME", "share")):
        monkeypatch.setenv(name, str(made / value))
    before = sorted(made.iterdir())
    yield made
    assert sorted(made.iterdir()) == before  # a mistake writes nothing


REFUSED = [
    # A file that is not what was meant.
    ("info last", "did you mean @last?"),
    ("identify last --structure arx", "did you mean @last?"),
    ("info @last", "make one with `armrig collect`"),
    ("info empty.mcap", "is empty, 0 B: nothing was recorded; record again"),
    ("identify run.mcap.active --structure arx", "still being recorded, or the daemon was kill"),
    ("validate est.mcap --model est.mcap", "a model is what `armrig identify --save`"),
    # Arguments that are missing, too many, or in another order.
    ("identify", "F is missing: recording (*.mcap, @last or @NAME)"),
    ("identify est.mcap --structure oe --nb 4 4", "4: superfluous; `armrig identify` takes F"),
    ("model est.mcap", "`armrig model` takes no file"),
    ("stop 1", "1: superfluous; `armrig stop` takes no file, options only"),
    ("compare est.mcap", "give a second recording to validate with"),
    ("identify est.mcap --validate", "--validate is given without a value; see `armrig identify"),
    # Commands and options that there are not.
    ("collect black", "did you mean blackbox"),
    ("identify est.mcap --nb4", "did you mean --nb"),
    ("report est.mcap --out f.pdf", "no such option: --out: did you mean -o PDF?; see"),
    ("ls --out f.txt", "no such option: --out; see `armrig ls --help`"),
    ("glossary inovation", "nearest: innovation"),
    ("glossary box", "nearest: grey box"),
    ("glossary zzzz", "`armrig glossary` lists all terms"),
    ("plot est.mcap --input u", "no such option: --input; see `armrig plot --help`"),
    # Structures and orders.
    ("identify est.mcap --structure OE", "'OE' is not one of 'arx', 'armax', 'oe'"),
    ("identify est.mcap --structure oe --nb=-1", "nb=-1 must be an integer >= 1"),
    ("identify est.mcap --structure arx --nk 0,1", "--nk 0,1: must be an integer; --search"),
    ("identify est.mcap --structure oe --na 4", "an OE model has nb, nf and nk"),
    ("identify data.csv --structure oe --integrator --assume settling", "contradicts --integrator"),
    # Tables.
    ("identify data.csv --structure arx --Ts 0,01", "decimals have a point: 0.01"),
    ("identify est.mcap --structure arx --Ts 0.01", "applies to other data"),
    (
        "identify decimal.csv --structure arx",
        "if decimals have a comma, separate the cells by semi",
    ),
    ("identify text.csv --structure arx", "line 3, column y: 'off' is not a number"),
    (
        "identify noheader.csv --structure arx",
        "give --input and --signal and --time a number from 1 to 3",
    ),
    ("identify one.csv --structure arx", "one column, but an input and an output are needed"),
    ("identify noTs.csv --structure arx", "give it in s (--Ts)"),
    ("identify other.csv --structure arx", "1 tid, 2 spenning, 3 vinkel"),
    ("identify same.csv --structure arx", "y equals u: give the column of the"),
    ("identify constant.csv --structure arx", "u is always 2.5"),
    ("identify data.csv --structure arx --signal u", "input and signal are both column 2"),
    # Where to write.
    ("identify est.mcap --structure arx -o no/f.png", "there is no directory no; create it first"),
    (
        "identify est.mcap --structure arx --save est.mcap",
        "would be overwritten; give another name",
    ),
    ("report", "give recordings to report on"),
    ("report est.mcap -o report.docx", "give a name that ends in .pdf"),
    ("report est.mcap -o report.pdf", "--force overwrites it, or give another name"),
    # The rig, and what it plays.
    ("record --seconds nan --from tcp/nowhere:1", "--seconds nan: must be more than 0"),
    ("collect blackbox --connect localhost", "not a zenoh endpoint, such as"),
    ("collect blackbox --low 4.5 --high 0.5", "low=4.5 V must be below high=0.5 V"),
    ("collect blackbox --high 6", "high=6.0 V is outside the rig's 0 to 5 V"),
    ("collect blackbox --Ts 100", "in seconds; 10 ms are 0.01"),
    ("collect blackbox --input sine", "'telegraph', 'prbs', 'white', 'multisine', 'chirp'"),
    # The physics.
    ("model --set J_2=6e-3kgm2", "give the number alone, in kg m², such as --set J_2=0.0048"),
    ("model --set J_1=-1", "J_1=-1.0 must be finite and > 0"),
    ("greybox est.mcap --free J_1,K_m", "give several names as a sequence"),
    ("integrate --h 10ms", "must be a number without its unit, such as 0.01"),
]


@pytest.mark.parametrize(("line", "way_out"), REFUSED, ids=[line for line, _ in REFUSED])
@pytest.mark.usefixtures("folder")
def test_an_invalid_command_line_is_refused_with_the_remedy(
    line: str, way_out: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(shlex.split(line))

    said = capsys.readouterr()
    assert way_out in said.err
    assert code != 0
    assert said.out == ""
    assert 1 <= said.err.count("\n") <= 2
    assert "Traceback" not in said.err


DOUBTED = [
    ("identify swapped.csv --structure arx", "the columns may be swapped"),
    ("identify data.csv --structure arx --Ts 10", "although the times are 0.01 s apart"),
    ("identify est.mcap --structure arx --validate step.mcap", "validate on another telegraph"),
    (
        "identify est.mcap --structure arx --validate est.mcap",
        "validate on other data",
    ),
]


@pytest.mark.parametrize(("line", "doubt"), DOUBTED, ids=[line for line, _ in DOUBTED])
@pytest.mark.usefixtures("folder")
def test_a_warning_about_the_data_precedes_the_results(
    line: str, doubt: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with redirect_stderr(sys.stdout):  # in the order in which they are written
        code = main(shlex.split(line))

    lines = capsys.readouterr().out.splitlines()
    assert code == 0
    before = list(takewhile(lambda text: text.startswith("armrig: ") or ".csv: " in text, lines))
    assert len(before) < len(lines)
    assert sum(doubt in text for text in before) == 1


def test_a_file_with_voltages_above_5_v_is_not_played(
    folder: Path, where: str, daemon: FakeDaemon, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(["collect", "blackbox", "--file", "high.csv", "--connect", where])

    assert code == 1
    assert "9" in (err := capsys.readouterr().err)
    assert "outside" in err
    assert "run" not in daemon.names()
