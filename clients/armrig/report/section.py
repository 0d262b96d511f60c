"""A section of the handout's report: the answer to one assignment."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Table of texts, with a heading for each column."""

    caption: str
    """Caption of the table, with the quantities in it."""
    header: tuple[str, ...]
    """A heading for each column."""
    rows: tuple[tuple[str, ...], ...]
    """Rows of the table; each row has a text for each column."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """Section on one assignment: text, tables and figure, or a reason for no answer."""

    number: str
    """Number of the assignment in the handout, such as 3.5."""
    answer: tuple[str, ...] = ()
    """Paragraphs; the first contains the numbers. As in Typst, "$" encloses a formula."""
    tables: tuple[Table, ...] = ()
    """Tables after the paragraphs."""
    figure: str = ""
    """Name of the figure; "" for no figure."""
    caption: str = ""
    """Caption of the figure."""
    fill: str = ""
    """Command that makes the missing recording; "" if there is an answer."""
    lack: str = ""
    """Reason why there is no answer; "" if there is an answer."""
