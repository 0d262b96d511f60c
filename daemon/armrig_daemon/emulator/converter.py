"""The converter: consecutive conversions for a sample or for a CAL.

All times are computed from the first trigger, in device time; `due_ns` and `end_ns` are in the time
of the caller.
"""

from __future__ import annotations

from armrig_protocol.messages import Message

from armrig_daemon.emulator.clock import microseconds
from armrig_daemon.emulator.firmware import NEVER, Firmware
from armrig_daemon.emulator.requests import cal_answer
from armrig_daemon.emulator.sampling import latch, sample
from armrig_daemon.emulator.sensors import mean


class Converter:
    """Converter that takes the samples in `fw.pending` and the readings of `fw.cal`."""

    def __init__(self, fw: Firmware) -> None:
        """Begin idle."""
        self._fw = fw
        self._conversion_ns = fw.hardware.conversion_ns
        self._hold_ns = fw.hardware.hold_ns
        self._codes: tuple[list[int], list[int]] = ([], [])
        """Readings of theta_1 and of alpha since the first trigger."""
        self._trigger_ns = 0
        self._held = self._conversions = 0
        self.due_ns = NEVER
        """Time of the next step."""
        self.end_ns = NEVER
        """Time at which the present sample or CAL ends."""

    def wake(self) -> None:
        """Begin the first waiting sample or CAL, unless a sample or a CAL is in progress."""
        fw = self._fw
        if self._conversions:
            return
        if fw.pending:
            self._trigger(fw.pending[0].due_ns, fw.conversions)
        elif fw.cal is not None:
            self._trigger(fw.cal.due_ns, fw.cal.n)

    def step(self, t_ns: int) -> list[Message]:
        """Hold the next input. After the last hold, latch u; after the last conversion, answer."""
        fw, codes = self._fw, self._codes
        if self._held == self._conversions:
            return self._end(t_ns)
        alpha_is_next = not self._held & 1  # alpha first, then in turn
        channel = fw.cal.channel if fw.cal is not None else int(alpha_is_next)
        codes[channel].append(fw.board.alpha(t_ns) if channel else fw.board.theta_1(t_ns))
        self._held += 1
        if self._held < self._conversions:
            after_ns = self._held * self._conversion_ns + self._hold_ns
            self.due_ns = fw.clock.instant(self._trigger_ns + after_ns)
        else:
            if fw.cal is None:
                # theta_1 is held just before the latch, so its reading does not depend on this u.
                latch(fw, t_ns)
            self.due_ns = self.end_ns
        return []

    def _end(self, t_ns: int) -> list[Message]:
        fw, conversion_ns = self._fw, self._conversion_ns
        theta_1, alpha = self._codes
        end_ns = self._trigger_ns + self._conversions * conversion_ns
        self._conversions, self.due_ns, self.end_ns = 0, NEVER, NEVER
        if fw.cal is not None:
            return [cal_answer(fw, alpha or theta_1)]
        t_us = microseconds(end_ns - conversion_ns)
        late = self._trigger_ns > fw.pending[0].due_ns
        messages = sample(fw, t_ns, t_us, mean(theta_1), mean(alpha), late=late)
        if fw.pending:
            self._trigger(max(end_ns, fw.pending[0].due_ns), fw.conversions)
        return messages

    def _trigger(self, device_ns: int, conversions: int) -> None:
        """Start the first conversion and compute the times of the others."""
        clock = self._fw.clock
        self._codes = ([], [])
        self._trigger_ns, self._held, self._conversions = device_ns, 0, conversions
        self.end_ns = clock.instant(device_ns + conversions * self._conversion_ns)
        self.due_ns = clock.instant(device_ns + self._hold_ns)
