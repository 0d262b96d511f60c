"""docs/several-signals.md: every line runs, and prints the text below it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.clients import pages

PAGE = pages.DOCS / "several-signals.md"


@pytest.mark.exhaustive
def test_every_line_of_the_page_prints_the_output_shown_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pages.record_all("several_signals.py", tmp_path)
    monkeypatch.chdir(tmp_path)

    assert pages.run(PAGE, capsys, atol=2e-3, commands="armrig ") == 7
    assert (tmp_path / "several.svg").stat().st_size > 0
