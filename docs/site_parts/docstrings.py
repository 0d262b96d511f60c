"""Escapes for vertical bars in docstrings: reStructuredText would substitute a text for |G|."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any


def with_bars(lines: Iterable[str]) -> Iterator[str]:
    """Yield the lines of a docstring, with a backslash before each bar outside literal text."""
    literal_below: int | None = None
    in_example = False
    for line in lines:
        indent = len(line) - len(line.lstrip())
        in_example = bool(line.strip()) and (in_example or line.lstrip().startswith(">>> "))
        if literal_below is not None and line.strip() and indent <= literal_below:
            literal_below = None
        if in_example or literal_below is not None:
            yield line
            continue
        if line.rstrip().endswith("::"):
            literal_below = indent
        parts = line.split("``")
        parts[::2] = [part.replace("|", "\\|") for part in parts[::2]]
        yield "``".join(parts)


def _escape(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    lines[:] = with_bars(lines)


def setup(app: Any) -> dict[str, bool]:
    """Escape the bars of each docstring that Sphinx reads, before numpydoc reads it."""
    app.connect("autodoc-process-docstring", _escape, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
