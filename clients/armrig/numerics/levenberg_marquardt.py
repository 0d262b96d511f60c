"""Levenberg-Marquardt search with the QR factor of the scaled Jacobian."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt
from typing import Protocol

import numpy as np
from scipy.linalg.lapack import dgeqrf, dgesdd

from armrig.numerics.least_squares import column_norms, upper_ones
from armrig.numerics.polynomial import Array

TOLERANCE = 1e-10
MAX_STEPS = 200
MAX_HALVINGS = 60
FIRST_DAMPING = 1e-6  # relative to the squared norm of a column of J
_SAME_COST_TOLERANCE = 1e-7  # relative difference in cost up to which two minima are the same
_NEAR_TARGET = 1e-5  # relative difference in cost up to which a step decides about the target
_REACH = 100.0  # farther from the target: largest ratio of later decrease to predicted decrease
_MISS_SHARE = 0.3  # largest distance between the best minimum and the end of a step to it, in steps
_GRADIENT_FALL = 0.9  # largest ratio of successive gradients that counts as a decrease
_MIN_DECREASE = 1e-13  # relative decrease of the cost; a smaller predicted decrease is rounding
_WALL_RANK_TOLERANCE = 1e-9  # relative singular value above which walls do not coincide

Jacobian = Array | Callable[[], Array]
"""Jacobian (N, n), or a function that computes it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimum:
    """Result of a search."""

    theta: Array
    """Parameters (n,)."""
    cost: float
    """Sum of squared residuals at theta."""
    iterations: int
    """Number of steps tried."""
    converged: bool
    """True if the change of the cost and the scaled gradient are within the tolerance."""
    damping: float = FIRST_DAMPING
    """Damping with which the search continues from theta."""


class Walls(Protocol):
    """Boundary of the admissible set, along which a search may move."""

    def inside(self, theta: Array, previous: Array) -> Array:
        """Return theta itself if it touches no wall, else theta moved inside from `previous`."""

    def normals(self, theta: Array) -> Array:
        """Return the outward normals (k, n) of the walls that theta touches."""


def levenberg_marquardt(
    linearise: Callable[[Array], tuple[Array, Jacobian]],
    theta: Array,
    *,
    admissible: Callable[[Array], bool],
    most: int = MAX_STEPS,
    earlier_cost: float = np.nan,
    target: float = np.inf,
    best: Array | None = None,
    damping: float = FIRST_DAMPING,
    walls: Walls | None = None,
    error: float = 0.0,
    tolerance: float = TOLERANCE,
) -> Optimum:
    """Return the local minimum of |e(theta)|² that a descent from an admissible `theta` reaches.

    `linearise` returns e (N,) and J (N, n) of theta, so that e(theta + d) is close to e - J d.
    In place of J it may return a function that computes J. A rejected step then costs only e.

    The search stops if both the relative change of the cost and the scaled gradient |Q^T e| / |e|
    are below `tolerance`. The columns of Q are an orthonormal basis of the column space of J. The
    scaled gradient is therefore the cosine of the angle between e and this space. The search also
    stops if rounding prevents further progress, or after `most` steps. A trial step that ends
    outside the admissible set is halved until it ends inside.

    `earlier_cost` is the cost of a minimum found earlier. If the search is near this cost and the
    predicted decrease is small, the search stops to save time. The search also stops if the
    gradient is so small that a cost below `target` is out of reach. It also stops if an undamped
    step leads to `best`, a minimum found earlier. `damping` is that of the first step.

    `error` is the relative error of J. The search does not move along directions in which the
    relative singular value of the scaled J is at most `error`.

    If theta touches a wall, a step across this wall is replaced by a step along the wall. Without
    walls the search stops at the boundary of the admissible set.

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
    growth = 2.0
    linear: _Linear | None = None  # J at theta, once a step needs it
    touches, change = walls, np.inf
    iterations = 0
    while iterations < most:
        iterations += 1
        if linear is None:
            linear, scale = _compress(e, J, error)
            normals = _normals(touches, theta, scale)
        s, Vt, z = _along(normals, *linear, damping)
        predicted = float(z @ z)
        reach = 1.0 if cost <= target * (1 + _NEAR_TARGET) else _REACH
        if cost - reach * predicted > target:
            break
        if best is not None and _leads_to(scale * (best - theta), linear, (s, Vt, z)):
            break
        if change <= tolerance and sqrt(predicted / cost) <= tolerance:
            return Optimum(theta=theta, cost=cost, iterations=iterations, converged=True)
        along = s / (s**2 + damping) * z
        step = (Vt.T @ along) / scale
        promised = float(along @ (s * z + damping * along))
        if (
            abs(cost - earlier_cost) <= _SAME_COST_TOLERANCE * earlier_cost
            and promised <= _SAME_COST_TOLERANCE * cost
        ):
            return Optimum(theta=theta, cost=cost, iterations=iterations, converged=True)
        step, share, inside = _admissible_step(step, theta, admissible, walls)
        promised *= 1 - (1 - share) ** 2
        trial_e, trial_J = linearise(theta + step)
        trial_cost = float(trial_e @ trial_e)
        if trial_cost < cost:  # NaN is not
            change = (cost - trial_cost) / cost
            ratio = (cost - trial_cost) / promised if promised > 0 else 1.0
            theta, cost = theta + step, trial_cost
            if cost == 0:
                return Optimum(theta=theta, cost=cost, iterations=iterations, converged=True)
            e, J, linear, touches = trial_e, trial_J, None, None if inside else walls
            damping *= max(1 / 3, 1 - (2 * ratio - 1) ** 3) if ratio < 1 else 1 / 10
            growth = 2.0
        elif promised <= _MIN_DECREASE * cost:
            # The change of the cost is now rounding, but the gradient still shows progress. If the
            # search stopped here, theta would be off by about sqrt(1e-13 N) standard deviations.
            ends = _compress(trial_e, trial_J, error)
            falls = np.linalg.norm(ends[0][2]) < _GRADIENT_FALL * np.linalg.norm(z)
            if z is not linear[2] or not falls:
                return Optimum(theta=theta, cost=cost, iterations=iterations, converged=True)
            theta, cost, change = theta + step, trial_cost, 0.0
            linear, scale = ends
            normals = _normals(walls, theta, scale)
        else:
            # A damping below the least squared singular value hardly changes the step. Only the
            # searches from a moved mode omit such steps: others might end in another minimum.
            least = 1e-12 if best is None else max(1e-12, float(s[-1]) ** 2)
            damping, growth = max(damping, least) * growth, 2 * growth
            if damping > 1e12:
                break
    return Optimum(theta=theta, cost=cost, iterations=iterations, converged=False, damping=damping)


_Linear = tuple[Array, Array, Array]


def _leads_to(way: Array, linear: _Linear, along: _Linear) -> bool:
    """Return whether an undamped step, maybe along walls, leads to theta + `way` / scale."""
    (S, V, _), (s, Vt, z) = linear, along
    step = Vt.T @ np.divide(z, s, where=s > 0, out=np.zeros(s.size))
    off = S * (V @ (way - step))
    return bool(off @ off <= _MISS_SHARE**2 * (z @ z))


def _admissible_step(
    step: Array, theta: Array, admissible: Callable[[Array], bool], walls: Walls | None
) -> tuple[Array, float, bool]:
    """Return an admissible step, its factor after halvings, and whether its end touches no wall."""
    if walls is not None:
        trial = theta + step
        end = walls.inside(trial, theta)
        step = end - theta
        if end is trial:
            return step, 1.0, True
    halvings = 0
    while not admissible(theta + step) and halvings < MAX_HALVINGS:
        step, halvings = step / 2, halvings + 1
    return step, 0.5**halvings, False


def _normals(walls: Walls | None, theta: Array, scale: Array) -> Array:
    return np.zeros((0, theta.size)) if walls is None else walls.normals(theta) / scale


def _along(normals: Array, s: Array, Vt: Array, z: Array, damping: float) -> _Linear:
    """Return s, V^T and z for steps along the walls that an unrestricted step would cross."""
    if not normals.size:
        return s, Vt, z
    S, V, Z = s, Vt, z
    crossed = np.zeros(normals.shape[0], dtype=np.bool_)
    while True:
        outward = normals @ (Vt.T @ (s / (s**2 + damping) * z)) > 0
        if not np.any(outward & ~crossed):
            return s, Vt, z
        crossed |= outward
        _, sizes, axes = np.linalg.svd(normals[crossed])
        free = axes[int(np.sum(sizes > _WALL_RANK_TOLERANCE * sizes[0])) :]
        U, s, along = np.linalg.svd((S[:, None] * V) @ free.T, full_matrices=False)
        Vt, z = along @ free, (U.T @ Z) * (s > 0)


def _compress(e: Array, J: Jacobian, error: float) -> tuple[_Linear, Array]:
    """Return (s, V^T, U^T Q^T e) and the scale (n,), with J / scale = Q R and R = U s V^T."""
    J = J() if callable(J) else J
    # e is the last column, so that R contains Q^T e and Q itself is not needed.
    n = J.shape[1]
    augmented = np.empty((e.size, n + 1), order="F")
    augmented[:, :n], augmented[:, n] = J, e
    R = dgeqrf(augmented, overwrite_a=True)[0][:n]
    R = R * upper_ones(*R.shape)
    scale = column_norms(R[:, :n])
    scale[scale == 0] = 1.0
    # A third of the time of np.linalg.svd. Both do not end if a value is inf, but inf / inf is NaN.
    U, s, Vt, failed = dgesdd(R[:, :n] / scale, full_matrices=0)
    if failed:
        raise np.linalg.LinAlgError("the singular values of the Jacobian are not determined")
    return (s, Vt, (U.T @ R[:, n]) * (s > error * s[0])), scale
