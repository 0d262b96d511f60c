"""docs/handout.md: every line of Python runs, and prints what stands below it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from armrig.cli import app

from tests.clients import pages

PAGE = pages.DOCS / "handout.md"


@pytest.mark.exhaustive
def test_every_line_of_the_page_prints_the_output_shown_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pages.record_all("handout.py", tmp_path)
    monkeypatch.chdir(tmp_path)

    assert pages.run(PAGE, capsys, atol=2e-3, commands="armrig identify") == 14


def test_the_page_contains_every_assignment() -> None:
    text = PAGE.read_text(encoding="utf-8")
    chapters = re.findall(r"^## (\d\.\d)", text, re.MULTILINE)

    assert chapters == ["2.1", "2.2", "2.3", *(f"3.{k}" for k in range(1, 9)), "4.1"]
    assert "| 2.1–2.3 |" in text
    assert "| 4.1–4.4 |" in text


def test_every_command_of_the_table_exists() -> None:
    text = PAGE.read_text(encoding="utf-8")
    known = {c.callback.__name__ for c in app().registered_commands if c.callback}
    known |= {group.name for group in app().registered_groups}

    named = set(re.findall(r"`armrig ([a-z]+)", text))
    assert {"sampling", "hints", "identify"} <= named <= known


def test_every_figure_of_the_page_exists() -> None:
    shown = set(re.findall(r"\]\(figures/(.+?)\)", PAGE.read_text(encoding="utf-8")))

    assert shown == {path.name for path in (PAGE.parent / "figures").glob("handout-*.svg")}
