"""The converter: one channel after the other, for one sample after the other.

A sample's times follow from its trigger, in device time; `due_ns` and `end_ns` are given time.
"""

from __future__ import annotations

from armrig_protocol.messages import Message

from armrig_daemon.emulator.clock import microseconds
from armrig_daemon.emulator.firmware import NEVER, Firmware
from armrig_daemon.emulator.sampling import latch, sample


class Converter:
    """Takes the samples that wait in `fw.pending`."""

    def __init__(self, fw: Firmware) -> None:
        """Begin idle."""
        self._fw = fw
        self._conversion_ns = fw.hardware.conversion_ns
        self._hold_ns = fw.hardware.hold_ns
        self._y1 = self._y0 = 0
        self._trigger_ns = 0
        self._act = 0
        self.due_ns = NEVER
        """When the next act is due."""
        self.end_ns = NEVER
        """When the sample under way will have ended."""

    def wake(self) -> None:
        """Begin with the first pending sample, unless one is being converted."""
        if self._fw.pending and not self._act:
            self._trigger(self._fw.pending[0].due_ns)

    def step(self, t_ns: int) -> list[Message]:
        """Do the next of a sample's three acts: hold alpha; hold theta_1 and latch; answer."""
        fw = self._fw
        if self._act == 1:
            self._y1 = fw.board.alpha(t_ns)
            after_ns = self._conversion_ns + self._hold_ns
            self._act, self.due_ns = 2, fw.clock.instant(self._trigger_ns + after_ns)
            return []
        if self._act == 2:
            # theta_1 is held just before the latch, so that it cannot know of this u.
            self._y0 = fw.board.theta_1(t_ns)
            latch(fw, t_ns)
            self._act, self.due_ns = 3, self.end_ns
            return []
        t_us = microseconds(self._trigger_ns + self._conversion_ns)
        late = self._trigger_ns > fw.pending[0].due_ns
        messages = sample(fw, t_ns, t_us, self._y0, self._y1, late=late)
        end_ns = self._trigger_ns + 2 * self._conversion_ns
        self._act, self.due_ns, self.end_ns = 0, NEVER, NEVER
        if fw.pending:
            self._trigger(max(end_ns, fw.pending[0].due_ns))
        return messages

    def _trigger(self, device_ns: int) -> None:
        """Start alpha's conversion, and plan all that follows from it."""
        clock = self._fw.clock
        self._trigger_ns = device_ns
        self.end_ns = clock.instant(device_ns + 2 * self._conversion_ns)
        self._act, self.due_ns = 1, clock.instant(device_ns + self._hold_ns)
