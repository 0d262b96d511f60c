"""Scheduled runs: the daemon sends setpoints before the device needs them.

The device's timer paces the samples, so u[k] must be in the device before sample k. The protocol of
the setpoints is go-back-N: the field `queued` of a sample shows up to which index the device has
setpoints. If the index does not grow in time, the daemon repeats all setpoints from this index on.
Setpoints have no other acknowledgement.
"""

from __future__ import annotations

from armrig_core.commands.codes import OutcomeCode
from armrig_protocol.messages import SETPOINTS_PER_FRAME, Message, Ping, Setpoints
from msgspec.structs import replace

from armrig_daemon.decisions import outcomes
from armrig_daemon.decisions.budget import PING_INTERVAL_US
from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.outcomes import Step
from armrig_daemon.decisions.state import ActiveRun, DecisionState, Phase, Queue, RequestKind
from armrig_daemon.pipe import Run

_ARMED = Phase.ARMED

RESEND_NS = 30_000_000
"""Time without progress of the device's queue after which setpoints are sent again, in ns."""
FILL_NS = 2_000_000_000
"""Longest time to fill the queue before the start, in ns."""
MAX_FRAMES = 8
"""Largest number of setpoint frames that are sent at once; more would delay other frames."""


def begin(state: DecisionState, now_ns: int, order: Run) -> Step:
    """Begin to fill the queue of the device, which is armed at 0 V for this run."""
    run = ActiveRun(order.run_id, order.codes, -1, scheduled=True)
    queue = Queue(order, moved_ns=now_ns, asked_ns=now_ns)
    return refill(replace(state, run=run, queue=queue), now_ns)


def refill(state: DecisionState, now_ns: int) -> Step:
    """Send the setpoints that the device has room for."""
    queue, run = state.queue, state.run
    if queue is None or run is None or state.device is None or state.is_stopping:
        return state, []
    sent, moved_ns = queue.sent, queue.moved_ns
    if queue.held < sent and now_ns - moved_ns > RESEND_NS:
        sent, moved_ns = queue.held, now_ns
    end = min(run.samples, queue.base + state.device.queue)
    frames: list[Message] = []
    while len(frames) < MAX_FRAMES and (
        end - sent >= SETPOINTS_PER_FRAME or sent < end == run.samples
    ):
        codes = [run.code(i) for i in range(sent, min(sent + SETPOINTS_PER_FRAME, end))]
        before = run.code_before(sent, state.rules.rest_code)
        if not all(map(state.rules.allows, [before, *codes], codes)):
            fault = Fault(Id.LIMITS, f"a voltage from u[{sent}] on is not within the limits")
            return state, [outcomes.Transmit(tuple(frames)), outcomes.Trip(fault)]
        n = len(codes)
        codes += [0] * (SETPOINTS_PER_FRAME - n)
        frames.append(Setpoints(0, 0, sent, n, 0, tuple(codes)))
        moved_ns = now_ns if sent == queue.held else moved_ns
        sent += n
    if sent != queue.sent or moved_ns != queue.moved_ns:  # usually nothing was sent
        state = replace(state, queue=replace(queue, sent=sent, moved_ns=moved_ns))
    return state, [outcomes.Transmit(tuple(frames))] if frames else []


def note_queue(state: DecisionState, now_ns: int, base: int, queued: int) -> Step:
    """Store the number of setpoints in the device; send more, or START if there are enough."""
    queue, run = state.queue, state.run
    if queue is None or run is None:
        return state, []
    held = base + queued
    moved_ns = now_ns if held > queue.held else queue.moved_ns
    # `refill` sets `sent` to the `held` of that moment; `held` may have grown since.
    queue = replace(queue, base=base, held=held, sent=max(queue.sent, held), moved_ns=moved_ns)
    state = replace(state, queue=queue)
    if state.phase is _ARMED and state.asked is None:
        if _is_filled(state):
            return state, [outcomes.Ask(RequestKind.START, queue.order)]
        if now_ns - queue.asked_ns > FILL_NS:
            text = "the device does not take the setpoints"
            return state, [outcomes.Halt(text, code=OutcomeCode.DEVICE)]
    return refill(state, now_ns)


def _is_filled(state: DecisionState) -> bool:
    queue, run, device = state.queue, state.run, state.device
    if queue is None or run is None or device is None:
        return False
    enough = min(run.samples, device.queue - SETPOINTS_PER_FRAME)
    return queue.held >= enough


def tick(state: DecisionState, now_ns: int) -> Step:
    """Fill the device's queue and compare the clocks during a scheduled run."""
    if state.is_stopping:
        # No STOP was confirmed, and the device still drives the motor: repeat STOP until the
        # device's watchdog stops the motor.
        return state, [] if state.asked is not None else [outcomes.Ask(RequestKind.STOP)]
    state, follow = refill(state, now_ns)
    link = state.link
    if link is not None and now_ns - link.ping_ns >= PING_INTERVAL_US * 1000:
        state = state.linked(ping_ns=now_ns)
        follow = [*follow, outcomes.Transmit((Ping(0, 0, now_ns),))]
    return state, follow
