"""Devices that break a rule of scheduled mode, its queue and its timer (section 6)."""

from __future__ import annotations

from dataclasses import replace as dataclass_replace
from functools import partial
from typing import Any

from armrig_daemon.emulator import clock, queue, requests, transitions
from armrig_daemon.emulator.firmware import Firmware
from armrig_daemon.emulator.queue import SetpointQueue
from armrig_protocol.messages import Cause, Config, Message, Setpoints

from tests.daemon.conformance.spoiling import Patch, SpoiltDevice


def _one_shifted(patch: Patch, by_ns: int) -> None:
    due = clock.Timer.due_ns.fget
    patch.setattr(clock.Timer, "due_ns", property(lambda self: due(self) + by_ns * (self.k == 17)))


def _starts_at_once(patch: Patch) -> None:
    make = transitions._timer

    def short(fw: Firmware, now_ns: int, period_ns: int, k_stop: int) -> Any:
        made = make(fw, now_ns, period_ns, k_stop)
        return dataclass_replace(made, first_ns=made.first_ns - period_ns)

    patch.setattr(transitions, "_timer", short)


def _one_sample_late(patch: Patch) -> None:
    advance = SetpointQueue.advance

    def late(self: SetpointQueue) -> bool:
        before = self.in_force
        there = advance(self)
        self.in_force = before
        return there

    patch.setattr(SetpointQueue, "advance", late)


def _hold_is_zero(patch: Patch) -> None:
    advance = SetpointQueue.advance

    def rests(self: SetpointQueue) -> bool:
        there = advance(self)
        if not there:
            self.in_force = self._rest
        return there

    patch.setattr(SetpointQueue, "advance", rests)


def _more_may_disagree(patch: Patch) -> None:
    add = SetpointQueue.add

    def taken(self: SetpointQueue, m: Setpoints) -> bool:
        known = zip(m.u, self._entries, strict=False)
        return add(self, m) or all(u >= entry.u for u, entry in known)

    patch.setattr(SetpointQueue, "add", taken)


def _smaller_queue(patch: Patch) -> None:
    def smaller(self: SetpointQueue, config: Config, capacity: int) -> None:
        original(self, config, capacity - 1)

    original = SetpointQueue.__init__
    patch.setattr(SetpointQueue, "__init__", smaller)


def _queue_outlives_its_run(patch: Patch) -> None:
    class Kept(SetpointQueue):
        last: list[Any] = []  # noqa: RUF012 - of this test alone

        def __init__(self, config: Config, capacity: int) -> None:
            super().__init__(config, capacity)
            self._entries.extend(Kept.last)
            self._frames.extend([len(Kept.last)] if Kept.last else [])
            Kept.last = self._entries

    patch.setattr(transitions, "SetpointQueue", Kept)


def _half_the_setpoint_frames(patch: Patch) -> None:
    patch.setattr(queue, "MIN_SETPOINTS_PER_FRAME", 16)


def _n_of_25(patch: Patch) -> None:
    patch.setattr(requests, "SETPOINTS_PER_FRAME", 300)


def _setpoints_feed(patch: Patch) -> None:
    tick = Firmware.tick

    def feeding(self: Firmware, now_ns: int) -> list[Message]:
        self.feed(now_ns)
        return tick(self, now_ns)

    patch.setattr(Firmware, "tick", feeding)


def _padding_counts(patch: Patch) -> None:
    violation = SetpointQueue.violation

    def all_of_it(self: SetpointQueue, m: Setpoints) -> tuple[Cause, int]:
        return violation(self, m._replace(n=24))

    patch.setattr(SetpointQueue, "violation", all_of_it)


def _late_repeat_steps(patch: Patch) -> None:
    steps = SetpointQueue._steps

    def behind(self: SetpointQueue, offset: int, codes: tuple[int, ...]) -> Any:
        yield from steps(self, offset, codes)
        if not self._entries and offset == -len(codes):
            yield self.in_force.u, 0  # what follows the last code of the frame

    patch.setattr(SetpointQueue, "_steps", behind)


SPOILT: dict[str, SpoiltDevice] = {
    "one sample is 5 us early": SpoiltDevice(partial(_one_shifted, by_ns=-5_000), "within 1 us"),
    "START samples at once": SpoiltDevice(_starts_at_once, "one Ts after START"),
    "each u is one sample late": SpoiltDevice(_one_sample_late, "Sample k applies u[k]"),
    "HOLD does not hold": SpoiltDevice(_hold_is_zero, "empty queue sets"),
    "a greater code does not disagree": SpoiltDevice(_more_may_disagree, "differ from the queue"),
    "the queue is one too small": SpoiltDevice(_smaller_queue, "capacity in HELLO_R"),
    "the queue outlives its run": SpoiltDevice(_queue_outlives_its_run, "the queue is empty"),
    "too few frames in the queue": SpoiltDevice(_half_the_setpoint_frames, "`queue`/8"),
    "n of 25 is taken": SpoiltDevice(_n_of_25, "n = 0, n > 24"),
    "queued setpoints feed": SpoiltDevice(_setpoints_feed, "do not feed"),
    "padding is looked at": SpoiltDevice(_padding_counts, "padding"),
    "a late repeat is a step": SpoiltDevice(_late_repeat_steps, "Repeated setpoints before"),
}
