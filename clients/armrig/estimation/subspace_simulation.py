"""A subspace model made for simulation: A, B and the first states by its simulation error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from armrig_core.errors import InputError

from armrig.data.dataset import Dataset
from armrig.estimation.hannan_rissanen import noise_start
from armrig.estimation.prediction_error import PredictionError, Solution
from armrig.estimation.stability import stabilised
from armrig.models.innovations import Experiment, prepared, regression
from armrig.models.structure import Structure
from armrig.numerics.polynomial import Array, filtered, reflected, without_integrator


def simulating(
    data: Dataset, n: Structure, A: Array, C: Array, *, orders: str
) -> tuple[Array, Array, Array]:
    """Return A, B and C of the model that simulates the data best, from a subspace's A and C.

    For given A the simulation error y - (B u + x) / A is linear in B and in what the unknown
    state x adds, so a search from the subspace's poles, reflected into the circle, is over A
    alone. C is then the one of least one-step loss for this A and B of three: the subspace's, the
    one that Hannan and Rissanen's regressions find in A y - B u, and A itself, which is noise
    that is white on the output.

    Raises
    ------
    ValueError
        u determines fewer coefficients than B has.
    """
    output = Structure(nb=n.nb, nf=n.na, nk=n.nk, integrator="f" if n.integrator else "")
    experiments = tuple(prepared(part, output) for part in data.experiments())
    problem = PredictionError(experiments=experiments, structure=output)
    start = stabilised(without_integrator(A) if n.integrator else A)
    found = problem.minimise(start[1:])
    solution = problem.solve(found.theta)
    if solution.rank < n.nb:
        raise InputError(
            f"{orders}: u determines only {solution.rank} of {n.nb} numerator coefficients; "
            "lower the order or excite with a richer input"
        )
    free = stabilised(np.append(1.0, found.theta))
    B = np.append(np.zeros(n.nk), solution.ab)
    whole = np.convolve([1.0, -1.0], free) if n.integrator else free
    noises = [C, _of_what_is_left(experiments, solution, whole, n.nc), reflected(whole)]
    one_step = [prepared(part, n) for part in data.experiments()]
    losses = [_one_step_loss(one_step, n, free, B, noise) for noise in noises]
    return whole, B, noises[int(np.argmin(losses))]


def _of_what_is_left(
    experiments: Sequence[Experiment], solution: Solution, A: Array, nc: int
) -> Array:
    """Return C of C e = A (y - simulated y)."""
    v = []
    for x, part in zip(experiments, solution.parts, strict=True):
        left = x.y - part.driven
        left[~x.rows] = np.nan
        left = filtered(A, [1.0], left) if np.isfinite(left).all() else _convolved(A, left)
        left[: A.size - 1] = np.nan
        v.append(left)
    C, _ = noise_start(v, nc=nc, nd=0)
    return C


def _convolved(A: Array, x: Array) -> Array:
    """Return A x, NaN where it looks back on a hole."""
    return np.asarray(np.convolve(x, A)[: x.size])


def _one_step_loss(
    experiments: Sequence[Experiment], n: Structure, A: Array, B: Array, C: Array
) -> float:
    """Return the sum of squared one-step errors, the unknown past fitted."""
    one, total = np.ones(1), 0.0
    for x in experiments:
        given = regression(x, n, C=C, D=one, F=one)
        raw = given.y - given.X @ np.append(A[1:], B[n.nk :])
        total += float(np.sum(given.unknown.without(raw[:, None]) ** 2))
    return total
