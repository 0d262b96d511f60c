"""All decisions of the daemon: `step(state, now_ns, events) -> (state', actions)`.

The function is pure: no clock, I/O, randomness, logging or threads. It keeps these invariants of
ARCHITECTURE.md. Every non-zero code that the function sends belongs to a command of the lease's
holder (S5). The code is within the limits (S1), and the last round trip is recent enough (S4). A
fault stays latched until a reset (S6).
"""

from __future__ import annotations

from collections.abc import Iterable

from armrig_core.commands.codes import GapCode, OutcomeCode, RefusalCode
from armrig_protocol.decoder import feed
from armrig_protocol.frame import Spoilt, Unknown, encode
from armrig_protocol.messages import MAX_UNECHOED, Exchange, Keepalive
from armrig_protocol.messages import State as DeviceState
from msgspec.structs import replace

from armrig_daemon.decisions import gaps, orders, replies, setpoints, transitions
from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.phases import On, moved
from armrig_daemon.decisions.requests import Step, ask, linked, log, refuse, report_state, send
from armrig_daemon.decisions.state import (
    Action,
    Emit,
    Event,
    Link,
    LinkDown,
    LinkUp,
    Ordered,
    Phase,
    Received,
    RequestKind,
    Rules,
    Sent,
    ServiceGone,
    State,
    Tick,
    Traffic,
    Wakeup,
)
from armrig_daemon.decisions.stopping import end_run, leave, stop, trip
from armrig_daemon.pipe import RunStarted

ARMED_NS = 10_000_000_000
"""Longest time for which the rig stays armed, at 0 V, without a command, in ns."""
_NEVER = 1 << 62
_NOISE = (Spoilt, Unknown)
# Names at module level: the lookup of a member in its enum takes 0.08 µs each time.
_RUN, _ARMED, _ACTIVE = DeviceState.RUN, Phase.ARMED, Phase.ACTIVE
_DRIVING = (_ARMED, _ACTIVE)


def start(rules: Rules) -> State:
    """Return the state before the first event."""
    return State(rules=rules, pace_us=rules.ts_us)


def step(state: State, now_ns: int, events: Iterable[Event]) -> Step:
    """Return the state after `events`, and the actions; `now_ns` is the time after the events."""
    done: list[Action] = []
    for event in events:
        state, actions = _one(state, now_ns, event)
        done += actions
    return state, done


def wake_ns(state: State) -> int:
    """Return the time at which the core needs a `Wakeup` if no event arrives earlier, in ns."""
    if state.asked is not None:
        return transitions.retry_ns(state.asked)
    link = state.link
    return _NEVER if link is None else link.last_send_ns + state.rules.watchdog_ms * 1_000_000 // 3


def _one(state: State, now_ns: int, event: Event) -> Step:
    match event:
        case Received():
            return _received(state, now_ns, event.data)
        case Tick():
            return _tick(state, now_ns, event)
        case Wakeup():
            return _wakeup(state, now_ns)
        case Ordered():
            return orders.handle(state, now_ns, event.order)
        case LinkUp():
            return ask(replace(state, link=Link()), now_ns, RequestKind.HELLO)
        case LinkDown():
            return _link_down(state, now_ns, event.reason)
        case ServiceGone():
            return orders.quit_(state, now_ns)


def _link_down(state: State, now_ns: int, reason: str) -> Step:
    order = state.asked.order if state.asked else None
    done = refuse(order, f"link lost: {reason}", RefusalCode.NO_LINK)
    state = replace(state, link=None, device=None, asked=None)
    if state.quitting:
        state, actions = leave(state)
        return state, done + actions
    if state.phase in _DRIVING:
        state, actions = trip(state, now_ns, Fault(Id.LINK, f"link lost: {reason}"))
        return state, done + actions
    state, ended = end_run(state, now_ns)  # without a link, no STOP can be confirmed
    state = moved(state, On.LOST)
    said = [log(now_ns, "warning", f"no link: {reason}"), report_state(state, now_ns)]
    return state, [*done, *ended, *said]


def _received(state: State, now_ns: int, data: bytes) -> Step:
    link = state.link
    if link is None:
        return state, []
    pending, received = feed(link.pending, data)
    if pending != link.pending:
        state = linked(state, pending=pending)
    if state.asked is not None and state.asked.want is RequestKind.HELLO:
        sound = sum(not isinstance(message, _NOISE) for message in received)
        came = Traffic(link.came.bytes + len(data), link.came.frames + sound)
        state = linked(state, came=came)
    done: list[Action] = []
    for message in received:
        if isinstance(message, _NOISE):
            # If noise cost a sample, the sample is reported as a gap.
            done.append(log(now_ns, "debug", f"line: {message}"))
            continue
        state, actions = replies.handle(state, now_ns, message)
        done += actions
    return state, done


def _wakeup(state: State, now_ns: int) -> Step:
    if state.asked is not None:
        return transitions.retry(state, now_ns)
    link = state.link
    if link is None:
        return state, []
    drives = link.device_state == _RUN
    if drives and (setpoints.is_stopping(state) or _lapsed(state, now_ns)):
        return linked(state, last_send_ns=now_ns), []  # a KEEPALIVE would feed its watchdog
    return send(state, now_ns, encode(Keepalive(0, link.seq)))


def _lapsed(state: State, now_ns: int) -> bool:
    """Return whether the next tick will stop the motor; a Wakeup may precede this tick."""
    rules = state.rules
    if state.k >= 0 and now_ns - state.tick_ns > rules.pause_ns(
        state.ts_us, scheduled=_is_self_paced(state)
    ):
        return True
    return state.run is None and state.phase is _ACTIVE and _has_run_out(state, now_ns)


def _has_run_out(state: State, now_ns: int) -> bool:
    """Return whether the newest command of the lease's holder is too old (S2)."""
    lease = state.lease
    return lease is not None and now_ns - lease.renewed_ns > state.rules.lease_ns(state.ts_us)


def _is_self_paced(state: State) -> bool:
    """Return whether the device is in a scheduled run, paced by its own clock."""
    in_force, link = state.configuration, state.link
    if in_force is None or link is None:
        return False
    return in_force.scheduled and link.device_state == _RUN


def _tick(state: State, now_ns: int, tick: Tick) -> Step:
    done: list[Action] = []
    self_paced = _is_self_paced(state)
    skipped = tick.k - state.k - 1 if state.k >= 0 else 0
    pause_ns = now_ns - state.tick_ns if state.k >= 0 else 0
    if skipped > 0 and not self_paced:
        state = _skip(state, tick.k - skipped, skipped, now_ns, GapCode.HOST_LATE)
    state = replace(state, k=tick.k, tick_ns=now_ns)
    link = state.link
    if link is None:
        return state, done
    if state.device is None:
        if state.asked is not None:
            return transitions.retry(state, now_ns)  # if events never pause, no Wakeup comes
        # A STOP may have replaced the pending HELLO: send HELLO again (T1).
        return ask(state, now_ns, RequestKind.HELLO)
    rules, driving, ts_us = state.rules, state.phase in _DRIVING, state.ts_us
    fault: Fault | None = None
    if pause_ns > rules.pause_ns(ts_us, scheduled=self_paced):
        fault = Fault(Id.PAUSE, f"the host paused for {pause_ns / 1e6:.0f} ms")
    elif rules.stop_after and skipped >= rules.stop_after and not self_paced:
        cause = f"{skipped} ticks in a row were missed: {rules.stop_after} are allowed"
        fault = Fault(Id.MISSED, cause)
    elif rules.service_ns and now_ns - state.service_ns > rules.service_ns:
        fault = Fault(Id.SERVICE, "the service is frozen: nobody could stop the motor")
    if driving and fault:
        state, actions = trip(state, now_ns, fault)
        return state, done + actions
    if now_ns - link.last_round_trip_ns > rules.age_ns(ts_us, scheduled=self_paced):
        state, actions = _stale(state, now_ns, now_ns - link.last_round_trip_ns, driving=driving)
        return state, done + actions
    if self_paced:
        state, actions = setpoints.tick(state, now_ns)
        return state, done + actions
    if state.run is not None and state.run.scheduled and state.run.k_first >= 0:
        # The device has stopped, but the run has not ended yet. No tick is needed.
        return state, done
    if len(link.sent) >= MAX_UNECHOED:
        # Send nothing, to limit the number of old commands on the line. If no answer comes,
        # `_stale` stops the motor.
        return _skip(state, tick.k, 1, now_ns, GapCode.DEVICE_LATE), done
    state, code, actions = _decide(state, now_ns, tick.k)
    done += actions
    link = link if state.link is None else state.link
    seq = link.seq
    sent = Sent(seq, tick.k, tick.sched_ns, now_ns, code, link.device_seq)
    frame = encode(Exchange(0, seq, tick.k & 0xFFFFFFFF, code))
    state, actions = send(state, now_ns, frame, sent)
    return state, done + actions


def _skip(state: State, k: int, count: int, now_ns: int, reason: GapCode) -> State:
    return gaps.note(state, gaps.missing(k, count, reason, None, state.tick_ns, now_ns))


def _stale(state: State, now_ns: int, age_ns: int, *, driving: bool) -> Step:
    age_ms = age_ns / 1e6
    if driving:
        cause = f"no answer from the device for {age_ms:.0f} ms"
        return trip(state, now_ns, Fault(Id.STALE, cause))
    if state.asked is not None:
        return state, []
    state = moved(linked(state, sent=()), On.LOST, device=None)
    state, actions = ask(state, now_ns, RequestKind.HELLO)
    text = f"no answer from the device for {age_ms:.0f} ms; sending HELLO"
    return state, [log(now_ns, "warning", text), report_state(state, now_ns), *actions]


def _decide(state: State, now_ns: int, k: int) -> tuple[State, int, list[Action]]:
    """Return the code for tick `k`: the code of a valid command, or 0 without a valid command."""
    lease = state.lease
    if lease is None or (state.asked is not None and state.asked.want is RequestKind.STOP):
        return state, 0, []
    if state.phase is _ARMED and now_ns - lease.renewed_ns > ARMED_NS:
        state, actions = stop(state, now_ns, "")
        text = "armed for 10 s without a command: disarmed"
        return state, 0, [log(now_ns, "info", text), *actions]
    if state.phase is not _ACTIVE:
        return state, 0, []
    if state.run is None:
        if _has_run_out(state, now_ns):
            fault = Fault(Id.LEASE, "the lease ran out: no command from its holder")
            state, actions = trip(state, now_ns, fault)
            return state, 0, actions
        return state, state.code, []
    done: list[Action] = []
    run = state.run
    if run.k_first < 0:
        run = replace(run, k_first=k)
        state = replace(state, run=run)
        started = RunStarted(run_id=run.run_id, k_first=k, count=run.samples, t_host_ns=now_ns)
        done.append(Emit(started))
    i = k - run.k_first
    if i < run.samples:
        code = run.code(i)
        if not state.rules.allows(run.code(i - 1), code):
            fault = Fault(Id.LIMITS, f"u[{i}] is not within the limits")
            state, actions = trip(state, now_ns, fault)
            return state, 0, done + actions
        return replace(state, run=replace(run, due=i + 1)), code, done
    state = replace(state, run=replace(run, due=run.samples))
    state, actions = stop(state, now_ns, "complete", code=OutcomeCode.COMPLETE)
    return state, 0, done + actions
