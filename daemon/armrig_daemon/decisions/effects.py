"""Effects of requests: the reply, or the state of the device, that shows them."""

from __future__ import annotations

from armrig_protocol import messages as wire
from armrig_protocol.messages import State as DeviceState
from msgspec.structs import replace

from armrig_daemon.decisions import outcomes
from armrig_daemon.decisions.faults import Fault, Id, name_of
from armrig_daemon.decisions.outcomes import Step
from armrig_daemon.decisions.request_table import REQUESTS
from armrig_daemon.decisions.state import (
    ActiveRun,
    Configuration,
    DecisionState,
    PendingRequest,
    Phase,
    RequestKind,
)
from armrig_daemon.decisions.transitions import EXPECTED_STATES, LATCHED_STATES, MAX_TRIES, rest


def handle_reply(
    state: DecisionState, now_ns: int, reply: wire.HelloReply | wire.ConfigReply
) -> Step:
    """Handle a reply that a request awaits; an unrequested reply proves no round trip."""
    asked = state.asked
    if asked is None:
        return state, []
    row = REQUESTS[asked.want]
    if row.awaits is type(reply):
        return row.effect(state, now_ns, asked, reply)
    if asked.want is RequestKind.ARM and isinstance(reply, wire.ConfigReply):
        return _take_new_nonce(state, asked, reply)
    return state, []


def _take_new_nonce(state: DecisionState, asked: PendingRequest, reply: wire.ConfigReply) -> Step:
    """Arm with the nonce of a configuration that the device has accepted twice.

    CONFIG was sent twice, because its answer was late: only the second nonce can arm.
    """
    in_force = state.configuration
    if in_force is None or not _is_renewed(in_force, reply) or asked.tries >= MAX_TRIES:
        return state, []
    state = replace(state, configuration=replace(in_force, nonce=reply.nonce))
    return state, [outcomes.Ask(RequestKind.ARM, asked.order, tries=asked.tries + 1)]


def _is_renewed(in_force: Configuration, reply: wire.ConfigReply) -> bool:
    """Return whether the configuration in force was accepted again, under another nonce."""
    same = reply.code == wire.Code.OK and reply.config_crc == in_force.config_crc
    return same and reply.nonce != in_force.nonce


def note_state(state: DecisionState, now_ns: int, reported: int, *, ended: bool = False) -> Step:
    """Handle the state that a frame reports; this state shows whether a request took effect.

    Parameters
    ----------
    reported : int
        State of the device in the frame.
    ended : bool, default False
        True if the frame reports that the device has ended the run after its last sample.
    """
    link = state.link
    before = 0 if link is None else link.device_state
    if reported != before:
        state = state.linked(device_state=reported)
    if (asked := state.asked) is not None:
        row = REQUESTS[asked.want]
        if isinstance(row.awaits, frozenset) and reported in row.awaits:
            return row.effect(replace(state, asked=None), now_ns, asked)
    run = state.run
    idle = reported == DeviceState.IDLE and before == DeviceState.RUN
    if idle and run and run.scheduled and (ended or _is_over(state, run, now_ns)):
        # The device has reached k_stop; its earlier samples have arrived before this frame.
        return rest(state, None, outcomes.EndRun(complete=True))
    expected = EXPECTED_STATES.get(state.phase)
    latched = reported in LATCHED_STATES
    strayed = expected is not None and state.asked is None and reported != expected
    if strayed and not latched:
        name = name_of(DeviceState, reported)
        cause = f"the device is in {name}, which the daemon did not request"
        return state, [outcomes.Trip(Fault(Id.STATE, cause))]
    if latched and before not in LATCHED_STATES and state.phase is not Phase.FAULT:
        cause = f"the device is in {DeviceState(reported).name}"
        return state, [outcomes.Trip(Fault(Id.DEVICE, cause))]
    return state, []


def _is_over(state: DecisionState, run: ActiveRun, now_ns: int) -> bool:
    """Return whether a scheduled run must be over by now, even if its end was not received."""
    return run.due >= run.samples or now_ns >= run.t_zero_ns + run.samples * state.ts_us * 1000
