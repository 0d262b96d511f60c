"""The samples in a pixel."""

from __future__ import annotations

from math import inf, isnan, nan, pi, radians

import msgspec
import numpy as np
import pytest
from armrig.dashboard.bins import (
    RunRotation,
    as_lists,
    binned,
    coarser,
    needed_before,
    rate,
    signals,
    signals_of,
)
from armrig_core.commands.commands import OutputRange
from armrig_core.rig.description import Description, builtin
from armrig_core.telemetry.telemetry import Sample
from armrig_protocol.messages import Flag


def _samples(theta_1_deg: list[float], Ts: float = 0.001, u: float = 1.0) -> list[Sample]:
    return [
        Sample(
            k=k,
            t_sched_ns=round(k * Ts * 1e9),
            t_host_ns=round(k * Ts * 1e9),
            t_device_us=0,
            value_0=radians(theta),
            value_1=radians(-theta),
            u_cmd_v=u,
            u_applied_v=u,
            counts_0=0,
            counts_1=0,
            flags=0,
        )
        for k, theta in enumerate(theta_1_deg)
    ]


def _binned(samples: list[Sample]) -> np.ndarray:
    found = signals(samples)
    return binned(found[:0], found)


def test_a_bin_holds_the_least_and_the_largest() -> None:
    """A peak of one sample among ten is seen."""
    rows = _binned(_samples([0, 0, 0, 7, 0, 0, -3, 0, 0, 0] + [1] * 10))

    assert rows.shape == (2, 9)
    np.testing.assert_allclose(rows[:, 0], [0.0, 0.01])
    np.testing.assert_allclose(rows[:, 3], [-3, 1])
    np.testing.assert_allclose(rows[:, 4], [7, 1])


def test_each_sample_of_a_slow_stream_is_a_bin() -> None:
    assert _binned(_samples([1, 2, 3], Ts=0.01)).shape[0] == 3


@pytest.mark.parametrize("dead_band", [0, 2])
def test_a_wrap_ends_a_bin(dead_band: int) -> None:
    """Otherwise the page would draw a line across the whole turn; the dead band hides the wrap."""
    angles = [358.0, 359.0, *[float("nan")] * dead_band, 1.0, 2.0]

    for found in (_binned(_samples(angles)), coarser(_binned(_samples(angles, Ts=0.01)), 0.1)):
        assert found[:, 3].round().tolist() == [358, 1]
        assert found[:, 4].round().tolist() == [359, 2]
    assert _binned(_samples([0, 170])).shape[0] == 1


def test_an_unknown_angle_does_not_hide_a_known_angle_of_its_bin() -> None:
    nan = float("nan")
    rows = _binned(_samples([nan, 5, nan, nan, nan, nan, nan, nan, nan, nan] + [nan] * 10))

    assert as_lists(rows)[0][3:5] == [5.0, 5.0]
    assert np.isnan(as_lists(rows)[1][3:5]).all()


@pytest.mark.parametrize("Ts", [0.001, 0.01, 0.03, 0.1, 0.15])
def test_the_rate_is_the_slope_across_a_wrap(Ts: float) -> None:
    """One degree a millisecond is 1000 °/s, also from 359 to 0, at any sampling time."""
    found = signals(_samples([(350 + 1000 * Ts * k) % 360 for k in range(300)], Ts=Ts))
    slope = rate(found[:200], found[200:])

    np.testing.assert_allclose(slope, 1000.0, rtol=1e-6)


def test_the_rate_is_a_slope_over_a_tenth_of_a_second_of_time() -> None:
    """A step of the converter, 0.35°, shows as 3.5 °/s at any sampling time up to 0.1 s."""
    for Ts in (0.001, 0.01, 0.02, 0.05, 0.1):
        found = signals(_samples([0.0] * 300 + [0.35], Ts=Ts))
        assert rate(found[:-1], found[-1:])[0] == pytest.approx(3.5), Ts


def test_a_missing_sample_or_angle_does_not_remove_other_rates() -> None:
    """The slope then uses an older sample, at most 0.2 s older."""
    nan = float("nan")
    samples = _samples([nan if k in (3, 25) else float(k) for k in range(60)], Ts=0.01)
    del samples[15:17]
    found = signals(samples)
    slope = rate(found[:13], found[13:])
    at = {round(k): y for k, y in zip(found[13:, 0], slope, strict=True)}

    assert np.isnan(at.pop(25))
    np.testing.assert_allclose([*at.values()], 100.0)
    late = signals([*_samples([0.0] * 20, Ts=0.01), *_samples([1.0] * 70, Ts=0.01)[50:]])
    assert np.isnan(rate(late[:20], late[20:])[:10]).all()
    assert np.isfinite(rate(late[:20], late[20:])[10:]).all()
    assert np.isnan(rate(found[:0], found[:5])).all()
    for n in range(1, found.shape[0]):  # of the earlier samples those that are kept are enough
        kept = rate(needed_before(found[:n]), found[n:])
        np.testing.assert_array_equal(kept, rate(found[:n], found[n:]))


def test_slow_samples_have_a_rate_from_one_to_the_next() -> None:
    """If a sample is missing between two slow ones, half a turn may have passed."""
    samples = _samples([float(k) for k in range(9)], Ts=0.5)
    del samples[4]
    found = signals(samples)

    np.testing.assert_allclose(rate(found[:1], found[1:]), [2.0, 2.0, 2.0, np.nan, 2.0, 2.0, 2.0])
    for n in range(1, 8):
        before = needed_before(found[:n])
        np.testing.assert_allclose(rate(before, found[n:]), rate(found[:n], found[n:]))


def test_the_number_of_samples_kept_for_a_rate_is_bounded() -> None:
    """A foreign recording may give all samples the same time; they need no more memory."""
    found = np.zeros((5000, 5))

    assert needed_before(found).shape[0] == 1000


def test_coarser_rows_keep_the_extremes() -> None:
    rows = _binned(_samples([float(k % 37) for k in range(100)]))
    wide = coarser(rows, 0.05)

    assert wide.shape == (2, 9)
    assert (wide[0, 3].round(), wide[0, 4].round()) == (0, 36)


def test_a_sample_exactly_at_an_edge_begins_the_next_bin() -> None:
    """Also if its time in seconds is rounded to just below the edge."""
    assert 0.29 / 0.01 < 29
    rows = _binned(_samples([k / 4 for k in range(400)]))

    assert rows.shape[0] == 40
    np.testing.assert_allclose(rows[:, 3], 2.5 * np.arange(40))
    np.testing.assert_allclose(rows[:, 4], 2.5 * np.arange(40) + 2.25)


def test_each_signal_has_its_columns_and_unit() -> None:
    samples = _samples([1.0, 7.0], Ts=0.12, u=1.23449)
    found = signals([s._replace(u_cmd_v=4.0) for s in samples[1:]])

    sent = msgspec.json.encode(as_lists(binned(signals(samples[:1]), found)))

    assert sent == b"[[0.12,1.234,1.234,7.0,7.0,50.0,50.0,-7.0,-7.0]]"


SERVO = b"""
[rig]
name = "servo"
[outputs.x_1]
unit = "mm"
per_count = 1e-5
low = 0.1
rate = "v"
[outputs.phi]
unit = "rad"
per_count = 1e-4
turning = true
"""


def test_a_described_rig_has_a_column_for_each_output_and_rate() -> None:
    """A wrap of the second output divides a bin, too; a value of small steps has more decimals."""
    drawn = signals_of(Description.of(SERVO))
    samples = [
        s._replace(value_0=0.123456 + k / 1000, value_1=radians(y))
        for k, (s, y) in enumerate(
            zip(_samples([0, 0, 0], Ts=0.15), [358.0, 359.0, 1.0], strict=True)
        )
    ]
    rows = binned(signals([]), signals(samples, drawn), drawn)

    assert [(s.key, s.label, s.unit, s.kind) for s in drawn[1:]] == [
        ("x_1", "x₁", "mm", "value"),
        ("v", "rate of x₁", "mm/s", "rate"),
        ("phi", "φ", "°", "turning"),
        ("phi_rate", "rate of φ", "°/s", "rate"),
    ]
    assert drawn[1].limits == (0.1, inf)
    np.testing.assert_allclose(rows[1:, 3:5], [[0.1245, 0.1245], [0.1255, 0.1255]], atol=6e-5)
    np.testing.assert_allclose(rows[2, 5:], [0.007, 0.007, 1, 1, 13.33, 13.33], atol=4e-3)
    assert coarser(rows, 1.0, drawn).shape == (2, 11)


def test_each_limit_of_the_daemon_belongs_to_the_signal_of_its_channel() -> None:
    """In the page's unit; a limit of turns has a signal of its own, and 0 to 5 V is no limit."""
    ranges = {"theta_1": OutputRange(turns=3), "alpha": OutputRange(low=-pi / 6, high=pi / 4)}

    drawn = {s.key: s for s in signals_of(builtin("arm"), ranges, (0.0, 4.5))}
    (_, heated, _) = signals_of(builtin("heater"), {"T1": OutputRange(high=50.0)})

    assert list(drawn) == ["u", "theta_1", "theta_1_turned", "velocity", "alpha"]
    assert drawn["u"].limits == (-inf, 4.5)
    assert (drawn["theta_1_turned"].limits, drawn["theta_1_turned"].unit) == ((-3, 3), "turns")
    np.testing.assert_allclose(drawn["alpha"].limits, (-30, 45))
    assert heated.limits == (-inf, 50.0)


def test_the_rotation_is_counted_as_the_device_counts_it() -> None:
    """From the first sample of a run, modulo a turn of the readings, in both directions."""
    run = int(Flag.RUN)
    counts = [10, 60_000, 60_000, 20_000, 60_000, 30_000, 30_000]
    flags = [0, run, run, run, run, 0, run]
    samples = [
        plain._replace(counts_0=counts_0, flags=flag)
        for plain, counts_0, flag in zip(_samples([0.0] * 7), counts, flags, strict=True)
    ]

    turns = RunRotation().add(samples)

    ahead = (20_000 - 60_000 + 65_536) / 65_536
    np.testing.assert_allclose(turns, [nan, 0, 0, ahead, 0, nan, 0])
    assert isnan(RunRotation().add(samples[2:3])[0])  # the start of the run is not known


def test_a_heater_has_its_input_in_percent_and_no_rate() -> None:
    power, *temperatures = signals_of(builtin("heater"))

    assert (power.key, power.label, power.unit, power.own) == (
        "u",
        "power",
        "V",
        (20.0, 0.0, "%", 0.0),
    )
    assert [(s.key, s.unit, s.limits, s.is_symmetric) for s in temperatures] == [
        (name, "°C", (-inf, 70.0), False) for name in ("T1", "T2")
    ]
