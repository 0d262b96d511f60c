"""What a model gives away of itself."""

from __future__ import annotations

from collections.abc import Iterator

from armrig.data.treatment import INTEGRATING_OUTPUTS
from armrig.models.cancellation import overlapping
from armrig.models.equation import whiteness_sentence
from armrig.models.fit import Fit
from armrig.recordings.usability import Finding
from armrig.validation.advice.finding import finding

COLOURED = "raise the orders, or add a noise model"
"""What to do about residuals that are not white."""
_REAL = 1e-9
_STD_99 = 2.58


def examine_model(fit: Fit) -> Iterator[Finding]:
    """Iterate over the points, in the order in which one would look."""
    yield _about_search(fit)
    white = not fit.trusts_robust
    text = whiteness_sentence(fit) + ("" if white else f"; {COLOURED}")
    yield finding("residuals", text, good=white)
    yield _about_overlap(fit)
    yield from _about_poles(fit)
    yield from _about_integrator(fit)
    yield from _about_first_coefficient(fit)
    if fit.structure == "arx" and fit.output in INTEGRATING_OUTPUTS:
        text = "ARX takes the noise to pass through 1/A; on an angle it is added at the end: "
        yield finding("structure", text + "compare with oe(…, integrator=True)", good=False)


def _about_search(fit: Fit) -> Finding:
    if not fit.converged:
        text = "the search did not converge: lower the orders, or give it more data"
    elif not fit.agreed:
        text = "start values led to different minima: the best was taken, it may not be the global"
    else:
        return finding("search", "one minimum" if fit.starts else "closed form", good=True)
    return finding("search", text, good=False)


def _about_overlap(fit: Fit) -> Finding:
    pairs = overlapping(fit)
    if not pairs:
        return finding("order", "all poles and zeros can be told apart", good=True)
    places = ", ".join(f"{_z(pole)} and {_z(zero)}" for pole, zero, _ in pairs)
    text = f"pole and zero {places} (z plane) cannot be told apart: they cancel, and the order is "
    return finding("order", text + "too high by as many; lower nb and nf (or na)", good=False)


def _about_poles(fit: Fit) -> Iterator[Finding]:
    poles = fit.poles()
    for z, std in zip(poles.values, poles.std, strict=True):
        if abs(z) > 1 + max(_STD_99 * std, 1e-3) and z.imag >= 0:
            text = f"pole {_z(z)} is outside the unit circle: the rig is stable, so simulate with "
            yield finding("unstable", text + "care, and look at delay and orders", good=False)
        if abs(z.imag) < _REAL and z.real < 0:
            sure = "" if z.real + _STD_99 * std < 0 else ", though it may as well be positive"
            text = f"pole {_z(z)} is real and negative{sure}: sampling makes none such of a rig in "
            text += "continuous time (exp(s Ts) > 0), it stands for noise; lower the order"
            yield finding("poles", text, good=False)


def _about_integrator(fit: Fit) -> Iterator[Finding]:
    if fit.integrator:
        return
    poles = fit.poles()
    for z, std in zip(poles.values, poles.std, strict=True):
        if abs(z.imag) < _REAL and abs(z.real - 1) < max(_STD_99 * std, 1e-3):
            text = f"pole {z.real:.5f} ± {std:.1g} is 1 as far as can be told: fix it, "
            yield finding("integrator", text + "oe(…, integrator=True)", good=False)
            return
    if fit.output in INTEGRATING_OUTPUTS:
        text = f"{fit.output} integrates, and no pole of the model is 1: fix it, "
        yield finding("integrator", text + "oe(…, integrator=True)", good=False)


def _about_first_coefficient(fit: Fit) -> Iterator[Finding]:
    i = fit.slice_of("b").start
    b, std = float(fit.theta[i]), float(fit.std_robust[i])
    if std > 0 and abs(b) < _STD_99 * std:
        text = f"b1 = {b:.2g} ± {std:.2g} is not shown to be there: a delay, or nothing but noise; "
        yield finding("delay", text + "armrig.delay(data) decides", good=False)


def _z(z: complex) -> str:
    return f"{z.real:.3f}" if abs(z.imag) < _REAL else f"{z.real:.3f} ± {abs(z.imag):.3f}i"
