"""What a model gives away of itself."""

from __future__ import annotations

from collections.abc import Iterator

from armrig.data.finding import Finding
from armrig.data.treatment import INTEGRATING_OUTPUTS
from armrig.models.characteristics import overlapping
from armrig.models.equation import whiteness_sentence
from armrig.models.fit import Fit
from armrig.models.structure_table import KINDS
from armrig.numerics.quantities import near_one
from armrig.validation.advice.finding import finding

COLOURED = "raise the orders, look at the delay, or add a noise model"
"""What to do about residuals that are not white."""
_REAL = 1e-9
_VAGUE = 0.1  # standard deviation of a pole that may be anywhere
_AT_ONE = 0.01  # distance from 1 in the z plane
_STD_99 = 2.58
_Pair = tuple[complex, complex, float]
"""A pole, a zero, and the p value of their being one."""


def examine_model(fit: Fit) -> Iterator[Finding]:
    """Iterate over the points, in the order in which one would look."""
    yield _about_search(fit)
    white = not fit.trusts_robust
    text = whiteness_sentence(fit) + ("" if white else f"; {COLOURED}")
    yield finding("residuals", text, good=white)
    apart, at_one = _overlaps(fit)
    yield _about_overlap(fit, apart)
    yield from _about_pair_at_one(fit, at_one)
    yield from _about_poles(fit)
    if not at_one:
        yield from _about_integrator(fit)
    yield from _about_first_coefficient(fit)
    if fit.structure == "arx" and fit.output in INTEGRATING_OUTPUTS:
        text = "ARX takes the noise to pass through 1/A; on an angle it is added at the end: "
        yield finding("structure", text + "compare with oe(…, integrator=True)", good=False)


def cancelling(fit: Fit) -> list[_Pair]:
    """Return pole, zero and p value of the pairs that an order too high makes; not those at 1."""
    return _overlaps(fit)[0]


def _overlaps(fit: Fit) -> tuple[list[_Pair], list[_Pair]]:
    """Return the pairs that cannot be told apart, and of them those at 1, which make a level."""
    pairs = overlapping(fit)
    at_one = [p for p in pairs if abs(p[0] - 1) < _AT_ONE and abs(p[1] - 1) < _AT_ONE]
    return [p for p in pairs if p not in at_one], at_one


def _about_search(fit: Fit) -> Finding:
    if not fit.converged:
        text = "the search did not converge: lower the orders, or give it more data"
    elif not fit.agreed:
        text = "start values led to different minima: the best was taken, it may not be the global"
    else:
        return finding("search", "one minimum" if fit.starts else "closed form", good=True)
    return finding("search", text, good=False)


def _about_overlap(fit: Fit, pairs: list[_Pair]) -> Finding:
    if not pairs:
        return finding("order", "all poles and zeros can be told apart", good=True)
    places = ", ".join(f"{_z(pole)} and {_z(zero)}" for pole, zero, _ in pairs)
    text = f"pole and zero {places} (z plane) cannot be told apart: they cancel, and the order is "
    kind = KINDS[fit.structure]
    lower = " and ".join(name for name in ("nb", kind.poles) if name in kind.orders)
    return finding("order", text + f"too high by as many; lower {lower}", good=False)


def _about_pair_at_one(fit: Fit, pairs: list[_Pair]) -> Iterator[Finding]:
    """Say what a pole and a zero near 1 stand for: a constant, or an order too high."""
    if not pairs:
        return
    pole, zero, _ = pairs[0]
    text = f"pole {_z(pole)} and zero {_z(zero)} cancel: together they make a level of "
    text += f"{fit.output} that u does not; remove the means, armrig.detrend(data), or take "
    yield finding("level", text + "offset=True; if that is done, lower the order", good=False)


def _about_poles(fit: Fit) -> Iterator[Finding]:
    poles = fit.poles()
    for z, std in zip(poles.values, poles.std, strict=True):
        if abs(z) > 1 + max(_STD_99 * std, 1e-3) and z.imag >= 0:
            text = f"pole {_z(z)} is outside the unit circle: the rig is stable, so simulate with "
            yield finding("unstable", text + "care, and look at delay and orders", good=False)
        if abs(z.imag) < _REAL and z.real + _STD_99 * std < 0:
            text = f"pole {_z(z)} is real and negative: sampling makes none such of a rig in "
            text += "continuous time (exp(s Ts) > 0), it stands for noise; lower the order"
            yield finding("poles", text, good=False)


def _about_integrator(fit: Fit) -> Iterator[Finding]:
    if fit.integrator:
        return
    poles = fit.poles()
    for z, std in zip(poles.values, poles.std, strict=True):
        near = abs(z.real - 1) < max(_STD_99 * std, 1e-3) and std < _VAGUE
        if abs(z.imag) < _REAL and near:
            within = abs(z.real - 1) < _STD_99 * std
            what = "is 1 within its accuracy" if within else "is so near 1 that it integrates"
            text = f"pole {near_one(z.real, std)} {what}: fix it, "
            yield finding("integrator", text + "oe(…, integrator=True)", good=False)
            return
    if fit.output in INTEGRATING_OUTPUTS:
        text = f"{fit.output} integrates, and no pole of the model is 1: fix it, "
        yield finding("integrator", text + "oe(…, integrator=True)", good=False)


def _about_first_coefficient(fit: Fit) -> Iterator[Finding]:
    i = fit.slice_of("b").start
    b, std = float(fit.theta[i]), float(fit.std_robust[i])
    if std > 0 and abs(b) < _STD_99 * std:
        text = f"b1 = {b:.2g} ± {std:.2g} is not shown to differ from 0: a delay, or nothing but "
        yield finding("delay", text + "noise; armrig.delay(data) decides", good=False)


def _z(z: complex) -> str:
    return f"{z.real:.3f}" if abs(z.imag) < _REAL else f"{z.real:.3f} ± {abs(z.imag):.3f}i"
