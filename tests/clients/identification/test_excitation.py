"""Inputs that cannot harm the rig."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from armrig.excitation import step, telegraph


def test_a_telegraph_signal_switches_as_often_as_asked() -> None:
    """With probability a a sample, within four standard deviations."""
    N, a = 20_000, 0.05

    u = telegraph(N, a, low=0.0, high=5.0, seed=3)

    switches = np.count_nonzero(np.diff(u))
    assert set(u) == {0.0, 5.0}
    assert abs(switches - a * (N - 1)) < 4 * np.sqrt(a * (1 - a) * N)


def test_the_first_level_is_drawn_with_equal_chances() -> None:
    """Whatever the switching probability; four standard deviations of 1000 draws."""
    rng = np.random.default_rng(0)

    high = sum(telegraph(1, 0.05, seed=rng)[0] == 4.5 for _ in range(1000))

    assert abs(high - 500) < 4 * np.sqrt(250)


def test_the_same_seed_gives_the_same_signal() -> None:
    """A run can be repeated."""
    np.testing.assert_array_equal(telegraph(50, 0.3, seed=7), telegraph(50, 0.3, seed=7))


@pytest.mark.parametrize(("low", "high"), [(-1.0, 1.0), (0.0, 5.1), (float("nan"), 1.0)])
def test_a_level_outside_the_rig_s_range_is_refused(low: float, high: float) -> None:
    """The handout's telegraph.m gives -1 and 1."""
    with pytest.raises(ValueError, match="is outside the rig's 0 to 5 V"):
        telegraph(10, 0.1, low=low, high=high)
    with pytest.raises(ValueError, match="is outside the rig's 0 to 5 V"):
        step(10, low=low, high=high)


def test_a_step_is_low_before_and_high_from_its_sample_on() -> None:
    """The sample named is the first at the high level."""
    np.testing.assert_array_equal(step(4, low=1.0, high=2.0, at=3), [1, 1, 1, 2])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 0.1), "N=0 must be an integer >= 1"),
        ((10.5, 0.1), "N=10.5 must be an integer >= 1"),
        (("10", 0.1), "N='10' must be an integer >= 1"),
        ((True, 0.1), "N=True must be an integer >= 1"),
        ((9, 1.5), "a=1.5 is a probability"),
        ((9, float("nan")), "a=nan is a probability"),
        ((9, "0.1"), "a='0.1' must be a number"),
        ((9, 0.1, 3.0, 2.0), "below high"),
        ((9, 0.1, "0", 2.0), "low='0' must be a number"),
        ((9, 0.1, 0.5, 4.5, -1), "seed=-1 must be an integer >= 0"),
        ((9, 0.1, 0.5, 4.5, "x"), "seed='x' must be an integer >= 0"),
    ],
)
def test_an_impossible_signal_is_refused(arguments: tuple[Any, ...], message: str) -> None:
    """What came and what is allowed, in our words."""
    with pytest.raises(ValueError, match=message):
        telegraph(*arguments)


@pytest.mark.parametrize(("N", "at"), [(0, 0), (4.0, 1), (4, 1.5), (4, -1), (4, 5)])
def test_an_impossible_step_is_refused(N: Any, at: Any) -> None:
    """Before numpy meets it."""
    with pytest.raises(ValueError, match=r"(N|at)=.* must be"):
        step(N, at=at)


def test_numpy_s_integers_are_integers() -> None:
    """A length may come out of a computation."""
    np.testing.assert_array_equal(telegraph(np.int64(5), 0.5), telegraph(5, 0.5))
