"""Reports as PDF: of a study, and for the handout; typst sets text and tables."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from string import ascii_lowercase
from typing import Any

from armrig_core.errors import OperationError

from armrig.data.dataset import Dataset
from armrig.models.characteristics import integrates
from armrig.numerics.quantities import error, milliseconds, percent
from armrig.recordings.figures import varying_times
from armrig.recordings.recording import Recording
from armrig.recordings.usability import different_calibrations, early_ends, emulation
from armrig.report import model_facts, recording_facts
from armrig.report.answers import QUESTIONS, Answers
from armrig.report.conclusions import abstract, calibration_sentences, conclusions
from armrig.report.figures import DETAIL_S, suffix, write_figures
from armrig.report.handout_study import HandoutStudy
from armrig.report.identification_sections import identification_sections
from armrig.report.physical_sections import numerical_sections, physical_sections
from armrig.report.recording_facts import run_name, without_turns
from armrig.report.study import STEP, Study, best_first, each_output, kind_of
from armrig.report.typesetting import recorded, source_folder, typeset

TEMPLATE = "handout.typ"
MOST_PAGES = 10
"""Number of pages that section 5 of the handout allows, including the cover."""
_MAX_NAMED_SECTIONS = 3


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
        The folder of the source already contains files; or the compiler refuses the document, which
        is a fault of this module.
    OSError
        The PDF cannot be written.
    """
    study = best_first(study)
    return _written(study, output, "report.typ", content(study, remarks), source, figures)


def content(study: Study, remarks: Sequence[str]) -> dict[str, Any]:
    """Return the values for the template report.typ, with all numbers as text."""
    manifest = study.recording_of(study.estimation.source).manifest
    truncated = [
        f"{r.path.name} is incomplete: {r.damage}." for r in study.recordings if r.truncated
    ]
    return {
        "title": "Black-box identification of the rig",
        "subtitle": f"rig {manifest.rig}, recorded {manifest.started[:16].replace('T', ' ')}",
        **_of_recordings(study.recordings),
        "date": f"{recorded(study.recordings):%Y-%m-%d}",
        "summary": abstract(study),
        "recordings": [
            {"role": recording_facts.role(study, r), "file": r.path.name, "sha256": r.sha256}
            for r in study.recordings
        ],
        "facts": recording_facts.facts(study),
        "remarks": [*emulation(study.recordings), *remarks, *truncated],
        "chain": recording_facts.shared_facts(study),
        "timing": [
            *recording_facts.timing_rows(study.timing),
            *recording_facts.disturbance_rows(study.disturbances),
        ],
        "data": recording_facts.data_text(study),
        "treatment": recording_facts.treatment(study),
        "timing_figure": _timing_caption(study),
        "step": _step_caption(study),
        "orders": model_facts.orders(study),
        "structure": model_facts.structure(study),
        "estimation": model_facts.estimations(study),
        "fits_header": [
            *(["output"] if study.others else []),
            "model",
            "fit of the angle",
            "rms error",
            *(["fit of the velocity"] if _with_velocity(study) else []),
        ],
        "fits": [row for one in each_output(study) for row in _fit_rows(one, study)],
        "percent": model_facts.percent_warning(study),
        "physics": model_facts.physics(study),
        "tests_header": [
            "hypothesis",
            *(["output"] if study.others else []),
            *(f"p ({m.name})" for m in study.estimated),
            "a small p points to",
        ],
        "tests": model_facts.residual_rows(study),
        "verdict": conclusions(study),
        "captions": {
            "fits": f"Simulation of the validation data (recording {_run(study.validation, study)}"
            f"). {study.note[0].upper()}{study.note[1:]}.",
            "tests": "Tests of the one-step residuals on the validation data (recording "
            f"{_run(study.validation, study)}). The tests allow for the uncertainty of the "
            "estimated models.",
        },
        "outputs": [_of_output(one, study) for one in each_output(study)],
    }


def _run(data: Dataset, study: Study) -> str:
    return run_name(study.recording_of(data.source))


def _with_velocity(study: Study) -> bool:
    rows = (one.reference.comparison for one in each_output(study))
    return any(row.velocity_fit_percent is not None for row in rows)


def _fit_rows(one: Study, study: Study) -> Iterator[list[str]]:
    """Yield a row for each model: its fits and its rms error for one output."""
    for k, m in enumerate(one.models):
        row = m.comparison
        velocity = "–" if row.velocity_fit_percent is None else percent(row.velocity_fit_percent)
        yield [
            *([one.symbol if k == 0 else ""] if study.others else []),
            row.name,
            percent(row.fit_percent),
            error(row.rms_error, one.validation.unit),
            *([velocity] if _with_velocity(study) else []),
        ]


def _of_output(one: Study, study: Study) -> dict[str, Any]:
    """Return the values for the tables and figures of one output."""
    symbol = one.symbol if study.others else ""
    return {
        "suffix": suffix(one, study),
        "models": [model_facts.model_table(m, one.reference, symbol) for m in one.estimated],
        "captions": _captions(one),
    }


def _timing_caption(study: Study) -> str | None:
    """Return the caption of `timing.svg`, with its quantities; None if there is no such figure."""
    recording = study.recording_of(study.estimation.source)
    texts = {"jitter": "jitter of the sampling instants", "lateness": "lateness at the host"}
    if not (varying := varying_times(recording)):
        return None
    return (
        f"Histogram of {' and of '.join(map(texts.__getitem__, varying))} in the estimation data "
        f"(recording {run_name(recording)}). Both axes are logarithmic. Values below the clock's "
        "resolution are at the left edge."
    )


def _step_caption(study: Study) -> str | None:
    steps = [r for r in study.recordings if kind_of(r) == STEP]
    if not steps:
        return None
    return (
        f"(a) Chassis angle after a step of the motor's voltage; (b) the voltage; recording "
        f"{run_name(steps[0])}."
    )


def _captions(one: Study) -> dict[str, str]:
    """Return the captions of the figures of one output, with the quantities on their axes."""
    estimation, validation = (_run(data, one) for data in (one.estimation, one.validation))
    marks = ascii_lowercase[: 2 * len(one.estimated)]
    halves = ", the first and the second half of one recording" if one.halves else ""
    angle, ramp = one.angle, without_turns(one.validation)
    turns = " with its turns counted" if one.integrates else ""
    detail = f"rate of the {angle}, from differences" if one.integrates else angle
    drawn = [f"{angle}{turns}{without_turns(data)}" for data in (one.estimation, one.validation)]
    angles = f"(a, c) {drawn[0]}" if drawn[0] == drawn[1] else f"(a) {drawn[0]}; (c) {drawn[1]}"
    rate = "Rate" if all(integrates(m.model) for m in one.models) else "Response"
    return {
        "data": f"Estimation data (a, b; recording {estimation}) and validation data (c, d; "
        f"recording {validation}){halves}: {angles}; (b, d) voltage that the device applied. "
        "Shaded: dead band or missing sample.",
        "compare": f"(a) Measured and simulated {angle} of the validation data (recording "
        f"{validation}){ramp}; (b) data (dots) and models, minus the best model. If a model has a "
        "much larger error, the scale is logarithmic beyond the dotted lines.",
        "velocity": f"Detail of {DETAIL_S:g} s: {detail} (recording {validation}). The simulation "
        "of the models starts at the beginning of the data.",
        "bode": f"Frequency response from voltage to {angle}, (a) magnitude and (b) phase, with "
        "95 % bands. A band is linearised or, if a linearisation is poor, sampled from the "
        "covariance of the parameters. Dots: spectral analysis of the estimation data with 95 % "
        f"bars. Recording {estimation}.",
        "step_poles": f"(a) {rate} of the {angle} after a step of 1 V, with 95 % bands; (b) poles "
        "(×) and zeros (○) with 95 % regions: bars for real roots, ellipses for complex roots, "
        "dotted if sampled. A square marks a pole and a zero that are not significantly different "
        f"(1 %). Models from recording {estimation}.",
        "residuals": f"Correlation of the residuals of the {angle} with themselves "
        f"({', '.join(marks[::2])}) and with the input ({', '.join(marks[1::2])}) on recording "
        f"{validation}. Grey: range of 99 % of the values if the hypothesis is true.",
    }


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
    values = _handout_content(study, answers or Answers())
    return _written(study, output, TEMPLATE, values, source)


def _written(
    study: Study | HandoutStudy,
    output: str | Path,
    template: str,
    values: dict[str, Any],
    source: Path | None,
    figures: Path | None = None,
) -> Path:
    """Draw the figures, typeset a template with values, write the PDF, and return its path."""
    output = Path(output)
    with source_folder(source) as root:
        drawn = write_figures(study, root)
        pdf, places = typeset(root, template, values, recorded(study.recordings))
        if figures is not None:
            for path in drawn:
                shutil.copyfile(path, figures / path.name)
    if template == TEMPLATE:
        check_length(places)
    output.write_bytes(pdf)
    return output


def _handout_content(study: HandoutStudy, answers: Answers) -> dict[str, Any]:
    """Return the values for the template handout.typ, with all numbers as text."""
    sections = physical_sections(study) | identification_sections(study) | numerical_sections(study)
    return {
        "sections": [
            {"number": number, "reasons": _paragraphs(answers.reasons.get(number, ""))}
            | asdict(section)
            | QUESTIONS[number]._asdict()
            for number, section in sections.items()
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
        **_of_recordings(study.recordings),
        "remarks": [
            *emulation(study.recordings),
            *(f"{found.text}." for found in early_ends(study.recordings)),
            *calibration_sentences(study.recordings),
        ],
    }


def _of_recordings(recordings: Sequence[Recording]) -> dict[str, Any]:
    return {
        "version": version("armrig"),
        "notes": recording_facts.notes(recordings),
        "warnings": [f"{found.text}." for found in different_calibrations(recordings)],
    }


def _paragraphs(text: str) -> list[str]:
    """Split a text into paragraphs at its empty lines, and return each paragraph as one line."""
    return [" ".join(part.split()) for part in re.split(r"\n\s*\n", text) if part.strip()]


def check_length(places: Sequence[tuple[str, float]]) -> None:
    """Refuse more than `MOST_PAGES` pages with an OperationError that names the longest sections.

    A place is the name of a section and its begin: the number of the page, from 1, plus the share
    of this page above the section. The last entry is the end of the document.
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
