"""docs/handout.md: every line of Python runs, and prints what stands below it."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig.cli import app

PAGE = Path(__file__).parents[2] / "docs" / "handout.md"
_BLOCK = re.compile(r"```(python|text)\n(.*?)```", re.DOTALL)
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a directory with the recordings that the page speaks of."""
    script_path = PAGE.parent / "figures" / "handout.py"
    found = importlib.util.spec_from_file_location("figures_of_the_handout", script_path)
    assert found is not None
    assert found.loader is not None
    script: Any = importlib.util.module_from_spec(found)
    found.loader.exec_module(script)
    folder = tmp_path_factory.mktemp("page")
    script.record_all(folder)
    return folder


def test_every_line_of_the_page_runs_and_prints_what_it_says(
    recordings: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same words; of the numbers the last digit may be another machine's."""
    monkeypatch.chdir(recordings)
    names: dict[str, Any] = {}
    printed, compared = "", 0
    for language, text in _BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        if language == "python":
            exec(compile(text, str(PAGE), "exec"), names)
            printed = capsys.readouterr().out
            continue
        assert _words(printed) == _words(text)
        np.testing.assert_allclose(_numbers(printed), _numbers(text), rtol=0.05, atol=2e-3)
        compared += 1

    assert compared == 9


def test_every_assignment_is_there() -> None:
    """In the table, and from 3.1 on with a chapter."""
    text = PAGE.read_text(encoding="utf-8")
    chapters = re.findall(r"^## (\d\.\d)", text, re.MULTILINE)

    assert chapters == [*(f"3.{k}" for k in range(1, 9)), "4.1"]
    assert "| 2.1–2.3 |" in text
    assert "| 4.1–4.4 |" in text


def test_every_command_of_the_table_exists() -> None:
    """Under the name that the page gives it."""
    text = PAGE.read_text(encoding="utf-8")
    known = {c.callback.__name__ for c in app.registered_commands if c.callback}
    known |= {group.name for group in app.registered_groups}

    assert set(re.findall(r"`armrig ([a-z]+)", text)) <= known


def test_every_figure_of_the_page_is_there() -> None:
    """As many as the script draws, and none besides."""
    shown = set(re.findall(r"\]\(figures/(.+?)\)", PAGE.read_text(encoding="utf-8")))

    assert shown == {path.name for path in (PAGE.parent / "figures").glob("handout-*.svg")}


def _words(text: str) -> str:
    return " ".join(_NUMBER.sub("#", text).split())


def _numbers(text: str) -> list[float]:
    return [float(x) for x in _NUMBER.findall(text)]
