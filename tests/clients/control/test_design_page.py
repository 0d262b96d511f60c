"""docs/design.md: its Python and its command print what the page shows."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.clients import pages


def test_each_program_of_the_page_prints_the_text_below_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)

    assert pages.run(pages.DOCS / "design.md", capsys, atol=2e-3, commands="armrig") == 4
    assert (tmp_path / "law.png").stat().st_size > 0
