"""Which readings keep a rig from being armed, and which do not."""

from __future__ import annotations

from math import nan

import pytest
from armrig_core.telemetry import Sample
from armrig_daemon.readings import Readings, objection, seen, theta_1_rad
from armrig_daemon.records import Distribution, Timing
from armrig_daemon.service import _untimely
from armrig_protocol.messages import Flag
from msgspec.structs import replace

MS = 1_000_000


def _after(
    samples: int,
    *,
    ts_ms: int = 10,
    u: float = 0.0,
    step: int = 0,
    y0: int = 20_000,
    flags: int = 0,
    before: Readings | None = None,
) -> Readings:
    """Return the readings after samples in which theta_1 goes on by `step` counts."""
    readings = before or Readings()
    newest = readings.newest
    first = 0 if newest is None else newest.k + 1
    for k in range(first, first + samples):
        counts = (y0 + step * k) % 65536
        t_ns = k * ts_ms * MS
        angle = nan if flags & Flag.ADC0_RAIL else 0.5
        alpha = 0 if flags & Flag.ADC1_RAIL else 32768
        sample = Sample(k, t_ns, t_ns, t_ns // 1000, angle, 0.0, u, u, counts, alpha, flags)
        readings = seen(readings, sample)
    return readings


def _objection(readings: Readings, *, alpha_is_read: bool = True) -> str:
    return objection(readings, turns_per_volt_s=0.3, alpha_is_read=alpha_is_read)


def test_a_rig_at_rest_may_be_armed() -> None:
    """A reading that does not move is what a still shaft gives; so is a dead band's."""
    assert _objection(Readings()) == ""
    assert _objection(_after(1000)) == ""
    assert _objection(_after(1000, y0=0, flags=Flag.ADC0_RAIL)) == ""


def test_alpha_at_the_end_of_its_range_is_named() -> None:
    """For 0.2 s; one sample there is a spike."""
    railed = _after(30, flags=Flag.ADC1_RAIL)

    assert _objection(railed).startswith("alpha reads 0 of 65535, the end of its range: see")
    assert _objection(_after(10, flags=Flag.ADC1_RAIL)) == ""
    assert _objection(railed, alpha_is_read=False) == ""
    assert _objection(_after(1, before=railed)) == ""


@pytest.mark.parametrize("jitter", [0, 1])
def test_a_theta_1_that_stays_while_the_motor_is_driven_is_named(jitter: int) -> None:
    """3 V for 2 s are a turn of the model, with noise or without."""
    readings = Readings()
    for k in range(200):
        readings = _after(1, u=3.0, y0=20_000 + 64 * (k % 2) * jitter, before=readings)

    text = _objection(readings)

    assert "theta_1 reads 200" in text
    assert "did not move while the motor was driven for 1.2 turns" in text


def test_a_theta_1_that_moves_is_not_stuck() -> None:
    """Neither in a run, nor in its dead band, nor once it was turned by hand."""
    stuck = _after(200, u=3.0)

    assert _objection(_after(1000, u=3.0, step=40)) == ""
    assert _objection(stuck) != ""
    assert _objection(_after(1, y0=30_000, before=stuck)) == ""


def test_a_voltage_that_may_not_overcome_the_friction_proves_nothing() -> None:
    """Nor do samples with whole turns between them."""
    assert _objection(_after(5000, u=1.0)) == ""
    assert _objection(_after(100, ts_ms=1000, u=5.0)) == ""


def test_the_newest_angle_is_the_start_of_a_rehearsal() -> None:
    """Unknown in the dead band, and before the first sample."""
    assert theta_1_rad(_after(1)) == 0.5
    assert theta_1_rad(_after(1, flags=Flag.ADC0_RAIL)) is None
    assert theta_1_rad(Readings()) is None


@pytest.mark.parametrize(("p99_us", "refused"), [(99_000.0, False), (101_000.0, True)])
def test_a_host_that_pauses_again_and_again_is_not_armed(p99_us: float, *, refused: bool) -> None:
    """Longer than the watchdog in more than 1 % of its ticks; once alone is no reason."""
    quiet = Distribution(p50=0, p90=0, p99=0, p999=0, max=0, n=100, missed=0)
    late = replace(quiet, p99=p99_us, p999=150_000.0, max=150_000.0)
    timing = Timing(
        t_host_ns=0,
        wake_lateness_us=late,
        device_tick_error_us=quiet,
        link_round_trip_us=quiet,
        queue_depth=quiet,
    )

    assert bool(_untimely(timing, 100)) is refused
    assert _untimely(None, 100) == ""
