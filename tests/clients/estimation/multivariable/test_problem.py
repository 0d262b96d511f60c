"""The prediction-error problem of several signals: its gradient, with missing samples, too."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.estimation.multivariable.problem import ONE, PolynomialProblem, Row, row_data
from armrig.estimation.multivariable.whitening import whitening
from armrig.numerics.polynomial import Array, filtered

N = 200
LAMBDA = np.array([[0.04, 0.03], [0.03, 0.05]])


def signals(missing: float) -> tuple[Array, Array]:
    rng = np.random.default_rng(3)
    u = np.sign(rng.standard_normal((N, 2)))
    e = rng.multivariate_normal([0, 0], LAMBDA, N)
    F = np.array([1.0, -1.2, 0.5])
    y = np.column_stack(
        [
            filtered([0, 1, 0.5], F, u[:, 0]) + filtered([0, 0, 2], F, u[:, 1]),
            filtered([0, 0.3], F, u[:, 0]) + filtered([0, 0.2, 0.1], F, u[:, 1]),
        ]
    )
    y += np.column_stack([filtered([1, 0.3], [1, -0.8], x) for x in e.T])
    y[rng.random(y.shape) < missing] = np.nan
    return u, y


def problem(rows: tuple[Row, ...], sizes: tuple[int, ...], missing: float) -> PolynomialProblem:
    u, y = signals(missing)
    parts = [(u[:80], y[:80]), (u[80:], y[80:])]
    Lambda = LAMBDA[: len(rows), : len(rows)]
    return PolynomialProblem(
        rows=rows,
        sizes=sizes,
        bounded=(False, *([True] * (len(sizes) - 1))),
        experiments=tuple(
            tuple(row_data(a, b[:, i], row) for i, row in enumerate(rows)) for a, b in parts
        ),
        weights=tuple(whitening(Lambda, np.isfinite(b[:, : len(rows)])) for _, b in parts),
    )


BOX_JENKINS = (Row(nb=(2, 1), nk=(1, 2), f=(1, 2), c=3, d=4),)
ARMAX = (Row(nb=(2, 1), nk=(1, 0), f=(1, 1), c=2, d=1),)
SHARED = (
    Row(nb=(2, 1), nk=(1, 2), f=(1, 1), c=2, d=ONE, integrator=True),
    Row(nb=(1, 2), nk=(1, 1), f=(1, 1), c=ONE, d=3),
)
CASES = {
    "bj": (BOX_JENKINS, (0, 2, 1, 1, 1), [-1.1, 0.4, -0.6, 0.2, -0.7]),
    "armax": (ARMAX, (0, 2, 1), [-1.1, 0.4, 0.2]),
    "shared": (SHARED, (0, 2, 1, 1), [-1.1, 0.4, 0.3, -0.6]),
}


@pytest.mark.parametrize("missing", [0.0, 0.2])
@pytest.mark.parametrize("case", CASES)
def test_the_gradient_is_the_slope_of_the_cost(case: str, missing: float) -> None:
    rows, sizes, start = CASES[case]
    p = problem(rows, sizes, missing)
    theta = np.array(start)
    h = 1e-6

    e, J = p.linearise(theta)

    assert e @ e == pytest.approx(p.cost(theta), rel=1e-12)
    steps = h * np.eye(theta.size)
    slopes = [(p.cost(theta + d) - p.cost(theta - d)) / (2 * h) for d in steps]
    np.testing.assert_allclose(-2 * J.T @ e, slopes, rtol=1e-5, atol=1e-5 * np.abs(slopes).max())


def test_weights_whiten_the_measured_outputs() -> None:
    rows = np.array([[True, True], [True, False], [False, False]])

    G = whitening(LAMBDA, rows)

    np.testing.assert_allclose(G[0] @ LAMBDA @ G[0].T, np.eye(2), atol=1e-12)
    assert G[1, 0, 0] == pytest.approx(LAMBDA[0, 0] ** -0.5)
    assert not G[2].any()
