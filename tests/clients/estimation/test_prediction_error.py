"""The derivatives and the search that estimators share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.estimation.prediction_error import PredictionErrorProblem
from armrig.models.innovations import prepared
from armrig.models.structure import Structure
from armrig.numerics.polynomial import filtered
from numpy.typing import NDArray

B, F = np.array([0, 0, 1.0, -0.4, 0.2]), np.array([1, -1.5, 0.9, -0.2])


def signals(seed: int, N: int = 120, missing: float = 0.0) -> Dataset:
    """Return any u and y: derivatives hold for all."""
    rng = np.random.default_rng(seed)
    return Dataset(
        u=rng.standard_normal(N), y=rng.standard_normal(N), Ts=1, valid=rng.random(N) >= missing
    )


GENERAL = Structure(na=2, nb=2, nc=2, nd=1, nf=2, nk=1)
THETA = np.array([0.5, -0.2, -0.6, -1.1, 0.5])  # c1 c2 d1 f1 f2


def test_every_derivative_of_the_prediction_is_that_of_a_complex_step() -> None:
    """With all five polynomials, from rest, by e = (D/C) (A y - (B/F) u)."""
    data, h = signals(2), 1e-30
    structure = replace(GENERAL, at_rest=True)
    problem = PredictionErrorProblem(experiments=(prepared(data, structure),), structure=structure)

    solution = problem.solve(THETA)

    theta = np.concatenate([solution.ab, THETA]).astype(complex)
    for column in range(theta.size):
        moved = theta + 1j * h * np.eye(theta.size)[column]
        a, b, c, d, f = np.split(moved, [2, 4, 6, 7])
        driven = filtered([0, *b], [1, *f], data.u.astype(complex))
        v = filtered([1, *a], [1], data.y.astype(complex)) - driven
        e = filtered([1, *d], [1, *c], v)
        expected = -e.imag / h
        np.testing.assert_allclose(solution.Psi[:, column], expected, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(solution.e, e.real, atol=1e-12)


@pytest.mark.parametrize("missing", [0.0, 0.1])
@pytest.mark.parametrize(
    ("structure", "theta"),
    [
        (Structure(nb=2, nf=2, nk=1), [-1.1, 0.5]),
        (Structure(nb=2, nf=2, nk=1, integrator="f"), [-1.1, 0.5]),
        (Structure(na=2, nb=2, nc=2, nk=1), [0.5, -0.2]),
        (Structure(na=1, nb=2, nc=2, nk=1, integrator="a"), [0.5, -0.2]),
        (Structure(nb=3, nc=2, nd=1, nf=1, nk=2, offset=True), [0.5, -0.2, -0.6, -0.8]),
        (Structure(nb=2, nc=1, nd=1, nf=1, nk=0, integrator="f"), [0.5, -0.6, -0.8]),
        (Structure(nb=2, nd=2, nf=1, nk=1), [-0.6, 0.3, -0.8]),
        (GENERAL, THETA),
    ],
)
def test_the_reduced_gradient_equals_that_of_the_cost(
    structure: Structure, theta: list[float], missing: float
) -> None:
    """Kaufman's Jacobian drops a term of the residual's derivative, none of the cost's."""
    parts = [signals(3, missing=missing), signals(4, missing=missing)]
    problem = PredictionErrorProblem(
        experiments=tuple(prepared(part, structure) for part in parts), structure=structure
    )
    at = np.array(theta)

    e, J = problem.linearise(at)

    for k in range(at.size):
        step = 1e-6 * np.eye(at.size)[k]
        slope = (problem.cost(at + step) - problem.cost(at - step)) / 2e-6
        assert -2 * (J.T @ e)[k] == pytest.approx(slope, rel=1e-5, abs=1e-7 * float(e @ e))


@pytest.mark.parametrize(("nc", "nd"), [(1, 2), (2, 1), (1, 0)])
def test_the_normal_of_a_root_on_the_circle_points_outwards(nc: int, nd: int) -> None:
    """The gradients of |z| of a root of C and of a pair of F, at their places in theta."""
    structure = Structure(nb=1, nc=nc, nd=nd, nf=3, nk=1)
    problem = PredictionErrorProblem(
        experiments=(prepared(signals(1), structure),), structure=structure
    )
    C, F = np.poly([1.0, 0.3][:nc]), np.poly([*np.exp([0.7j, -0.7j]), -0.4]).real
    theta = np.concatenate([C[1:], [0.6, -0.2][:nd], F[1:]])

    rows = problem.normals(theta)

    def modulus(which: str, at: NDArray[np.float64]) -> float:
        c, _, f = problem.polynomials(at)
        return float(np.abs(np.roots(c if which == "C" else f)).max())

    steps = 1e-6 * np.eye(theta.size)
    for which in "CF":
        slopes = [(modulus(which, theta + d) - modulus(which, theta - d)) / 2e-6 for d in steps]
        along = np.array(slopes) / np.linalg.norm(slopes)
        assert any(np.allclose(row, along, atol=1e-5) for row in rows), which


def test_the_first_stretch_has_no_volume() -> None:
    """Pulses at the beginning of the data are no gaps: e² alone is the cost without a gap."""
    structure = Structure(na=1, nb=1, nc=1, nk=1)
    whole, other = signals(1, 60), signals(2, 50)
    holed = whole.replaced(valid=np.arange(60) != 30, step=None)

    def ratio(*parts: Dataset) -> float:
        problem = PredictionErrorProblem(
            experiments=tuple(prepared(part, structure) for part in parts), structure=structure
        )
        e = problem.solve(np.array([0.7])).e
        return problem.cost(np.array([0.7])) / float(e @ e)

    assert ratio(whole) == 1.0
    assert ratio(holed) > 1.005
    assert ratio(whole, other) > 1.005
