"""The device's clock over given time."""

from __future__ import annotations

from armrig_daemon.emulator.clock import EmulatedClock, clock_at_reset, microseconds
from armrig_daemon.emulator.settings import EmulatorSettings
from hypothesis import given
from hypothesis import strategies as st

YEAR_NS = 365 * 86_400 * 10**9
PPM = st.floats(-500, 500)


@given(PPM, st.integers(0, YEAR_NS), st.integers(0, YEAR_NS))
def test_an_instant_is_the_first_at_which_the_clock_shows_it(
    ppm: float, reset_ns: int, device_ns: int
) -> None:
    clock = clock_at_reset(EmulatorSettings(clock_ppm=ppm), reset_ns)

    t_ns = clock.instant(device_ns)

    assert device_ns <= clock.device_ns(t_ns) <= device_ns + 1
    assert clock.device_ns(t_ns - 1) < device_ns


def test_clock_of_a_slow_oscillator() -> None:
    """100 ppm: 100 µs a second."""
    slow = clock_at_reset(EmulatorSettings(clock_ppm=100.0), 5)

    assert slow.instant(10**9) == 5 + 10**9 + 100_000
    assert slow.after(5, 10**10) == 5 + 10**10 + 1_000_000
    assert EmulatedClock(7).device_ns(107) == 100
    assert EmulatedClock(7).instant(100) == 107


def test_microseconds_wrap() -> None:
    """At 2^32, after 71.6 min."""
    assert microseconds(1_999) == 1
    assert microseconds(2**32 * 1000 + 5_000) == 5
