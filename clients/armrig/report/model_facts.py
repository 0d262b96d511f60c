"""What a report says of its models: coefficients, losses, residuals, physics beside them."""

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
    """Return the orders, together where the models share them."""
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
    """Return the table of a model's coefficients, the reference beside one of the same form."""
    same = letters(m.fit) == letters(reference.model)
    beside = reference.model if same else None
    caption = f"{m.name} model and its standard deviations."
    if same:
        caption = f"{m.name} model, its standard deviations, and the coefficients of the physical "
        caption += "model."
    return {
        "name": m.name,
        "equation": typst_form(m.fit),
        "header": [m.name, "estimate", "σ", "σ robust", *([reference.name] if same else [])],
        "rows": _coefficients(m.fit, beside),
        "caption": caption,
    }


def _coefficients(fit: Fit, beside: Model | None) -> list[list[str]]:
    rows = []
    theirs = dict(zip(beside.names, beside.theta, strict=True)) if beside else {}
    for name, value, std, robust in zip(fit.names, fit.theta, fit.std, fit.std_robust, strict=True):
        decimals = places(float(std))
        row = [name, fixed(float(value), decimals), fixed(float(std), decimals)]
        row.append(fixed(float(robust), decimals))
        if beside:
            row.append(fixed(float(theirs[name]), decimals) if name in theirs else "–")
        rows.append(row)
    return rows


def structure(study: Study) -> str:
    """Return what was known beforehand of the models' structure."""
    integrating = sorted({m.fit.integrating.upper() for m in study.estimated if m.fit.integrator})
    if not integrating:
        return ""
    return (
        f"The angle integrates the voltage, so {listed(integrating)} "
        f"{'has' if len(integrating) == 1 else 'have'} the factor 1 − q⁻¹ by construction; initial "
        "state and input offset of each experiment are estimated with the model. Samples in the "
        "dead band of the potentiometer, and the one after, count as missing."
    )


def estimation(model: AssessedFit) -> str:
    """Return a model's losses, and whether its deviations hold."""
    fit = model.fit
    warned = "".join(f" {w[:1].upper()}{w[1:].rstrip('.')}." for w in fit.warnings)
    converged = "" if fit.converged else " The search did not converge."
    return (
        f"{model.name}: loss {power(fit.loss)} {fit.unit}², "
        f"FPE {power(fit.fpe)} {fit.unit}², AIC {number(fit.aic)}; "
        f"on the estimation data, {whiteness_sentence(fit, 'σ', 'σ robust')}.{converged}{warned}"
    )


def percent_warning(study: Study) -> str:
    """Return why the percentages flatter, where the output integrates."""
    if study.reference.comparison.velocity_fit_percent is None:
        return ""
    return (
        "The percentage of the angle flatters every model, because the ramp dominates its "
        "variation: read the rms error. The percentage of the velocity is that of differences, "
        "and the measured ones carry the converter's noise twice, so that even the true system "
        "would not reach 100 %."
    )


def physics(study: Study) -> str:
    """Return how far each model is from the physics, the best one first."""
    first, *others = (_deviation(m, study) for m in study.ranked)
    name, (median, most, at) = study.best.name, first
    text = (
        "The physical model is the handout's: two inertias, a spring and a DC motor, with its "
        "parameters as given, sampled exactly for a held input; nothing in it was fitted. From "
        f"{study.omega[0]:g} to {study.omega[-1]:.0f} rad/s the {name} model differs from it by "
        f"{median} (median) and at most {most}, at {at}"
    )
    for m, (median, most, at) in zip(study.ranked[1:], others, strict=True):
        text += f"; the {m.name} model by {median} and {most}, at {at}"
    return f"{text}.{arm_at_rest(study)}"


def arm_at_rest(study: Study) -> str:
    """Return a space and which data have no moving arm, as the physics has; "" if all have."""
    used = {study.estimation.source, study.validation.source}
    names = [run_name(r) for r in study.recordings if r.sha256 in used and not alpha_moves(r)]
    if not names:
        return ""
    return (
        f" In {listed(names)} alpha rests: the arm was off, or held. The physics has a moving arm, "
        "so it is the physics of another rig."
    )


def _deviation(m: AssessedFit, study: Study) -> tuple[str, str, str]:
    """Return median and greatest deviation from the physics, and where that is."""
    at = float(study.omega[np.argmax(m.deviation)])
    median, most = float(np.median(m.deviation)), float(np.max(m.deviation))
    return percent(100 * median), percent(100 * most), f"{number(at)} rad/s"


def residual_rows(study: Study) -> list[list[str]]:
    """Return the p values of the residual tests, a column a model."""
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
