"""Comparison of the device's clock with the host's, from exchanges with four time stamps."""

from __future__ import annotations

from armrig_protocol.frame import wire_length
from armrig_protocol.messages import Exchange, Message, Ping, Pong
from armrig_protocol.messages import Sample as DeviceSample
from armrig_protocol.messages import State as DeviceState
from msgspec.structs import replace

from armrig_daemon.decisions import clockmap
from armrig_daemon.decisions.budget import BITS_PER_BYTE, PING_INTERVAL_US
from armrig_daemon.decisions.state import ClockComparison, DecisionState, Sent


def by_pong(state: DecisionState, now_ns: int, pong: Pong) -> DecisionState:
    """Return the state after a PONG, which contains two time stamps of the device."""
    ways = (Ping, Pong)
    clock, stamps = state.clock, (pong.host_ns, pong.rx_us, pong.tx_us, now_ns)
    return state if clock is None else _compare(state, clock, ways, *stamps)


def by_sample(state: DecisionState, now_ns: int, sent: Sent, m: DeviceSample) -> DecisionState:
    """Return the state after a SAMPLE that answers an EXCHANGE.

    The device triggers the first conversion of channel 1 when the request arrives. With
    oversampling m, this trigger is 2 m - 1 conversions before `t_us`, the time of the last trigger
    of channel 0. The device begins to send the answer one conversion after `t_us`.
    """
    device, clock = state.device, state.clock
    if device is None or clock is None or now_ns - clock.compared_ns < PING_INTERVAL_US * 1000:
        return state
    before_us = (2 * _oversampling(state, sent, m) - 1) * device.skew_us
    rx_us, tx_us = (m.t_us - before_us) & 0xFFFFFFFF, (m.t_us + device.skew_us) & 0xFFFFFFFF
    ways = (Exchange, DeviceSample)
    return _compare(state, clock, ways, sent.sent_ns, rx_us, tx_us, now_ns)


def _oversampling(state: DecisionState, sent: Sent, m: DeviceSample) -> int:
    """Return the number of conversions in a reading of a channel; 1 if the number is not known."""
    # Too small a number makes the round trip long, so that it gets little weight. Too large a
    # number makes it shorter than all others, so that it dominates the estimate.
    in_force = state.configuration
    if m.state == DeviceState.IDLE or in_force is None or sent.sent_ns < in_force.asked_ns:
        return 1
    return state.rules.oversampling


def _compare(
    state: DecisionState,
    clock: ClockComparison,
    ways: tuple[type[Message], type[Message]],
    h1_ns: int,
    rx_us: int,
    tx_us: int,
    h4_ns: int,
) -> DecisionState:
    request_ns, answer_ns = (
        wire_length(way) * BITS_PER_BYTE * 1_000_000_000 // state.rules.baud for way in ways
    )
    rx = clockmap.extend(clock.device_us or rx_us, rx_us)
    tx = clockmap.extend(rx, tx_us)
    # Each pair of frames has its own time on the wire, which is subtracted here.
    compared = clockmap.update(clock.map, h1_ns + request_ns, rx, tx, h4_ns - answer_ns)
    return replace(state, clock=ClockComparison(clock.boot_id, h4_ns, tx, compared))
