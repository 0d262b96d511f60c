"""Length of past and future: bounds by the order and the length, and the choice."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.estimation.subspace_horizon import (
    _longest_stretches,
    _loss,
    least_loss,
    longest_horizon,
)
from armrig.numerics.polynomial import filtered, impulse, lagged
from numpy.typing import NDArray

Vector = NDArray[np.float64]


def signals(N: int, noise: float = 0.1) -> list[tuple[Vector, Vector]]:
    """Return u and y of a plant of one pole, noise through it."""
    u, e = np.random.default_rng(1).standard_normal((2, N))
    return [(u, filtered([0.0, 1.0], [1.0, -0.5], u) + filtered([noise], [1.0, -0.5], e))]


@pytest.mark.parametrize(
    ("N", "order", "horizon"),
    [
        (2000, None, 10),  # an ARX model of order 1 would do
        (2000, 4, 10),
        (2000, 7, 16),  # 2 (order + 1)
        (96, None, 8),  # one for 12 samples
        (96, 7, 9),  # and never less than order + 2
    ],
)
def test_the_horizon_is_bounded_by_order_and_length(
    N: int, order: int | None, horizon: int
) -> None:
    assert longest_horizon(signals(N), N, order) == horizon


def test_a_long_memory_takes_a_long_horizon() -> None:
    """The horizon has at most 30 samples."""
    u, e = np.random.default_rng(1).standard_normal((2, 4000))
    y = filtered([0.0, 1.0], [1.0, -0.98], u) + 2 * e

    assert 10 < longest_horizon([(u, y)], 4000, None) <= 30


def test_models_are_compared_on_the_longest_stretches() -> None:
    u = np.arange(3000.0)
    y = u.copy()
    y[[500, 2200]] = np.nan  # 500, 1699 and 799 samples
    short = np.arange(100.0)

    parts = _longest_stretches([(short, short), (u, y)])

    assert [y.size for _, y in parts] == [1699, 301]
    assert [y[0] for _, y in parts] == [501.0, 2201.0]
    assert all(np.array_equal(u, y) for u, y in parts)


def test_the_model_of_least_loss_is_taken_and_the_first_without_noise() -> None:
    true, other = (np.array([1.0, -0.5]), np.ones(1)), (np.array([1.0, 0.3]), np.ones(1))

    for models, best in (((true, other), 0), ((other, true), 1)):
        padded = [(A, np.append(C, 0.0)) for A, C in models]
        assert least_loss(signals(1000), padded, direct=False) == best
    small = [(A, np.append(C, 0.0)) for A, C in (true, true)]
    assert least_loss(signals(1000, noise=1e-9), small, direct=False) == 0


@pytest.mark.parametrize("direct", [False, True])
def test_the_loss_is_that_of_least_squares(direct: bool) -> None:
    rng = np.random.default_rng(5)
    u, y = rng.standard_normal((2, 60))
    A, C = np.array([1.0, -1.2, 0.5]), np.array([1.0, 0.3, 0.1])
    pulse, filtered_u = impulse(C, 60), filtered([1.0], C, u)
    Phi = np.column_stack(
        [lagged(filtered_u, range(not direct, 3)), lagged(pulse, range(2)), np.cumsum(pulse)]
    )
    v = filtered(A, C, y)

    loss = _loss(u, y, A, C, direct=direct)

    best = Phi @ np.linalg.lstsq(Phi, v, rcond=None)[0]
    assert loss == pytest.approx(float(np.sum((v - best) ** 2)), rel=1e-9)
