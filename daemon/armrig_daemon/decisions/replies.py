"""Replies of the device, except samples, and the checks of each frame's sender."""

from __future__ import annotations

from armrig_protocol import messages as wire
from msgspec.structs import replace

from armrig_daemon.decisions import outcomes
from armrig_daemon.decisions.faults import Fault, Id, of_device
from armrig_daemon.decisions.outcomes import Step, Then, log
from armrig_daemon.decisions.phases import On, change_phase
from armrig_daemon.decisions.request_table import REQUESTS
from armrig_daemon.decisions.state import (
    DecisionState,
    Phase,
    RequestKind,
    RoundTrip,
)


def note_echo(state: DecisionState, echo: int) -> Step:
    """Store that the device has received the frame `echo`, which proves a round trip.

    If another host has sent this frame to a driven device, stop with a fault.
    """
    link = state.link
    ahead = link is not None and link.is_ahead(echo)
    if link is not None and ahead and state.phase in (Phase.ARMED, Phase.ACTIVE):
        cause = f"the device has received frame {echo}, but this daemon sends {link.seq} next"
        return state, [outcomes.Trip(Fault(Id.STATE, cause))]
    beats = () if link is None or ahead else link.beats
    newest = [b for b in beats if (echo - b.seq) & 0xFFFF < 0x8000]
    if link is None or not newest:
        return state, []
    link = replace(link, beats=link.beats[len(newest) :], last_round_trip_ns=newest[-1].sent_ns)
    return replace(state, link=link), []


def pong(state: DecisionState, now_ns: int, reply: wire.Pong) -> Step:
    """Handle the answer to the last PING, which proves a round trip; ignore any other PONG."""
    link = state.link
    if link is None or reply.host_ns != link.ping_ns:
        return state, []  # the answer to an earlier PING
    state = state.linked(last_round_trip_ns=max(link.last_round_trip_ns, reply.host_ns))
    return state, [RoundTrip(now_ns - reply.host_ns), outcomes.NoteState(reply.state)]


def handle_reboot(state: DecisionState, now_ns: int) -> Step:
    """Handle a restart of the device, after which the device is at 0 V without a configuration."""
    was_driving = state.phase in (Phase.ARMED, Phase.ACTIVE)
    state = replace(state.linked(sent=(), device_state=0), device=None)
    done: list[outcomes.Outcome] = []
    if was_driving:
        done = [outcomes.Trip(Fault(Id.RESET, "the device was reset"))]
    elif state.phase is not Phase.FAULT:
        state = change_phase(state, On.LOST)
        done = [log(now_ns, "warning", "the device was reset"), Then.REPORT]
    # The run is over. HELLO replaces a STOP, which the restarted device will not confirm.
    return state, [*done, outcomes.EndRun(), outcomes.Ask(RequestKind.HELLO)]


def ack(state: DecisionState, reply: wire.Ack) -> Step:
    """Handle the acknowledgement of a request, or its refusal."""
    asked, link = state.asked, state.link
    if asked is None or link is None or reply.of_seq != asked.seq:
        return state, [outcomes.NoteState(reply.state)]
    if reply.code == wire.Code.OK:
        if reply.of_type == wire.TYPES[REQUESTS[asked.want].message]:
            state = state.linked(last_round_trip_ns=max(link.last_round_trip_ns, asked.sent_ns))
        return state, [outcomes.NoteState(reply.state)]
    return REQUESTS[asked.want].refusal(state, asked, reply)


def event(state: DecisionState, reply: wire.Event) -> Step:
    """Handle an event of the device, which may have stopped the motor by itself."""
    state = state.linked(token=reply.token)
    if reply.token and state.phase is not Phase.FAULT:
        unit = "{} mV" if reply.cause == wire.Cause.VCC_LOW else "code {}"
        detail = f" ({unit.format(reply.detail)})" if reply.detail else ""
        cause = f"the device stopped by itself: {of_device(reply.cause)}{detail}"
        state = state.linked(device_state=reply.state)
        return state, [outcomes.Trip(Fault(Id.DEVICE, cause, reply.cause))]
    return state, [outcomes.NoteState(reply.state, reply.cause == wire.Cause.END)]
