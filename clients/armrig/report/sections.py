"""Contents of a report as values: sections of texts, tables and figures, without their layout."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from string import ascii_uppercase

Draw = Callable[..., object]
"""Function that draws into the axes `ax`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportTable:
    """Table of texts, with a heading for each column."""

    caption: str
    """Caption of the table, with the quantities in it."""
    header: tuple[str, ...]
    """A heading for each column."""
    rows: tuple[tuple[str, ...], ...]
    """Rows of the table; each row has a text for each column."""
    name: str = ""
    """Name for references; "" if no text refers to the table."""
    numeric: bool = True
    """True if short texts are aligned right, except those of the first column."""


@dataclass(frozen=True, slots=True)
class ReportFigure:
    """Figure, which is drawn into a file next to the template."""

    name: str
    """Name for references, and name of the file without ".svg"."""
    caption: str
    """Caption of the figure, with the quantities on its axes."""
    height: float
    """Height in inches."""
    draws: tuple[Draw, ...] = field(repr=False)
    """Function for each panel; a row has two panels, or three of an odd number."""
    floats: bool = True
    """True if the figure may move to the top of a page, so that no page is half empty.

    After such a figure, all figures move: otherwise a figure could overtake the one before it.
    """


def figure(
    name: str, caption: str, height: float, *draws: Draw, floats: bool = True
) -> tuple[ReportFigure]:
    """Return the figures of a section with one figure."""
    return (ReportFigure(name, caption, height, draws, floats),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """Section of a report: its parts are typeset in the order of the fields."""

    number: str = ""
    """Number of the section, such as "2.1"; a letter begins the appendix."""
    title: str = ""
    """Title of the section; "" for no heading."""
    level: int = 1
    """Level of the heading: 2 for a section of a section of level 1."""
    warnings: tuple[str, ...] = ()
    """Warnings, which have a frame."""
    lack: str = ""
    """Reason why there is no result, and the command that makes it; "" if there is a result."""
    lead: str = ""
    """Bold text before the first paragraph."""
    paragraphs: tuple[str, ...] = ()
    """Paragraphs; "$" encloses a formula of Typst, and "<name>" refers to a table or a figure.

    Texts of others, such as the name of a run, must pass `plain`.
    """
    tables: tuple[ReportTable, ...] = ()
    side_by_side: bool = False
    """True if a row has two tables."""
    figures: tuple[ReportFigure, ...] = ()
    points: tuple[str, ...] = ()
    """List of texts without formulas and references."""
    asks: str = ""
    """Reasons that the reader of the section must give; "" for none."""
    reasons: tuple[str, ...] = ()
    """Paragraphs of the given reasons: a student's own words, without markup."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cover:
    """First page of a report that somebody hands in."""

    above: str
    """Text above the title, such as the name of a course."""
    kind: str
    """Kind of the report, in the first line of its title."""
    below: tuple[str, ...]
    """Lines below the title."""
    fields: tuple[tuple[str, str], ...]
    """Names of lines to fill in, each with its text or ""."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Contents:
    """Contents of a report."""

    title: str
    subtitle: str = ""
    """Line below the title; "" for none."""
    cover: Cover | None = None
    """First page; None if the sections begin on the first page."""
    front: Section
    """Section without a heading before the other sections."""
    sections: tuple[Section, ...]


def number_sections(
    sections: Iterable[Section], appendix: Iterable[Section]
) -> tuple[Section, ...]:
    """Return sections with the numbers 1, 2, …, then those of the appendix: A, B, …."""
    return (
        *(replace(s, number=str(k)) for k, s in enumerate(sections, 1)),
        *(replace(s, number=k) for k, s in zip(ascii_uppercase, appendix, strict=False)),
    )


def plain(text: str) -> str:
    """Return a text of others without the signs that a paragraph reads as markup."""
    return text.replace("$", "").replace("<", "")
