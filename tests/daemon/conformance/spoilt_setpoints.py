"""Devices that break a rule of scheduled mode, its queue and its timer (section 6)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from armrig_daemon.emulator import queue, requests, transitions
from armrig_daemon.emulator.clock import Timer
from armrig_daemon.emulator.firmware import Firmware
from armrig_daemon.emulator.queue import SetpointQueue
from armrig_protocol.messages import Cause, Config, Message, Setpoints

from tests.daemon.conformance.spoiling import Patch, SpoiltDevices

SPOILT = SpoiltDevices()
_DUE_NS: Any = Timer.due_ns
SPOILT.add(
    "one sample is 5 us early",
    "within 1 us",
    Patch.setattr,
    Timer,
    "due_ns",
    property(lambda timer: _DUE_NS.fget(timer) - 5_000 * (timer.k == 17)),
)


@SPOILT.function("START samples at once", "one Ts after START", transitions, "_timer")
def _starts_at_once(make: Any, fw: Firmware, now_ns: int, period_ns: int, k_stop: int) -> Timer:
    made = make(fw, now_ns, period_ns, k_stop)
    return replace(made, first_ns=made.first_ns - period_ns)


@SPOILT.function("each u is one sample late", "Sample k applies u[k]", SetpointQueue, "advance")
def _one_sample_late(advance: Any, of: SetpointQueue) -> bool:
    before = of.in_force
    there = advance(of)
    of.in_force = before
    return there


@SPOILT.function("HOLD does not hold", "empty queue sets", SetpointQueue, "advance")
def _hold_is_zero(advance: Any, of: SetpointQueue) -> bool:
    there = advance(of)
    if not there:
        of.in_force = of._rest
    return there


@SPOILT.function("a greater code does not disagree", "differ from the queue", SetpointQueue, "add")
def _more_may_disagree(add: Any, of: SetpointQueue, m: Setpoints) -> bool:
    known = zip(m.u, of._entries, strict=False)
    return add(of, m) or all(u >= entry.u for u, entry in known)


@SPOILT.function("the queue is one too small", "capacity in HELLO_R", SetpointQueue, "__init__")
def _smaller_queue(begin: Any, of: SetpointQueue, config: Config, capacity: int) -> None:
    begin(of, config, capacity - 1)


def _queue_outlives_its_run(patch: Patch) -> None:
    class Kept(SetpointQueue):
        last: list[Any] = []  # noqa: RUF012 - of this test alone

        def __init__(self, config: Config, capacity: int) -> None:
            super().__init__(config, capacity)
            self._entries.extend(Kept.last)
            self._frames.extend([len(Kept.last)] if Kept.last else [])
            Kept.last = self._entries

    patch.setattr(transitions, "SetpointQueue", Kept)


SPOILT.add("the queue outlives its run", "the queue is empty", _queue_outlives_its_run)
SPOILT.add(
    "too few frames in the queue", "`queue`/8", Patch.setattr, queue, "MIN_SETPOINTS_PER_FRAME", 16
)
SPOILT.add("n of 25 is taken", "n = 0, n > 24", Patch.setattr, requests, "SETPOINTS_PER_FRAME", 300)


@SPOILT.function("queued setpoints feed", "do not feed", Firmware, "tick")
def _setpoints_feed(tick: Any, fw: Firmware, now_ns: int) -> list[Message]:
    fw.feed(now_ns)
    return tick(fw, now_ns)


@SPOILT.function("padding is looked at", "padding", SetpointQueue, "violation")
def _padding_counts(violation: Any, of: SetpointQueue, m: Setpoints) -> tuple[Cause, int]:
    return violation(of, m._replace(n=24))


@SPOILT.function("a late repeat is a step", "Repeated setpoints before", SetpointQueue, "_steps")
def _late_repeat_steps(steps: Any, of: SetpointQueue, offset: int, codes: tuple[int, ...]) -> Any:
    yield from steps(of, offset, codes)
    if not of._entries and offset == -len(codes):
        yield of.in_force.u, 0  # what follows the last code of the frame
