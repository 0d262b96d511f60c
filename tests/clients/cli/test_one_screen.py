"""The answer of a command fits a screen of 80 columns; --verbose prints the rest."""

from __future__ import annotations

from pathlib import Path

import pytest
from armrig.cli import main, options

from tests.sampling import without_slow

COLUMNS, LINES = 80, 24
SHORT = 14
"""Most lines of the commands below `short`."""
# By command: its arguments, what its answer begins with, and what only --verbose says.
COMMANDS = {
    "info": ("info {1}", "verdict", "sha256"),
    "identify": (
        "identify {1} --structure oe --integrator --validate {2}",
        "OE(nb=4, nf=4, nk=1) fits theta_1 to",
        "starts agree",
    ),
    "identify with warnings": (
        "identify {1} --structure arx --na 4 --nb 4 --validate {2}",
        "ARX(na=4, nb=4, nk=1) fits theta_1 to",
        "FPE",
    ),
    "identify with four polynomials": (
        "identify {1} --structure bj --nc 2 --nd 2 --integrator",
        "BJ(nb=4, nc=2, nd=2, nf=4, nk=1) fits theta_1 to",
        "FPE",
    ),
    "short sampling": ("sampling {0}", "sampling time: ", "step analysis of"),
    "short sampling without a step": ("sampling {1}", "sampling time: ", "  aliasing:"),
    "short simulate": (
        "simulate {2} --model model.json --set J_1=0.002",
        "handout is closest",
        "determines the first rise",
    ),
    "short simulate without a recording": ("simulate", "Steady speed", "back-EMF"),
    "short integrate": ("integrate", "least work for", "Accuracy decides"),
    "validate": (
        "validate {2} --model model.json",
        "Simulated, OE(nb=4, nf=4, nk=1) fits theta_1 to",
        "no dynamics missing: p",
    ),
    "short compare": ("compare {1} {2}", "physics is closest", "poles [1/s]"),
    "check": ("check {1} --level 0.001", "open loop (handout 3.7): no feedback found", "Question:"),
    "greybox": ("greybox {1}", "J_1 = ", "robust"),
    "split": ("split {1} --parts 1,2", "From 1 to 2 parts", "Each sample adds its share"),
}


SLOW = {"short compare", "identify with four polynomials"}


@pytest.mark.parametrize("command", without_slow(COMMANDS, lambda command: command in SLOW))
def test_an_answer_comes_first_and_fits_a_screen(
    command: str,
    three_recordings: tuple[Path, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(options, "_columns", lambda stream: COLUMNS)
    if "model.json" in COMMANDS[command][0]:
        made = ["identify", str(three_recordings[1]), "--structure", "oe", "--integrator"]
        assert main([*made, "--save", "model.json"]) == 0
    line, first, only_verbose = COMMANDS[command]
    arguments = [word.format(*map(str, three_recordings)) for word in line.split()]
    capsys.readouterr()

    assert main(arguments) == 0
    short = capsys.readouterr().out
    assert main([*arguments, "-v"]) == 0
    whole = capsys.readouterr().out

    # A path is not broken.
    lines = [text for text in short.splitlines() if str(tmp_path.parent) not in text]
    assert short.startswith(first)
    assert max(map(len, lines)) <= COLUMNS
    assert len(short.splitlines()) <= (SHORT if command.startswith("short ") else LINES - 1)
    assert only_verbose not in short
    assert only_verbose in whole
