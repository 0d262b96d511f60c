"""What one look at data or at a model has found."""

from __future__ import annotations

from armrig.data.finding import Finding


def finding(about: str, text: str, *, good: bool) -> Finding:
    """Return what was found, with a warning's rank where it is not good."""
    return Finding(level="good" if good else "warning", about=about, text=text)
