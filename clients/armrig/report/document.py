"""A study as a typeset PDF; figures are matplotlib's, text and tables are typst's."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from string import ascii_lowercase
from typing import Any

from armrig.numerics.quantities import error, percent
from armrig.recordings.doubts import different_calibrations, emulation
from armrig.report.conclusions import abstract, conclusions
from armrig.report.figures import DETAIL_S, write_figures
from armrig.report.model_facts import (
    estimation,
    model_table,
    orders,
    percent_warning,
    physics,
    residual_rows,
    structure,
)
from armrig.report.recording_facts import (
    data_text,
    disturbance_rows,
    facts,
    notes,
    role,
    run_name,
    shared_facts,
    timing_rows,
    treatment,
)
from armrig.report.study import STEP, Study, kind_of
from armrig.report.typesetting import recorded, source_folder, typeset


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
        Sentences that a reader must know, in addition to those of the recordings.
    figures : Path, optional
        Directory to leave the figures in, as SVG.
    source : Path, optional
        New folder for the report's Typst source, its values and its figures.

    The PDF's bytes follow from the study, the remarks and the versions of armrig, matplotlib and
    typst: no time of day enters.

    Raises
    ------
    OperationError
        The compiler refuses, which is a fault of this module; or the folder of the source contains
        files already.
    OSError
        The PDF cannot be written.
    """
    output = Path(output)
    with source_folder(source) as root:
        drawn = write_figures(study, root)
        made = recorded(study.recordings)
        pdf, _ = typeset(root, "report.typ", content(study, remarks), made)
        if figures is not None:
            for path in drawn:
                shutil.copyfile(path, figures / path.name)
    output.write_bytes(pdf)
    return output


def content(study: Study, remarks: Sequence[str]) -> dict[str, Any]:
    """Return what the template says as text: see report.typ."""
    manifest = study.recording_of(study.estimation.source).manifest
    truncated = [
        f"{r.path.name} is not whole: {r.damage}." for r in study.recordings if r.truncated
    ]
    return {
        "title": "Black-box identification of the rig",
        "subtitle": f"rig {manifest.rig}, recorded {manifest.started[:16].replace('T', ' ')}",
        "version": version("armrig"),
        "date": f"{recorded(study.recordings):%Y-%m-%d}",
        "summary": abstract(study),
        "recordings": [
            {"role": role(study, r), "file": r.path.name, "sha256": r.sha256}
            for r in study.recordings
        ],
        "facts": facts(study),
        "notes": notes(study.recordings),
        "warnings": different_calibrations(study.recordings),
        "remarks": [*emulation(study.recordings), *remarks, *truncated],
        "chain": shared_facts(study),
        "timing": [*timing_rows(study.timing), *disturbance_rows(study.disturbances)],
        "data": data_text(study),
        "treatment": treatment(study),
        "step": _step_caption(study),
        "orders": orders(study),
        "structure": structure(study),
        "models": [model_table(m, study.reference) for m in study.estimated],
        "estimation": " ".join(estimation(m) for m in study.estimated),
        "fits": [
            [
                row.name,
                percent(row.fit_percent),
                error(row.rms_error, study.validation.unit),
                "–" if row.velocity_fit_percent is None else percent(row.velocity_fit_percent),
            ]
            for row in (m.comparison for m in study.models)
        ],
        "percent": percent_warning(study),
        "physics": physics(study),
        "tested": [m.name for m in study.estimated],
        "tests": residual_rows(study),
        "captions": _captions(study),
        "verdict": conclusions(study),
    }


def _step_caption(study: Study) -> str | None:
    steps = [r for r in study.recordings if kind_of(r) == STEP]
    if not steps:
        return None
    return (
        f"(a) Chassis angle after a step of the motor's voltage (b); recording "
        f"{run_name(steps[0])}."
    )


def _captions(study: Study) -> dict[str, str]:
    estimation, validation = (
        run_name(study.recording_of(data.source)) for data in (study.estimation, study.validation)
    )
    marks = ascii_lowercase[: 2 * len(study.estimated)]
    halves = ": first and second half of one recording" if study.halves else ""
    return {
        "data": f"Estimation data (a, b; recording {estimation}) and validation data (c, d; "
        f"recording {validation}){halves}: chassis angle with its turns counted, less the ramp of "
        "its mean speed (a, c), and the voltage that the device applied (b, d). Shaded: "
        "dead band, or a missing sample.",
        "fits": f"Simulation of the validation data (recording {validation}). "
        f"{study.note[0].upper()}{study.note[1:]}.",
        "compare": "(a) Angle measured and simulated on the validation data (recording "
        f"{validation}), less the ramp of its mean speed; (b) data (dots) and models less the best "
        "model. If another model is far off, the scale is logarithmic beyond the dotted "
        "lines.",
        "velocity": f"Detail of {DETAIL_S:g} s: rate of the angle from differences (recording "
        f"{validation}). The models are simulated from the beginning of the data, as above.",
        "bode": "Frequency response from voltage to angle, with 95 % bands, linearised or, where "
        "that is poor, sampled from the covariance of the parameters; dots: spectral analysis of "
        f"the estimation data, 95 % bars. Recording {estimation}.",
        "step_poles": "(a) Answer to a unit step with 95 % bands; (b) poles (×) and zeros "
        "(○) with 95 % regions (bars for real roots, ellipses, dotted where sampled); a square "
        "holds a pole and a zero that cannot be told apart (1 %). "
        f"Models from recording {estimation}.",
        "tests": f"Tests of the one-step residuals on the validation data (recording {validation}),"
        " with the uncertainty of the estimated models allowed for.",
        "residuals": f"Correlation of the residuals with themselves ({', '.join(marks[::2])}) "
        f"and with the input ({', '.join(marks[1::2])}) on recording {validation}. Grey: 99 % of "
        "the values if the hypothesis is true.",
    }
