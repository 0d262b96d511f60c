"""Poles outside the unit circle: what a fit says of them, and how they are brought inside."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from armrig.data.finding import Asks, EstimateFinding, warning
from armrig.estimation.prediction_error import PredictionError, Solution
from armrig.models.fit import Fit
from armrig.models.innovations import errors
from armrig.models.model import Model
from armrig.models.structure_table import KINDS
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array, reflected, roots, without_integrator

ROUNDING = 1e-9  # a root on the circle is computed so far beside it at most
_VAGUE = 0.1  # deviation of a pole that may be anywhere
_SURELY = 3.0  # deviations from 1 beyond which a pole is no integrator
REFLECT: tuple[str, Asks] = "lower the orders, or stable=True reflects it", "order"
_MARGIN = 1e-6  # from the circle, of a pole that is brought inside from so near


def stabilised(p: Array) -> Array:
    """Return p with each root z outside the unit circle reflected into it, to 1/z*.

    That changes |p| by one factor at all frequencies. A root on the circle is drawn inside by
    1e-6; a p with all roots inside is returned as it is.
    """
    if np.all(np.abs(roots(p)) < 1.0 - ROUNDING):
        return p
    return reflected(p, 1.0 - _MARGIN)


def reflection_warnings(before: Array, after: Array) -> Iterator[EstimateFinding]:
    """Say which roots of a polynomial `stabilised` moved, if some."""
    z = np.abs(roots(before))
    moved = z[z >= 1.0 - ROUNDING]
    if after is not before and moved.size:
        farthest = f"the farthest from |z| = {moved.max():.4f}"
        yield warning(
            "reflected",
            f"stable=True reflected {moved.size} of {z.size} poles into the circle, {farthest}, "
            "and estimated B anew; the deviations are those of the free estimate",
            moved=moved.size,
            farthest=float(moved.max()),
        )


def with_stable_poles(
    problem: PredictionError, solution: Solution, theta: Array
) -> tuple[Array, Solution, tuple[EstimateFinding, ...]]:
    """Return theta = (c, d, f) and the solution with A, D and F reflected, and what was.

    C stays, and for given A, C, D and F the errors are linear in B and the unknown past.
    """
    n = problem.structure
    free = problem.named(solution.ab, theta)
    A, D, F = inside = [stabilised(free[name]) for name in "ADF"]
    notes = [
        w for name, p in zip("ADF", inside, strict=True) for w in reflection_warnings(free[name], p)
    ]
    if not notes:
        return theta, solution, ()
    theta = np.concatenate([theta[: n.nc], D[1:], F[1:]])
    solution = problem.solve(theta)
    if A is not free["A"]:
        y = solution.e + solution.by_ab @ solution.ab - solution.by_ab[:, : n.na] @ A[1:]
        basis = orthonormal(solution.by_ab[:, n.na :])
        ab = np.concatenate([A[1:], basis.coefficients(y)])
        pairs = zip(problem.experiments, solution.given, strict=True)
        parts = [errors(x, n, given, **problem.named(ab, theta)) for x, given in pairs]
        solution = replace(
            solution,
            ab=ab,
            parts=tuple(parts),
            e=basis.without(y),
            by_cdf=np.vstack([part.Psi for part in parts]),
        )
    return theta, solution, tuple(notes)


def largest_unstable(model: Model) -> float:
    """Return |z| of the farthest pole, of G or of the noise, that is not inside the circle.

    A pole at 1 by construction does not count; 0 where all others are inside.
    """
    polynomials = {letter: np.asarray(getattr(model, letter.upper())) for letter in "adf"}
    if model.integrating:
        polynomials[model.integrating] = without_integrator(polynomials[model.integrating])
    if not all(np.isfinite(p).all() for p in polynomials.values()):
        return float("inf")
    z = np.abs(np.concatenate([roots(p) for p in polynomials.values()]))
    return float(np.max(z[z >= 1.0 - ROUNDING], initial=0.0))


def with_stability_warning(fit: Fit) -> Fit:
    """Return the fit, with a warning where a pole is not inside the circle."""
    farthest = largest_unstable(fit)
    if not farthest:
        return fit
    return replace(fit, findings=(*fit.findings, unstable(farthest, *_way_out(fit))))


def unstable(farthest: float, way_out: str, asks: Asks) -> EstimateFinding:
    """Return the warning of a pole that far from 0, and what to do."""
    text = f"a pole is unstable, |z| = {farthest:.4f}: {way_out}"
    return warning("unstable", text, asks, farthest=farthest)


def _way_out(fit: Fit) -> tuple[str, Asks]:
    """Return what to do where the pole may be an integrator's, or how to be rid of it."""
    poles = fit.poles()
    for z, std in zip(poles.values, poles.std, strict=True):
        real = z.imag == 0 and not fit.integrator
        if real and abs(z) >= 1 - ROUNDING and std > _VAGUE:
            return f"and its deviation is {std:.2g}, so the data do not determine the model", ""
        if real and abs(z) >= 1 - ROUNDING and abs(z - 1) < _SURELY * std + ROUNDING:
            what = f"1 within its accuracy; if {fit.output} integrates, "
            if "integrator" in KINDS[fit.structure].takes:
                return what + "ask for integrator=True", "integrator"
            return what + "take oe with integrator=True", "structure"
    return REFLECT
