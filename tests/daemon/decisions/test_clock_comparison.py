"""The stamps of an exchange, as the map of the clocks gets them."""

from __future__ import annotations

from math import isnan

import pytest
from armrig_core.rig.volts import volts_of
from armrig_daemon.config import Config, DeviceTable
from armrig_daemon.decisions import clock_comparison, clockmap
from armrig_daemon.decisions.budget import PING_INTERVAL_US
from armrig_daemon.decisions.clockmap import ClockMap
from armrig_daemon.decisions.sampling import convert_sample, unwrap
from armrig_daemon.decisions.state import DecisionState, Sent
from armrig_protocol.frame import wire_length
from armrig_protocol.messages import Exchange, Flag, Ping, Pong
from armrig_protocol.messages import Sample as DeviceSample
from armrig_protocol.messages import State as DeviceState

from tests.daemon.decision_states import changed, device_sample, rested
from tests.daemon.virtual_bench import Bench

NOW = 9_000_000_000
WRAP = 1 << 32


def _on_the_wire_ns(kind: type) -> int:
    return int(wire_length(kind) * 10 * 1_000_000_000 // 500_000)


def _fresh(**fields: object) -> DecisionState:
    """Return a state in which the clocks have not been compared, on a line of 500 kBd."""
    state = rested().loop.state
    assert state.rules.baud == 500_000
    nothing = {"map": ClockMap(), "device_us": 0, "compared_ns": 0}
    return changed(state, **{**nothing, **fields})


def test_a_pong_contains_its_two_time_stamps() -> None:
    pong = Pong(3, 0, NOW - 2_000_000, 1000, 1060)

    after = clock_comparison.by_pong(_fresh(), NOW, pong)

    h1, h4 = pong.host_ns + _on_the_wire_ns(Ping), NOW - _on_the_wire_ns(Pong)
    assert after.clock.map == clockmap.update(ClockMap(), h1, 1000, 1060, h4)
    assert (after.clock.device_us, after.clock.compared_ns) == (1060, NOW)


@pytest.mark.parametrize(("t_us", "rx", "tx"), [(5001, 4897, 5105), (51, WRAP - 53, WRAP + 155)])
def test_the_request_of_a_sample_precedes_its_trigger_by_one_conversion(
    t_us: int, rx: int, tx: int
) -> None:
    state = _fresh()
    assert state.device.skew_us == 104
    sent = Sent(1, 2, 3, NOW - 2_000_000, 4)

    after = clock_comparison.by_sample(state, NOW, sent, device_sample(state, t_us=t_us))

    h1, h4 = sent.sent_ns + _on_the_wire_ns(Exchange), NOW - _on_the_wire_ns(DeviceSample)
    assert after.clock.map == clockmap.update(ClockMap(), h1, rx, tx, h4)
    assert after.clock.device_us == tx


@pytest.mark.parametrize(
    ("reported", "asked_ns", "pairs"),
    [
        (DeviceState.READY, NOW - 3_000_000, 8),
        (DeviceState.RUN, NOW - 2_000_000, 8),
        (DeviceState.READY, NOW - 1_999_999, 1),
        (DeviceState.IDLE, NOW - 3_000_000, 1),
        (DeviceState.READY, None, 1),
    ],
)
def test_the_request_of_an_oversampled_sample_precedes_all_its_conversions(
    reported: int, asked_ns: int | None, pairs: int
) -> None:
    state = _fresh(**({"configuration": None} if asked_ns is None else {"asked_ns": asked_ns}))
    state = changed(state, rules=changed(state.rules, oversampling=8))
    sent = Sent(1, 2, 3, NOW - 2_000_000, 4)

    taken = device_sample(state, t_us=5001)._replace(state=reported)
    after = clock_comparison.by_sample(state, NOW, sent, taken)

    h1, h4 = sent.sent_ns + _on_the_wire_ns(Exchange), NOW - _on_the_wire_ns(DeviceSample)
    rx = 5001 - (2 * pairs - 1) * 104
    assert after.clock.map == clockmap.update(ClockMap(), h1, rx, 5105, h4)


def test_oversampling_does_not_shift_the_clocks_against_each_other() -> None:
    bench = Bench(Config(device=DeviceTable(oversampling=8)))

    found = clockmap.estimate(bench.loop.state.clock.map)

    assert abs(found.offset_ns) < 10_000


def test_the_device_s_clock_is_followed_through_its_wraps() -> None:
    state = _fresh(device_us=7 * WRAP + 100)

    after = clock_comparison.by_pong(state, NOW, Pong(3, 0, NOW - 2_000_000, 200, 260))

    assert after.clock.device_us == 7 * WRAP + 260


@pytest.mark.parametrize(("since_ns", "compares"), [(PING_INTERVAL_US * 1000, True), (0, False)])
def test_samples_compare_the_clocks_at_most_at_the_rate_of_pings(
    since_ns: int, compares: bool
) -> None:
    for lack in (0, 1):
        state = _fresh(compared_ns=NOW - since_ns + lack)
        sent = Sent(1, 2, 3, NOW - 2_000_000, 4)
        after = clock_comparison.by_sample(state, NOW, sent, device_sample(state, t_us=5000))
        assert (after != state) == (compares and not lack)
    gone = changed(state, device=None, compared_ns=0)
    assert clock_comparison.by_sample(gone, NOW, sent, device_sample(state, t_us=5000)) == gone


@pytest.mark.parametrize(
    ("last", "raw", "is_"),
    [(0, 0, 0), (0, 5, 5), (5, 5, 5), (WRAP - 1, 0, WRAP), (3 * WRAP + 9, 8, 4 * WRAP + 8)],
)
def test_a_32_bit_clock_continues_after_its_wraps(last: int, raw: int, is_: int) -> None:
    assert unwrap(last, raw) == is_


@pytest.mark.parametrize(
    ("flags", "theta_1", "alpha"),
    [(0, True, True), (Flag.ADC0_RAIL, False, True), (Flag.ADC1_RAIL, True, False)],
)
def test_a_sample_is_converted_to_the_units_of_the_telemetry(
    flags: int, theta_1: bool, alpha: bool
) -> None:
    state = rested().loop.state
    calibration = state.rules.calibration
    taken = device_sample(state, y0=20_000, y1=30_000, u_k=40_000, flags=int(flags))

    sample = convert_sample(state.rules, taken, 11, 22, 33, 44, 55_000)

    assert (sample.k, sample.t_sched_ns, sample.t_host_ns, sample.t_device_us) == (11, 22, 33, 44)
    assert (sample.u_cmd_v, sample.u_applied_v) == (volts_of(55_000), volts_of(40_000))
    assert (sample.counts_0, sample.counts_1, sample.flags) == (20_000, 30_000, flags)
    assert isnan(sample.value_0) != theta_1
    assert isnan(sample.value_1) != alpha
    if theta_1 and alpha:
        assert sample.value_0 == calibration.theta_1.value(20_000)
        assert sample.value_1 == calibration.alpha.value(30_000)
