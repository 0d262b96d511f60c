"""Levenberg-Marquardt on the QR factor of the scaled Jacobian."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg.lapack import dgeqrf

from armrig.numerics.least_squares import column_norms
from armrig.numerics.polynomial import Array

TOLERANCE = 1e-10
MOST_STEPS = 200
_SAME = 1e-7  # relative difference in cost up to which two ends are one
_FALLS = 0.9  # factor by which a gradient that still falls does so in a step
_FLOATING_LIMIT = 1e-13  # a promised relative decrease below this is rounding noise

_PARALLEL = 1e-9  # relative size from which walls do not coincide


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


class Walls(Protocol):
    """Boundary of the admissible set, along which a search may go."""

    def inside(self, theta: Array, previous: Array) -> Array:
        """Return theta, moved into the walls if a step from `previous` led beyond."""

    def normals(self, theta: Array) -> Array:
        """Return the outward normals (k, n) of the walls at which theta is."""


def levenberg_marquardt(
    linearise: Callable[[Array], tuple[Array, Array]],
    theta: Array,
    *,
    admissible: Callable[[Array], bool],
    most: int = MOST_STEPS,
    known: float = np.nan,
    walls: Walls | None = None,
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
    most : int, default 200
        Steps to try.
    known : float, optional
        Cost of a minimum that was found already: at this cost, with nothing more to gain, the
        search has ended there too, and its last digits are not worth their time.
    walls : Walls, optional
        A step that would cross a wall at which theta is goes along it instead. Without walls the
        search sticks where it first meets the boundary.

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
    whole, scale = _compressed(e, J)
    normals = _normals(walls, theta, scale)
    change = np.inf
    iterations = 0
    while iterations < most:
        iterations += 1
        s, Vt, z = _along(normals, *whole, damping)
        gradient = float(np.linalg.norm(z[s > 0])) / np.sqrt(cost)
        if gradient <= TOLERANCE and change <= TOLERANCE:
            return Optimum(theta=theta, cost=cost, iterations=iterations, converged=True)
        step = (Vt.T @ (s / (s**2 + damping) * z)) / scale
        promised = float(np.sum(z**2 * (1 - (damping / (s**2 + damping)) ** 2)))
        if abs(cost - known) <= _SAME * known and promised <= _SAME * cost:
            return Optimum(theta=theta, cost=cost, iterations=iterations, converged=True)
        if walls is not None:
            step = walls.inside(theta + step, theta) - theta
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
            whole, scale = _compressed(trial_e, trial_J)
            normals = _normals(walls, theta, scale)
            damping *= max(1 / 3, 1 - (2 * ratio - 1) ** 3) if ratio < 1 else 1 / 10
            growth = 2.0
        elif promised <= _FLOATING_LIMIT * cost:
            # The cost, a large sum, cannot tell better from worse any more. The gradient can: to
            # stop here would leave some sqrt(1e-13 N) standard deviations to chance.
            ends = _compressed(trial_e, trial_J)
            falls = np.linalg.norm(ends[0][2]) < _FALLS * np.linalg.norm(z)
            if z is not whole[2] or not falls:
                return Optimum(theta=theta, cost=cost, iterations=iterations, converged=True)
            theta, cost, change = theta + step, trial_cost, 0.0
            whole, scale = ends
            normals = _normals(walls, theta, scale)
        else:
            damping, growth = max(damping, 1e-12) * growth, 2 * growth
            if damping > 1e12:
                break
    return Optimum(theta=theta, cost=cost, iterations=iterations, converged=False)


_Linear = tuple[Array, Array, Array]


def _normals(walls: Walls | None, theta: Array, scale: Array) -> Array:
    """Return the walls' normals by the scaled parameters."""
    return np.zeros((0, theta.size)) if walls is None else walls.normals(theta) / scale


def _along(normals: Array, s: Array, Vt: Array, z: Array, damping: float) -> _Linear:
    """Return s, V^T and z of the problem along the walls that its step would cross."""
    S, V, Z = s, Vt, z
    crossed = np.zeros(normals.shape[0], dtype=np.bool_)
    while True:
        outward = normals @ (Vt.T @ (s / (s**2 + damping) * z)) > 0
        if not np.any(outward & ~crossed):
            return s, Vt, z
        crossed |= outward
        _, sizes, axes = np.linalg.svd(normals[crossed])
        free = axes[int(np.sum(sizes > _PARALLEL * sizes[0])) :]
        U, s, along = np.linalg.svd((S[:, None] * V) @ free.T, full_matrices=False)
        Vt, z = along @ free, U.T @ Z


def _compressed(e: Array, J: Array) -> tuple[_Linear, Array]:
    """Return s, V^T of the scaled Jacobian's R factor, U^T Q^T e, and the scale (n,)."""
    scale = column_norms(J)
    scale[scale == 0] = 1.0
    # With e as one more column R holds Q^T e, and Q is never formed.
    n = scale.size
    whole = np.empty((e.size, n + 1), order="F")
    np.divide(J, scale, out=whole[:, :n])
    whole[:, n] = e
    packed, *_ = dgeqrf(whole, overwrite_a=True)
    R = np.triu(packed[: n + 1])
    U, s, Vt = np.linalg.svd(R[:n, :n], full_matrices=False)
    return (s, Vt, U.T @ R[:n, n]), scale
