"""Facts about a report's models: coefficients, losses, residuals, and deviations."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from armrig.models.equation import letters, typst_form, whiteness_sentence
from armrig.models.fit import Fit
from armrig.numerics.quantities import fixed, listed, number, p_value, percent, places, power
from armrig.recordings.findings import alpha_moves
from armrig.report.recording_facts import run_name
from armrig.report.study import Assessed, AssessedFit, Study, each_output
from armrig.validation.residual_test import ResidualTest


def orders(study: Study) -> str:
    """Return the orders of the models of each output as text."""
    of_each = [_orders(one) for one in each_output(study)]
    if len(of_each) == 1:
        return of_each[0]
    return "; ".join(
        f"for {one.symbol} {text}" for one, text in zip(each_output(study), of_each, strict=True)
    )


def _orders(study: Study) -> str:
    """Return the orders of the models; orders that all models share are not repeated."""
    values: dict[str, set[int]] = {}
    for m in study.estimated:
        for name, n in m.fit.orders.items():
            values.setdefault(name, set()).add(n)
    if any(len(found) > 1 for found in values.values()):
        return "; ".join(f"{m.name} {_assigned(m.fit.orders)}" for m in study.estimated)
    shared = {name: n for name, (n,) in values.items()}
    nk = shared.pop("nk")
    if len(set(shared.values())) == 1:
        return f"{' = '.join(shared)} = {next(iter(shared.values()))}, nk = {nk}"
    return _assigned(shared | {"nk": nk})


def _assigned(orders: Mapping[str, int]) -> str:
    return ", ".join(f"{name} = {n}" for name, n in orders.items())


def model_table(m: AssessedFit, reference: Assessed, symbol: str = "") -> dict[str, Any]:
    """Return the equation and the table of a model's coefficients, as values of the template.

    If reference and model have the same polynomials, one column has the reference's coefficients.
    If the model has several outputs, `symbol` is that of the output.
    """
    same = letters(m.fit) == letters(reference.model)
    of = f" of {symbol}" if symbol else ""
    caption = f"{m.name} model{of} and its standard deviations."
    if same:
        caption = f"{m.name} model{of}, its standard deviations, and the coefficients of the "
        caption += "physical model."
    return {
        "name": m.name,
        "equation": typst_form(m.fit),
        "header": [
            f"{m.name}, {symbol}" if symbol else m.name,
            "estimate",
            "σ",
            "σ robust",
            *([reference.name] if same else []),
        ],
        "rows": _coefficients(m.fit, reference.model if same else None),
        "caption": caption,
    }


def _coefficients(fit: Fit, reference: Fit | None) -> list[list[str]]:
    rows = []
    theirs = dict(zip(reference.names, reference.theta, strict=True)) if reference else {}
    for name, value, std, robust in zip(fit.names, fit.theta, fit.std, fit.std_robust, strict=True):
        decimals = places(float(std))
        row = [name, fixed(float(value), decimals), fixed(float(std), decimals)]
        row.append(fixed(float(robust), decimals))
        if reference:
            row.append(fixed(float(theirs[name]), decimals) if name in theirs else "–")
        rows.append(row)
    return rows


def structure(study: Study) -> str:
    """Return a text on the integrator, the initial state and the dead band in the models."""
    said = []
    letters_of = {
        m.fit.integrating.upper()
        for one in each_output(study)
        for m in one.estimated
        if m.fit.integrator
    }
    if letters_of:
        ramp = next(one for one in each_output(study) if one.integrates)
        angle = f"The {ramp.angle}" if study.others else "The angle"
        of = " of this angle" if study.others else ""
        has = "have" if len(letters_of) > 1 else "has"
        said.append(
            f"{angle} integrates the voltage, so {listed(sorted(letters_of))}{of} {has} the factor "
            "1 − q⁻¹ by construction."
        )
    if study.others:
        outputs = listed([one.symbol for one in each_output(study)])
        said.append(
            f"Each model has both outputs, {outputs}. In the OE model both outputs have one "
            "denominator, which is estimated from both. The table of each output contains the "
            "coefficients of its own transfer function. In the ARX model each output depends on "
            "its own past only, and the covariance of the errors weights both outputs."
        )
    offset = " and the input offset" if letters_of else ""
    are = "are" if offset else "is"
    said.append(
        f"The initial state{offset} of each experiment {are} estimated with the model. Samples in "
        "the dead band of the potentiometer, and the first sample after it, count as missing."
    )
    return " ".join(said)


def estimations(study: Study) -> str:
    """Return the losses of all models, without repeated warnings."""
    sentences = [
        text
        for one in each_output(study)
        for m in one.estimated
        for text in _estimation(m, one.symbol if study.others else "")
    ]
    return " ".join(dict.fromkeys(sentences))


def _estimation(model: AssessedFit, symbol: str) -> Iterator[str]:
    """Yield sentences with losses and warnings; FPE and AIC only for a model of one output."""
    fit = model.fit
    of = f" of {symbol}" if symbol else ""
    criteria = f", FPE {power(fit.fpe)} {fit.unit}², AIC {number(fit.aic)}" if not symbol else ""
    yield (
        f"{model.name}{of}: loss {power(fit.loss)} {fit.unit}²{criteria}; "
        f"on the estimation data, {whiteness_sentence(fit, 'σ', 'σ robust')}."
    )
    if not fit.converged:
        yield "The search did not converge."
    for w in fit.warnings:
        yield f"{w[:1].upper()}{w[1:].rstrip('.')}."


def percent_warning(study: Study) -> str:
    """Return a warning about the fits in percent if an output integrates; "" otherwise."""
    ramps = [
        o for o in each_output(study) if o.reference.comparison.velocity_fit_percent is not None
    ]
    if not ramps:
        return ""
    angle = f"the {ramps[0].angle}" if study.others else "the angle"
    return (
        f"The fit of {angle} is high for every model, because the ramp dominates the angle's "
        "variation: compare the rms errors. The fit of the velocity is computed from differences "
        "of the angle. The measured differences contain the converter's noise twice, so even the "
        "true system would not reach 100 %."
    )


def physics(study: Study) -> str:
    """Return a text on the deviation of each model from the physical model, the best first."""
    return (
        "The physical model is the handout's: two inertias, a spring and a DC motor. It has the "
        "handout's parameters and is sampled exactly for a held input; nothing in it was fitted. "
        f"{' '.join(_deviations(one, study) for one in each_output(study))}{arm_at_rest(study)}"
    )


def _deviations(one: Study, study: Study) -> str:
    span = f"{one.omega[0]:g} to {one.omega[-1]:.0f} rad/s"
    to = f"{f' to the {one.angle}' if study.others else ''} differs from the physical model"
    texts: list[str] = []
    for m in one.ranked:
        at = number(float(one.omega[np.argmax(m.deviation)]))
        shares = (np.median(m.deviation), np.max(m.deviation))
        median, most = (percent(100 * float(x)) for x in shares)
        texts.append(
            f"the {m.name} model{' differs' if texts else to} by a median of {median} and at most "
            f"by {most}, at {at} rad/s"
        )
    return f"From {span} {'; '.join(texts)}."


def arm_at_rest(study: Study) -> str:
    """Return a space and a sentence on recordings whose arm did not move; "" if there are none."""
    used = {study.estimation.source, study.validation.source}
    names = [run_name(r) for r in study.recordings if r.sha256 in used and not alpha_moves(r)]
    if not names:
        return ""
    return (
        f" In {listed(names)} alpha is constant: the arm was removed or held. The physical model "
        "has a moving arm, so it describes another rig."
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


def residual_rows(study: Study) -> list[list[str]]:
    """Return rows of the residual tests: hypothesis, p value of each model, and what to change.

    If the models have several outputs, the second column contains the output. The first row of
    each hypothesis then tests all outputs together.
    """
    of_each = [(one.symbol, [m.tests for m in one.estimated]) for one in each_output(study)]
    together = [m.together for m in study.estimated if m.together]
    if together:
        of_each.insert(0, ("together", together))
    return [
        [
            "" if i else hypothesis,
            *([output] if together else []),
            *(p_value(p_of(test)) for test in tests),
            "" if i else remedy,
        ]
        for hypothesis, remedy, p_of in HYPOTHESES
        for i, (output, tests) in enumerate(of_each)
    ]
