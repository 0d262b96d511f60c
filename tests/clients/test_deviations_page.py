"""docs/deviations.md: its Python runs, and prints what the page shows."""

from __future__ import annotations

import pytest

from tests.clients import pages


@pytest.mark.exhaustive
def test_every_line_of_the_page_prints_the_output_shown_there(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert pages.run(pages.DOCS / "deviations.md", capsys, atol=1e-4) == 3
