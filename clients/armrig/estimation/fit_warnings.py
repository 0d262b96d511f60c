"""Warnings about a search and its parameters, and the curvature of the loss."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from armrig.data.finding import Finding, warning
from armrig.estimation.continuous_problem import ContinuousProblem
from armrig.estimation.problem import PolynomialProblem
from armrig.models.estimate import MAX_TRUSTED_CURVATURE, Start
from armrig.numerics.levenberg_marquardt import Optimum
from armrig.numerics.polynomial import Array, roots
from armrig.numerics.whiteness import Whiteness

CURVED_TEXT = (
    "do not trust the standard deviations of the coefficients: the loss is far from parabolic "
    "within two standard deviations. A pole and a zero may nearly cancel. The standard deviations "
    "of the responses are valid"
)
_CIRCLE_TOLERANCE = 1e-6
_PROBED_SIGMAS = 2.0
_MIN_RISE_RATIO = 1e-3  # a smaller ratio is set to this value
_MAX_CURVATURE = -float(np.log(_MIN_RISE_RATIO))


def not_converged(steps: int, of: str = "") -> Finding:
    """Return the warning about a search that ended without a minimum."""
    text = f"the search{of} did not converge in {steps} steps: lower the orders, or record more "
    return warning("search", f"{text}data", "order", steps=steps)


def search_warnings(best: Optimum, starts: tuple[Start, ...], *, agreed: bool) -> Iterator[Finding]:
    """Yield warnings about a search that did not converge or that found several minima."""
    if not best.converged:
        yield not_converged(best.iterations)
    elif not agreed:
        text = (
            f"the search from {starts[-1].name!r} ended in a poorer minimum "
            f"(loss {starts[-1].loss:.2g}): the best was taken, it may not be global"
        )
        yield warning("search", text, loss=starts[-1].loss)


def parameter_warnings(W: Array, white: Whiteness, C: Array, curved: float) -> Iterator[Finding]:
    """Yield warnings about C, about the rank of the data, and about the curvature of the loss."""
    if C.size > 1 and np.max(np.abs(roots(C))) > 1 - _CIRCLE_TOLERANCE:
        yield warning(
            "root_on_circle",
            "C has a root on the unit circle, the limit of the search, so the standard deviation "
            "of the root has no meaning. Lower nc, or check whether the data were differenced or "
            "detrended",
        )
    d, rank = W.shape
    if rank < d:
        text = f"the data determine only {rank} of {d} parameters: lower the orders"
        yield warning("undetermined", text, rank=rank, parameters=d)
    if curved > MAX_TRUSTED_CURVATURE and not white.coloured:
        yield warning("curved", CURVED_TEXT, curvature=curved)


def curvature(
    problem: PolynomialProblem | ContinuousProblem,
    theta: Array,
    covariance: Array,
    noise_variance: float,
) -> float:
    """Return the largest |ln r|; r is the rise of the loss divided by the rise of a parabola.

    Both rises are computed two standard deviations from the minimum, in both directions of each
    principal axis v. The axes are the principal axes of the scaled covariance of (c, d, f). At each
    point the coefficients a and b are fitted again. If the loss V is a parabola and s is the
    standard deviation along v ::

        (V(theta ± 2 s v) - V(theta)) / lambda = 4

    theta (n,) contains (c, d, f) at the minimum; lambda is `noise_variance`. The result is 0 if the
    loss is a parabola or the model has no c, d or f, and at most 6.9.

    References
    ----------
    .. [1] D. M. Bates, D. G. Watts, *Nonlinear Regression Analysis and Its Applications*, 1988,
       section 6.1 (profiles of the sum of squares).
    """
    deviation = np.sqrt(np.diag(covariance))
    if not theta.size or not noise_variance > 0 or not np.all(deviation > 0):
        return 0.0
    values, axes = np.linalg.eigh(covariance / np.outer(deviation, deviation))
    least, worst = problem.cost(theta), 0.0
    for value, axis in zip(values, axes.T, strict=True):
        step = _PROBED_SIGMAS * np.sqrt(max(value, 0.0)) * deviation * axis
        for moved in (theta + step, theta - step):
            if not problem.circle.admits(moved):
                return _MAX_CURVATURE
            rise = (problem.cost(moved) - least) / noise_variance / _PROBED_SIGMAS**2
            worst = max(worst, abs(float(np.log(max(rise, _MIN_RISE_RATIO)))))
    return worst
