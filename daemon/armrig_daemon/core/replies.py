"""What a device says, and what the core makes of it."""

from __future__ import annotations

from armrig_core.volts import applied_code
from armrig_protocol.frame import encode
from armrig_protocol.messages import (
    TYPES,
    Ack,
    Arm,
    Cause,
    ClearFault,
    Code,
    Config,
    ConfigReply,
    Flag,
    Hello,
    HelloReply,
    Message,
    Pong,
    Start,
    Stop,
)
from armrig_protocol.messages import Event as DeviceEvent
from armrig_protocol.messages import Sample as DeviceSample
from armrig_protocol.messages import State as DeviceState
from msgspec.structs import replace

from armrig_daemon.core import clock_comparison, device_state, gaps, setpoints
from armrig_daemon.core.conversion import converted, extended, is_older
from armrig_daemon.core.faults import Fault, Id
from armrig_daemon.core.requests import Step, ask, log, say_state, send
from armrig_daemon.core.state import Action, Phase, Publish, RoundTrip, Sent, State, Want
from armrig_daemon.core.stopping import end_run, trip

_TYPES = {
    Want.HELLO: TYPES[Hello],
    Want.CONFIGURE: TYPES[Config],
    Want.ARM: TYPES[Arm],
    Want.START: TYPES[Start],
    Want.STOP: TYPES[Stop],
    Want.CLEAR: TYPES[ClearFault],
}
_RUN = int(Flag.RUN)  # an enum's `&` makes an enum: 0.5 µs each time


def take(state: State, now_ns: int, message: Message) -> Step:
    """Return the state after one message of the device."""
    match message:
        case DeviceSample():
            return _sample(state, now_ns, message)
        case HelloReply():
            return device_state.hello(state, now_ns, message)
        case ConfigReply():
            return device_state.configured(state, now_ns, message)
        case Ack():
            return _ack(state, now_ns, message)
        case DeviceEvent():
            return _event(state, now_ns, message)
        case Pong():
            return _pong(state, now_ns, message)
    return state, []


def _pong(state: State, now_ns: int, pong: Pong) -> Step:
    if pong.host_ns != state.ping_ns:
        return state, []  # an old one: it says nothing of now
    round_trip = RoundTrip(now_ns - pong.host_ns)
    state = replace(state, fresh_ns=max(state.fresh_ns, pong.host_ns))
    state = clock_comparison.by_pong(state, now_ns, pong)
    state, done = device_state.seen(state, now_ns, pong.state)
    return state, [round_trip, *done]


def _is_other_boot(state: State, boot: int) -> bool:
    return state.device is not None and boot != state.device.boot_id & 0xFFFF


def _rebooted(state: State, now_ns: int) -> Step:
    """Meet a device that has started anew: it is at 0 V and knows nothing of us."""
    was_driving = state.phase in (Phase.ARMED, Phase.ACTIVE)
    state = replace(state, device=None, sent=(), device_state=0)
    done: list[Action] = []
    if was_driving:
        state, done = trip(state, now_ns, Fault(Id.RESET, "the device was reset"))
    elif state.phase is not Phase.FAULT:
        state = replace(state, phase=Phase.INIT)
        done = [log(now_ns, "warning", "the device was reset"), say_state(state, now_ns)]
    # Whatever was played is over, and no STOP will be confirmed: HELLO takes its place.
    state, ended = end_run(state, now_ns)
    state, actions = ask(state, now_ns, Want.HELLO)
    return state, [*done, *ended, *actions]


def _ack(state: State, now_ns: int, ack: Ack) -> Step:
    asked = state.asked
    if asked is None or ack.of_seq != asked.seq:
        return device_state.seen(state, now_ns, ack.state)
    if ack.code == Code.OK:
        if ack.of_type == _TYPES[asked.want]:
            state = replace(state, fresh_ns=max(state.fresh_ns, asked.sent_ns))
        return device_state.seen(state, now_ns, ack.state)
    if ack.code == Code.STALE:
        if asked.want is Want.HELLO and ack.state in (DeviceState.ARMED, DeviceState.RUN):
            # Old frames hold it there, played again, and HELLO has to wait: STOP has not.
            return send(state, now_ns, encode(Stop(0, state.seq)))
        return state, []  # it will be sent again, with a newer seq
    text = f"the device refuses {asked.want}: {device_state.name_of(ack.code)}"
    return device_state.failed(state, now_ns, text)


def _event(state: State, now_ns: int, event: DeviceEvent) -> Step:
    if _is_other_boot(state, event.boot):
        return _rebooted(state, now_ns)
    cause = Cause(event.cause).name if event.cause in set(Cause) else str(event.cause)
    state = replace(state, token=event.token)
    if event.token and state.phase is not Phase.FAULT:
        detail = f", code {event.detail}" if event.detail else ""
        state = replace(state, device_state=event.state)
        fault = Fault(Id.DEVICE, f"the device stopped by itself: {cause}{detail}")
        return trip(state, now_ns, fault)
    return device_state.seen(state, now_ns, event.state, ended=event.cause == Cause.END)


def _place(sent: tuple[Sent, ...], k: int) -> int | None:
    """Return which EXCHANGE asked for sample `k`, a number that wraps; None where none did."""
    for at, one in enumerate(sent):
        if one.k & 0xFFFFFFFF == k:
            return at
    return None


def _sample(state: State, now_ns: int, m: DeviceSample) -> Step:
    if _is_other_boot(state, m.boot):
        return _rebooted(state, now_ns)
    if state.scheduled and m.flags & _RUN:
        return _self_paced(state, now_ns, m)
    at, device = _place(state.sent, m.k), state.device
    if at is None or device is None or setpoints.is_ahead(state, m.echo):
        return state, []  # nothing of ours: an old burst, or an echo of another host
    if state.sampled_ns and is_older(state.t_us, m.t_us):
        return state, []  # of an earlier k with this number: the device's clock never goes back
    sent = state.sent[at]
    if sent.k <= state.told:
        return replace(state, sent=state.sent[at + 1 :]), []  # overtaken: told as a gap already
    t_us = extended(state.t_us, m.t_us)
    for before in state.sent[:at]:
        state = gaps.note(state, gaps.lost(before, now_ns))
    state, done = gaps.account(state, sent.k, now_ns, m.u_km1)
    published = converted(
        state.rules.calibration, m, sent.k, sent.sched_ns, sent.sent_ns, t_us, sent.code
    )
    done += [RoundTrip(now_ns - sent.sent_ns), Publish(published)]
    expected = applied_code(sent.code, device.pwm_bits) if m.flags & _RUN else 0
    state = replace(
        state,
        sent=state.sent[at + 1 :],
        fresh_ns=sent.sent_ns,
        sampled_ns=sent.sent_ns,
        t_us=t_us,
        applied=m.u_k,
        told=sent.k,
    )
    state = clock_comparison.by_sample(state, now_ns, sent, m)
    state, actions = device_state.seen(state, now_ns, m.state)
    done += actions
    state, actions = setpoints.counted(state, now_ns, 0, m.queued)
    done += actions
    if m.u_k != expected and state.phase is not Phase.FAULT:
        text = f"the device applied code {m.u_k} where {sent.code} was commanded"
        state, actions = trip(state, now_ns, Fault(Id.APPLIED, text))
        done += actions
    return state, done


def _self_paced(state: State, now_ns: int, m: DeviceSample) -> Step:
    state, done = device_state.seen(setpoints.heard(state, m.echo), now_ns, m.state)
    state, actions = setpoints.sample(state, now_ns, m)
    done += actions
    if setpoints.is_ahead(state, m.echo) and state.phase in (Phase.ARMED, Phase.ACTIVE):
        # It has made our own frames stale, and will look like one of them once we have sent it.
        cause = f"the device has heard frame {m.echo}, and the next of ours is {state.seq}"
        state, actions = trip(state, now_ns, Fault(Id.STATE, cause))
        done += actions
    return state, done
