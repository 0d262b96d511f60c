"""What a study comes to, in words."""

from __future__ import annotations

import numpy as np

from armrig.numerics.quantities import (
    error,
    microseconds,
    milliseconds,
    number,
    p_relation,
    percent,
)
from armrig.numerics.whiteness import WHITE_LEVEL
from armrig.recordings.calibration.staleness import remarks
from armrig.recordings.jitter import angle_of_jitter, fastest_rate
from armrig.report.study import Judged, Study


def verdict(study: Study) -> list[str]:
    """Return what the study comes to, one sentence or two a point."""
    arx, oe = study.estimated
    table = {m.name: row for m, row in zip(study.models, study.table.rows, strict=True)}
    unit = study.validation.unit
    points = [
        f"Simulated over {study.validation.t[-1]:.0f} s that it has not seen, the OE model is off "
        f"by {error(table['OE'].rms_error, unit)} rms, the ARX model by "
        f"{error(table['ARX'].rms_error, unit)}, the physics of the handout by "
        f"{error(table['physics'].rms_error, unit)}."
    ]
    for model in (oe, arx):
        points.append(_residual_verdict(model))
    deviations = np.median(study.deviation, axis=1)
    span = f"{study.omega[0]:g} to {study.omega[-1]:.0f} rad/s"
    points.append(
        f"From {span} the frequency response differs from the physics by a median of "
        f"{percent(100 * deviations[1])} (OE) and {percent(100 * deviations[0])} (ARX)."
    )
    if table["ARX"].rms_error > 3 * table["OE"].rms_error:
        points.append(
            "ARX and OE disagree. ARX assumes noise that passes through 1/A, and here it is added "
            "to the angle: the least-squares estimate then buys one-step prediction with a wrong "
            "transfer function. For simulation and for control use the OE model."
        )
    points += calibration_remarks(study)
    points.append(_jitter_verdict(study))
    missing = sum(r.missing for r in study.recordings)
    if missing:
        points.append(
            f"{missing} samples are missing. They are marked so, and no estimate uses a value in "
            "their place."
        )
    return points


def calibration_remarks(study: Study) -> list[str]:
    """Return what speaks against the calibration of any recording, each sentence once.

    What is not said of all names the files that it is said of.
    """
    of: dict[str, list[str]] = {}
    for r in study.recordings:
        for sentence in remarks(r.calibration, r.manifest):
            of.setdefault(sentence, []).append(r.path.name)
    return [
        sentence
        if len(names) == len(study.recordings)
        else f"{', '.join(names)}: {sentence[0].lower()}{sentence[1:]}"
        for sentence, names in of.items()
    ]


def _jitter_verdict(study: Study) -> str:
    """Return what the jitter can have done to the angle of the validation data."""
    data = study.validation
    timing = study.timing[study.recordings.index(study.recording_of(data.source))]
    return (
        "The sampling interval of the validation data has a standard deviation of "
        f"{microseconds(timing.std_us)}; at {number(fastest_rate(data))} {data.unit}/s, hardly "
        f"ever exceeded, that is an angle of {error(angle_of_jitter(timing, data), data.unit)}, in "
        "the measurement and in what the input has done by then."
    )


def _residual_verdict(model: Judged) -> str:
    tests = model.tests
    if tests is None or np.isnan([tests.whiteness, tests.missing_dynamics]).any():
        return f"{model.name}: too few residuals to test."
    white, free = tests.whiteness >= WHITE_LEVEL, tests.missing_dynamics >= WHITE_LEVEL
    said = f"{'white' if white else 'not white'} (p {p_relation(tests.whiteness)}) and "
    said += (
        f"{'free of' if free else 'tied to'} past input (p {p_relation(tests.missing_dynamics)})"
    )
    ending = "nothing speaks against its structure"
    if not (white and free):
        ending = f"look at its {'noise model' if free else 'orders and its delay'}"
    if min(tests.whiteness, tests.missing_dynamics) >= 0.001 and not (white and free):
        ending += ", but one true model in a hundred is told the same"
    return f"On validation data the residuals of {model.name} are {said}: {ending}."


def summary(study: Study) -> str:
    """Return the outcome in three sentences."""
    _, oe = study.table.rows[:2]
    N, Ts = study.estimation.N, study.estimation.Ts
    deviation = 100 * float(np.median(study.deviation[1]))
    return (
        f"From {N} samples at {milliseconds(Ts)} an ARX and an OE model from the motor's voltage "
        "to the chassis angle were estimated. On data that it has not seen the OE model simulates "
        f"the angle with an rms error of {error(oe.rms_error, study.validation.unit)}, and its "
        "frequency response differs from that of the physical model by a median of "
        f"{percent(deviation)}."
    )
