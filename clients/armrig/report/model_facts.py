"""Facts about a report's models: coefficients, losses, residuals, deviations, conclusions."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from armrig.models.equation import letters, whiteness_sentence
from armrig.models.fit import Fit
from armrig.models.structure_table import row_of, with_article
from armrig.numerics.quantities import (
    error,
    join_names,
    milliseconds,
    number,
    p_value,
    percent,
    places,
    plural,
    power,
    with_decimals,
)
from armrig.recordings.findings import second_moves
from armrig.report.recording_facts import calibration_sentences, jitter_verdicts, run_name
from armrig.report.sections import ReportTable, plain
from armrig.report.study import AssessedFit, Study, each_output
from armrig.validation.answer import tests_sentence
from armrig.validation.residual_test import ResidualTest


def orders(study: Study) -> str:
    """Return the orders of each model as text."""
    return "; ".join(
        ", ".join(f"{name} = {n}" for name, n in m.model.orders.items())
        + f" ({_label(m, part, study)})"
        for part in each_output(study)
        for m in part.estimated
    )


def _label(m: AssessedFit, part: Study, study: Study) -> str:
    """Return the name of a model; if the study has several outputs, with the output's symbol."""
    return f"{m.name} of {part.symbol}" if study.others else m.name


def model_table(m: AssessedFit, part: Study, study: Study) -> ReportTable:
    """Return the table of a model's coefficients for one output of the study.

    If the physical model has the same polynomials, one column has its coefficients.
    """
    name, reference = _label(m, part, study), part.reference
    if reference is not None and letters(m.model) != letters(reference.model):
        reference = None
    more, columns = " and their standard deviations", [name, "estimate", "σ", "σ robust"]
    if reference is not None:
        more = ", their standard deviations, and the coefficients of the physical model"
        columns.append(reference.name)
    return ReportTable(
        caption=f"Coefficients of {name}{more}.",
        header=tuple(columns),
        rows=tuple(_coefficients(m.model, reference.model if reference else None)),
    )


def _coefficients(fit: Fit, reference: Fit | None) -> Iterator[tuple[str, ...]]:
    theirs = dict(zip(reference.names, reference.theta, strict=True)) if reference else {}
    for name, value, std, robust in zip(fit.names, fit.theta, fit.std, fit.std_robust, strict=True):
        decimals = places(float(std))
        row = (name, *(with_decimals(float(x), decimals) for x in (value, std, robust)))
        if reference:
            row += (with_decimals(float(theirs[name]), decimals) if name in theirs else "–",)
        yield row
    physical = fit.quantities().values() if fit.Ts == 0 else ()
    quantities = (q for q in physical if np.isfinite(q.value))
    for q in (q for q in quantities if q.name not in fit.names):  # the delay has a row
        value, std = (with_decimals(x, places(q.std)) for x in (q.value, q.std))
        trusted = ("–", std) if fit.trusts_robust else (std, "–")
        yield (f"{q.name} [{q.unit or '–'}]", value, *trusted)


def structure(study: Study) -> str:
    """Return a text on the integrator, the initial state and the dead band in the models."""
    sentences = integrator_sentences(study)
    offset = " and the input offset" if sentences else ""
    if study.others:
        outputs = join_names([part.symbol for part in each_output(study)])
        sentences.append(
            f"Each model has both outputs, {outputs}. In the OE model both outputs have one "
            "denominator, which is estimated from both. The table of each output contains the "
            "coefficients of its own transfer function. In the ARX model each output depends on "
            "its own past only, and the covariance of the errors weights both outputs."
        )
    are = "are" if offset else "is"
    sentences.append(
        f"The initial state{offset} of each experiment {are} estimated with the model."
        + " Samples in the dead band of the potentiometer, and the first sample after it, count as "
        "missing." * study.of_arm
    )
    return " ".join(sentences)


def integrator_sentences(study: Study) -> list[str]:
    """Return a sentence on each integrator that a model has by construction."""
    return [
        f"{part.symbol} integrates the {part.input}, so {m.model.integrating.upper()} of "
        f"{_label(m, part, study)} has the factor "
        f"{'1 − q⁻¹' if m.model.Ts else 's'} by construction."
        for part in each_output(study)
        for m in part.estimated
        if m.model.integrator
    ]


def estimations(study: Study) -> list[str]:
    """Return the losses and the warnings of each model, without repeated texts."""
    texts = [
        " ".join(_estimation(_label(m, part, study), m.model, alone=not study.others))
        for part in each_output(study)
        for m in part.estimated
    ]
    return list(dict.fromkeys(texts))


def _estimation(name: str, fit: Fit, *, alone: bool) -> Iterator[str]:
    """Yield sentences with losses and warnings; FPE and AIC only for a model of one output."""
    criteria = f", FPE {power(fit.fpe)} {fit.unit}², AIC {number(fit.aic)}" if alone else ""
    yield (
        f"{name}: loss {power(fit.loss)} {fit.unit}²{criteria}; "
        f"on the estimation data, {whiteness_sentence(fit, 'σ', 'σ robust')}."
    )
    if not fit.search.converged:
        yield "The search did not converge."
    for w in fit.warnings:
        yield f"{w[:1].upper()}{w[1:].rstrip('.')}."


def percent_warning(study: Study) -> Iterator[str]:
    """Yield a warning about the fits in percent of each output that integrates."""
    for part in each_output(study):
        if part.models[0].velocity_fit_percent is not None:
            yield (
                f"The fit of {part.symbol} is high for every model, because the ramp dominates the "
                "variation: compare the rms errors. The fit of the velocity is computed from "
                "differences of the angle. The measured differences contain the converter's noise "
                "twice, so even the true system would not reach 100 %."
            )


def physics(study: Study) -> str:
    """Return a text on the deviation of each model from the physical model, the best first.

    The text ends in a blank, or is "" for a rig that is not the arm.
    """
    if study.reference is None:
        return f"{without_arm(study)} " if study.of_arm else ""
    return (
        "The physical model is the handout's: two inertias, a spring and a DC motor. It has the "
        "handout's parameters and is sampled exactly for a held input; nothing in it was fitted. "
        f"{' '.join(deviations(part, study) for part in each_output(study))} "
    )


def deviations(part: Study, study: Study) -> str:
    """Return a sentence on the deviations of one output's models, the best first."""
    span = f"{part.omega[0]:g} to {part.omega[-1]:.0f} rad/s"
    to = f"{f' to the {part.angle}' if study.others else ''} differs from the physical model"
    texts: list[str] = []
    for m, deviation in ((m, m.deviation) for m in part.ranked if m.deviation is not None):
        at = number(float(part.omega[np.argmax(deviation)]))
        shares = (np.median(deviation), np.max(deviation))
        median, most = (percent(100 * float(x)) for x in shares)
        texts.append(
            f"the {m.name} model{' differs' if texts else to} by a median of {median} and at most "
            f"by {most}, at {at} rad/s"
        )
    return f"From {span} {'; '.join(texts)}."


def without_arm(study: Study) -> str:
    """Return the reason why the models are not compared with the physical model."""
    used = {study.estimation.source, study.validation.source}
    names = [run_name(r) for r in study.recordings if r.sha256 in used and not second_moves(r)]
    second = [*study.recordings[0].channels][-1]
    return (
        f"In {plain(join_names(names))} {second} is constant: the arm was removed or held. The "
        "models "
        "are therefore not compared with the physical model of the whole rig."
    )


HYPOTHESES: tuple[tuple[str, str, Callable[[ResidualTest], float]], ...] = (
    ("white", "noise model or orders", lambda t: t.white.p_value),
    ("no correlation with past input", "orders or delay", lambda t: t.missing_dynamics),
    (
        "no correlation with future input",
        "feedback in the experiment, or delay too large",
        lambda t: t.feedback,
    ),
)
"""Hypotheses about the residuals, what to change if the p value is small, and the p value."""


def residual_rows(study: Study) -> tuple[tuple[str, ...], ...]:
    """Return rows of the residual tests: hypothesis, p value of each model, and what to change.

    If the models have several outputs, the second column contains the output. The first row of
    each hypothesis then tests all outputs together.
    """
    of_each = [(part.symbol, [m.tests for m in part.estimated]) for part in each_output(study)]
    together = [m.together for m in study.estimated if m.together]
    if together:
        of_each.insert(0, ("together", together))
    return tuple(
        (
            "" if i else hypothesis,
            *([output] if together else []),
            *(p_value(p_of(test)) for test in tests),
            "" if i else remedy,
        )
        for hypothesis, remedy, p_of in HYPOTHESES
        for i, (output, tests) in enumerate(of_each)
    )


MIN_BIASED_RMS_RATIO = 3.0
"""Ratio of the rms errors of an ARX model and the best model, above which ARX is called biased."""


def conclusions(study: Study) -> list[str]:
    """Return the conclusions of a study, each in a few sentences."""
    points = [
        f"{m.name}{', all outputs together' * bool(m.together)}, on the validation data. "
        f"{tests_sentence(m.together or m.tests)}."
        for m in study.ranked
    ]
    points += dict.fromkeys(
        text for part in each_output(study) for text in _structure_verdicts(part)
    )
    points += calibration_sentences(study.recordings)
    points += jitter_verdicts(study)
    missing = sum(r.missing for r in study.recordings)
    if missing:
        points.append(
            f"{plural(missing, 'sample is', 'samples are')} missing. They are marked as missing, "
            "and no estimate uses a value in their place."
        )
    return points


def _structure_verdicts(study: Study) -> Iterator[str]:
    """Yield an explanation for each ARX model that simulates far worse than the best model."""
    best = study.best
    limit = MIN_BIASED_RMS_RATIO * best.comparison.rms_error
    if row_of(best.model.structure).equation_error:
        return
    for m in study.estimated:
        if row_of(m.model.structure).equation_error and m.comparison.rms_error > limit:
            yield (
                f"{m.name} and {best.name} disagree. ARX assumes that the noise passes through "
                "1/A. Here the noise is added to the angle, so the ARX transfer function is "
                "biased, although ARX predicts one step ahead well. For simulation and control "
                f"use the {best.name} model."
            )


def abstract(study: Study) -> str:
    """Return the result of a study in three sentences."""
    name, each = study.best.name, each_output(study)
    the = {part.output: f"the {part.angle}" if part.of_arm else part.output for part in each}
    outputs = [f"{the[x.output]} {x.symbol}" if x.of_arm else x.output for x in each]
    best = [next(m for m in part.estimated if m.name == name) for part in each]
    errors = [
        f"{the[part.output]} with an rms error of "
        f"{error(m.comparison.rms_error, part.validation.unit)}"
        for part, m in zip(each, best, strict=True)
    ]
    medians = [percent(100 * float(np.median(d))) for m in best if (d := m.deviation) is not None]
    differs = " In the median its frequency response differs from that of the physical model by "
    names = join_names([with_article(m.name) for m in study.estimated])
    motor = "motor's " * study.of_arm
    return (
        f"{names[0].upper()}{names[1:]} model from the {motor}{study.input} to "
        f"{join_names(outputs)} "
        f"were estimated from {plural(study.estimation.N, 'sample')} at "
        f"{milliseconds(study.estimation.Ts)}. On validation data the {name} model simulates "
        f"{join_names(errors)}.{f'{differs}{join_names(medians)}.' if medians else ''}"
    )
