"""Messages of the device, and the core's reactions to them."""

from __future__ import annotations

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

from armrig_daemon.decisions import clock_comparison, sampling, transitions
from armrig_daemon.decisions.faults import Fault, Id, of_device
from armrig_daemon.decisions.phases import On, moved
from armrig_daemon.decisions.requests import (
    Step,
    ask,
    is_newer,
    linked,
    log,
    report_state,
    send,
)
from armrig_daemon.decisions.state import Action, Phase, RequestKind, RoundTrip, State
from armrig_daemon.decisions.stopping import end_run, trip

_TYPES = {
    RequestKind.HELLO: TYPES[Hello],
    RequestKind.CONFIGURE: TYPES[Config],
    RequestKind.ARM: TYPES[Arm],
    RequestKind.START: TYPES[Start],
    RequestKind.STOP: TYPES[Stop],
    RequestKind.CLEAR: TYPES[ClearFault],
}


def handle(state: State, now_ns: int, message: Message) -> Step:
    """Return the state after one message of the device."""
    known = None if state.link is None else state.link.device_seq
    # A device that was reset begins its numbers again.
    if known is None or isinstance(message, HelloReply) or is_newer(message.seq, known):
        state = linked(state, device_seq=message.seq)
    match message:
        case DeviceSample():
            if _is_other_boot(state, message.boot):
                return _rebooted(state, now_ns)
            return sampling.handle(state, now_ns, message)
        case HelloReply():
            return transitions.handle_hello(state, now_ns, message)
        case ConfigReply():
            return transitions.handle_config(state, now_ns, message)
        case Ack():
            return _ack(state, now_ns, message)
        case DeviceEvent():
            return _event(state, now_ns, message)
        case Pong():
            return _pong(state, now_ns, message)
    return state, []


def _pong(state: State, now_ns: int, pong: Pong) -> Step:
    link = state.link
    if link is None or pong.host_ns != link.ping_ns:
        return state, []  # the answer to an earlier PING
    round_trip = RoundTrip(now_ns - pong.host_ns)
    state = linked(state, last_round_trip_ns=max(link.last_round_trip_ns, pong.host_ns))
    state = clock_comparison.by_pong(state, now_ns, pong)
    state, done = transitions.note_state(state, now_ns, pong.state)
    return state, [round_trip, *done]


def _is_other_boot(state: State, boot: int) -> bool:
    return state.device is not None and boot != state.device.boot_id & 0xFFFF


def _rebooted(state: State, now_ns: int) -> Step:
    """Handle a restart of the device, after which the device is at 0 V without a configuration."""
    was_driving = state.phase in (Phase.ARMED, Phase.ACTIVE)
    state = replace(linked(state, sent=(), device_state=0), device=None)
    done: list[Action] = []
    if was_driving:
        state, done = trip(state, now_ns, Fault(Id.RESET, "the device was reset"))
    elif state.phase is not Phase.FAULT:
        state = moved(state, On.LOST)
        done = [log(now_ns, "warning", "the device was reset"), report_state(state, now_ns)]
    # The run is over. HELLO replaces a STOP, which the restarted device will not confirm.
    state, ended = end_run(state, now_ns)
    state, actions = ask(state, now_ns, RequestKind.HELLO)
    return state, [*done, *ended, *actions]


def _ack(state: State, now_ns: int, ack: Ack) -> Step:
    asked, link = state.asked, state.link
    if asked is None or link is None or ack.of_seq != asked.seq:
        return transitions.note_state(state, now_ns, ack.state)
    if ack.code == Code.OK:
        if ack.of_type == _TYPES[asked.want]:
            state = linked(state, last_round_trip_ns=max(link.last_round_trip_ns, asked.sent_ns))
        return transitions.note_state(state, now_ns, ack.state)
    if ack.code == Code.STALE:
        if asked.want is RequestKind.HELLO and ack.state in (DeviceState.ARMED, DeviceState.RUN):
            # Repeated old frames keep the device in this state: send STOP at once, before HELLO.
            return send(state, now_ns, encode(Stop(0, link.seq)))
        return state, []  # the request will be sent again, with a newer seq
    if (
        asked.want is RequestKind.STOP
        and state.phase is Phase.FAULT
        and ack.code == Code.WRONG_STATE
    ):
        # If the state shows that the device has stopped by itself, STOP is done; otherwise repeat
        # STOP.
        return transitions.note_state(state, now_ns, ack.state)
    text = f"the device refuses {asked.want}: {transitions.name_of(ack.code)}"
    return transitions.give_up(state, now_ns, text)


def _event(state: State, now_ns: int, event: DeviceEvent) -> Step:
    if _is_other_boot(state, event.boot):
        return _rebooted(state, now_ns)
    state = linked(state, token=event.token)
    if event.token and state.phase is not Phase.FAULT:
        unit = "{} mV" if event.cause == Cause.VCC_LOW else "code {}"
        detail = f" ({unit.format(event.detail)})" if event.detail else ""
        state = linked(state, device_state=event.state)
        cause = f"the device stopped by itself: {of_device(event.cause)}{detail}"
        return trip(state, now_ns, Fault(Id.DEVICE, cause, event.cause))
    return transitions.note_state(state, now_ns, event.state, ended=event.cause == Cause.END)
