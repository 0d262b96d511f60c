"""The handout's report: cover, a section for each assignment, and at most ten pages."""

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
from armrig.recordings.doubts import different_calibrations, early_ends, emulation
from armrig.report.answers import QUESTIONS, Answers
from armrig.report.conclusions import calibration_sentences
from armrig.report.handout_figures import write_handout_figures
from armrig.report.handout_study import HandoutStudy
from armrig.report.identification_sections import identification_sections
from armrig.report.physical_sections import numerical_sections, physical_sections
from armrig.report.recording_facts import notes, run_name
from armrig.report.section import Section
from armrig.report.typesetting import recorded, source_folder, typeset

TEMPLATE = "handout.typ"
MOST_PAGES = 10
"""Of the handout, its cover included (section 5)."""
_NAMED = 3  # sections that are named where there are too many pages


def handout_report(
    study: HandoutStudy,
    output: str | Path,
    *,
    answers: Answers | None = None,
    source: Path | None = None,
) -> Path:
    """Typeset the handout's report at `output`, and return the path.

    Each assignment from 2.1 to 4.4 has a section with the handout's number: the result, the method,
    and the student's reasons, or a blank for them. A section without a recording names the command
    that makes one. The cover has the handout's fields.

    Parameters
    ----------
    answers : Answers, optional
        Names for the cover, and reasons.
    source : Path, optional
        New folder for the report's Typst source, its values and its figures.

    Raises
    ------
    OperationError
        There are more than `MOST_PAGES`; the source is written all the same.
    OperationError
        The folder of the source contains files already.
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
    """Return what the template says, as text: see handout.typ."""
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
    """Return the paragraphs of a text, each in one line; an empty line begins a paragraph."""
    return [" ".join(part.split()) for part in re.split(r"\n\s*\n", text) if part.strip()]


def check_length(places: Sequence[tuple[str, float]]) -> None:
    """Refuse more than `MOST_PAGES`, and name the longest sections.

    Parameters
    ----------
    places : sequence of (str, float)
        Where each section begins, and last where the document ends: page, from 1, and the share of
        it that is above.
    """
    if not places:
        raise OperationError(
            f"{TEMPLATE}: has no #mark of a section, which tells how long it is: leave them in"
        )
    pages = int(places[-1][1])
    if pages <= MOST_PAGES:
        return
    lengths = {name: end - begin for (name, begin), (_, end) in pairwise(places)}
    longest = sorted(lengths, key=lambda name: -lengths[name])[:_NAMED]
    named = ", ".join(f"{name} ({lengths[name]:.1f})" for name in longest)
    raise OperationError(
        f"the report has {pages} pages, and the handout allows {MOST_PAGES}; the longest sections "
        f"are {named}: shorten your reasons, or give models of lower order (--na, --nb, --nf)"
    )
