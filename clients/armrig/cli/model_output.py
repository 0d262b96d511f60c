"""Tables and lines about a model and its tests, for a person at the terminal."""

from __future__ import annotations

from dataclasses import replace
from math import isnan
from typing import TYPE_CHECKING, Any

import numpy as np

from armrig.cli.printing import fields_of
from armrig.cli.recorded_data import source_facts
from armrig.data.treatment import INTEGRATING_OUTPUTS
from armrig.models.equation import form, heading, outputs_and_poles, signals, whiteness_sentence
from armrig.models.fit import Fit
from armrig.numerics.quantities import NBSP, listed, near_one, p_relation, places, with_std
from armrig.numerics.whiteness import BAND_99_PERCENT, WHITE_LEVEL
from armrig.validation.advice import advice
from armrig.validation.answer import DYNAMICS, FEEDBACK, LEVEL, NOISE, OF_DATA, UNTESTED
from armrig.validation.comparison import Comparison
from armrig.validation.feedback_and_delay.by_channel import ByChannel
from armrig.validation.residual_test import ResidualTest

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from armrig.data.dataset import Dataset, Signals
    from armrig.data.finding import Finding
    from armrig.models.responses import Roots
    from armrig.validation.search_result import SearchResult

RTOL = 1e-9
"""Relative difference of two errors that is due to rounding."""
_MAX_DECIMALS = 9
_MAX_SHOWN_MODELS = 5  # models of a search without --verbose
_MAX_REASONS = 3  # reasons without --verbose; the table shows the first


def short_model_lines(fit: Fit, *, roots: bool) -> list[str]:
    """Return lines with equation, signals, coefficients of each polynomial, poles and zeros.

    For several signals, the lines contain the quality of each output, and the poles. Each number
    has a standard deviation: σ robust if `fit.trusts_robust`, otherwise σ.
    """
    if (fit.ny, fit.nu) != (1, 1):
        return list(outputs_and_poles(fit))
    std, which = (fit.std_robust, "σ robust") if fit.trusts_robust else (fit.std, "σ")
    texts: dict[str, list[str]] = {}
    for name, value, deviation in zip(fit.names, fit.theta, std, strict=True):
        texts.setdefault(name[0], []).append(with_std(float(value), float(deviation)))
    lines = [f"  {_equation(fit)}", f"  {signals(fit)}; below, ± is {which}"]
    lines += [f"  {letter}1 …   {_listed(values)}" for letter, values in texts.items()]
    if roots:
        lines += [f"  poles  {_roots(fit.poles())}", f"  zeros  {_roots(fit.zeros())}"]
    return lines


def _roots(found: Roots) -> str:
    """Return the roots and their standard deviations as text; a complex pair is one text."""
    texts = []
    for z, (real, imag) in _each_root(found):
        if z.imag > 0:
            least = min((s for s in (real, imag) if s > 0), default=0.0)
            decimals = min(places(least), _MAX_DECIMALS)
            pair = f"{z.real:.{decimals}f} ± {z.imag:.{decimals}f}i"
            texts.append(f"{pair} (σ {real:.2g}, {imag:.2g})")
        else:
            texts.append(near_one(z.real, real) if real else f"{z.real:g} (fixed)")
    return _listed(texts) or "none"


def _each_root(found: Roots) -> list[tuple[complex, list[float]]]:
    """Return each real root and each pair, with the deviations of its real and imaginary part."""
    with np.errstate(invalid="ignore"):  # rounding may make a variance negative
        stds = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    each = zip(found.values.tolist(), stds.tolist(), strict=True)
    return [(z, std) for z, std in each if z.imag >= 0]


def _listed(numbers: Sequence[str]) -> str:
    """Return the numbers as text, separated by commas; a line break cannot divide a number."""
    return ", ".join(number.replace(" ", NBSP) for number in numbers)


def model_lines(fit: Fit) -> list[str]:
    """Return the equation, the coefficients with σ and σ robust, and the tests of a model."""
    if (fit.ny, fit.nu) != (1, 1):
        return list(_channel_lines(fit))
    squared = _squared(fit.unit)
    lines = [
        heading(fit),
        f"  {_equation(fit)}",
        *coefficients(fit),
        *root_lines(fit),
        f"  fit {fit.fit_percent:.2f} % one step ahead on estimation data",
        f"  loss {fit.loss:.4g}{squared}, FPE {fit.fpe:.4g}{squared}, AIC {fit.aic:.5g}",
        f"  {whiteness_sentence(fit, 'σ', 'σ robust')}",
    ]
    if fit.starts:
        how = "agree" if fit.agreed else "DISAGREE, the best one was used"
        ends = ", ".join(f"{s.name} {s.loss:.6g}" for s in fit.starts)
        lines.append(f"  starts {how}: {ends}{squared}" + ("" if fit.converged else _UNFINISHED))
    if fit.canonical_correlations.size:
        lines += [f"  {line}" for line in fit.explain().splitlines()]
    return [*lines, *(f"  warning: {w}" for w in fit.warnings)]


def _channel_lines(fit: Fit) -> Iterator[str]:
    """Yield the quality of each output, the poles, and the coefficients of each channel."""
    yield from outputs_and_poles(fit)
    for i, j, channel in fit.channels():
        yield f"{fit.inputs[j]} to {fit.outputs[i]}, delay {channel.nk} Ts"
        yield from coefficients(channel)
        yield from root_lines(channel)
    yield from (f"  warning: {w}" for w in fit.warnings)


def advice_lines(fit: Fit, doubts: Sequence[Finding]) -> list[str]:
    """Return lines with doubts about the data, warnings from the estimation, and advice."""
    about = {f.about for f in doubts}
    # The first sentence of the output already reports the residuals.
    advised = [f for f in advice_on(fit) if f.level != "good"]
    advised = [f for f in advised if f.about not in {"residuals", *about}]
    if "integrator" in about or any(f.about == "level" for f in fit.findings):
        # This finding already explains the pole and the zero at 1.
        advised = [f for f in advised if f.about != "level"]
    said = about | {f.about for f in advised}
    warnings = [f.text for f in fit.findings if not said & _SAID_BY.get(f.about, set())]
    lines = [f"! {f.about}: {f.text}" for f in doubts]
    lines += [f"! {w}" for w in warnings] + [f"! {f.about}: {f.text}" for f in advised]
    return lines or ["nothing to act on"]


def advice_on(fit: Fit) -> tuple[Finding, ...]:
    """Return the findings about a model; those about several signals name their channels."""
    found: Any = advice(fit)
    if not isinstance(found, ByChannel):
        return tuple(found.findings)
    channels: dict[Finding, list[str]] = {}
    for (output, input), of_channel in found.results.items():
        for f in of_channel.findings:
            channels.setdefault(f, []).append(f"{input} to {output}")
    return tuple(replace(f, text=f"{listed(of)}: {f.text}") for f, of in channels.items())


def to_act_on(fit: Fit, doubts: Sequence[Finding]) -> set[str]:
    """Return the names of the findings to act on."""
    found = {f.about for f in (*doubts, *advice_on(fit)) if f.level != "good"}
    asked = {f.about if f.about in OF_DATA else f.asks for f in fit.findings}
    return found | (asked - {""})


def short_search_lines(found: SearchResult) -> list[str]:
    """Return the best five models of a search and the reasons for the choice."""
    return [found.table(_MAX_SHOWN_MODELS), *(f"- {r}" for r in found.reasons[1:_MAX_REASONS])]


def search_lines(found: SearchResult) -> list[str]:
    """Return the table and the reasons of a search, without the chosen model's warnings."""
    lines = repr(found).splitlines()
    return [line for line in lines if line.removeprefix("- ") not in found.fit.warnings]


_SAID_BY = {
    **{name: {name} for name in OF_DATA},
    "unstable": {"integrator", "unstable"},
    "poorer_minimum": {"search"},
    "not_converged": {"search"},
}
"""For each name of an estimation's finding: names of the findings of the advice that repeat it."""
_UNFINISHED = " (NOT CONVERGED)"


def coefficients(fit: Fit) -> list[str]:
    """Return the table of the parameters."""
    lines = [f"  {'coefficient':12} {'estimate':>14} {'σ':>10} {'σ robust':>10}"]
    with np.errstate(invalid="ignore"):  # rounding may make a variance negative
        stds = fit.std, fit.std_robust
    rows = zip(fit.names, fit.theta, *stds, strict=True)
    for name, value, std, robust in rows:
        power = int(name[1:]) - 1 + (fit.nk if name[0] == "b" else 1)
        finite = [s for s in (std, robust) if np.isfinite(s) and s > 0]
        decimals = min(places(min(finite, default=0.0)), _MAX_DECIMALS)
        lines.append(
            f"  {f'{name} q^-{power}':12} {value:>14.{decimals}f} {_std(std)} {_std(robust)}"
        )
    return lines


def root_lines(fit: Fit) -> list[str]:
    """Return poles and zeros in the z plane with their standard deviations; a pair is one row."""
    lines = [f"  {'root of z':12} {'value':>22} {'σ':>10} {'σ of the imaginary part':>24}"]
    for name, found in (("pole", fit.poles()), ("zero", fit.zeros())):
        for z, (real, imag) in _each_root(found):
            pair = f" ± {z.imag:.5f}i" if z.imag > 0 else ""
            std = f"{'fixed':>10}" if real == 0 and not pair else _std(real)
            lines.append(
                f"  {name:12} {f'{z.real:.5f}{pair}':>22} {std}{f' {imag:24.2g}' if pair else ''}"
            )
    return lines


def equally_well(horizons: Sequence[int | None]) -> str:
    """Return a sentence on the horizons, in samples, at which prediction equals simulation."""
    ahead = " and ".join(map(str, horizons))
    return f"Predicted {ahead} ahead, it fits equally well: the model has no noise model."


def residual_lines(tests: ResidualTest) -> list[str]:
    """Return the tests of the residuals, each with its hypothesis and p value."""
    where = "estimation" if tests.on_estimation_data else "validation"
    look = f": {NOISE}" if tests.white.coloured else ""
    counts = np.atleast_1d(np.isfinite(tests.e).sum(axis=0)).tolist()
    return [
        f"residuals on {where} data, {listed([str(n) for n in counts])} samples; {LEVEL}",
        f"  residuals {tests.white}{look}",
        f"  no dynamics missing: {_p(tests.missing_dynamics, DYNAMICS)}",
        f"  no feedback seen: {_p(tests.feedback, FEEDBACK)}",
        *([f"  no power: {tests.powerless}"] if tests.powerless else []),
        *(
            f"  residuals of {name}: {white}"
            for name, white in zip(tests.outputs, tests.white_by_output, strict=True)
            if len(tests.outputs) > 1
        ),
        *pair_lines(tests, every=True),
    ]


def pair_lines(tests: ResidualTest, *, every: bool = False) -> list[str]:
    """Return the tests of each pair; a single pair has no line of its own."""
    several = tests.missing_dynamics_by_pair.size > 1
    return [*tests.pair_lines(every=every)] if several else []


def lags_outside(tests: ResidualTest) -> str:
    """Return a note on single lags outside their bands if the joint test accepts; otherwise ""."""
    if tests.missing_dynamics_by_pair.size > 1:
        return ""
    beyond = np.abs(tests.cross_correlation) > BAND_99_PERCENT * tests.cross_std
    lags = [
        outside
        for p, outside in (
            (tests.whiteness, np.abs(tests.autocorrelation[1:]) > tests.autocorrelation_band),
            (tests.missing_dynamics, beyond[tests.cross_lags >= 0]),
            (tests.feedback, beyond[tests.cross_lags < 0]),
        )
        if p >= WHITE_LEVEL
    ]
    n, N = (sum(f(outside) for outside in lags) for f in (np.count_nonzero, np.size))
    if not n:
        return ""
    return (
        f"{n} of {N} lags {'is' if n == 1 else 'are'} outside the 99 % band although their joint "
        "test accepts. The joint test decides, because its p is for all lags together. The band is "
        "for a single lag: by chance one lag in a hundred is outside, often with its neighbours."
    )


def model_facts(fit: Fit) -> dict[str, Any]:
    """Return the results of the estimation as JSON fields.

    The values of several signals are a list with an item for each output or channel.
    """
    shared = {"converged": fit.converged, "warnings": list(fit.warnings)}
    if (fit.ny, fit.nu) != (1, 1):
        return _facts_of_each(fit) | shared
    facts = {
        **fields_of(fit, "structure orders integrator Ts"),
        "parameters": _parameters(fit),
        **fields_of(fit, "noise_variance loss fpe aic mdl fit_percent"),
        **_whiteness(fit),
        **shared,
        "N": fit.N,
        "answers": fit.summary().facts(),
    }
    if fit.canonical_correlations.size:
        facts |= fields_of(fit, "canonical_correlations suggested_order")
    return facts


def _whiteness(found: Fit | ResidualTest) -> dict[str, Any]:
    return {"p_white": found.whiteness, "whiteness_test": found.whiteness_test}


def _facts_of_each(fit: Fit) -> dict[str, Any]:
    """Return the results of each output and channel as JSON fields."""
    poles = fit.poles()
    return {
        "structure": fit.structure,
        "orders": fit.specification or fit.orders,
        "integrator": list(fit.form.integrators),
        **fields_of(fit, "shared inputs outputs Ts"),
        "noise_covariance": fit.noise_covariance,
        **{name: [getattr(q, name) for q in fit.quality] for name in ("loss", "fit_percent", "N")},
        "p_white": [q.white.p_value for q in fit.quality],
        "whiteness_test": [q.white.test for q in fit.quality],
        "poles": [
            {"real": z.real, "imag": z.imag, "std": std}
            for z, std in zip(poles.values, poles.std, strict=True)
        ],
        "channels": [
            {
                "input": fit.inputs[j],
                "output": fit.outputs[i],
                "nk": channel.nk,
                "parameters": _parameters(channel),
            }
            for i, j, channel in fit.channels()
        ],
    }


def _parameters(channel: Fit) -> dict[str, dict[str, float]]:
    rows = zip(channel.names, channel.theta, channel.std, channel.std_robust, strict=True)
    return {name: {"value": v, "std": s, "std_robust": r} for name, v, s, r in rows}


def error_facts(
    rows: Sequence[Comparison], names: str = "fit_percent rms_error velocity_fit_percent"
) -> dict[str, Any]:
    """Return the errors of a model as JSON fields; several outputs have lists."""
    each = [fields_of(row, names) for row in rows]
    if len(rows) == 1:
        return each[0]
    return {"outputs": [row.output for row in rows]} | {
        name: [of[name] for of in each] for name in each[0]
    }


def residual_facts(
    data: Dataset | Signals, rows: Sequence[Comparison], tests: ResidualTest
) -> dict[str, Any]:
    """Return the results on validation data as JSON fields."""
    facts = (
        source_facts(data)
        | {"on_estimation_data": rows[0].on_estimation_data}
        | error_facts(rows)
        | {
            **_whiteness(tests),
            "p_no_dynamics_missing": tests.missing_dynamics,
            "p_no_feedback": tests.feedback,
            "no_power": tests.powerless,
        }
    )
    if tests.missing_dynamics_by_pair.size == 1:
        return facts
    return facts | {
        "p_white_by_output": [white.p_value for white in tests.white_by_output],
        "whiteness_test_by_output": [white.test for white in tests.white_by_output],
        "channels": [
            {
                "input": input,
                "output": output,
                "p_no_dynamics_missing": tests.missing_dynamics_by_pair[i, j],
                "p_no_feedback": tests.feedback_by_pair[i, j],
            }
            for i, output in enumerate(tests.outputs)
            for j, input in enumerate(tests.inputs)
        ],
    }


def hint(fit: Fit) -> str:
    """Return a suggestion for the next model; "" if there is none."""
    for name, fixed in zip(fit.outputs, fit.form.integrators, strict=True):
        if fit.structure == "oe" and name in INTEGRATING_OUTPUTS and not fixed:
            return f"the angle {name} integrates: try --integrator"
    return ""


def _equation(fit: Fit) -> str:
    root = f"; one root of {fit.integrating.upper()} is 1 by construction" if fit.integrator else ""
    return f"{form(fit)}{root}"


def _p(p: float, otherwise: str) -> str:
    if isnan(p):
        return UNTESTED
    return f"p {p_relation(p)}" + (f", rejected: {otherwise}" if p < WHITE_LEVEL else "")


def _std(std: float) -> str:
    return f"{std:>10.2g}" if np.isfinite(std) else f"{'not known':>10}"


def _squared(unit: str) -> str:
    return f" ({unit})²" if "/" in unit else f" {unit}²" if unit else ""
