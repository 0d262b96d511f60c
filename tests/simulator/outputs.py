"""Drawn limits of measured outputs, and their judge, which counts in raw readings by itself."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from random import Random
from typing import NamedTuple

from armrig_core.rig.description import Description
from armrig_core.telemetry.telemetry import Sample
from armrig_protocol.messages import Flag

from tests.simulator.violation import Violation

MS = 1_000_000
NAMES = ("y", "z")
_RAILS = (Flag.ADC0_RAIL, Flag.ADC1_RAIL)
_REST = 32_768  # of the second potentiometer
_HALF, _FULL = 32_768, 65_535


class Output(NamedTuple):
    """A described output; its limits are in counts, where the judge compares."""

    zero: int
    per_count: float
    """A power of two, so that the core's values are exact at the limits, too."""
    low: float
    high: float
    samples: int
    blind_ns: int
    """Time of the description; 0 without it."""
    valid_rail: str = ""
    rail_is_outside: bool | None = None

    def limits_of_end(self, counts: int) -> bool:
        """Return whether a reading at this end of the range is outside the limit before it."""
        end, limit = (0, self.low) if counts < _HALF else (_FULL, self.high)
        if abs(limit) == inf:
            return False
        if self.rail_is_outside is not None:
            return self.rail_is_outside
        return abs(limit - end) <= 0.05 * _FULL


def draw_outputs(rng: Random, ts_us: int) -> tuple[Output, ...]:
    """Return no described output in most schedules, else one or two with limits or without."""
    if rng.random() < 0.6:
        return ()
    low = (rng.choice([-inf, -inf, 2_000.0]), rng.choice([-inf, -inf, _REST - 640.0, _REST - 64.0]))
    # An arm at rest reads the limit itself, which is inside.
    high = (rng.choice([inf, inf, 60_000.0]), rng.choice([inf, _REST + 1_920.0, float(_REST)]))
    least_ns = max(50 * MS, 5_000 * ts_us)
    return tuple(
        Output(
            rng.choice([0, 4_096, _REST]),
            rng.choice([0.25, 2.0, -0.5]),
            low[channel],
            high[channel],
            rng.choice([1, 2, 2, 5]),
            rng.choice([0, 1, 1, 3]) * least_ns,
            rng.choice(["", "", "", "low", "high"]) if channel else "",
            rng.choice([None, None, True]),
        )
        for channel in range(rng.choice([1, 2, 2]))
    )


def described(outputs: tuple[Output, ...], turns: int) -> Description:
    """Return the description of a rig with these outputs, as its file gives it.

    With `turns`, in hundredths of a turn, the first output turns.
    """
    lines = ['[rig]\nname = "drawn"']
    turning = f"turning = true\nturns = {turns / 100}\n" if turns else ""  # of the first
    for name, o in zip(NAMES, outputs, strict=False):
        ends = sorted((end - o.zero) * o.per_count for end in (o.low, o.high))
        blind = f"blind_s = {o.blind_ns / 1e9}\n" if o.blind_ns else ""
        blind += f'valid_rail = "{o.valid_rail}"\n' if o.valid_rail else ""
        if o.rail_is_outside is not None:
            blind += f"rail_is_outside = {str(o.rail_is_outside).lower()}\n"
        lines.append(
            f'[outputs.{name}]\nunit = "rad"\nzero_counts = {o.zero}\nper_count = {o.per_count}\n'
            f"{turning}low = {ends[0]}\nhigh = {ends[1]}\nsamples = {o.samples}\n{blind}"
        )
        turning = ""
    return Description.of("\n".join(lines).encode())


@dataclass(slots=True)
class _Seen:
    """Samples of an output so far."""

    outside: int = 0
    """Consecutive valid samples outside the limits."""
    came_ns: int = -1
    """Time at which the newest valid sample was published; -1 before the first sample."""
    asked_ns: int = 0
    """Time at which the newest valid sample was requested."""
    at_rail: int = 0
    """Consecutive samples at an end of the range that is no value."""


class OutputJudge:
    """The rule: outside or blind for too long means FAULT and STOP in that step, and nothing else.

    A missed trip is a violation of O1, and a trip without its cause of O2.
    """

    def __init__(self, outputs: tuple[Output, ...], ts_us: int, rails: int, turns: int) -> None:
        """Begin without a sample; `rails` is the number of samples at an end that is a fault."""
        self._outputs = outputs
        self._rails = rails if any(o.valid_rail for o in outputs) else 0  # else the device counts
        self._blind_ns = [
            max(1_000 * MS, 5_000 * ts_us)
            if not o.blind_ns and (o.low > -inf or o.high < inf) and not (turns and not n)
            else o.blind_ns
            for n, o in enumerate(outputs)
        ]
        self.begin_host()

    def begin_host(self) -> None:
        """Forget what the ended process knew."""
        self._seen = [_Seen() for _ in self._outputs]
        self.stop_sent = self.has_sampled = self.has_tripped = False

    def begin_step(self) -> None:
        """Note that a step of the core begins."""
        self.stop_sent = self.has_sampled = self.has_tripped = False

    def sampled(self, now_ns: int, sample: Sample) -> None:
        """Count a published sample."""
        self.has_sampled = True
        counts = (sample.counts_0, sample.counts_1)
        for channel, (o, seen) in enumerate(zip(self._outputs, self._seen, strict=True)):
            end = "low" if counts[channel] < _HALF else "high"
            at_end = bool(sample.flags & _RAILS[channel])
            beyond = at_end and o.limits_of_end(counts[channel])
            if at_end and not beyond and end != o.valid_rail:
                seen.at_rail += 1
                if seen.came_ns < 0:
                    seen.came_ns, seen.asked_ns = now_ns, sample.t_host_ns
                continue
            seen.at_rail = 0
            seen.came_ns, seen.asked_ns = now_ns, sample.t_host_ns
            inside = o.low <= counts[channel] <= o.high and not beyond
            seen.outside = 0 if inside else seen.outside + 1

    def end_step(self, now_ns: int, phase: str, *, is_tick: bool) -> None:
        """Judge that a driven rig was stopped (O1)."""
        if self.has_tripped and not self.stop_sent:
            raise Violation("O1", now_ns, "an output tripped, and no STOP was sent in that step")
        if phase not in ("armed", "active"):
            return
        for name, o, seen, blind_ns in zip(
            NAMES, self._outputs, self._seen, self._blind_ns, strict=False
        ):
            if self.has_sampled and 0 < self._rails <= seen.at_rail:
                raise Violation("O1", now_ns, f"{name} is at an end in {seen.at_rail} samples")
            if self.has_sampled and seen.outside >= o.samples:
                text = f"{name} is outside in {seen.outside} samples, {o.samples} are allowed"
                raise Violation("O1", now_ns, text)
            if is_tick and blind_ns and 0 <= seen.came_ns < now_ns - blind_ns:
                text = f"{name} is blind for {(now_ns - seen.came_ns) / MS:.1f} ms"
                raise Violation("O1", now_ns, text)

    def tripped(self, now_ns: int, reason: str) -> None:
        """Judge the cause of a trip that names an output (O2)."""
        for name, o, seen, blind_ns in zip(
            NAMES, self._outputs, self._seen, self._blind_ns, strict=False
        ):
            if not reason.startswith(f"{name} "):
                continue
            self.has_tripped = True
            is_blind = reason.startswith(f"{name} has had no valid sample")
            if is_blind and not (blind_ns and now_ns - seen.asked_ns > blind_ns):
                raise Violation("O2", now_ns, f"{reason}: asked {now_ns - seen.asked_ns} ns ago")
            if reason.startswith(f"{name} read an end of its range"):
                if not 0 < self._rails <= seen.at_rail:
                    raise Violation("O2", now_ns, f"{reason}: {seen.at_rail} samples are")
            elif not is_blind and seen.outside < o.samples:
                raise Violation("O2", now_ns, f"{reason}: {seen.outside} samples are outside")
