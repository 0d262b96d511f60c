"""A section of the handout's report: the answer to one assignment."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Numbers under headings."""

    header: tuple[str, ...]
    """A heading for each column."""
    rows: tuple[tuple[str, ...], ...]
    """Texts, as many in each row."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """What is said of one assignment; the answer comes first."""

    number: str
    """The handout's, such as 3.5."""
    answer: tuple[str, ...] = ()
    """Paragraphs; the first has the numbers."""
    formula: str = ""
    """In Typst's mathematics, after the first paragraph."""
    table: Table | None = None
    """After the paragraphs."""
    figure: str = ""
    """Name of the figure, or none."""
    caption: str = ""
    """Of the figure."""
    fill: str = ""
    """Command that makes what the section lacks; without an answer only."""
    lack: str = ""
    """Why there is no answer."""
