"""Facts about the models of a report: coefficients, losses, residuals, distance to the physics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from armrig.models.equation import letters, whiteness_sentence
from armrig.models.fit import Fit
from armrig.models.markup import typst_form
from armrig.models.model import Model
from armrig.numerics.quantities import fixed, listed, number, p_value, percent, places, power
from armrig.recordings.findings import alpha_moves
from armrig.report.recording_facts import run_name
from armrig.report.study import Assessed, AssessedFit, Study


def orders(study: Study) -> str:
    """Return the orders of the models as text; orders that all models share are not repeated."""
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


def model_table(m: AssessedFit, reference: Assessed) -> dict[str, Any]:
    """Return the equation and the table of a model's coefficients, as values of the template.

    If the reference has the same form as the model, a column contains the reference's coefficients.
    """
    same = letters(m.fit) == letters(reference.model)
    caption = f"{m.name} model and its standard deviations."
    if same:
        caption = f"{m.name} model, its standard deviations, and the coefficients of the physical "
        caption += "model."
    return {
        "name": m.name,
        "equation": typst_form(m.fit),
        "header": [m.name, "estimate", "σ", "σ robust", *([reference.name] if same else [])],
        "rows": _coefficients(m.fit, reference.model if same else None),
        "caption": caption,
    }


def _coefficients(fit: Fit, reference: Model | None) -> list[list[str]]:
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
    integrating = sorted({m.fit.integrating.upper() for m in study.estimated if m.fit.integrator})
    if not integrating:
        return ""
    return (
        f"The angle integrates the voltage, so {listed(integrating)} "
        f"{'has' if len(integrating) == 1 else 'have'} the factor 1 − q⁻¹ by construction. The "
        "initial state and the input offset of each experiment are estimated with the model. "
        "Samples in the dead band of the potentiometer, and the first sample after it, count as "
        "missing."
    )


def estimation(model: AssessedFit) -> str:
    """Return a model's losses, and which of its standard deviations are valid."""
    fit = model.fit
    warned = "".join(f" {w[:1].upper()}{w[1:].rstrip('.')}." for w in fit.warnings)
    converged = "" if fit.converged else " The search did not converge."
    return (
        f"{model.name}: loss {power(fit.loss)} {fit.unit}², "
        f"FPE {power(fit.fpe)} {fit.unit}², AIC {number(fit.aic)}; "
        f"on the estimation data, {whiteness_sentence(fit, 'σ', 'σ robust')}.{converged}{warned}"
    )


def percent_warning(study: Study) -> str:
    """Return a warning about the fits in percent if the output integrates; "" otherwise."""
    if study.reference.comparison.velocity_fit_percent is None:
        return ""
    return (
        "The fit of the angle is high for every model, because the ramp dominates the angle's "
        "variation: compare the rms errors. The fit of the velocity is computed from differences "
        "of the angle. The measured differences contain the converter's noise twice, so even the "
        "true system would not reach 100 %."
    )


def physics(study: Study) -> str:
    """Return a text with the distance of each model to the physics, the best model first."""
    first, *others = (_deviation(m, study) for m in study.ranked)
    name, (median, most, at) = study.best.name, first
    text = (
        "The physical model is the handout's: two inertias, a spring and a DC motor. It has the "
        "handout's parameters and is sampled exactly for a held input; nothing in it was fitted. "
        f"From {study.omega[0]:g} to {study.omega[-1]:.0f} rad/s the {name} model differs from the "
        f"physical model by a median of {median} and at most by {most}, at {at}"
    )
    for m, (median, most, at) in zip(study.ranked[1:], others, strict=True):
        text += (
            f"; the {m.name} model differs by a median of {median} and at most by {most}, at {at}"
        )
    return f"{text}.{arm_at_rest(study)}"


def arm_at_rest(study: Study) -> str:
    """Return a sentence, after a space, on recordings whose arm did not move; "" if all moved."""
    used = {study.estimation.source, study.validation.source}
    names = [run_name(r) for r in study.recordings if r.sha256 in used and not alpha_moves(r)]
    if not names:
        return ""
    return (
        f" In {listed(names)} alpha is constant: the arm was removed or held. The physical model "
        "has a moving arm, so it describes another rig."
    )


def _deviation(m: AssessedFit, study: Study) -> tuple[str, str, str]:
    """Return median and greatest deviation from the physics, and the frequency of the latter."""
    at = float(study.omega[np.argmax(m.deviation)])
    median, most = float(np.median(m.deviation)), float(np.max(m.deviation))
    return percent(100 * median), percent(100 * most), f"{number(at)} rad/s"


def residual_rows(study: Study) -> list[list[str]]:
    """Return rows of the residual tests: hypothesis, p value of each model, and what to change."""
    tests = [m.tests for m in study.estimated]
    return [
        ["white", *(p_value(t.whiteness) for t in tests), "noise model or orders"],
        [
            "no correlation with past input",
            *(p_value(t.missing_dynamics) for t in tests),
            "orders or delay",
        ],
        [
            "no correlation with future input",
            *(p_value(t.feedback) for t in tests),
            "feedback in the experiment, or delay too large",
        ],
    ]
