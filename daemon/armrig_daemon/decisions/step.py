"""All decisions of the daemon: `step(state, now_ns, events) -> (state', actions)`.

The function is pure: no clock, I/O, randomness, logging or threads. Its rules:

1. The phase changes only by the table of `phases.py`. A fault stays latched until a reset (S6).
2. At most one request to the device is pending. The table of `request_table.py` determines when it
   is sent again, what shows its effect, and what follows.
3. A module below returns outcomes and calls no other module; `carry_out` performs the outcomes in
   their order.
4. A tick sends one EXCHANGE. Its code belongs to a command of the lease's holder (S5) and is within
   the limits (S1); in any other case it is the code of rest.
5. If the last round trip is too old (S4), the host paused, or a limited output is outside its
   limits, a driven motor is stopped with a fault.
6. Each number k is published once, as a sample or as missing.
7. An order is answered once: when its request takes effect, fails or is replaced.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from armrig_core.commands.codes import GapCode, OutcomeCode, RefusalCode
from armrig_core.process.printable import plural
from armrig_core.rig.volts import volts_of
from armrig_protocol import messages as wire
from armrig_protocol.decoder import feed
from armrig_protocol.frame import Spoilt, Unknown, encode
from msgspec.structs import replace

from armrig_daemon.decisions import (
    clock_comparison,
    control,
    effects,
    gaps,
    orders,
    outcomes,
    output_limits,
    own_control,
    replies,
    requests,
    sampling,
    setpoints,
    stopping,
)
from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.outcomes import Step, Then, log, refuse, report_state, silence
from armrig_daemon.decisions.phases import On, change_phase
from armrig_daemon.decisions.state import (
    Action,
    DecisionState,
    Emit,
    Event,
    LinkDown,
    LinkState,
    LinkUp,
    Ordered,
    Phase,
    Received,
    RequestKind,
    RoundTrip,
    Rules,
    Sent,
    ServiceGone,
    Tick,
    Traffic,
    is_newer,
)
from armrig_daemon.pipe import RunStarted

_NEVER = 1 << 62
_NOISE = (Spoilt, Unknown)
# Names at module level: the lookup of a member in its enum takes 0.08 µs each time.
_RUN, _ARMED, _ACTIVE, _FAULT = wire.State.RUN, Phase.ARMED, Phase.ACTIVE, Phase.FAULT
_DRIVING = (_ARMED, _ACTIVE)
# int: `&` of two Flags takes 0.5 µs.
_FLAG_RUN, _FLAG_UNDERRUN = int(wire.Flag.RUN), int(wire.Flag.UNDERRUN)
Decided = tuple[DecisionState, list[Action]]


def start(rules: Rules) -> DecisionState:
    """Return the state before the first event."""
    rest_code = rules.rest_code
    return DecisionState(rules=rules, pace_us=rules.ts_us, code=rest_code, applied=rest_code)


def step(state: DecisionState, now_ns: int, events: Iterable[Event]) -> Decided:
    """Return the state after `events`, and the actions; `now_ns` is the time after the events."""
    done: list[Action] = []
    for event in events:
        # Faster than a match: each tick has these two.
        if type(event) is Received:
            state, actions = _handle_bytes(state, now_ns, event.data)
        elif type(event) is Tick:
            state, actions = _tick(state, now_ns, event)
        else:
            state, actions = carry_out(now_ns, _other(state, now_ns, event))
        done += actions
    return state, done


def wake_ns(state: DecisionState) -> int:
    """Return the time at which the core needs a `Wakeup` if no event arrives earlier, in ns."""
    if state.asked is not None:
        return requests.retry_ns(state.asked)
    link = state.link
    return _NEVER if link is None else link.last_send_ns + state.rules.watchdog_ms * 1_000_000 // 3


def _other(state: DecisionState, now_ns: int, event: Event) -> Step:
    """Handle an event that not every tick has."""
    match event:
        case Ordered():
            return orders.handle(state, now_ns, event.order)
        case LinkUp():
            return replace(state, link=LinkState()), [outcomes.Ask(RequestKind.HELLO)]
        case LinkDown():
            return _link_down(state, now_ns, event.reason)
        case ServiceGone():
            return orders.quit_(state)
    return _wakeup(state, now_ns)


def carry_out(now_ns: int, decided: Step) -> Decided:
    """Return the state after the follow-ups of a decision, in their order, and the actions."""
    state, follow = decided
    done: list[Action] = []
    if not follow:
        return state, done  # as for nearly every sample
    waiting = [*reversed(follow)]
    while waiting:
        following = waiting.pop()
        more: Sequence[outcomes.Outcome] = ()
        match following:
            case outcomes.Ask():
                state, more = requests.ask(state, now_ns, following)
            case outcomes.Transmit():
                state, more = requests.transmit(state, now_ns, following.messages)
            case outcomes.NoteState():
                reported, ended = following
                state, more = effects.note_state(state, now_ns, reported, ended=ended)
            case outcomes.Trip():
                state, more = stopping.trip(state, now_ns, following.fault)
            case outcomes.Halt():
                state, more = stopping.stop(state, following)
            case Then.LEAVE:
                state, more = stopping.leave(state)
            case outcomes.GiveUp():
                state, more = requests.give_up(state, now_ns, following.error)
            case Then.FORGET:
                state = replace(state, asked=None, outcome="", outcome_code=None)
            case outcomes.EndRun():
                state, more = gaps.end_run(state, now_ns, complete=following.complete)
            case outcomes.Fill():
                state, more = setpoints.begin(state, now_ns, following.order)
            case Then.REPORT:
                done.append(report_state(state, now_ns))
            case Then.REPORT_SILENCE:
                done += silence(state, now_ns)
            case _:
                done.append(following)
        waiting += reversed(more)
    return state, done


def _link_down(state: DecisionState, now_ns: int, reason: str) -> Step:
    order = state.asked.order if state.asked else None
    done = refuse(order, f"link lost: {reason}", RefusalCode.NO_LINK)
    state = replace(state, link=None, device=None, asked=None)
    if state.quitting:
        return state, [*done, Then.LEAVE]
    if state.phase in _DRIVING:
        return state, [*done, outcomes.Trip(Fault(Id.LINK, f"link lost: {reason}"))]
    # Without a link, no STOP can be confirmed: the run is over.
    warning = log(now_ns, "warning", f"no link: {reason}")
    return change_phase(state, On.LOST), [*done, outcomes.EndRun(), warning, Then.REPORT]


def _handle_bytes(state: DecisionState, now_ns: int, data: bytes) -> Decided:
    link = state.link
    if link is None:
        return state, []
    pending, received = feed(link.pending, data)
    if pending != link.pending:
        state = state.linked(pending=pending)
    if state.asked is not None and state.asked.want is RequestKind.HELLO:
        sound = sum(not isinstance(message, _NOISE) for message in received)
        traffic = Traffic(link.came.bytes + len(data), link.came.frames + sound)
        state = state.linked(came=traffic)
    done: list[Action] = []
    for message in received:
        if isinstance(message, _NOISE):
            # If noise cost a sample, the sample is reported as a gap.
            done.append(log(now_ns, "debug", f"line: {message}"))
            continue
        state, actions = handle_message(state, now_ns, message)
        done += actions
    return state, done


def handle_message(state: DecisionState, now_ns: int, message: wire.Message) -> Decided:
    """Handle a message of the device."""
    device, link, seq = state.device, state.link, message.seq
    last_seq = None if link is None else link.device_seq
    # A device that was reset begins its numbers again.
    newest = last_seq is None or is_newer(seq, last_seq) or isinstance(message, wire.HelloReply)
    if link is not None and newest:
        state = replace(state, link=replace(link, device_seq=seq))
    decided: Step = state, []
    match message:
        case wire.Sample() | wire.Event() if device and message.boot != device.boot_id & 0xFFFF:
            decided = replies.handle_reboot(state, now_ns)
        case wire.Sample():
            return handle_sample(state, now_ns, message)
        case wire.HelloReply() | wire.ConfigReply():
            decided = effects.handle_reply(state, now_ns, message)
        case wire.Ack():
            decided = replies.ack(state, message)
        case wire.Event():
            decided = replies.event(state, message)
        case wire.Pong():
            state, follow = replies.pong(state, now_ns, message)
            decided = clock_comparison.by_pong(state, now_ns, message) if follow else state, follow
    return carry_out(now_ns, decided)


def handle_sample(state: DecisionState, now_ns: int, m: wire.Sample) -> Decided:
    """Handle a sample: echo, state of the device, number, gaps, clock, queue, applied code."""
    in_force = state.configuration
    self_paced = in_force is not None and in_force.scheduled and bool(m.flags & _FLAG_RUN)
    done: list[Action] = []
    if self_paced:
        # The echo is checked first: after this sample the daemon sends setpoints. The echo of
        # another host's frame could then look like the echo of one of these setpoints.
        state, done = carry_out(now_ns, replies.note_echo(state, m.echo))
        # The device's state is handled before the sample, because the state RUN confirms START and
        # thereby determines k.
        state, actions = carry_out(now_ns, effects.note_state(state, now_ns, m.state))
        done += actions
        arrived = sampling.of_run(state, now_ns, m)
    else:
        state, arrived = sampling.answer(state, m)
    if arrived is None:
        return state, done
    state, actions = gaps.publish(state, now_ns, m, arrived)
    done += actions
    if arrived.answered is not None:
        done.append(RoundTrip(now_ns - arrived.answered.sent_ns))
        state = clock_comparison.by_sample(state, now_ns, arrived.answered, m)
        # If the device has stopped, the sample is still valid: handle the state after the sample.
        state, actions = carry_out(now_ns, effects.note_state(state, now_ns, m.state))
        done += actions
    if state.run is not None and state.run.control:
        state, actions = carry_out(now_ns, control.observe(state, arrived.sample))
        done += actions
    # The limits come before the queue: a full queue starts the run of a rig that is inside them.
    if limits := state.rules.limits:
        state, actions = carry_out(now_ns, output_limits.observe(state, limits, arrived.sample))
        done += actions
    base = m.k + 1 if self_paced else 0
    state, actions = carry_out(now_ns, setpoints.note_queue(state, now_ns, base, m.queued))
    done += actions
    if self_paced and m.flags & _FLAG_UNDERRUN:
        u = f"its input was {volts_of(m.u_k):.3g} V"
        done.append(log(now_ns, "warning", f"sample {arrived.sample.k} had no setpoint: {u}"))
    elif m.u_k != arrived.expected and (self_paced or state.phase is not _FAULT):
        # In exchange mode, a fault has set the commanded code to rest, and its cause is kept. In a
        # scheduled run, a device that still plays its queue gets STOP again at once.
        text = f"the device applied code {m.u_k}, but code {arrived.code} was commanded"
        state, actions = carry_out(now_ns, (state, [outcomes.Trip(Fault(Id.APPLIED, text))]))
        done += actions
    return state, done


def _wakeup(state: DecisionState, now_ns: int) -> Step:
    if state.asked is not None:
        return requests.retry(state, now_ns)
    link = state.link
    if link is None:
        return state, []
    drives = link.device_state == _RUN
    if drives and (state.is_stopping or _will_stop_motor(state, now_ns)):
        # A KEEPALIVE would feed the device's watchdog.
        return state.linked(last_send_ns=now_ns), []
    return state, [outcomes.Transmit((wire.Keepalive(0, 0),))]


def _will_stop_motor(state: DecisionState, now_ns: int) -> bool:
    """Return whether the next tick will stop the motor; a Wakeup may precede this tick."""
    rules = state.rules
    if state.k >= 0 and now_ns - state.tick_ns > rules.pause_ns(
        state.ts_us, scheduled=_is_self_paced(state)
    ):
        return True
    return state.run is None and state.phase is _ACTIVE and own_control.has_run_out(state, now_ns)


def _is_self_paced(state: DecisionState) -> bool:
    """Return whether the device is in a scheduled run, paced by its own clock."""
    in_force, link = state.configuration, state.link
    if in_force is None or link is None:
        return False
    return in_force.scheduled and link.device_state == _RUN


def _tick(state: DecisionState, now_ns: int, tick: Tick) -> Decided:
    self_paced = _is_self_paced(state)
    skipped = tick.k - state.k - 1 if state.k >= 0 else 0
    pause_ns = now_ns - state.tick_ns if state.k >= 0 else 0
    if skipped > 0 and not self_paced:
        state = _skip(state, tick.k - skipped, skipped, now_ns, GapCode.HOST_LATE)
    state = replace(state, k=tick.k, tick_ns=now_ns)
    link = state.link
    if link is None:
        return state, []
    if state.device is None:
        # If events never pause, no Wakeup comes. A STOP may have replaced the pending HELLO: send
        # HELLO again (T1).
        hello: Step = state, [outcomes.Ask(RequestKind.HELLO)]
        return carry_out(now_ns, requests.retry(state, now_ns) if state.asked else hello)
    rules, driving, ts_us = state.rules, state.phase in _DRIVING, state.ts_us
    fault: Fault | None = None
    if pause_ns > rules.pause_ns(ts_us, scheduled=self_paced):
        fault = Fault(Id.PAUSE, f"the host paused for {pause_ns / 1e6:.0f} ms")
    elif rules.stop_after and skipped >= rules.stop_after and not self_paced:
        missed = plural(skipped, "tick in a row was", "ticks in a row were")
        cause = f"{missed} missed: {rules.stop_after} are allowed"
        fault = Fault(Id.MISSED, cause)
    elif rules.service_ns and now_ns - state.service_ns > rules.service_ns:
        fault = Fault(Id.SERVICE, "the service is frozen: nobody could stop the motor")
    elif rules.limits:
        fault = output_limits.blind(rules.limits, state.watch, now_ns, ts_us)
    if driving and fault:
        return carry_out(now_ns, (state, [outcomes.Trip(fault)]))
    age_ns = now_ns - link.last_round_trip_ns
    if age_ns > rules.age_ns(ts_us, scheduled=self_paced):
        return carry_out(now_ns, _stale(state, now_ns, age_ns, driving=driving))
    if self_paced:
        return carry_out(now_ns, setpoints.tick(state, now_ns))
    if state.run is not None and state.run.scheduled and state.run.k_first >= 0:
        # The device has stopped, but the run has not ended yet. No tick is needed.
        return state, []
    if len(link.sent) >= wire.MAX_UNECHOED:
        # Send nothing, to limit the number of old commands on the line. If no answer comes,
        # `_stale` stops the motor.
        return _skip(state, tick.k, 1, now_ns, GapCode.DEVICE_LATE), []
    state, code, follow = _decide(state, now_ns, tick.k)
    state, done = carry_out(now_ns, (state, follow))
    link = link if state.link is None else state.link
    seq = link.seq
    sent = Sent(seq, tick.k, tick.sched_ns, now_ns, code, link.device_seq)
    frame = encode(wire.Exchange(0, seq, tick.k & 0xFFFFFFFF, code))
    state, actions = requests.send(state, now_ns, frame, sent)
    return state, done + actions


def _skip(state: DecisionState, k: int, count: int, now_ns: int, reason: GapCode) -> DecisionState:
    return gaps.note(state, gaps.missing(k, count, reason, None, state.tick_ns, now_ns))


def _stale(state: DecisionState, now_ns: int, age_ns: int, *, driving: bool) -> Step:
    age_ms = age_ns / 1e6
    if driving:
        cause = f"no answer from the device for {age_ms:.0f} ms"
        return state, [outcomes.Trip(Fault(Id.STALE, cause))]
    if state.asked is not None:
        return state, []
    state = change_phase(state.linked(sent=()), On.LOST, device=None)
    text = f"no answer from the device for {age_ms:.0f} ms; sending HELLO"
    return state, [log(now_ns, "warning", text), Then.REPORT, outcomes.Ask(RequestKind.HELLO)]


def _decide(
    state: DecisionState, now_ns: int, k: int
) -> tuple[DecisionState, int, list[outcomes.Outcome]]:
    """Return the code for tick `k`: that of a valid command, or the rest code without one."""
    lease, rest_code = state.lease, state.rules.rest_code
    if lease is None or (state.asked is not None and state.asked.want is RequestKind.STOP):
        return state, rest_code, []
    if state.phase is _ARMED and now_ns - lease.renewed_ns > own_control.ARMED_NS:
        text = "armed for 10 s without a command: disarmed"
        return state, rest_code, [log(now_ns, "info", text), outcomes.Halt("")]
    if state.phase is not _ACTIVE:
        return state, rest_code, []
    if state.run is None:
        if own_control.has_run_out(state, now_ns):
            cause = "the lease ran out: no command from its holder"
            return state, rest_code, [outcomes.Trip(Fault(Id.LEASE, cause))]
        return state, state.code, []
    done: list[outcomes.Outcome] = []
    run = state.run
    if run.k_first < 0:
        run = replace(run, k_first=k)
        state = replace(state, run=run)
        started = RunStarted(run_id=run.run_id, k_first=k, count=run.samples, t_host_ns=now_ns)
        done.append(Emit(started))
    i = k - run.k_first
    if i >= run.samples:
        state = replace(state, run=replace(run, due=run.samples))
        return state, rest_code, [*done, outcomes.Halt("complete", code=OutcomeCode.COMPLETE)]
    if run.control:
        state, code, more = control.decide(state, now_ns, run, run.control, i)
        return state, code, [*done, *more]
    if run.own:
        state, code, more = own_control.decide(state, now_ns, lease.n, run, run.own, i)
        return state, code, [*done, *more]
    code = run.code(i)
    if not state.rules.allows(run.code_before(i, rest_code), code):
        fault = Fault(Id.LIMITS, f"u[{i}] is not within the limits")
        return state, rest_code, [*done, outcomes.Trip(fault)]
    return replace(state, run=replace(run, due=i + 1)), code, done
