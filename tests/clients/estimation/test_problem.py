"""The problem that all prediction-error estimators share: its derivatives, for every shape."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from armrig.estimation.problem import PolynomialProblem
from armrig.models.innovations import prepare
from armrig.models.structure import Structure
from armrig.numerics.covariance import whitening
from armrig.numerics.polynomial import apply_filter
from numpy.typing import NDArray

N = 120
LAMBDA = np.array([[0.04, 0.03], [0.03, 0.05]])
GENERAL = Structure(na=2, nb=(2,), nc=2, nd=1, nf=(2,), nk=(1,))
THETA = np.array([0.5, -0.2, -0.6, -1.1, 0.5])  # c1 c2 d1 f1 f2
START = {"a": [-0.5, 0.3], "c": [0.5, -0.2], "d": [-0.6, 0.3], "f": [-0.8, 0.5]}


def problem(*rows: Structure, missing: float = 0.0, parts: int = 2) -> PolynomialProblem:
    """Return a problem with any u and y: derivatives hold for all."""
    experiments = []
    for seed in range(parts):
        rng = np.random.default_rng(3 + seed)
        u, y = rng.standard_normal((N, len(rows[0].nb))), rng.standard_normal((N, len(rows)))
        y[rng.random(y.shape) < missing] = np.nan
        experiments.append(tuple(prepare(u, y[:, i], n) for i, n in enumerate(rows)))
    found = PolynomialProblem(rows=rows, experiments=tuple(experiments))
    if len(rows) == 1:
        return found
    masks = [np.column_stack([x.rows for x in of]) for of in experiments]
    return replace(found, weights=tuple(whitening(LAMBDA, m) for m in masks))


def start(p: PolynomialProblem) -> NDArray[np.float64]:
    """Return stable polynomials, whose orders are those of the problem."""
    pairs = zip(p.layout.letters, p.layout.slices, strict=True)
    return np.concatenate([START[letter][: part.stop - part.start] for letter, part in pairs])


def test_every_derivative_of_the_prediction_is_that_of_a_complex_step() -> None:
    """With all five polynomials, from rest, by e = (D/C) (A y - (B/F) u)."""
    h = 1e-30
    p = problem(replace(GENERAL, at_rest=True), parts=1)
    u, y = p.experiments[0][0].u[:, 0], p.experiments[0][0].y

    solution = p.solve(THETA)

    theta = np.concatenate([solution.ab, THETA]).astype(complex)
    for column in range(theta.size):
        moved = theta + 1j * h * np.eye(theta.size)[column]
        a, b, c, d, f = np.split(moved, [2, 4, 6, 7])
        driven = apply_filter([0, *b], [1, *f], u.astype(complex))
        v = apply_filter([1, *a], [1], y.astype(complex)) - driven
        e = apply_filter([1, *d], [1, *c], v)
        expected = -e.imag / h
        np.testing.assert_allclose(solution.Psi[:, column], expected, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(solution.e, e.real, atol=1e-12)


ONE_INPUT = [
    Structure(nb=(2,), nf=(2,), nk=(1,)),
    Structure(nb=(2,), nf=(2,), nk=(1,), integrator="f"),
    Structure(na=2, nb=(2,), nc=2, nf=(0,), nk=(1,)),
    Structure(na=1, nb=(2,), nc=2, nf=(0,), nk=(1,), integrator="a"),
    Structure(nb=(3,), nc=2, nd=1, nf=(1,), nk=(2,), offset=True),
    Structure(nb=(2,), nc=1, nd=1, nf=(1,), nk=(0,), integrator="f"),
    Structure(nb=(2,), nd=2, nf=(1,), nk=(1,)),
    Structure(na=2, nb=(2,), nd=1, nf=(0,), nk=(1,)),
    GENERAL,
]
TWO_INPUTS = [
    Structure(nb=(2, 1), nk=(1, 2), nf=(2, 1), nc=1, nd=1),
    Structure(nb=(2, 1), nk=(1, 0), nf=(0, 0), na=2, nc=1, offset=True),
    Structure(nb=(2, 1), nk=(1, 2), nf=(0, 1), nc=1, nd=1, integrator="f"),
]
TWO_OUTPUTS = [
    (
        Structure(nb=(2, 1), nk=(1, 2), nc=1, integrator="f", nf=(2, 2), shared=True),
        Structure(nb=(1, 2), nk=(1, 1), nd=1, nf=(2, 2), shared=True),
    ),
    (
        Structure(na=2, nb=(2, 1), nk=(1, 2), nf=(0, 0), nc=1, integrator="a"),
        Structure(na=2, nb=(1, 2), nk=(1, 1), nf=(0, 0), nc=2),
    ),
]


@pytest.mark.parametrize("missing", [0.0, 0.1])
@pytest.mark.parametrize("rows", [*((n,) for n in ONE_INPUT + TWO_INPUTS), *TWO_OUTPUTS])
def test_the_reduced_gradient_equals_that_of_the_cost(
    rows: tuple[Structure, ...], missing: float
) -> None:
    """Kaufman's Jacobian drops a term of the residual's derivative, none of the cost's."""
    p = problem(*rows, missing=missing)
    at = start(p)

    e, J = p.linearise(at)

    assert e @ e == pytest.approx(p.cost(at), rel=1e-12)
    for k in range(at.size):
        step = 1e-6 * np.eye(at.size)[k]
        slope = (p.cost(at + step) - p.cost(at - step)) / 2e-6
        assert -2 * (J.T @ e)[k] == pytest.approx(slope, rel=1e-5, abs=1e-7 * float(e @ e))


PROJECTED = (
    ONE_INPUT[0],
    Structure(nb=(3,), nc=1, nd=2, nf=(2,), nk=(0,)),
    Structure(nb=(2,), nc=2, nf=(1,), nk=(2,), at_rest=True),
    Structure(nb=(2,), nc=1, nd=1, nf=(0,), nk=(1,)),
    ONE_INPUT[2],
    GENERAL,
)
WITH_TREND = (
    replace(PROJECTED[1], offset=True),
    Structure(nb=(2,), nc=1, nd=1, nf=(2,), nk=(1,), integrator="f"),
)


@pytest.mark.parametrize(
    ("n", "rich"),
    [*product(PROJECTED, (True, False)), *product(WITH_TREND, (True,))],
)
def test_the_projected_errors_have_the_cost_and_the_gradient_of_the_solution(
    n: Structure, rich: bool
) -> None:
    """A constant u determines one b only; a search then uses the solution itself."""
    p = problem(n, parts=1)
    x = p.experiments[0][0]
    if n.trend:
        p = replace(p, experiments=((replace(x, y=x.y + 3.0),),))
    if not rich:
        y = x.y
        p = PolynomialProblem(rows=(n,), experiments=((prepare(np.ones((N, 1)), y, n),),))
    at = start(p)

    e, J = p.linearise(at)

    s = p.solve(at)
    assert p.projects
    assert (e.size < N) == (s.rank == p.linear_size)
    np.testing.assert_allclose([e @ e, p.cost(at)], s.e @ s.e, rtol=1e-12)
    np.testing.assert_allclose(J.T @ J, s.J.T @ s.J, rtol=1e-9, atol=1e-11 * N)
    np.testing.assert_allclose(J.T @ e, s.J.T @ s.e, rtol=1e-9, atol=1e-11 * N)


def test_a_is_searched_only_after_gaps_in_a_noise_model() -> None:
    """Without a gap the errors are linear in A; two outputs with one A have one copy of it."""
    row = Structure(na=2, nb=(1,), nc=1, nf=(0,), nk=(1,))

    found = [problem(*rows, missing=m) for m in (0.0, 0.1) for rows in ((row,), (row, row))]

    assert ["".join(p.letters) for p in found] == ["c", "cc", "aac", "aacc"]
    assert [(p.linear_size, p.size) for p in found] == [(3, 1), (4, 2), (1, 3), (2, 4)]


@pytest.mark.parametrize(("nc", "nd"), [(1, 2), (2, 1), (1, 0)])
def test_the_normal_of_a_root_on_the_circle_points_outwards(nc: int, nd: int) -> None:
    """The gradients of |z| of a root of C and of a pair of F, at their places in theta."""
    p = problem(Structure(nb=(1,), nc=nc, nd=nd, nf=(3,), nk=(1,)), parts=1)
    C, F = np.poly([1.0, 0.3][:nc]), np.poly([*np.exp([0.7j, -0.7j]), -0.4]).real
    theta = np.concatenate([C[1:], [0.6, -0.2][:nd], F[1:]])

    rows = p.circle.normals(theta)

    def modulus(which: str, at: NDArray[np.float64]) -> float:
        c, _, f = p.polynomials(at)
        return float(np.abs(np.roots(c if which == "C" else f)).max())

    steps = 1e-6 * np.eye(theta.size)
    for which in "CF":
        slopes = [(modulus(which, theta + d) - modulus(which, theta - d)) / 2e-6 for d in steps]
        along = np.array(slopes) / np.linalg.norm(slopes)
        assert any(np.allclose(row, along, atol=1e-5) for row in rows), which


def test_only_pulses_after_the_first_experiment_are_integrated_out() -> None:
    """Data of one experiment are fitted by plain least squares; a gap adds its variances."""
    structure = Structure(na=1, nb=(1,), nc=1, nf=(0,), nk=(1,))
    moving = replace(structure, na=0, nd=1)

    def ratio(n: Structure, **of: float) -> float:
        p = problem(n, **of)  # type: ignore[arg-type]
        e = p.solve(start(p)).e
        return p.cost(start(p)) / float(e @ e)

    assert ratio(structure, parts=1) == pytest.approx(1.0, rel=1e-12)
    assert ratio(moving, parts=1, missing=0.05) > 1.005
    assert ratio(structure, parts=2) > 1.001
