"""Treatment of data: what it removes, what it must not."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pytest
from armrig.dataset import Dataset, merge
from armrig.excitation import telegraph
from armrig.polynomial import filtered
from armrig.preprocess import IntegratingOutputWarning, detrend, difference
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

finite = st.floats(-1e3, 1e3)


@settings(deadline=None)
@given(arrays(np.float64, (2, 30), elements=finite), arrays(np.bool_, 30), st.integers(0, 1))
def test_detrending_twice_changes_nothing(
    signals: NDArray[np.float64], valid: NDArray[np.bool_], order: int
) -> None:
    """Also with holes, and in each experiment by itself."""
    data = Dataset(u=signals[0], y=signals[1], Ts=1.0, valid=valid, starts=(0, 12))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IntegratingOutputWarning)
        once = detrend(data, order)
        twice = detrend(once, order)

    np.testing.assert_allclose(twice.u, once.u, atol=1e-9)
    np.testing.assert_allclose(twice.y, once.y, atol=1e-9)


def test_each_experiment_loses_its_own_mean() -> None:
    """A level common to all would leave a step at the boundary."""
    data = merge([Dataset(u=[1, 3], y=[5, 7], Ts=1), Dataset(u=[10, 12], y=[0, 4], Ts=1)])

    treated = detrend(data)

    np.testing.assert_allclose(treated.y, [-1, 1, -2, 2])
    np.testing.assert_allclose(treated.u, [-1, 1, -1, 1])
    assert treated.history == ("detrend(order=0)",)


def test_a_line_removed_from_the_angle_is_warned_of() -> None:
    """theta_1 integrates by construction."""
    data = Dataset(u=np.ones(50), y=np.arange(50.0), Ts=1, output="theta_1")

    with pytest.warns(IntegratingOutputWarning, match="theta_1 integrates its input"):
        detrend(data, order=1)


@pytest.mark.parametrize("seed", range(5))
def test_an_integrator_without_a_name_is_found_by_test(seed: int) -> None:
    """The unit root shows in the data."""
    rng = np.random.default_rng(seed)
    u = telegraph(1000, 0.1, seed=rng)
    y = filtered([0, 0.1], [1, -1.5, 0.5], u) + 0.005 * rng.standard_normal(1000)

    with pytest.warns(IntegratingOutputWarning, match="no pull back"):
        detrend(Dataset(u=u, y=y, Ts=0.01), order=1)


@pytest.mark.parametrize("seed", range(5))
def test_a_drift_under_a_stable_output_may_be_removed(seed: int) -> None:
    """No warning, though the level travels far."""
    rng = np.random.default_rng(seed)
    u = telegraph(1000, 0.1, seed=rng)
    y = filtered([0, 0.1], [1, -0.9], u) + 0.1 * rng.standard_normal(1000)

    treated = detrend(Dataset(u=u, y=y + 0.02 * np.arange(1000), Ts=0.01), order=1)

    assert abs(np.mean(treated.y)) < 1e-9


def test_real_data_with_a_stable_output_are_not_warned_of(
    reference: Callable[[str], NDArray[np.float64]],
) -> None:
    """The hair dryer does not integrate."""
    u, y = reference("dryer.dat").T

    detrend(Dataset(u=u, y=y, Ts=0.08), order=1)


def test_a_difference_is_missing_where_a_neighbour_is() -> None:
    """And at the first sample of each experiment."""
    data = Dataset(
        u=np.zeros(7),
        y=[0, 1, 3, 6, 10, 0, 2],
        Ts=0.5,
        valid=[True, True, True, False, True, True, True],
        starts=(0, 5),
        output="theta_1",
        unit="rad",
    )

    velocity = difference(data)

    np.testing.assert_array_equal(velocity.y, [np.nan, 2, 4, np.nan, np.nan, np.nan, 4])
    assert (velocity.output, velocity.unit) == ("velocity", "rad/s")


def test_another_order_is_refused() -> None:
    """The message says which there are."""
    with pytest.raises(ValueError, match="order=2 must be 0"):
        detrend(Dataset(u=[0], y=[0], Ts=1), order=2)
