"""What a study comes to, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

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
from armrig.recordings.calibration.staleness import remarks
from armrig.recordings.jitter import angle_of_jitter, fastest_rate
from armrig.recordings.recording import Recording
from armrig.report.study import AssessedFit, Study

_FAR = 3.0  # times the best model's rms error, from which on an ARX model is another one


def conclusions(study: Study) -> list[str]:
    """Return what the study comes to, one sentence or two a point."""
    points = [
        _simulation_verdict(study),
        *(_residual_verdict(model) for model in study.ranked),
        _physics_verdict(study),
        *_structure_verdicts(study),
    ]
    points += calibration_sentences(study.recordings)
    points.append(_jitter_verdict(study))
    missing = sum(r.missing for r in study.recordings)
    if missing:
        points.append(
            f"{missing} samples are missing. They are marked so, and no estimate uses a value in "
            "their place."
        )
    return points


def _simulation_verdict(study: Study) -> str:
    """Return how far each model is off, the best of the estimated ones first."""
    unit = study.validation.unit
    first, *others = (f"{m.name} model" for m in study.ranked)
    best, *rest = (error(m.comparison.rms_error, unit) for m in study.ranked)
    off = [f"the {name} by {size}" for name, size in zip(others, rest, strict=True)]
    off.append(f"the physics of the handout by {error(study.reference.comparison.rms_error, unit)}")
    return (
        f"Simulated over {study.validation.t[-1]:.0f} s that it has not seen, the {first} is off "
        f"by {best} rms, {', '.join(off)}."
    )


def _physics_verdict(study: Study) -> str:
    span = f"{study.omega[0]:g} to {study.omega[-1]:.0f} rad/s"
    medians = listed(
        [f"{percent(100 * float(np.median(m.deviation)))} ({m.name})" for m in study.ranked]
    )
    return f"From {span} the frequency response differs from the physics by a median of {medians}."


def _structure_verdicts(study: Study) -> Iterator[str]:
    """Say of each ARX model that simulates far worse than the best what is wrong with it."""
    best = study.best
    farthest = _FAR * best.comparison.rms_error
    for m in study.estimated if best.fit.structure != "arx" else ():
        if m.fit.structure == "arx" and m.comparison.rms_error > farthest:
            yield (
                f"{m.name} and {best.name} disagree. ARX assumes noise that passes through 1/A, "
                "and here it is added to the angle, so its transfer function is biased, although "
                "it predicts one step ahead well. For simulation and for control use "
                f"the {best.name} model."
            )


def calibration_sentences(recordings: Sequence[Recording]) -> list[str]:
    """Return what speaks against the calibration of any recording, each sentence once.

    What is not said of all names the files that it is said of.
    """
    of: dict[str, list[str]] = {}
    for r in recordings:
        for sentence in remarks(r.calibration, r.manifest):
            of.setdefault(sentence, []).append(r.path.name)
    return [
        sentence
        if len(names) == len(recordings)
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
        f"ever exceeded, that moves θ₁ by {error(angle_of_jitter(timing, data), data.unit)}, "
        "in the measurement and in what the input has done by then."
    )


def _residual_verdict(model: AssessedFit) -> str:
    tests = model.tests
    if np.isnan([tests.whiteness, tests.missing_dynamics]).any():
        return f"{model.name}: too few residuals to test."
    white, free = not tests.white.coloured, tests.missing_dynamics >= WHITE_LEVEL
    if tests.powerless and white and free:
        return f"The residual tests of {model.name} have no power: {tests.powerless}."
    said = f"{tests.white} and "
    said += (
        f"{'free of' if free else 'tied to'} past input (p {p_relation(tests.missing_dynamics)})"
    )
    ending = "nothing speaks against its structure"
    if not (white and free):
        ending = f"look at its {'noise model' if free else 'orders and its delay'}"
    if min(tests.whiteness, tests.missing_dynamics) >= 0.001 and not (white and free):
        ending += ", though one correct model in a hundred fails this test by chance"
    return f"On validation data the residuals of {model.name} are {said}: {ending}."


def abstract(study: Study) -> str:
    """Return the outcome in three sentences."""
    best = study.best
    N, Ts = study.estimation.N, study.estimation.Ts
    deviation = 100 * float(np.median(best.deviation))
    rms = error(best.comparison.rms_error, study.validation.unit)
    names = listed([with_article(m.name) for m in study.estimated])
    were = "were" if len(study.estimated) > 1 else "was"
    return (
        f"From {N} samples at {milliseconds(Ts)} {names} model from the motor's voltage "
        f"to the chassis angle {were} estimated. On data that it has not seen the {best.name} "
        f"model simulates the angle with an rms error of {rms}, and its frequency response differs "
        f"from that of the physical model by a median of {percent(deviation)}."
    )
