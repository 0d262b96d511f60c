"""Levenberg-Marquardt on the QR factor of the scaled Jacobian."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from armrig.least_squares import column_norms
from armrig.polynomial import Array

TOLERANCE = 1e-10
_MAX_ITERATIONS = 200
_FLOATING_LIMIT = 1e-13  # a promised relative decrease below this is rounding noise


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimum:
    """Where the search ended."""

    theta: Array
    """Parameters (n,)."""
    cost: float
    """Sum of squared residuals there."""
    iterations: int
    """Steps tried."""
    converged: bool
    """Cost and scaled gradient both met the tolerance."""


def levenberg_marquardt(
    linearise: Callable[[Array], tuple[Array, Array]],
    theta: Array,
    *,
    admissible: Callable[[Array], bool],
) -> Optimum:
    """Return the nearest minimum of |e(theta)|² from `theta` downhill.

    Stops when the cost's relative change and the scaled gradient |Q^T e| / |e|, the cosine
    between the residual and the Jacobian's column space, are both below 1e-10, or at the limit of
    floating point. A trial step outside the admissible set is halved until it is inside.

    Parameters
    ----------
    linearise : callable
        theta -> e (N,), J (N, n) with e(theta + d) close to e - J d.
    theta : ndarray (n,)
        Admissible start.
    admissible : callable
        theta -> bool.

    References
    ----------
    .. [1] J. J. Moré, "The Levenberg-Marquardt algorithm: implementation and theory", 1978.
    .. [2] K. Madsen, H. B. Nielsen, O. Tingleff, *Methods for Non-linear Least Squares
       Problems*, 2004, algorithm 3.16 (damping).
    """
    e, J = linearise(theta)
    cost = float(e @ e)
    if theta.size == 0 or cost == 0:
        return Optimum(theta=theta, cost=cost, iterations=0, converged=True)
    damping, growth = 1e-6, 2.0
    s, Vt, z, scale = _compressed(e, J)
    change = np.inf
    iterations = 0
    while iterations < _MAX_ITERATIONS:
        iterations += 1
        gradient = float(np.linalg.norm(z[s > 0])) / np.sqrt(cost)
        if gradient <= TOLERANCE and change <= TOLERANCE:
            return Optimum(theta=theta, cost=cost, iterations=iterations, converged=True)
        step = (Vt.T @ (s / (s**2 + damping) * z)) / scale
        promised = float(np.sum(z**2 * (1 - (damping / (s**2 + damping)) ** 2)))
        halvings = 0
        while not admissible(theta + step) and halvings < 60:
            step, halvings = step / 2, halvings + 1
        if halvings:
            promised *= 1 - (1 - 0.5**halvings) ** 2
        trial_e, trial_J = linearise(theta + step)
        trial_cost = float(trial_e @ trial_e)
        if np.isfinite(trial_cost) and trial_cost < cost:
            change = (cost - trial_cost) / cost
            ratio = (cost - trial_cost) / promised if promised > 0 else 1.0
            theta, cost = theta + step, trial_cost
            if cost == 0:
                return Optimum(theta=theta, cost=cost, iterations=iterations, converged=True)
            s, Vt, z, scale = _compressed(trial_e, trial_J)
            damping *= max(1 / 3, 1 - (2 * ratio - 1) ** 3) if ratio < 1 else 1 / 10
            growth = 2.0
        elif promised <= _FLOATING_LIMIT * cost:
            return Optimum(theta=theta, cost=cost, iterations=iterations, converged=True)
        else:
            damping, growth = max(damping, 1e-12) * growth, 2 * growth
            if damping > 1e12:
                break
    return Optimum(theta=theta, cost=cost, iterations=iterations, converged=False)


def _compressed(e: Array, J: Array) -> tuple[Array, Array, Array, Array]:
    """Return s, V^T of the scaled Jacobian's R factor, U^T Q^T e, and the scale (n,)."""
    scale = column_norms(J)
    scale[scale == 0] = 1.0
    Q, R, order = qr(J / scale, mode="economic", pivoting=True, check_finite=False)
    unordered = np.empty_like(R)
    unordered[:, order] = R
    U, s, Vt = np.linalg.svd(unordered, full_matrices=False)
    return s, Vt, U.T @ (Q.T @ e), scale
