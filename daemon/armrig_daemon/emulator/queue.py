"""Queue of the setpoints in scheduled mode, one code for each sample (PROTOCOL.md, section 6)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import islice, pairwise
from typing import NamedTuple

from armrig_protocol.messages import Cause, Config, Setpoints, Underrun

_INDEX_MODULUS = 1 << 32
MIN_SETPOINTS_PER_FRAME = 8  # with fewer per frame, the queue cannot be filled


class Setpoint(NamedTuple):
    """A code, and the frame that contained it."""

    u: int
    seq: int
    """Sequence number of the frame; 0 for u_rest, which is in no frame."""


class SetpointQueue:
    """Setpoints of the samples `next`, `next` + 1 ..., from ARM to the end of RUN."""

    def __init__(self, config: Config, capacity: int) -> None:
        """Create an empty queue; sample 0 is next, and the last code is u_rest."""
        self._config, self._capacity = config, capacity
        self._rest = Setpoint(config.u_rest, 0)
        self._entries: deque[Setpoint] = deque()
        self._frames: deque[int] = deque()
        """For each frame, the number of its entries that are still in the queue."""
        self._dry = 0
        self.next = 0
        """Index of the next sample to latch; it does not wrap."""
        self.in_force = self._rest
        """Setpoint latched last; its code is not rounded to the duty."""

    def __len__(self) -> int:
        """Return the number of samples from `next` on that have a setpoint."""
        return len(self._entries)

    def violation(self, m: Setpoints) -> tuple[Cause, int]:
        """Return RANGE or SLEW and the first code that violates this limit, or NONE and 0."""
        config, codes = self._config, m.u[: m.n]
        for u in codes:
            if not config.u_min <= u <= config.u_max:
                return Cause.RANGE, u
        if config.slew:
            for before, u in self._steps(self._offset(m.k0), codes):
                if abs(u - before) > config.slew:
                    return Cause.SLEW, u
        return Cause.NONE, 0

    def add(self, m: Setpoints) -> bool:
        """Add the setpoints of `m` that are new; return False if `m` contradicts the queue.

        Setpoints that are late or follow a gap are dropped. A full queue also drops new setpoints.
        """
        offset, have = self._offset(m.k0), len(self._entries)
        if offset > have:
            return True
        codes = m.u[max(0, -offset) : m.n]
        first = max(0, offset)
        entries = islice(self._entries, first, None)
        if any(entry.u != u for entry, u in zip(entries, codes, strict=False)):
            return False
        new = codes[have - first : self._capacity - first]
        if new and len(self._frames) < self._capacity // MIN_SETPOINTS_PER_FRAME:
            self._entries.extend(Setpoint(u, m.seq) for u in new)
            self._frames.append(len(new))
        return True

    def advance(self) -> bool:
        """Latch the setpoint of `next`; return True if the setpoint was in the queue.

        If the queue is empty, the policy decides: u_rest, or the last code for `hold` samples.
        """
        self.next += 1
        if self._entries:
            self.in_force = self._entries.popleft()
            self._frames[0] -= 1
            if not self._frames[0]:
                self._frames.popleft()
            self._dry = 0
            return True
        self._dry += 1
        if self._config.underrun != Underrun.HOLD or self._dry > self._config.hold:
            self.in_force = self._rest
        return False

    def _offset(self, k0: int) -> int:
        """Return `k0` - `next` modulo 2^32, as a signed number."""
        half = _INDEX_MODULUS // 2
        return (k0 - self.next + half) % _INDEX_MODULUS - half

    def _steps(self, offset: int, codes: tuple[int, ...]) -> Iterator[tuple[int, int]]:
        """Yield each step that `codes` causes, as (code before the step, code after it)."""
        yield from pairwise(codes)
        if self.next + offset == 0:
            yield self._rest.u, codes[0]
        if self._entries:
            if offset == len(self._entries):
                yield self._entries[-1].u, codes[0]
        elif -len(codes) < offset <= 0:
            # After an underrun, the motor has the policy's code, whatever the frame contains.
            yield self.in_force.u, codes[-offset]
