"""What a device says, and what the core makes of it."""

from __future__ import annotations

from math import nan

from armrig_core.telemetry import Sample
from armrig_core.volts import applied_code, volts_of
from armrig_protocol.messages import (
    Ack,
    Cause,
    Code,
    ConfigReply,
    Flag,
    HelloReply,
    Message,
)
from armrig_protocol.messages import Event as DeviceEvent
from armrig_protocol.messages import Sample as DeviceSample

from armrig_daemon import handshake
from armrig_daemon.asking import Step, ask, log, say_state
from armrig_daemon.records import Gap
from armrig_daemon.state import Action, Emit, Phase, Publish, Sent, State, Want
from armrig_daemon.stopping import trip

_ADC0_RAIL, _ADC1_RAIL = int(Flag.ADC0_RAIL), int(Flag.ADC1_RAIL)


def take(state: State, now_ns: int, message: Message) -> Step:
    """Return the state after one message of the device."""
    match message:
        case DeviceSample():
            return _sample(state, now_ns, message)
        case HelloReply():
            return handshake.hello(state, now_ns, message)
        case ConfigReply():
            return handshake.configured(state, now_ns, message)
        case Ack():
            return _ack(state, now_ns, message)
        case DeviceEvent():
            return _event(state, now_ns, message)
    return state, []  # STATUS and PONG are for the timing to come


def _is_other_boot(state: State, boot: int) -> bool:
    return state.device is not None and boot != state.device.boot_id & 0xFFFF


def _rebooted(state: State, now_ns: int) -> Step:
    """Meet a device that has started anew: it is at 0 V and knows nothing of us."""
    was_driving = state.phase in (Phase.ARMED, Phase.ACTIVE)
    state = state._replace(device=None, sent=(), device_state=0)
    done: list[Action] = []
    if was_driving:
        state, done = trip(state, now_ns, "the device was reset")
    elif state.phase is not Phase.FAULT:
        state = state._replace(phase=Phase.INIT)
        done = [log(now_ns, "warning", "the device was reset"), say_state(state, now_ns)]
    state, actions = ask(state, now_ns, Want.HELLO)
    return state, done + actions


def _ack(state: State, now_ns: int, ack: Ack) -> Step:
    asked = state.asked
    if asked is None or ack.of_seq != asked.seq or ack.code == Code.OK:
        return handshake.seen(state, now_ns, ack.state)
    if ack.code == Code.STALE:
        return state, []  # it will be sent again, with a newer seq
    text = f"the device refuses {asked.want}: {handshake.name_of(ack.code)}"
    return handshake.failed(state, now_ns, text)


def _event(state: State, now_ns: int, event: DeviceEvent) -> Step:
    if _is_other_boot(state, event.boot):
        return _rebooted(state, now_ns)
    cause = Cause(event.cause).name if event.cause in set(Cause) else str(event.cause)
    state = state._replace(token=event.token)
    if event.token and state.phase is not Phase.FAULT:
        detail = f", code {event.detail}" if event.detail else ""
        state = state._replace(device_state=event.state)
        return trip(state, now_ns, f"the device stopped by itself: {cause}{detail}")
    return handshake.seen(state, now_ns, event.state)


def _sample(state: State, now_ns: int, m: DeviceSample) -> Step:
    if _is_other_boot(state, m.boot):
        return _rebooted(state, now_ns)
    at = next((i for i, s in enumerate(state.sent) if s.k & 0xFFFFFFFF == m.k), None)
    if at is None or state.device is None:
        return state, []  # nothing of ours: an old burst, or an echo of another host
    sent = state.sent[at]
    t_us = state.t_us + ((m.t_us - state.t_us) & 0xFFFFFFFF)
    done: list[Action] = [_lost(s, state.sent[i + 1], m) for i, s in enumerate(state.sent[:at])]
    done.append(Publish(_converted(state, sent, m, t_us)))
    expected = applied_code(sent.code, state.device.pwm_bits) if m.flags & Flag.RUN else 0
    state = state._replace(
        sent=state.sent[at + 1 :], fresh_ns=sent.sent_ns, t_us=t_us, applied=m.u_k
    )
    state, actions = handshake.seen(state, now_ns, m.state)
    done += actions
    if m.u_k != expected and state.phase is not Phase.FAULT:
        text = f"the device applied code {m.u_k} where {sent.code} was commanded"
        state, actions = trip(state, now_ns, text)
        done += actions
    return state, done


def _converted(state: State, sent: Sent, m: DeviceSample, t_us: int) -> Sample:
    calibration = state.rules.calibration
    return Sample(
        sent.k,
        sent.sched_ns,
        sent.sent_ns,
        t_us,
        nan if m.flags & _ADC0_RAIL else calibration.theta_1.angle(m.y0),
        nan if m.flags & _ADC1_RAIL else calibration.alpha.angle(m.y1),
        volts_of(sent.code),
        volts_of(m.u_k),
        m.y0,
        m.y1,
        m.flags,
    )


def _lost(sent: Sent, after: Sent, m: DeviceSample) -> Action:
    """Return the gap of a sample that was asked for and never came.

    Where the next sample is there, its u_km1 says which input was really held.
    """
    confirmed = after.k & 0xFFFFFFFF == m.k
    code = m.u_km1 if confirmed else sent.code
    reason = "a frame was lost" if confirmed else "frames were lost; the input is as commanded"
    return Emit(
        Gap(
            k_first=sent.k,
            count=1,
            t_from_ns=sent.sent_ns,
            t_to_ns=after.sent_ns,
            u_held_v=volts_of(code),
            reason=reason,
        )
    )
