"""Conclusions of a study, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from armrig.data.finding import Finding
from armrig.models.structure_table import with_article
from armrig.numerics.quantities import (
    error,
    listed,
    microseconds,
    milliseconds,
    number,
    p_relation,
    percent,
)
from armrig.numerics.whiteness import WHITE_LEVEL
from armrig.recordings.jitter import angle_of_jitter, fastest_rate
from armrig.recordings.recording import Recording
from armrig.recordings.usability import doubts_of_calibration
from armrig.report.study import AssessedFit, Study, each_output
from armrig.validation.residual_test import UNKNOWN

MIN_BIASED_RMS_RATIO = 3.0
"""Ratio of the rms errors of an ARX model and the best model, above which ARX is called biased."""


def conclusions(study: Study) -> list[str]:
    """Return the conclusions of a study, each in a few sentences."""
    points = [
        *(_simulation_verdict(one, _of(one, study, "of")) for one in each_output(study)),
        *(_residual_verdict(model) for model in study.ranked),
        *(_physics_verdict(one, _of(one, study, "to")) for one in each_output(study)),
        *dict.fromkeys(text for one in each_output(study) for text in _structure_verdicts(one)),
    ]
    points += calibration_sentences(study.recordings)
    points += _jitter_verdicts(study)
    missing = sum(r.missing for r in study.recordings)
    if missing:
        points.append(
            f"{missing} samples are missing. They are marked as missing, and no estimate uses a "
            "value in their place."
        )
    return points


def _of(one: Study, study: Study, word: str) -> str:
    """Return a text such as " of the arm angle"; "" if the study has one output."""
    return f" {word} the {one.angle}" if study.others else ""


def _simulation_verdict(study: Study, of: str) -> str:
    errors = ", ".join(
        f"{error(m.comparison.rms_error, study.validation.unit)} "
        f"({'the physical model' if m is study.reference else m.name})"
        for m in (*study.ranked, study.reference)
    )
    return (
        f"In a simulation of the {study.validation.t[-1]:.0f} s of validation data the rms error"
        f"{of} is {errors}."
    )


def _physics_verdict(study: Study, to: str) -> str:
    span = f"{study.omega[0]:g} to {study.omega[-1]:.0f} rad/s"
    medians = listed(
        [f"{percent(100 * float(np.median(m.deviation)))} ({m.name})" for m in study.ranked]
    )
    return (
        f"From {span} the frequency response{to} differs from that of the physical model by a "
        f"median of {medians}."
    )


def _structure_verdicts(study: Study) -> Iterator[str]:
    """Yield an explanation for each ARX model that simulates far worse than the best model."""
    best = study.best
    limit = MIN_BIASED_RMS_RATIO * best.comparison.rms_error
    for m in study.estimated if best.fit.structure != "arx" else ():
        if m.fit.structure == "arx" and m.comparison.rms_error > limit:
            yield (
                f"{m.name} and {best.name} disagree. ARX assumes that the noise passes through "
                "1/A. Here the noise is added to the angle, so the ARX transfer function is "
                "biased, although ARX predicts one step ahead well. For simulation and control "
                f"use the {best.name} model."
            )


def calibration_sentences(recordings: Sequence[Recording]) -> list[str]:
    """Return the doubts about the calibrations of recordings, without repeated sentences.

    A sentence that holds only for some of the recordings begins with the names of their files.
    """
    of: dict[Finding, list[str]] = {}
    for r in recordings:
        for found in doubts_of_calibration(r.calibration, r.manifest):
            of.setdefault(found, []).append(r.path.name)
    return [
        found.text
        if len(names) == len(recordings)
        else f"{', '.join(names)}: {found.text[0].lower()}{found.text[1:]}"
        for found, names in of.items()
    ]


def _jitter_verdicts(study: Study) -> Iterator[str]:
    """Yield sentences on the jitter of the validation data, if there is any, and its effect."""
    timing = study.timing[study.recordings.index(study.recording_of(study.validation.source))]
    if timing.std_us == 0:
        return
    moved: list[str] = []
    for one in each_output(study):
        data = one.validation
        rate = f"at {number(fastest_rate(data))} {data.unit}/s"
        rate += "" if moved else ", the rate that 99 % of the data do not exceed,"
        by = error(angle_of_jitter(timing, data), data.unit)
        moved.append(f"{rate} this jitter moves {one.symbol} by {by}")
    yield (
        "The sampling interval of the validation data has a standard deviation of "
        f"{microseconds(timing.std_us)}. A{'; '.join(moved)[1:]}. The jitter affects both the "
        "measurement and the response to the input."
    )


def _residual_verdict(model: AssessedFit) -> str:
    tests = model.together or model.tests
    whiteness = tests.white.p_value
    if np.isnan([whiteness, tests.missing_dynamics]).any():
        return f"{model.name}: too few residuals to test."
    white, free = not tests.white.doubtful, tests.missing_dynamics >= WHITE_LEVEL
    if tests.powerless and white and free:
        return f"The residual tests of {model.name} have no power: {tests.powerless}."
    said = f"{tests.white} and "
    if tests.blind:
        return (
            f"On validation data the residuals of {model.name} are {said}{UNKNOWN}: {tests.blind}."
        )
    said += (
        f"{'un' if free else ''}correlated with past input (p {p_relation(tests.missing_dynamics)})"
    )
    ending = "nothing speaks against its structure"
    if not (white and free):
        ending = f"look at its {'noise model' if free else 'orders and its delay'}"
    if min(whiteness, tests.missing_dynamics) >= 0.001 and not (white and free):
        ending += ", though one correct model in a hundred fails this test by chance"
    of = f"{model.name}, all outputs together," if model.together else model.name
    return f"On validation data the residuals of {of} are {said}: {ending}."


def abstract(study: Study) -> str:
    """Return the result of a study in three sentences."""
    name, several = study.best.name, bool(study.others)
    N, Ts = study.estimation.N, study.estimation.Ts
    best = [next(m for m in one.estimated if m.name == name) for one in each_output(study)]
    errors = [
        f"{f'the {one.angle}' if several else 'the angle'} with an rms error of "
        f"{error(m.comparison.rms_error, one.validation.unit)}"
        for one, m in zip(each_output(study), best, strict=True)
    ]
    medians = listed([percent(100 * float(np.median(m.deviation))) for m in best])
    differs = "responses differ from those" if several else "response differs from that"
    angles = listed([f"the {one.angle}" for one in each_output(study)])
    names = listed([with_article(m.name) for m in study.estimated])
    were = "were" if len(study.estimated) > 1 else "was"
    return (
        f"{names[0].upper()}{names[1:]} model from the motor's voltage to "
        f"{angles} {were} estimated from {N} samples "
        f"at {milliseconds(Ts)}. On validation data the {name} model simulates {listed(errors)}. "
        f"Its frequency {differs} of the physical model by "
        f"{'medians' if several else 'a median'} of {medians}."
    )
