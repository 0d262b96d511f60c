"""The handout's report: cover, a section for each assignment, and at most ten pages."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

from armrig.numerics.quantities import milliseconds
from armrig.report.conclusions import calibration_sentences
from armrig.report.handout_figures import write_handout_figures
from armrig.report.handout_study import HandoutStudy
from armrig.report.identification_sections import identification_sections
from armrig.report.physical_sections import numerical_sections, physical_sections
from armrig.report.section import Section
from armrig.report.typesetting import ReportError, recorded, typeset

MOST_PAGES = 10
"""Of the handout, its cover included (section 5)."""
_NAMED = 3  # sections that are named where there are too many pages


class TooLongError(ReportError):
    """More pages than the handout allows; names the longest sections."""


def handout_report(study: HandoutStudy, output: str | Path, *, remarks: Sequence[str] = ()) -> Path:
    """Typeset the handout's report at `output`, and return the path.

    Each assignment from 2.1 to 4.4 has a section with the handout's number: first what was found,
    then how, and a place for reasons of one's own. What no recording says is marked, with the
    command that fills it. The cover has the handout's fields, as blanks.

    Parameters
    ----------
    remarks : sequence of str
        Sentences that a reader must know, such as what was emulated.

    Raises
    ------
    TooLongError
        There are more than `MOST_PAGES`.
    OSError
        The PDF cannot be written.
    """
    output = Path(output)
    sections = [
        *physical_sections(study),
        *identification_sections(study),
        *numerical_sections(study),
    ]
    with tempfile.TemporaryDirectory(prefix="armrig-handout-") as directory:
        root = Path(directory)
        figures = write_handout_figures(study, root)
        values = _values(study, sections, figures, remarks)
        pdf, places = typeset(root, "handout.typ", values, recorded(study.recordings), "place")
    check_length(places)
    output.write_bytes(pdf)
    return output


def _values(
    study: HandoutStudy,
    sections: Sequence[Section],
    figures: frozenset[str],
    remarks: Sequence[str],
) -> dict[str, Any]:
    """Return what the template says, as text: see handout.typ."""
    return {
        "version": version("armrig"),
        "sections": [
            asdict(s) | {"figure": s.figure if s.figure in figures else ""} for s in sections
        ],
        "recordings": [
            (
                r.path.name,
                r.manifest.experiment,
                f"{r.N} at {milliseconds(r.Ts)}, {r.missing} missing",
                r.short_hash,
            )
            for r in study.recordings
        ],
        "remarks": [*remarks, *calibration_sentences(study.recordings)],
    }


def check_length(places: Sequence[tuple[str, float]]) -> None:
    """Refuse more than `MOST_PAGES`, and name the longest sections.

    Parameters
    ----------
    places : sequence of (str, float)
        Where each section begins, and last where the document ends: page, from 1, and the share of
        it that is above.
    """
    pages = int(places[-1][1])
    if pages <= MOST_PAGES:
        return
    lengths = {name: end - begin for (name, begin), (_, end) in pairwise(places)}
    longest = sorted(lengths, key=lambda name: -lengths[name])[:_NAMED]
    named = ", ".join(f"{name} ({lengths[name]:.1f})" for name in longest)
    msg = (
        f"the report has {pages} pages, and the handout allows {MOST_PAGES}; the longest sections "
    )
    msg += f"are {named}: give fewer recordings, or models of lower order (--na, --nb, --nf)"
    raise TooLongError(msg)
