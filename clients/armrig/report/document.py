"""Reports as PDF: of a study, and for the handout; typst sets text and tables."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path

from armrig_core.errors import OperationError

from armrig.numerics.quantities import join_names, milliseconds, plural
from armrig.recordings.usability import early_ends, emulation, warnings_of
from armrig.report.answers import MAX_STUDENTS, QUESTIONS, Answers, Student
from armrig.report.control_sections import ControlStudy, control_contents
from armrig.report.figures import write_figures
from armrig.report.handout_study import HandoutStudy
from armrig.report.identification_sections import identification_sections
from armrig.report.physical_sections import numerical_sections, physical_sections
from armrig.report.recording_facts import calibration_sentences, notes, run_name
from armrig.report.sections import Contents, Cover, ReportTable, Section
from armrig.report.study import Study, best_first
from armrig.report.study_sections import study_contents
from armrig.report.typesetting import Places, latest_start, source_folder, typeset

MOST_PAGES = 10
"""Number of pages that section 5 of the handout allows, including the cover."""


def report(
    study: Study,
    output: str | Path,
    *,
    remarks: Sequence[str] = (),
    figures: Path | None = None,
    source: Path | None = None,
) -> Path:
    """Typeset a study as a PDF at `output`, and return the path.

    Parameters
    ----------
    remarks : sequence of str
        Warnings for the reader, in addition to the warnings about the recordings.
    figures : Path, optional
        Directory for copies of the figures, as SVG.
    source : Path, optional
        New folder for the report's Typst source, its values and its figures.

    The bytes of the PDF depend only on the study, the remarks, and the versions of armrig,
    matplotlib and typst.

    Raises
    ------
    OperationError
        The folder of the source already contains files.
    OSError
        The PDF cannot be written.
    """
    study = best_first(study)
    return _write_pdf(study, output, study_contents(study, remarks), source, figures)


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
        The report has more than 10 pages; its source is written nevertheless.
    OperationError
        The folder of the source already contains files.
    OSError
        The PDF cannot be written.
    """
    return _write_pdf(study, output, handout_contents(study, answers or Answers()), source)


def control_report(study: ControlStudy, output: str | Path, *, source: Path | None = None) -> Path:
    """Typeset the report of a run in control at `output`, and return the path.

    The arguments and errors are those of `report`.
    """
    return _write_pdf(study, output, control_contents(study), source)


def handout_contents(study: HandoutStudy, answers: Answers) -> Contents:
    """Return the contents of the handout's report, with all numbers as text."""
    return Contents(
        title="Modelling and simulation of robot-arm",
        cover=_cover(answers),
        front=_front(study),
        sections=(
            Section(number="2", title="Physical modelling"),
            *_sections_with_answers(physical_sections(study), answers),
            Section(number="3", title="System identification"),
            *_sections_with_answers(identification_sections(study), answers),
            Section(number="4", title="Numerical simulation"),
            *_sections_with_answers(numerical_sections(study), answers),
        ),
    )


def _sections_with_answers(sections: dict[str, Section], answers: Answers) -> Iterator[Section]:
    """Yield the sections with their questions, their answers, and references to their figures.

    An empty line begins a paragraph of an answer.
    """
    for number, section in sections.items():
        tables = tuple(
            replace(table, name=f"table-{number}-{k}") for k, table in enumerate(section.tables, 1)
        )
        references = [f"<{x.name}>" for x in tables] + [f"<{x.name}>" for x in section.figures]
        paragraphs = section.paragraphs
        if references:
            paragraphs = (*paragraphs[:-1], f"{paragraphs[-1]} See {join_names(references)}.")
        yield replace(
            section,
            number=number,
            title=QUESTIONS[number].title,
            level=2,
            lead="" if section.lack else "Result.",
            paragraphs=paragraphs,
            tables=tables,
            asks=QUESTIONS[number].asks,
            reasons=tuple(
                " ".join(part.split())
                for part in re.split(r"\n\s*\n", answers.reasons.get(number, ""))
                if part.strip()
            ),
        )


def _cover(answers: Answers) -> Cover:
    students = [*answers.students, *[Student()] * MAX_STUDENTS][:MAX_STUDENTS]
    names = [
        field
        for k, student in enumerate(students, 1)
        for field in (
            (f"Name (student {k}):", student.name),
            ("Civic registration number:", student.registration_number),
        )
    ]
    return Cover(
        above="ESS101 Modelling and Simulation",
        kind="Hand-In Assignment",
        below=("Department of Signals and Systems", "Chalmers University of Technology"),
        fields=(*names, ("Approved (date, sign):", "")),
    )


def _front(study: HandoutStudy) -> Section:
    """Return the lower part of the cover: the recordings, their notes and their faults."""
    table = ReportTable(
        caption="The recordings. Figures name a recording by its run. The SHA-256 identifies its "
        "file.",
        header=("file", "run", "samples", "missing", "dead band", "SHA-256"),
        rows=tuple(
            (
                r.path.name,
                run_name(r),
                f"{r.N} at {milliseconds(r.Ts)}",
                str(r.missing),
                str(r.hidden),
                r.short_hash,
            )
            for r in study.recordings
        ),
    )
    return Section(
        warnings=warnings_of(study.recordings),
        tables=(table,) if study.recordings else (),
        points=(
            *notes(study.recordings),
            *emulation(study.recordings),
            *(f"{finding.text}." for finding in early_ends(study.recordings)),
            *calibration_sentences(study.recordings),
            f"Numbers and figures by armrig {version('armrig')}; the reasons are the students'.",
        ),
    )


def _write_pdf(
    study: Study | HandoutStudy | ControlStudy,
    output: str | Path,
    contents: Contents,
    source: Path | None,
    figures: Path | None = None,
) -> Path:
    """Draw the figures, typeset the contents, write the PDF, and return its path."""
    output = Path(output)
    with source_folder(source) as root:
        paths = write_figures(contents, study.recordings, root)
        pdf, places = typeset(root, contents, latest_start(study.recordings))
        if figures is not None:
            for path in paths:
                shutil.copyfile(path, figures / path.name)
    if contents.cover is not None:  # a study may have any length
        check_length(places)
    output.write_bytes(pdf)
    return output


def check_length(places: Places) -> None:
    """Refuse more than `MOST_PAGES` pages with an OperationError that names the longest sections.

    A place is the name of a section and its begin: the number of the page, from 1, plus the share
    of this page above the section. The last entry is the end of the document.
    """
    pages = int(places[-1][1])
    if pages <= MOST_PAGES:
        return
    lengths = {name: end - begin for (name, begin), (_, end) in pairwise(places)}
    longest = sorted(lengths, key=lambda name: -lengths[name])[:3]
    named = ", ".join(f"{name} ({lengths[name]:.1f})" for name in longest)
    raise OperationError(
        f"the report has {plural(pages, 'page')}, and the handout allows {MOST_PAGES}; the longest "
        f"sections are {named}: shorten your reasons, or choose lower orders (--na, --nb, --nf)"
    )
