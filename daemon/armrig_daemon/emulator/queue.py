"""The queue of setpoints in scheduled mode: codes by sample index (PROTOCOL.md, section 6)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import islice, pairwise
from typing import NamedTuple

from armrig_protocol.messages import Cause, Config, Setpoints, Underrun

_INDICES = 1 << 32
LEAST_A_FRAME = 8  # so many entries at least must a frame bring for the queue to be filled


class Setpoint(NamedTuple):
    """A code, and the frame that brought it."""

    u: int
    seq: int
    """0 where it is u_rest, which no frame brought."""


class SetpointQueue:
    """What is to be latched at `next`, `next` + 1 ..., from ARM to the end of RUN."""

    def __init__(self, config: Config, capacity: int) -> None:
        """Begin empty, at sample 0, with u_rest before it."""
        self._config, self._capacity = config, capacity
        self._rest = Setpoint(config.u_rest, 0)
        self._entries: deque[Setpoint] = deque()
        self._frames: deque[int] = deque()
        """How many of the entries each frame brought that is still among them."""
        self._dry = 0
        self.next = 0
        """Index of the next sample to be latched; does not wrap."""
        self.in_force = self._rest
        """What was latched last, as the host sent it."""

    def __len__(self) -> int:
        """Return how many samples from `next` on have their setpoint."""
        return len(self._entries)

    def violation(self, m: Setpoints) -> tuple[Cause, int]:
        """Return RANGE or SLEW with the code outside it, or NONE; every code of `m` counts."""
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
        """Take in what is new and in time; return whether `m` agrees with what is here.

        What is too late, comes behind a gap or finds no room is dropped.
        """
        offset, have = self._offset(m.k0), len(self._entries)
        if offset > have:
            return True
        codes = m.u[max(0, -offset) : m.n]
        first = max(0, offset)
        known = islice(self._entries, first, None)
        if any(entry.u != u for entry, u in zip(known, codes, strict=False)):
            return False
        new = codes[have - first : self._capacity - first]
        if new and len(self._frames) < self._capacity // LEAST_A_FRAME:
            self._entries.extend(Setpoint(u, m.seq) for u in new)
            self._frames.append(len(new))
        return True

    def advance(self) -> bool:
        """Put the setpoint of `next` in force; return whether there was one.

        Where there was none, the policy decides: u_rest, or the last code for a while.
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
        """Return how far behind `next` index `k0` lies, negative before it; modulo 2^32."""
        return (k0 - self.next + _INDICES // 2) % _INDICES - _INDICES // 2

    def _steps(self, offset: int, codes: tuple[int, ...]) -> Iterator[tuple[int, int]]:
        """Return the steps that latching `codes` would make, each from and to."""
        yield from pairwise(codes)
        if self.next + offset == 0:
            yield self._rest.u, codes[0]
        if self._entries:
            if offset == len(self._entries):
                yield self._entries[-1].u, codes[0]
        elif -len(codes) < offset <= 0:
            # After an underrun the motor has what the policy gave it, whatever the frame says.
            yield self.in_force.u, codes[-offset]
