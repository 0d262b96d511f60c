"""Samples of the device: which sample was due, and its values.

In exchange mode a sample answers an EXCHANGE of the daemon. In a scheduled run the device samples
by its own timer. Each mode determines in its own way which sample was due.
"""

from __future__ import annotations

from armrig_core.rig.volts import device_code, volts_of
from armrig_core.telemetry.telemetry import Sample
from armrig_protocol.messages import Flag
from armrig_protocol.messages import Sample as DeviceSample
from msgspec.structs import replace

from armrig_daemon.decisions.clockmap import extend, host_ns_at
from armrig_daemon.decisions.state import ActiveRun, Arrived, DecisionState, Rules, Sent, is_newer

_RUN = int(Flag.RUN)  # int: `&` of two Flags takes 0.5 µs
_ADC0_RAIL, _ADC1_RAIL = int(Flag.ADC0_RAIL), int(Flag.ADC1_RAIL)

MIN_MAP_EXCHANGES = 8
"""Number of exchanges after which the clock map is more accurate than times counted from START."""


def answer(state: DecisionState, m: DeviceSample) -> tuple[DecisionState, Arrived | None]:
    """Return the sample that answers an EXCHANGE of the daemon; None for any other sample."""
    link, device = state.link, state.device
    at = None if link is None else _find_exchange(link.sent, m.k)
    if link is None or at is None or device is None or link.is_ahead(m.echo):
        return state, None  # an old frame, or the answer to another host
    if _is_older_than_last(state, m):
        return state, None
    sent, unanswered, later = link.sent[at], link.sent[:at], link.sent[at + 1 :]
    if (m.echo - sent.seq) & 0xFFFF >= 0x8000:
        return state, None  # made before the device took this EXCHANGE in, for a repeated frame
    if sent.device_seq is not None and not is_newer(m.seq, sent.device_seq):
        # Sent before the EXCHANGE: it answers a repeated frame of an old session.
        return state, None
    if sent.k <= state.last_reported_k:
        return state.linked(sent=later), None  # too late: it was already reported as a gap
    expected = device_code(sent.code, device.pwm_bits) if m.flags & _RUN else 0
    link = replace(link, sent=later, last_round_trip_ns=sent.sent_ns)
    t_us, by = unwrap(state.t_us, m.t_us), state.rules
    sample = convert_sample(by, m, sent.k, sent.sched_ns, sent.sent_ns, t_us, sent.code)
    return state, Arrived(sample, sent.code, expected, link, state.run, sent, unanswered)


def _find_exchange(sent: tuple[Sent, ...], k: int) -> int | None:
    """Return the index of the EXCHANGE for sample `k`, or None; `k` wraps at 2^32."""
    for at, exchange in enumerate(sent):
        if exchange.k & 0xFFFFFFFF == k:
            return at
    return None


def of_run(state: DecisionState, now_ns: int, m: DeviceSample) -> Arrived | None:
    """Return a sample of a scheduled run; None for a repeated sample or without a run."""
    run, device, link = state.run, state.device, state.link
    if run is None or run.k_first < 0 or not run.due <= m.k < run.samples:
        return None
    if device is None or link is None or _is_older_than_last(state, m):
        return None
    code = run.code(m.k)
    t_us, by = unwrap(state.t_us, m.t_us), state.rules
    sched_ns = _due_ns(state, run, m)
    sample = convert_sample(by, m, run.k_first + m.k, sched_ns, now_ns, t_us, code)
    expected = device_code(code, device.pwm_bits)
    return Arrived(sample, code, expected, link, replace(run, due=m.k + 1))


def _due_ns(state: DecisionState, run: ActiveRun, m: DeviceSample) -> int:
    """Return the host's time at which a sample was due, from the clock map or from `t_zero_ns`."""
    clock = state.clock
    if clock is not None and clock.map.weight and len(clock.map.round_trips) >= MIN_MAP_EXCHANGES:
        return host_ns_at(clock.map, extend(clock.device_us, m.t_us))
    return run.t_zero_ns + m.k * state.ts_us * 1000


def _is_older_than_last(state: DecisionState, m: DeviceSample) -> bool:
    """Return whether a sample precedes the last one by at most half a wrap of its clock."""
    return bool(state.sampled_ns) and (m.t_us - state.t_us) & 0xFFFFFFFF > 0x7FFFFFFF


def unwrap(last: int, raw: int) -> int:
    """Return the reading `raw` of a 32-bit clock without wraps; `last` is the previous result."""
    return last + ((raw - last) & 0xFFFFFFFF)


def convert_sample(
    rules: Rules,
    m: DeviceSample,
    k: int,
    sched_ns: int,
    host_ns: int,
    device_us: int,
    code: int,
) -> Sample:
    """Return a sample in ns, V and the units of the channels; NaN at a rail that is not valid."""
    first, second = rules.conversions
    return Sample(
        k,
        sched_ns,
        host_ns,
        device_us,
        first.value_at_rail(m.y0) if m.flags & _ADC0_RAIL else first.value(m.y0),
        second.value_at_rail(m.y1) if m.flags & _ADC1_RAIL else second.value(m.y1),
        volts_of(code),
        volts_of(rules.acting_code(m.u_k, m.flags)),
        m.y0,
        m.y1,
        m.flags,
    )
