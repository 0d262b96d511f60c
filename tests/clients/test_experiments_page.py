"""docs/experiments.md: every line of Python runs, and prints what stands below it."""

from __future__ import annotations

import importlib.util
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig.cli import main
from armrig_core import commands
from fake_daemon import FakeDaemon

PAGE = Path(__file__).parents[2] / "docs" / "experiments.md"
_BLOCK = re.compile(r"```(python|text)\n(.*?)```", re.DOTALL)
_HASH = re.compile(r"\b[0-9a-f]{12}\b")
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a directory with the recordings that the page speaks of."""
    found = importlib.util.spec_from_file_location(
        "figures_of_experiments", PAGE.parent / "figures" / "experiments.py"
    )
    assert found is not None
    assert found.loader is not None
    script: Any = importlib.util.module_from_spec(found)
    found.loader.exec_module(script)
    folder = tmp_path_factory.mktemp("page")
    script.record_all(folder)
    return folder


def without_numbers(text: str) -> str:
    """Return the words; of a hash nothing is left."""
    return " ".join(_NUMBER.sub("#", _HASH.sub("", text)).split())


def numbers(text: str) -> list[float]:
    """Return the numbers of a text, those in hashes left out."""
    return [float(x) for x in _NUMBER.findall(_HASH.sub("", text))]


def test_every_line_of_the_page_runs_and_prints_what_it_says(
    recordings: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same words; of the numbers the last digit may be another machine's."""
    from matplotlib import pyplot as plt

    monkeypatch.chdir(recordings)
    names: dict[str, Any] = {}
    printed, compared = "", 0
    for language, text in _BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        if language == "python":
            exec(compile(text, str(PAGE), "exec"), names)
            printed = capsys.readouterr().out
            continue
        assert without_numbers(printed) == without_numbers(text)
        np.testing.assert_allclose(numbers(printed), numbers(text), rtol=0.05, atol=1e-6)
        compared += 1
    plt.close("all")

    assert compared == 11


def test_every_command_of_the_page_is_taken(daemon: FakeDaemon, where: str) -> None:
    """By the command line, to its end."""
    text = PAGE.read_text(encoding="utf-8")
    lines = re.findall(r"^armrig .+$|`(armrig collect [a-z]+ --.+?)`", text, re.MULTILINE)
    blocks = re.findall(r"```sh\n(.+?)\n```", text)

    for line in (*blocks, *filter(None, lines)):
        assert main([*shlex.split(line)[1:], "--connect", where]) == 0

    played = [r.experiment for r in daemon.asked if isinstance(r, commands.Run)]
    names = ["step-first", "blackbox-monday", "blackbox-validation-monday"]
    assert played == [*names, *["bla"] * 4]


def test_every_figure_of_the_page_is_there() -> None:
    """As many as the script draws, and none besides."""
    shown = set(re.findall(r"\]\(figures/(.+?)\)", PAGE.read_text(encoding="utf-8")))

    assert shown == {path.name for path in (PAGE.parent / "figures").glob("experiments-*.svg")}
