"""docs/deviations.md: its Python runs, and prints what the page shows."""

from __future__ import annotations

import pytest

from tests.clients import pages


@pytest.mark.exhaustive
def test_the_page_runs_and_prints_what_it_shows(capsys: pytest.CaptureFixture[str]) -> None:
    assert pages.run(pages.DOCS / "deviations.md", capsys, atol=1e-4) == 3
