"""Report for the handout: a cover and a section for each assignment, on at most ten pages."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

from armrig_core.errors import OperationError

from armrig.numerics.quantities import milliseconds
from armrig.recordings.usability import different_calibrations, early_ends, emulation
from armrig.report.answers import QUESTIONS, Answers
from armrig.report.conclusions import calibration_sentences
from armrig.report.figures import write_handout_figures
from armrig.report.handout_study import HandoutStudy
from armrig.report.identification_sections import identification_sections
from armrig.report.physical_sections import numerical_sections, physical_sections
from armrig.report.recording_facts import notes, run_name
from armrig.report.section import Section
from armrig.report.typesetting import recorded, source_folder, typeset

TEMPLATE = "handout.typ"
MOST_PAGES = 10
"""Number of pages that section 5 of the handout allows, including the cover."""
_MAX_NAMED_SECTIONS = 3


def handout_report(
    study: HandoutStudy,
    output: str | Path,
    *,
    answers: Answers | None = None,
    source: Path | None = None,
) -> Path:
    """Typeset the handout's report at `output`, and return the path.

    Each assignment from 2.1 to 4.4 has a section: the result, the method, and the student's reasons
    or blank space for the reasons. If a recording is missing, the section contains the command that
    makes the recording. The cover has the fields of the handout's cover.

    Parameters
    ----------
    answers : Answers, optional
        Names for the cover, and reasons for the sections.
    source : Path, optional
        New folder for the report's Typst source, its values and its figures.

    Raises
    ------
    OperationError
        The report has more than `MOST_PAGES` pages; its source is written nevertheless.
    OperationError
        The folder of the source already contains files.
    OSError
        The PDF cannot be written.
    """
    output = Path(output)
    sections = [
        *physical_sections(study),
        *identification_sections(study),
        *numerical_sections(study),
    ]
    with source_folder(source) as root:
        figures = write_handout_figures(study, root)
        values = _values(study, sections, figures, answers or Answers())
        pdf, places = typeset(root, TEMPLATE, values, recorded(study.recordings))
    check_length(places)
    output.write_bytes(pdf)
    return output


def _values(
    study: HandoutStudy,
    sections: Sequence[Section],
    figures: frozenset[str],
    answers: Answers,
) -> dict[str, Any]:
    """Return the values for the template handout.typ, with all numbers as text."""
    return {
        "version": version("armrig"),
        "sections": [
            asdict(s)
            | asdict(QUESTIONS[s.number])
            | {
                "figure": s.figure if s.figure in figures else "",
                "reasons": _paragraphs(answers.reasons.get(s.number, "")),
            }
            for s in sections
        ],
        "students": [asdict(student) for student in answers.students],
        "recordings": [
            (
                r.path.name,
                run_name(r),
                f"{r.N} at {milliseconds(r.Ts)}",
                str(r.missing),
                str(r.hidden),
                r.short_hash,
            )
            for r in study.recordings
        ],
        "notes": notes(study.recordings),
        "warnings": different_calibrations(study.recordings),
        "remarks": [
            *emulation(study.recordings),
            *early_ends(study.recordings),
            *calibration_sentences(study.recordings),
        ],
    }


def _paragraphs(text: str) -> list[str]:
    """Split a text into paragraphs at its empty lines, and return each paragraph as one line."""
    return [" ".join(part.split()) for part in re.split(r"\n\s*\n", text) if part.strip()]


def check_length(places: Sequence[tuple[str, float]]) -> None:
    """Refuse more than `MOST_PAGES` pages with an OperationError that names the longest sections.

    Parameters
    ----------
    places : sequence of (str, float)
        Name of each section and the place where it begins: the number of the page, from 1, plus
        the share of this page above the section. The last entry is the end of the document.
    """
    if not places:
        raise OperationError(
            f"{TEMPLATE}: the #mark of each section is missing: keep the marks, because armrig "
            "computes the lengths of the sections from the marks"
        )
    pages = int(places[-1][1])
    if pages <= MOST_PAGES:
        return
    lengths = {name: end - begin for (name, begin), (_, end) in pairwise(places)}
    longest = sorted(lengths, key=lambda name: -lengths[name])[:_MAX_NAMED_SECTIONS]
    named = ", ".join(f"{name} ({lengths[name]:.1f})" for name in longest)
    raise OperationError(
        f"the report has {pages} pages, and the handout allows {MOST_PAGES}; the longest sections "
        f"are {named}: shorten your reasons, or choose lower orders (--na, --nb, --nf)"
    )
