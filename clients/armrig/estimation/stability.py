"""Reflection of unstable poles into the unit circle, and the warnings about unstable poles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from armrig.data.finding import Finding, Remedy, warning
from armrig.data.treatment import integrates_by_name
from armrig.estimation.problem import PolynomialProblem, Solution
from armrig.models.estimate import Form
from armrig.models.fit import Fit
from armrig.models.structure_table import STRUCTURES
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array, monic, reflect_roots, roots, without_integrator
from armrig.numerics.quantities import digits

CIRCLE_ROUNDING = 1e-9  # error of the computed modulus of a root on the circle
_MAX_POLE_STD = 0.1  # standard deviation above which the data do not determine a pole
_INTEGRATOR_SIGMAS = 3.0  # standard deviations from 1 beyond which a pole is no integrator
_MAX_DISTANCE_FROM_1 = 0.02  # a pole farther from 1 is no integrator, in spite of its deviation
REFLECT: tuple[str, Remedy] = (
    "if the rig is unstable, predict instead of simulating; else lower the orders, or set the "
    "option stable",
    "order",
)
_CIRCLE_MARGIN = 1e-6  # least distance of a reflected pole from the circle
_CIRCLE_TOLERANCE = 1e-6  # error of the modulus of an eigenvalue of several signals


def stabilise(p: Array) -> Array:
    """Return p with each root z outside the unit circle replaced by its reflection 1/z*.

    The reflection changes |p| by the same factor at all frequencies. A root on the circle is moved
    inside by 1e-6. If all roots are inside, the function returns p itself.
    """
    if np.all(np.abs(roots(p)) < 1.0 - CIRCLE_ROUNDING):
        return p
    return reflect_roots(p, 1.0 - _CIRCLE_MARGIN)


def reflection_warnings(before: Array, after: Array) -> Iterator[Finding]:
    """Yield a warning with the number of roots that `stabilised` moved, if there are any."""
    z = np.abs(roots(before))
    moved = z[z >= 1.0 - CIRCLE_ROUNDING]
    if after is not before and moved.size:
        farthest = f"the farthest from |z| = {moved.max():.4f}"
        yield warning(
            "reflected",
            f"{moved.size} of {z.size} poles were reflected into the circle (option stable), "
            f"{farthest}, and B was estimated again; the standard deviations ignore the reflection",
            moved=moved.size,
            farthest=float(moved.max()),
        )


def with_stable_poles(
    problem: PolynomialProblem, solution: Solution, theta: Array
) -> tuple[Array, Solution, tuple[Finding, ...]]:
    """Return theta, the solution and the warnings, after A, D and F are reflected.

    B and the unknown past are then estimated again, by least squares.
    """
    layout, ab, notes = problem.layout, solution.ab.copy(), list[Finding]()
    fixed = np.zeros(ab.size, dtype=np.bool_)
    for i, n in enumerate(problem.rows):
        at = layout.linear[i][: n.na] if layout.letters[0] != "a" else np.zeros(0, dtype=np.int_)
        A = stabilise(free := monic(ab[at]))
        if A is not free:
            notes += reflection_warnings(free, A)
            ab[at], fixed[at] = A[1:], True
    theta = theta.copy()
    for letter, part in zip(layout.letters, layout.slices, strict=True):
        if letter in "adf":
            inside = stabilise(free := monic(theta[part]))
            notes += reflection_warnings(free, inside)
            theta[part] = inside[1:]
    if not notes:
        return theta, solution, ()
    solution = problem.solve(theta)
    if fixed.any():
        y = solution.e + solution.by_ab @ solution.ab - solution.by_ab[:, fixed] @ ab[fixed]
        ab[~fixed] = orthonormal(solution.by_ab[:, ~fixed]).coefficients(y)
        solution = problem.solve(theta, ab)
    return theta, solution, tuple(notes)


def largest_unstable(model: Fit) -> float:
    """Return the largest |z| of the poles on or outside the unit circle, or 0 if all are inside.

    All poles of G and of the noise model are included, except a pole that is 1 by construction.
    """
    polynomials = {letter: np.asarray(getattr(model, letter.upper())) for letter in "adf"}
    if model.integrating:
        polynomials[model.integrating] = without_integrator(polynomials[model.integrating])
    if not all(np.isfinite(p).all() for p in polynomials.values()):
        return float("inf")
    z = np.abs(np.concatenate([roots(p) for p in polynomials.values()]))
    return float(np.max(z[z >= 1.0 - CIRCLE_ROUNDING], initial=0.0))


def with_stability_warning(fit: Fit) -> Fit:
    """Return the fit, with a warning if a pole is not inside the unit circle."""
    farthest = largest_unstable(fit)
    if not farthest:
        return fit
    return replace(fit, findings=(*fit.findings, unstable(farthest, *_way_out(fit, farthest))))


def unstable(farthest: float, way_out: str, remedy: Remedy) -> Finding:
    """Return the warning about an unstable pole of modulus `farthest`; the remedy is `way_out`."""
    about = "integrator" if remedy in ("integrator", "structure") else "unstable"
    text = f"a pole is unstable, |z| = {farthest:.4f}: {way_out}"
    return warning(about, text, remedy, modulus=farthest)


def instability(form: Form) -> Iterator[Finding]:
    """Yield a warning if a pole of a model of several signals is outside the unit circle."""
    largest = float(np.max(np.abs(np.linalg.eigvals(form.innovations_form().A)), initial=0.0))
    if largest > 1 + _CIRCLE_TOLERANCE:
        yield warning(
            "unstable",
            f"a pole of modulus {largest:.4g} is outside the unit circle: simulations grow without "
            "bound",
            modulus=largest,
        )


def _way_out(fit: Fit, farthest: float) -> tuple[str, Remedy]:
    """Return the remedy for an unstable pole of this modulus; the pole may be an integrator."""
    poles = fit.poles()
    for z, std in zip(poles.values, poles.std, strict=True):
        if z.imag != 0 or fit.integrator or abs(z) < farthest - CIRCLE_ROUNDING:
            continue
        if std > _MAX_POLE_STD:
            text = (
                f"its standard deviation is {digits(std, 2)}, so the data do not determine "
                "the model"
            )
            return text, ""
        at_1 = abs(z - 1) < _INTEGRATOR_SIGMAS * std + CIRCLE_ROUNDING
        integrates = abs(z - 1) < _MAX_DISTANCE_FROM_1 and integrates_by_name(fit.output)
        if at_1 or integrates:
            reason = "the pole is 1 within its accuracy; " if at_1 else ""
            reason += (
                f"{fit.output} integrates, so " if integrates else f"if {fit.output} integrates, "
            )
            if "integrator" in STRUCTURES[fit.structure].takes:
                return reason + "set the option integrator", "integrator"
            return reason + "use OE with the option integrator", "structure"
    return REFLECT
