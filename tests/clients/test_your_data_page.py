"""docs/your-data.md: every command runs, its output begins as shown, and each message appears."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig.cli import main

from tests.clients import pages

PAGE = pages.DOCS / "your-data.md"
_BLOCK = re.compile(r"```(python|sh|text)\n(.*?)```", re.DOTALL)
_ARX = ["--structure", "arx", "--na", "1", "--nb", "1"]
_MINE = "time,voltage,speed"
_U = [k * k // 31 % 2 + 1 for k in range(120)]
_Y = np.convolve([0, *_U], 0.9 ** np.arange(120))[:120] + np.random.default_rng(1).normal(
    0, 0.01, 120
)
_SAMPLES = [(k, u, y) for k, (u, y) in enumerate(zip(_U, _Y, strict=True))]


def _rows(*, first: float = 0.0, Ts: float = 0.1) -> list[str]:
    return [f"{first + Ts * k:.2f},{u},{y:.2f}" for k, u, y in _SAMPLES]


def _text(rows: list[str], names: str = _MINE) -> str:
    return "\n".join((names, *rows)) + "\n"


@pytest.mark.exhaustive
@pytest.mark.parametrize(("page", "expected"), [("your-data", (8, 4)), ("files", (2, 1))])
def test_every_line_of_the_page_prints_the_output_shown_there(
    page: str,
    expected: tuple[int, int],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", str(tmp_path))
    u = np.random.default_rng(2).integers(1, 3, 400)
    y = np.convolve([0, *u], 0.9 ** np.arange(400))[:400]
    rows = [f"{0.1 * k:.1f},{a},{b:.2f}" for k, (a, b) in enumerate(zip(u, y, strict=True))]
    Path("mine.csv").write_text(_text(rows))
    names: dict[str, Any] = {}
    commands = compared = 0
    printed = ""

    for language, text in _BLOCK.findall((pages.DOCS / f"{page}.md").read_text(encoding="utf-8")):
        if language == "text":
            assert printed.startswith(text)
            compared += 1
            continue
        if language == "python":
            exec(compile(text, page, "exec"), names)
        lines = text.splitlines() if language == "sh" else []
        refused = [line for line in lines if main(shlex.split(line)[1:])]
        assert refused == []
        commands += len(lines)
        printed = capsys.readouterr().out

    assert (commands, compared) == expected
    assert page == "files" or (tmp_path / "heater.png").stat().st_size > 0


_NAMED = ["--input", "voltage", "--signal", "speed"]
_LATE = [*_rows()[:50], "5.03,1,9.00", *_rows()[51:]]
_UNEVEN = [f"{0.1 * k + 0.03 * (k % 3):.2f},{r.partition(',')[2]}" for k, r in enumerate(_rows())]
_COMMAS = [f"{k};{u};{y + 1.4:.3f}".replace(".", ",") for k, u, y in _SAMPLES]
_CHANGES = [f"{k},{u if k % 7 == 0 else ''},{y:.2f}" for k, u, y in _SAMPLES]
_SUMMER = [f"2024-03-31T0{1 + 2 * (k > 59)}:{k % 60:02}:00,{u},1.{k}" for k, u in enumerate(_U)]
_RAILS = [f"{0.1 * k:.1f},{u},{min(1023, round(65 * y))}" for k, u, y in _SAMPLES]
_TURNS = [f"{0.1 * k:.1f},{u},{3000 * sum(_U[:k]) % 65536}" for k, u in enumerate(_U)]
_LEVEL = [f"{0.1 * k:.1f},{u},{50 + y:.2f}" for k, u, y in _SAMPLES]
_CLOCK = [f"{9 + k // 3600:02}{k // 60 % 60:02}{k % 60:02},{u},{y:.2f}" for k, u, y in _SAMPLES]
_STUCK = [f"{0.1 * k:.1f},{u},{2.2 if 30 <= k < 110 else y:.2f}" for k, u, y in _SAMPLES]
_WRONG = [*_rows()[:60], "6.00,1,99.00", "6.10,1,77.00", *_rows()[62:]]

_CASES: dict[str, tuple[str | bytes, list[str], list[str] | None]] = {
    "there is no such column": (_text(_rows()), _NAMED[:2], _NAMED),
    "there are no such columns": (_text(_rows()), [], _NAMED),
    "its columns have no names": (
        "\n".join(_rows()),
        [*_NAMED, "--Ts", "1"],
        ["--input", "2", "--signal", "3", "--Ts", "1"],
    ),
    "the sampling time is not known": (
        _text(_rows(), "x,voltage,speed"),
        _NAMED,
        [*_NAMED, "--time", "x"],
    ),
    "… cells (separated by …": ("Rig,3,3\n" * 8 + _text([*_rows(), "12.00,1"]), _NAMED, _NAMED),
    "is not a number": (_text(["0.00,off,0.00", *_rows(first=0.1)]), _NAMED, _NAMED),
    "is not text": (b"\0\x9c7,2\n" + _text(_rows()).encode(), _NAMED, _NAMED),
    "is not UTF-8": (_text(_rows(), f"{_MINE} [°]").encode("latin1"), _NAMED, _NAMED),
    "may be 1.493 or 1493": (
        _text(["0;1;1,493", *_COMMAS[1:]], _MINE.replace(",", ";")),
        _NAMED,
        [*_NAMED, "--decimal", ","],
    ),
    "u has a value in … of … rows": (
        _text(_CHANGES, "t,u,speed"),
        _NAMED[2:],
        [*_NAMED[2:], "--hold-input"],
    ),
    "is not a time": (_text([f"no {row}" for row in _rows()]), _NAMED, [*_NAMED, "--Ts", "0.01"]),
    "as digits of a clock": (_text(_CLOCK), _NAMED, [*_NAMED, "--Ts", "1"]),
    "… intervals are not the usual …": (_text(_UNEVEN), _NAMED, [*_NAMED, "--resample"]),
    "version 7.3": (b"MATLAB 7.3 MAT-file", [], None),
    "only MATLAB reads": (b"MATLAB 7.3 MAT-file", [], None),
    "Excel workbook": (b"\xd0\xcf\x11\xe0", [], None),
    "have no unit: read as s": (_text(_rows(Ts=2.0)), _NAMED, _NAMED),
    "read as late rows of the same grid": (_text(_LATE), _NAMED, None),
    "put in … missing row": (_text(_rows()[:50] + _rows()[51:]), _NAMED, None),
    "a gap of …": (_text(_rows() + _rows(first=99.0)), _NAMED, None),
    "the time goes back": (_text(_rows() + _rows()), _NAMED, None),
    "the clock goes forward by 1 h": (_text(_SUMMER), _NAMED, None),
    "used the given Ts = …": (_text(_rows()), [*_NAMED, "--Ts", "1"], _NAMED),
    "… samples … are exactly 1023": (_text(_RAILS), _NAMED, [*_NAMED, "--mask-rails"]),
    "jumps by 65536": (_text(_TURNS), _NAMED, [*_NAMED, "--unwrap", "65536"]),
    "needs a level": (_text(_LEVEL), _NAMED, [*_NAMED, "--detrend"]),
    "is taken as …": (_text(_rows()), _NAMED, None),
    "in sequence": (_text(_STUCK), _NAMED, None),
    "look wrong": (_text(_WRONG), _NAMED, [*_NAMED, "--hampel"]),
}
"""File, options with which armrig prints the message, and options of the remedy, by message."""


def _remedies() -> dict[str, str]:
    """Return the remedy in the row of each message of the page's tables."""
    text = PAGE.read_text(encoding="utf-8").partition("## My file is refused")[2]
    remedies = {}
    for line in re.findall(r'^\| ".*', text, re.MULTILINE):
        message, *_, remedy = line.strip("| ").split(" | ")
        remedies |= dict.fromkeys(re.findall('"(.+?)"', message), remedy)
    return remedies


def test_each_message_of_the_page_has_a_case() -> None:
    assert _remedies().keys() == _CASES.keys()


@pytest.mark.parametrize("message", _CASES)
def test_armrig_prints_a_message_of_the_page_and_its_remedy_helps(
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ARMRIG_RECORDING_DIRECTORY", str(tmp_path))
    content, before, after = _CASES[message]
    remedy = _remedies()[message]
    Path("mine.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    said = re.compile(".*".join(map(re.escape, message.split("…"))))
    command = ["hints"] if message == "is taken as …" else ["identify", *_ARX]

    def read(options: list[str], name: str) -> int:
        """Import the file, and give the options of the data to the command."""
        of_data = [option for option in options if option in ("--detrend", "--hampel")]
        of_file = [option for option in options if option not in of_data]
        refused = main(["import", "mine.csv", "--name", name, *of_file])
        roles = [] if "--input" in of_file or "--signal" not in of_file else of_file[:2]
        return refused or main([*command, f"@{name}", *roles, *of_data])

    refused = read(before, "before")

    assert said.search("".join(capsys.readouterr()))
    if after is None:
        return
    for line in re.findall(r"`([^`]+ > new.csv)`", remedy):
        subprocess.run(f"{line}; mv new.csv mine.csv", shell=True, check=True)
    assert all(option in remedy for option in after if option not in before and option[0] == "-")
    assert read(after, "after") == 0
    assert refused or not said.search("".join(capsys.readouterr()))


def test_every_kind_of_file_of_the_page_is_read() -> None:
    from armrig.data.files import DATA

    table = PAGE.read_text(encoding="utf-8").partition("## What is read")[2].splitlines()
    kinds = "".join(line for line in table if line.startswith("| `"))

    assert set(re.findall(r"`(\.[a-z]+)`", kinds)) == set(DATA)
