"""Advice on a model."""

from __future__ import annotations

from collections.abc import Iterator

from armrig.data.finding import Finding
from armrig.data.treatment import INTEGRATING_OUTPUTS
from armrig.models.characteristics import overlapping
from armrig.models.equation import whiteness_sentence
from armrig.models.fit import Fit
from armrig.models.structure_table import DESCRIBED
from armrig.numerics.quantities import near_one
from armrig.validation.advice.data_advice import finding

COLOURED = "raise the orders, look at the delay, or add a noise model"
"""Remedy for residuals that are not white."""
_FIX_POLE = "fix it (OE with the option integrator)"
_DEVIATIONS = "the ordinary deviations", "the robust deviations"
_MAX_IMAGINARY = 1e-9  # imaginary part below which a pole counts as real
_MAX_POLE_STD = 0.1  # standard deviation above which the data do not determine a pole
_MAX_DISTANCE_FROM_ONE = 0.01  # distance in the z plane below which a pole or zero is near 1
_STD_99 = 2.58
_Pair = tuple[complex, complex, float]
"""A pole, a zero, and the p value of their difference."""


def examine_model(fit: Fit) -> Iterator[Finding]:
    """Yield the findings of a model."""
    yield _about_search(fit)
    white = not fit.trusts_robust
    text = whiteness_sentence(fit, *_DEVIATIONS) + ("" if white else f"; {COLOURED}")
    yield finding("residuals", text, good=white)
    apart, at_one = _overlaps(fit)
    yield _about_overlap(fit, apart)
    yield from _about_pair_at_one(fit, at_one)
    yield from _about_poles(fit)
    if not at_one:
        yield from _about_integrator(fit)
    yield from _about_first_coefficient(fit)
    if fit.structure == "arx" and fit.output in INTEGRATING_OUTPUTS:
        text = "ARX assumes noise that passes through 1/A; an angle has noise at the output: "
        yield finding("structure", text + "compare with OE and the option integrator", good=False)


def cancelling(fit: Fit) -> list[_Pair]:
    """Return pole, zero and p value of the pairs that cancel, except pairs near 1."""
    return _overlaps(fit)[0]


def _overlaps(fit: Fit) -> tuple[list[_Pair], list[_Pair]]:
    """Return the cancelling pairs far from 1, and the pairs near 1, which model a constant."""
    pairs = overlapping(fit)
    at_one = [
        p
        for p in pairs
        if abs(p[0] - 1) < _MAX_DISTANCE_FROM_ONE and abs(p[1] - 1) < _MAX_DISTANCE_FROM_ONE
    ]
    return [p for p in pairs if p not in at_one], at_one


def _about_search(fit: Fit) -> Finding:
    if not fit.converged:
        text = "the search did not converge: lower the orders, or record more data"
    elif not fit.agreed:
        text = "start values led to different minima: the best was taken, it may not be global"
    else:
        return finding("search", "one minimum" if fit.starts else "closed form", good=True)
    return finding("search", text, good=False)


def _about_overlap(fit: Fit, pairs: list[_Pair]) -> Finding:
    if not pairs:
        return finding("order", "no pole is cancelled by a zero", good=True)
    places = ", ".join(f"{_z(pole)} and {_z(zero)}" for pole, zero, _ in pairs)
    text = (
        f"pole and zero {places} (z plane) cannot be distinguished: they cancel, and the order is "
    )
    kind = DESCRIBED[fit.structure]
    lower = " and ".join(name for name in ("nb", kind.poles) if name in kind.orders)
    return finding("order", text + f"too high by the number of pairs; lower {lower}", good=False)


def _about_pair_at_one(fit: Fit, pairs: list[_Pair]) -> Iterator[Finding]:
    """Yield the finding about a pole and a zero near 1: a constant level, or too high an order."""
    if not pairs:
        return
    pole, zero, _ = pairs[0]
    text = f"pole {_z(pole)} and zero {_z(zero)} cancel: they model a constant of "
    text += f"{fit.output} that u does not explain; remove the means (detrend), or estimate "
    text += "an offset (option offset). If you did one of these, lower the order"
    yield finding("level", text, good=False)


def _about_poles(fit: Fit) -> Iterator[Finding]:
    poles = fit.poles()
    for z, std in zip(poles.values, poles.std, strict=True):
        if abs(z) > 1 + max(_STD_99 * std, 1e-3) and z.imag >= 0:
            text = f"pole {_z(z)} is outside the unit circle: the rig is stable, so simulate with "
            yield finding("unstable", text + "care, and look at delay and orders", good=False)
        if abs(z.imag) < _MAX_IMAGINARY and z.real + _STD_99 * std < 0:
            text = f"pole {_z(z)} is real and negative: no rig in continuous time has such a pole "
            text += "after sampling (exp(s Ts) > 0), so it models noise; lower the order"
            yield finding("poles", text, good=False)


def _about_integrator(fit: Fit) -> Iterator[Finding]:
    if fit.integrator:
        return
    poles = fit.poles()
    for z, std in zip(poles.values, poles.std, strict=True):
        near = abs(z.real - 1) < max(_STD_99 * std, 1e-3) and std < _MAX_POLE_STD
        if abs(z.imag) < _MAX_IMAGINARY and near:
            within = abs(z.real - 1) < _STD_99 * std
            what = "is 1 within its accuracy" if within else "is so near 1 that it integrates"
            text = f"pole {near_one(z.real, std)} {what}: {_FIX_POLE}"
            yield finding("integrator", text, good=False)
            return
    if fit.output in INTEGRATING_OUTPUTS:
        text = f"{fit.output} integrates, and no pole of the model is 1: {_FIX_POLE}"
        yield finding("integrator", text, good=False)


def _about_first_coefficient(fit: Fit) -> Iterator[Finding]:
    i = fit.slice_of("b").start
    b, std = float(fit.theta[i]), float(fit.std_robust[i])
    if std > 0 and abs(b) < _STD_99 * std:
        text = f"b1 = {b:.2g} ± {std:.2g} does not differ significantly from 0: a delay, or only "
        yield finding(
            "delay", text + "noise; a test decides (armrig.delay, `armrig check`)", good=False
        )


def _z(z: complex) -> str:
    return f"{z.real:.3f}" if abs(z.imag) < _MAX_IMAGINARY else f"{z.real:.3f} ± {abs(z.imag):.3f}i"
