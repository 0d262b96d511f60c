"""Potentiometers and converter."""

from __future__ import annotations

from math import pi, radians, tau

import numpy as np
import pytest
from armrig_daemon.emulator.sensors import EmulatedPotentiometer, convert, wiper
from hypothesis import given
from hypothesis import strategies as st

TURNING = EmulatedPotentiometer(range_rad=radians(352), zero_rad=radians(176), wraps=True)
ENDING = EmulatedPotentiometer(range_rad=radians(300), zero_rad=radians(150), wraps=False)


def rng() -> np.random.Generator:
    """Return a generator with a seed of its own."""
    return np.random.default_rng(7)


@given(st.floats(-100, 100), st.integers(-20, 20))
def test_a_shaft_that_turns_on_reads_the_same_each_turn(angle: float, turns: int) -> None:
    once, again = wiper(TURNING, angle), wiper(TURNING, angle + turns * tau)
    edge = {0.0, 1.0, None}

    assert (
        (once is None and again is None)
        or {once, again} <= edge
        or again == pytest.approx(once, abs=1e-9)
        or min(once or 0, again or 0) < 1e-9
    )


def test_the_dead_band_is_eight_degrees_wide() -> None:
    """80 of 3600 places around the turn have no contact."""
    places = np.arange(3600) * (tau / 3600) + 1e-6

    dead = sum(wiper(TURNING, float(angle)) is None for angle in places)

    assert dead == 80


def test_a_shaft_that_does_not_turn_on_stops_at_the_ends() -> None:
    assert wiper(ENDING, pi) == 1.0
    assert wiper(ENDING, -pi) == 0.0


@pytest.mark.parametrize("bits", [10, 12, 16])
def test_readings_are_left_justified(bits: int) -> None:
    step = 1 << (16 - bits)

    assert convert(0.5, bits, 0.0, rng()) == 0x8000
    assert convert(1.0, bits, 0.0, rng()) == 0x10000 - step
    assert convert(0.0, bits, 0.0, rng()) == 0


@given(st.floats(0, 1), st.sampled_from([10, 12, 16]))
def test_a_reading_is_the_nearest_step(fraction: float, bits: int) -> None:
    """The reading is off by half a step at most, by a whole step at the top."""
    code = convert(fraction, bits, 0.0, rng())

    error = code / 65536 - fraction
    assert abs(error) <= 0.5 / 2**bits or fraction > 1 - 1 / 2**bits


def test_an_open_wiper_reads_the_rail() -> None:
    assert {convert(None, 10, 0.1, rng()) for _ in range(100)} == {0}


def test_noise_has_the_configured_standard_deviation() -> None:
    """10 mV on 16 bits."""
    generator = rng()

    codes = [convert(0.5, 16, 0.010, generator) for _ in range(20_000)]

    # 3.5 standard errors of a standard deviation: sigma / sqrt(2 N) is 0.5 %.
    assert np.std(codes) * 5 / 65536 == pytest.approx(0.010, rel=0.0175)
    assert np.mean(codes) == pytest.approx(0x8000, abs=4)


def test_a_track_between_two_resistors_gives_less_than_the_whole_voltage() -> None:
    pot = EmulatedPotentiometer(range_rad=4.0, zero_rad=1.0, wraps=True, low=0.1, high=0.9)

    assert wiper(pot, -1.0) == pytest.approx(0.1)
    assert wiper(pot, 1.0) == pytest.approx(0.5)
    assert wiper(pot, 3.0 - 1e-9) == pytest.approx(0.9)
    assert wiper(pot, 3.1) is None


def test_a_reversed_potentiometer_falls_as_the_angle_grows() -> None:
    pot = EmulatedPotentiometer(range_rad=4.0, zero_rad=1.0, wraps=False, sign=-1.0)

    assert wiper(pot, 0.0) == pytest.approx(0.25)
    assert wiper(pot, 0.4) == pytest.approx(0.15)
    assert wiper(pot, -0.4) == pytest.approx(0.35)
