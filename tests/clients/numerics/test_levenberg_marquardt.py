"""The search for a minimum: its end, its bounds, and its walls."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from armrig.numerics.levenberg_marquardt import levenberg_marquardt
from armrig.numerics.polynomial import Array


def test_residuals_of_zero_end_the_search() -> None:
    """Data without noise have no relative change that becomes small."""
    truth = np.array([3.0, -5.0])

    found = levenberg_marquardt(
        lambda theta: (truth - theta, np.eye(2)), np.zeros(2), admissible=lambda _: True
    )

    assert found.converged
    assert found.cost == 0
    assert found.theta.tolist() == truth.tolist()


T = np.linspace(0.0, 4.0, 50)
DECAY = np.array([2.0, 0.7])
NOISE = 0.05 * np.sin(37 * T**2)


def decay(theta: Array) -> tuple[Array, Array]:
    """Return the residuals of a e^(-b t), and the derivatives of the model."""
    wave = np.exp(-theta[1] * T)
    e = DECAY[0] * np.exp(-DECAY[1] * T) + NOISE - theta[0] * wave
    return e, np.column_stack([wave, -theta[0] * T * wave])


@pytest.mark.parametrize("start", [(1.0, 0.1), (20.0, 3.0), (-1.0, 0.5)])
def test_the_gradient_is_zero_at_the_minimum(start: tuple[float, float]) -> None:
    """In columns of unit length, so in any units of the parameters."""
    units = np.array([1e-6, 1e4])
    for scale in (np.ones(2), units):
        found = levenberg_marquardt(
            lambda theta, by=scale: (decay(theta * by)[0], decay(theta * by)[1] * by),
            np.array(start) / scale,
            admissible=lambda _: True,
        )

        e, J = decay(found.theta * scale)
        cosines = J.T @ e / np.linalg.norm(J, axis=0) / np.linalg.norm(e)
        assert found.converged
        assert found.iterations < 60
        assert found.cost == pytest.approx(float(e @ e))
        assert np.abs(cosines).max() < 1e-8
        np.testing.assert_allclose(found.theta * scale, DECAY, rtol=0.1)


def test_every_trial_is_admissible_and_their_number_is_the_requested() -> None:
    tried: list[float] = []

    def watched(theta: Array) -> tuple[Array, Array]:
        tried.append(float(theta[1]))
        return decay(theta)

    found = levenberg_marquardt(
        watched, np.array([2.0, 0.1]), admissible=lambda theta: theta[1] < 0.5, most=7
    )

    assert not found.converged
    assert found.iterations == 7
    assert len(tried) == 8
    assert max(tried) < 0.5
    assert tried[-1] > 0.4


def test_a_search_near_a_known_minimum_ends_early() -> None:
    whole = levenberg_marquardt(decay, np.array([1.0, 0.1]), admissible=lambda _: True)

    short, other = (
        levenberg_marquardt(
            decay, np.array([1.0, 0.1]), admissible=lambda _: True, earlier_cost=factor * whole.cost
        )
        for factor in (1.0, 0.5)
    )

    assert short.converged
    assert short.iterations < whole.iterations == other.iterations
    assert short.cost == pytest.approx(whole.cost, rel=1e-6)


def test_a_search_ends_early_if_its_target_is_out_of_reach() -> None:
    """Also if it returns to a minimum just above the target, or a step leads to a known minimum."""
    start = np.array([1.0, 0.1])
    whole = levenberg_marquardt(decay, start, admissible=lambda _: True)

    reached, below, returned = (
        levenberg_marquardt(decay, start, admissible=lambda _: True, target=factor * whole.cost)
        for factor in (1.1, 0.5, 1 - 1e-7)
    )

    led = levenberg_marquardt(decay, start, admissible=lambda _: True, best=whole.theta)
    not_led = levenberg_marquardt(decay, start, admissible=lambda _: True, best=whole.theta + 3)

    for other in (reached, not_led):
        assert (other.cost, other.iterations) == (whole.cost, whole.iterations)
    for early in (below, returned, led):
        assert not early.converged
        assert early.iterations < whole.iterations


class Below:
    """The wall theta_2 <= edge."""

    def __init__(self, edge: float) -> None:
        self.edge = edge

    def inside(self, theta: Array, previous: Array) -> Array:
        return np.array([theta[0], min(theta[1], self.edge)])

    def normals(self, theta: Array) -> Array:
        return np.array([[0.0, 1.0]])[: int(theta[1] >= self.edge)]


def test_a_search_follows_a_bound_to_its_least_cost() -> None:
    """With the rate held, the amplitude is linear least squares."""
    edge = 0.4
    found = levenberg_marquardt(
        decay, np.array([5.0, 0.1]), admissible=lambda _: True, walls=Below(edge)
    )
    free = levenberg_marquardt(
        decay, np.array([5.0, 0.1]), admissible=lambda _: True, walls=Below(5.0)
    )

    wave = np.exp(-edge * T)
    best = wave @ (DECAY[0] * np.exp(-DECAY[1] * T) + NOISE) / (wave @ wave)
    assert found.converged
    assert found.theta == pytest.approx([best, edge], rel=1e-6)
    assert free.theta[1] == pytest.approx(DECAY[1], rel=0.1)


def test_a_parameter_without_effect_keeps_its_value() -> None:
    found = levenberg_marquardt(
        lambda theta: (decay(theta[:2])[0], np.pad(decay(theta[:2])[1], ((0, 0), (0, 1)))),
        np.array([1.0, 0.1, 9.0]),
        admissible=lambda _: True,
    )

    assert found.converged
    assert found.theta[2] == 9.0


def test_a_rejected_step_needs_no_jacobian() -> None:
    """If `linearise` returns a function for J, the search calls it only where it moves to."""
    moved: list[float] = []
    tried: list[float] = []

    def linearise(theta: Array) -> tuple[Array, Callable[[], Array]]:
        tried.append(float(theta[0]))

        def J() -> Array:
            moved.append(float(theta[0]))
            return np.array([[1 / (1 + theta[0] ** 2)]])

        return -np.arctan(theta), J

    found = levenberg_marquardt(linearise, np.array([2.0]), admissible=lambda _: True)

    assert abs(found.theta[0]) < 1e-8
    assert found.converged
    assert np.all(np.diff(np.abs(moved)) < 0)
    assert len(moved) < len(tried)


def test_a_search_from_a_moved_mode_omits_steps_with_a_damping_that_changes_little() -> None:
    """The first step from 2 is rejected; without the omission several like it are tried."""
    tried: list[float] = []

    def linearise(theta: Array) -> tuple[Array, Array]:
        tried.append(float(theta[0]))
        return -np.arctan(theta), np.array([[1 / (1 + theta[0] ** 2)]])

    counts = []
    for best in (None, np.array([50.0])):
        tried.clear()
        found = levenberg_marquardt(
            linearise, np.array([2.0]), admissible=lambda _: True, best=best
        )
        assert abs(found.theta[0]) < 1e-8
        counts.append(len(tried))

    assert counts[1] < counts[0] - 2


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_jacobian_that_is_not_finite_is_refused(bad: float) -> None:
    """The decomposition in LAPACK would not end if a value were infinite."""
    J = np.array([[1.0, 2.0], [3.0, bad], [5.0, 7.0]])

    with pytest.raises(np.linalg.LinAlgError, match="of the Jacobian"):
        levenberg_marquardt(lambda _: (np.ones(3), J), np.zeros(2), admissible=lambda _: True)
