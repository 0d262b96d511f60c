"""Handling of the device's samples: number k, values, and the check of the input.

In exchange mode a sample answers an EXCHANGE of the daemon. In a scheduled run the device samples
by its own timer. Each mode determines in its own way which sample was due; the other code is
shared.
"""

from __future__ import annotations

from typing import NamedTuple

from armrig_core.rig.volts import applied_code, volts_of
from armrig_protocol.messages import Flag
from armrig_protocol.messages import Sample as DeviceSample
from msgspec.structs import replace

from armrig_daemon.decisions import clock_comparison, gaps, setpoints, transitions
from armrig_daemon.decisions.clockmap import extend, host_ns_at
from armrig_daemon.decisions.conversion import converted, extended, is_older
from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.requests import Step, is_newer, linked, log
from armrig_daemon.decisions.state import ActiveRun, Link, Phase, Publish, RoundTrip, Sent, State
from armrig_daemon.decisions.stopping import trip

_RUN, _UNDERRUN = int(Flag.RUN), int(Flag.UNDERRUN)  # int: `&` of two Flags takes 0.5 µs
_ARMED, _ACTIVE, _FAULT = Phase.ARMED, Phase.ACTIVE, Phase.FAULT

MIN_MAP_EXCHANGES = 8
"""Number of exchanges after which the clock map is more accurate than times counted from START."""


class _Due(NamedTuple):
    """Sample that was due and has arrived."""

    k: int
    sched_ns: int
    asked_ns: int
    """Time at which the sample was requested; without a request, the time of its arrival."""
    code: int
    """Code that was commanded for the sample."""
    expected: int
    """Code that the device must have applied."""


def handle(state: State, now_ns: int, m: DeviceSample) -> Step:
    """Return the state after a sample of the current boot of the device."""
    in_force = state.configuration
    if in_force is not None and in_force.scheduled and m.flags & _RUN:
        return _handle_self_paced(state, now_ns, m)
    return _handle_answer(state, now_ns, m)


def _handle_answer(state: State, now_ns: int, m: DeviceSample) -> Step:
    """Handle the answer to an EXCHANGE of the daemon; ignore any other sample and its state."""
    link, device = state.link, state.device
    at = None if link is None else _find_exchange(link.sent, m.k)
    if link is None or at is None or device is None or is_ahead(link, m.echo):
        return state, []  # an old frame, or the answer to another host
    if _is_older_than_last(state, m):
        return state, []
    sent, later = link.sent[at], link.sent[at + 1 :]
    if sent.device_seq is not None and not is_newer(m.seq, sent.device_seq):
        return state, []  # sent before the EXCHANGE: it answers a repeated frame of an old session
    if sent.k <= state.last_reported_k:
        return linked(state, sent=later), []  # too late: it was already reported as a gap
    for before in link.sent[:at]:
        state = gaps.note(state, gaps.lost(before, now_ns))
    expected = applied_code(sent.code, device.pwm_bits) if m.flags & _RUN else 0
    due = _Due(sent.k, sent.sched_ns, sent.sent_ns, sent.code, expected)
    link = replace(link, sent=later, last_round_trip_ns=sent.sent_ns)
    state, done = _publish(state, link, state.run, now_ns, m, due)
    done.append(RoundTrip(now_ns - sent.sent_ns))
    state = clock_comparison.by_sample(state, now_ns, sent, m)
    # Handle the sample before the state: if the device has stopped, the sample is still valid.
    state, actions = transitions.note_state(state, now_ns, m.state)
    done += actions
    state, actions = setpoints.note_queue(state, now_ns, 0, m.queued)
    done += actions
    if state.phase is _FAULT:
        return state, done  # the commanded code is 0 now; the cause of the fault is kept
    state, actions = _check_applied(state, now_ns, m, due)
    return state, done + actions


def _find_exchange(sent: tuple[Sent, ...], k: int) -> int | None:
    """Return the index of the EXCHANGE for sample `k`, or None; `k` wraps at 2^32."""
    for at, exchange in enumerate(sent):
        if exchange.k & 0xFFFFFFFF == k:
            return at
    return None


def _handle_self_paced(state: State, now_ns: int, m: DeviceSample) -> Step:
    """Handle a sample of a device that samples by its own timer."""
    # The echo is checked first: after this sample the daemon sends setpoints. The echo of
    # another host's frame could then look like the echo of one of these setpoints.
    state, done = _check_echo(state, now_ns, m)
    # The device's state is handled before the sample, because the state RUN confirms START and
    # thereby determines k.
    state = state if done else note_echo(state, m.echo)
    state, actions = transitions.note_state(state, now_ns, m.state)
    done += actions
    state, actions = _handle_of_run(state, now_ns, m)
    return state, done + actions


def _check_echo(state: State, now_ns: int, m: DeviceSample) -> Step:
    """Stop with a fault if the driven device has received frames of another host."""
    link = state.link
    if link is None or state.phase not in (_ARMED, _ACTIVE) or not is_ahead(link, m.echo):
        return state, []
    cause = f"the device has received frame {m.echo}, but this daemon sends {link.seq} next"
    return trip(state, now_ns, Fault(Id.STATE, cause))


def _handle_of_run(state: State, now_ns: int, m: DeviceSample) -> Step:
    """Handle a sample of a scheduled run; ignore a repeated sample and a sample without a run."""
    run, device, link = state.run, state.device, state.link
    if run is None or run.k_first < 0 or not run.due <= m.k < run.samples:
        return state, []
    if device is None or link is None or _is_older_than_last(state, m):
        return state, []
    code = run.code(m.k)
    expected = applied_code(code, device.pwm_bits)
    due = _Due(run.k_first + m.k, _sched_ns(state, run, m), now_ns, code, expected)
    state = setpoints.note_missing(state, run, m.k, now_ns)
    run = replace(run, due=m.k + 1)
    state, done = _publish(state, link, run, now_ns, m, due, m.queued)
    state, actions = setpoints.note_queue(state, now_ns, m.k + 1, m.queued)
    done += actions
    if m.flags & _UNDERRUN:
        text = f"sample {due.k} had no setpoint: its input was {volts_of(m.u_k):.3g} V"
        return state, [*done, log(now_ns, "warning", text)]
    # Check this even in a fault: if the device still plays its queue, STOP is sent again at once.
    state, actions = _check_applied(state, now_ns, m, due)
    return state, done + actions


def _sched_ns(state: State, run: ActiveRun, m: DeviceSample) -> int:
    """Return the host's time at which a sample was due, from the clock map or from `t_zero_ns`."""
    clock = state.clock
    if clock is not None and clock.map.weight and len(clock.map.round_trips) >= MIN_MAP_EXCHANGES:
        return host_ns_at(clock.map, extend(clock.device_us, m.t_us))
    return run.t_zero_ns + m.k * state.ts_us * 1000


def note_echo(state: State, echo: int) -> State:
    """Store that the device has received the frame `echo`, which proves a round trip."""
    link = state.link
    if link is None or is_ahead(link, echo):
        return state
    newest = [b for b in link.beats if (echo - b.seq) & 0xFFFF < 0x8000]
    if not newest:
        return state
    link = replace(link, beats=link.beats[len(newest) :], last_round_trip_ns=newest[-1].sent_ns)
    return replace(state, link=link)


def is_ahead(link: Link, echo: int) -> bool:
    """Return whether the frame `echo` was sent by another host, or before this link was opened."""
    return (echo - link.seq) & 0xFFFF < 0x8000


def _is_older_than_last(state: State, m: DeviceSample) -> bool:
    """Return whether a sample is older than the last sample, by the clock of the device."""
    return bool(state.sampled_ns) and is_older(state.t_us, m.t_us)


def _publish(
    state: State,
    link: Link,
    run: ActiveRun | None,
    now_ns: int,
    m: DeviceSample,
    due: _Due,
    queued: int = -1,
) -> Step:
    """Publish the gaps before a sample, then the sample; store `link` and `run` in the state."""
    state, done = gaps.report_missing(state, due.k, now_ns, m.u_km1)
    t_us = extended(state.t_us, m.t_us)
    calibration = state.rules.calibration
    sample = converted(calibration, m, due.k, due.sched_ns, due.asked_ns, t_us, due.code)
    done.append(Publish(sample, queued))
    state = replace(
        state,
        link=link,
        run=run,
        sampled_ns=due.asked_ns,
        t_us=t_us,
        applied=m.u_k,
        last_reported_k=due.k,
    )
    return state, done


def _check_applied(state: State, now_ns: int, m: DeviceSample, due: _Due) -> Step:
    """Stop with a fault if the device applied another code than commanded (S5)."""
    if m.u_k == due.expected:
        return state, []
    text = f"the device applied code {m.u_k}, but code {due.code} was commanded"
    return trip(state, now_ns, Fault(Id.APPLIED, text))
