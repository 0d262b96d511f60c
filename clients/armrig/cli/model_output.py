"""A model and its tests as a table and a few lines, for a person at the terminal."""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING, Any

import numpy as np

from armrig.cli.recorded_data import source_facts
from armrig.data.dataset import Dataset
from armrig.data.treatment import INTEGRATING_OUTPUTS
from armrig.models.equation import form, heading, whiteness_sentence
from armrig.models.fit import Fit
from armrig.models.subspace_fit import SubspaceFit
from armrig.numerics.quantities import p_relation, places
from armrig.numerics.whiteness import WHITE_LEVEL
from armrig.validation.comparison import Comparison
from armrig.validation.residuals import ResidualTest

if TYPE_CHECKING:
    from armrig.validation.search_result import SearchResult

_MOST_DECIMALS = 9


def model_lines(fit: Fit) -> list[str]:
    """Return the model: equation, coefficients with both standard deviations, and verdict."""
    squared = _squared(fit.unit)
    root = f"; one root of {fit.integrating.upper()} is 1 by construction" if fit.integrator else ""
    lines = [
        heading(fit),
        f"  {form(fit)}{root}",
        *coefficients(fit),
        *root_lines(fit),
        f"  fit {fit.fit_percent:.2f} % one step ahead on estimation data",
        f"  loss {fit.loss:.4g}{squared}, FPE {fit.fpe:.4g}{squared}, AIC {fit.aic:.5g}",
        f"  {whiteness_sentence(fit, 'σ', 'σ robust')}",
    ]
    if fit.starts:
        how = "agree" if fit.agreed else "DISAGREE, the best was taken"
        ends = ", ".join(f"{s.name} {s.loss:.6g}" for s in fit.starts)
        lines.append(f"  starts {how}: {ends}{squared}" + ("" if fit.converged else _UNFINISHED))
    if isinstance(fit, SubspaceFit):
        lines += [f"  {line}" for line in fit.explain().splitlines()]
    return [*lines, *(f"  warning: {in_symbols(w)}" for w in fit.warnings)]


def search_lines(found: SearchResult) -> list[str]:
    """Return the table and the reasons of a search, without the warnings of the model chosen."""
    lines = repr(found).splitlines()
    return [in_symbols(line) for line in lines if line.removeprefix("- ") not in found.fit.warnings]


def in_symbols(text: str) -> str:
    """Return a sentence of Python's in the words of the command line and of its tables."""
    for python, ours in _OURS.items():
        text = text.replace(python, ours)
    return text


_OURS = {
    "integrator=True": "--integrator",
    "std_robust": "σ robust",
    "trust std": "trust σ",
    "offset=True": "--offset",
    "stable=True": "--stable",
    "armrig.detrend(data)": "--detrend",
    "estimate from armrig.hampel(data), which marks": "--hampel marks",
}

_UNFINISHED = " (NOT CONVERGED)"


def coefficients(fit: Fit) -> list[str]:
    """Return the table of the parameters."""
    lines = [f"  {'coefficient':12} {'estimate':>14} {'σ':>10} {'σ robust':>10}"]
    with np.errstate(invalid="ignore"):  # a variance that rounding made negative is not known
        stds = fit.std, fit.std_robust
    rows = zip(fit.names, fit.theta, *stds, strict=True)
    for name, value, std, robust in rows:
        power = int(name[1:]) - 1 + (fit.nk if name[0] == "b" else 1)
        finite = [s for s in (std, robust) if np.isfinite(s) and s > 0]
        decimals = min(places(min(finite, default=0.0)), _MOST_DECIMALS)
        lines.append(
            f"  {f'{name} q^-{power}':12} {value:>14.{decimals}f} {_std(std)} {_std(robust)}"
        )
    return lines


def root_lines(fit: Fit) -> list[str]:
    """Return poles and zeros in the z plane with their standard deviations, a pair as one."""
    lines = [f"  {'root of z':12} {'value':>22} {'σ':>10} {'σ of the imaginary part':>24}"]
    for name, found in (("pole", fit.poles()), ("zero", fit.zeros())):
        with np.errstate(invalid="ignore"):  # as above
            stds = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
        for z, (real, imag) in zip(found.values.tolist(), stds.tolist(), strict=True):
            if z.imag < 0:
                continue
            pair = f" ± {z.imag:.5f}i" if z.imag > 0 else ""
            std = f"{'fixed':>10}" if real == 0 and not pair else _std(real)
            lines.append(
                f"  {name:12} {f'{z.real:.5f}{pair}':>22} {std}{f' {imag:24.2g}' if pair else ''}"
            )
    return lines


def residual_lines(tests: ResidualTest) -> list[str]:
    """Return the tests of the residuals, each with the hypothesis that its p value is of."""
    where = "estimation" if tests.on_estimation_data else "validation"
    look = ": look at the noise model or the orders" if tests.white.coloured else ""
    return [
        f"residuals on {where} data, {np.count_nonzero(np.isfinite(tests.e))} samples",
        f"  residuals {tests.white}{look}",
        f"  no dynamics missing: {_p(tests.missing_dynamics, 'look at the orders or the delay')}",
        f"  no feedback: {_p(tests.feedback, 'look at the experiment, or the delay is too large')}",
        *([f"  no power: {in_symbols(tests.powerless)}"] if tests.powerless else []),
    ]


def model_facts(fit: Fit) -> dict[str, Any]:
    """Return the model for a program."""
    rows = zip(fit.names, fit.theta, fit.std, fit.std_robust, strict=True)
    facts = {
        "structure": fit.structure,
        "orders": fit.orders,
        "integrator": fit.integrator,
        "Ts": fit.Ts,
        "parameters": {
            name: {"value": float(v), "std": float(s), "std_robust": float(r)}
            for name, v, s, r in rows
        },
        "noise_variance": fit.noise_variance,
        "loss": fit.loss,
        "fpe": fit.fpe,
        "aic": fit.aic,
        "mdl": fit.mdl,
        "fit_percent": fit.fit_percent,
        "p_white": fit.whiteness,
        "whiteness_test": fit.whiteness_test,
        "converged": fit.converged,
        "warnings": list(fit.warnings),
        "N": fit.N,
        "answers": fit.summary().facts(),
    }
    if isinstance(fit, SubspaceFit):
        facts["canonical_correlations"] = fit.canonical_correlations.tolist()
        facts["suggested_order"] = fit.suggested_order
    return facts


def residual_facts(data: Dataset, row: Comparison, tests: ResidualTest) -> dict[str, Any]:
    """Return the verdict of validation data for a program."""
    return source_facts(data) | {
        "on_estimation_data": row.on_estimation_data,
        "fit_percent": row.fit_percent,
        "rms_error": row.rms_error,
        "velocity_fit_percent": row.velocity_fit_percent,
        "p_white": tests.whiteness,
        "whiteness_test": tests.whiteness_test,
        "p_no_dynamics_missing": tests.missing_dynamics,
        "p_no_feedback": tests.feedback,
        "no_power": tests.powerless,
    }


def hint(fit: Fit) -> str:
    """Return what to try next, or nothing."""
    integrates = fit.output in INTEGRATING_OUTPUTS
    searched = fit.converged and fit.agreed
    if fit.structure == "oe" and integrates and not fit.integrator and not searched:
        return f"the angle {fit.output} integrates: try --integrator"
    return ""


def _p(p: float, otherwise: str) -> str:
    if isnan(p):
        return "too few samples, or no residual, to test"
    return f"p {p_relation(p)}" + (f", rejected: {otherwise}" if p < WHITE_LEVEL else "")


def _std(std: float) -> str:
    return f"{std:>10.2g}" if np.isfinite(std) else f"{'not known':>10}"


def _squared(unit: str) -> str:
    return f" ({unit})²" if "/" in unit else f" {unit}²" if unit else ""
