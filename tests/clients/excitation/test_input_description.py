"""The information in an input, before it is played."""

from __future__ import annotations

import re

import numpy as np
import pytest
from armrig.excitation import multisine, prbs, staircase, step, telegraph, white_noise
from armrig.excitation.input_description import describe_input
from armrig.numerics.power_spectrum import power_spectrum
from armrig.numerics.quantities import plural
from matplotlib import pyplot as plt
from numpy.typing import NDArray


@pytest.mark.parametrize(
    ("u", "order"),
    [
        (np.full(400, 2.0), 1),
        (np.zeros(400), 0),
        (step(400, at=37), 1),
        (step(400, at=200), 1),
        (step(400, at=363), 1),
        (2 + np.cos(0.7 * np.arange(400)), 3),
        (multisine(600, [11, 50, 77, 90], periods=3), 9),
        (prbs(310, register=5), 31),
        (prbs(300, register=3), 7),
    ],
)
def test_the_order_of_excitation_is_the_textbook_s(u: NDArray[np.float64], order: int) -> None:
    """A constant has 1, a sine 2, a sequence of period M has M; a single step has none.

    L. Ljung, System Identification, 2nd ed., 1999, section 13.2.
    """
    description = describe_input(u, 0.01)

    assert description.order == order
    assert f"persistently exciting of order {order}:" in repr(description)


@pytest.mark.parametrize("u", [telegraph(400, 0.3), white_noise(400), prbs(400)])
def test_an_input_that_excites_everything_has_a_lower_bound(u: NDArray[np.float64]) -> None:
    description = describe_input(u, 0.01)

    assert description.order == description.highest_order == 50
    assert "at least 50" in repr(description)


def test_the_weakest_direction_of_a_slow_signal_is_weaker() -> None:
    """White noise has its variance in every direction, a telegraph at least a/(1 - a) of it."""
    N, a = 100_000, 0.05

    white, slow = (describe_input(u, 1).weakest for u in (white_noise(N), telegraph(N, a)))

    assert white == pytest.approx(1.0, abs=0.1)
    assert slow == pytest.approx(a / (1 - a), rel=0.1)


def test_crest_factor_mean_and_levels_are_those_of_the_signal() -> None:
    """A two-level signal of equal shares has the crest factor 1, a sine sqrt(2)."""
    square, sine = np.tile([1.0, 3.0], 50), 2 + np.cos(2 * np.pi * np.arange(400) / 100)

    d = describe_input(square, 0.01)

    assert (d.mean, d.std, d.crest_factor) == (2.0, 1.0, 1.0)
    assert dict(zip(d.levels, d.shares, strict=True)) == {1.0: 0.5, 3.0: 0.5}
    assert describe_input(sine, 0.01).crest_factor == pytest.approx(np.sqrt(2))
    assert np.isnan(describe_input(np.ones(40), 0.01).crest_factor)


@pytest.mark.parametrize("u", [white_noise(500), staircase(500, 20), staircase(500, 21)])
def test_the_shares_of_the_time_sum_to_one(u: NDArray[np.float64]) -> None:
    d = describe_input(u, 0.01)

    assert d.shares.sum() == pytest.approx(1.0)
    assert d.levels.size == (10 if np.unique(u).size > 20 else 20)
    assert d.binned == (np.unique(u).size > 20)


def test_the_area_below_the_spectrum_is_the_variance() -> None:
    """One-sided, in rad/s."""
    d = describe_input(white_noise(20_000, 0, 5, seed=3), 0.01)

    area = float(np.sum(d.spectrum) * (d.omega[1] - d.omega[0]))

    assert area == pytest.approx(25 / 12, rel=0.03)
    assert d.omega[-1] == pytest.approx(np.pi / 0.01)


def test_sixteen_samples_have_a_spectrum() -> None:
    """Sixteen samples are the allowed minimum: one segment."""
    omega, density = power_spectrum([telegraph(16, 0.5)], 0.01)

    assert omega.size == density.size == 9
    assert np.sum(density) > 0


@pytest.mark.parametrize("u", [telegraph(3000, 0.1), np.ones(40), np.array([1.0]), white_noise(12)])
def test_every_input_can_be_described_and_shown(u: NDArray[np.float64]) -> None:
    d = describe_input(u, 0.01)

    assert f"input of {plural(u.size, 'sample')} at 0.01 s" in repr(d)
    plt.close(d.plot())


def test_half_of_the_power_is_reported_by_its_frequency() -> None:
    """A line with four tenths of the power, and a faster line with the rest."""
    t = 0.02 * np.arange(8000)
    for slow, half in ((0.4, 50.0), (0.6, 10.0)):
        power = np.sqrt(slow) * np.sin(10 * t) + np.sqrt(1 - slow) * np.sin(50 * t)

        said = repr(describe_input(2.5 + power, 0.02))

        (told,) = re.findall(r"half of the power below (\S+) rad/s \(Nyquist 157.1 rad/s\)", said)
        assert float(told) == pytest.approx(half, abs=1.0)
        assert said.startswith("input of 8000 samples at 0.02 s (160 s), ")
