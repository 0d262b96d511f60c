"""The derivatives and the search that estimators share."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.estimation.levenberg_marquardt import levenberg_marquardt
from armrig.estimation.orders import Sizes
from armrig.estimation.output_error import OutputError
from armrig.polynomial import filtered
from armrig.sensitivity import by_denominator, by_numerator
from numpy.typing import NDArray

B, F = np.array([0, 0, 1.0, -0.4, 0.2]), np.array([1, -1.5, 0.9, -0.2])


def test_the_analytic_jacobian_is_that_of_a_complex_step() -> None:
    """To the last digits, since a complex step has no cancellation."""
    u = np.random.default_rng(0).standard_normal(200)
    y = filtered(B, F, u)
    h = 1e-30

    J = np.hstack([by_numerator(u, F, range(2, 5)), by_denominator(y, F, 3)])

    for column, (polynomial, k) in enumerate(
        [("B", 2), ("B", 3), ("B", 4)] + [("F", k) for k in (1, 2, 3)]
    ):
        p = {"B": B.astype(complex), "F": F.astype(complex)}
        p[polynomial][k] += 1j * h
        step = filtered(p["B"], p["F"], u.astype(complex)).imag / h
        np.testing.assert_allclose(J[:, column], step, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("drift", [False, True])
def test_the_reduced_gradient_is_the_cost_s(drift: bool) -> None:
    """Kaufman's Jacobian drops a term of the residual's derivative, none of the cost's."""
    rng = np.random.default_rng(1)
    experiments = tuple(
        (rng.standard_normal(80), rng.standard_normal(80), rng.random(80) > 0.1) for _ in range(2)
    )
    sizes = Sizes(nb=2, nf=2, nk=1, count=2, drift=drift)
    problem = OutputError(experiments=experiments, sizes=sizes)
    f = np.array([-1.1, 0.5])

    e, J = problem.linearise(f)

    for k in range(2):
        step = 1e-6 * np.eye(2)[k]
        costs = [problem.cost(np.append(1.0, f + s)) for s in (step, -step)]
        slope = (costs[0] - costs[1]) / 2e-6
        assert -2 * (J.T @ e)[k] == pytest.approx(slope, rel=1e-5)


def rosenbrock(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return e and -de/dx of the curved valley with its bottom at (1, 1)."""
    e = np.array([10 * (x[1] - x[0] ** 2), 1 - x[0], 0.1])
    return e, -np.array([[-20 * x[0], 10], [-1, 0], [0, 0]])


def test_the_search_follows_a_curved_valley_to_its_bottom() -> None:
    """Rosenbrock's function with a constant residual on top."""
    optimum = levenberg_marquardt(rosenbrock, np.array([-1.2, 1.0]), admissible=lambda _: True)

    assert optimum.converged
    np.testing.assert_allclose(optimum.theta, [1, 1], atol=1e-9)


def test_no_step_leaves_the_admissible_set() -> None:
    """The search ends at the wall when the minimum lies behind it."""
    seen = []

    def watched(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        seen.append(x[0])
        return rosenbrock(x)

    levenberg_marquardt(watched, np.array([-1.2, 1.0]), admissible=lambda x: bool(x[0] < 0.5))

    assert max(seen) < 0.5
