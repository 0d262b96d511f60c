"""The pages hold no gap that somebody meant to fill."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_no_page_has_a_placeholder() -> None:
    """Such as @FIGURE@ or TODO."""
    pages = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("firmware_protocol/*.md")]
    found = {p.name: re.findall(r"@[A-Z]+@|\bTODO\b|\bMEASURE\b", p.read_text()) for p in pages}

    assert len(pages) > 10
    assert {name: gaps for name, gaps in found.items() if gaps} == {}
