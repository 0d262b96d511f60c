"""Comparison of a simulated board's pins with the reports of its firmware.

The harness measures the pins. The frames report the state, and SAMPLE reports the applied code.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from armrig_protocol import decoder
from armrig_protocol.decoder import Received
from armrig_protocol.frame import Spoilt, Unknown
from armrig_protocol.messages import CODE_FULL_SCALE, TYPES, Ack, Sample, Start, State

from armrig_daemon.emulator.harness import CYCLES_PER_US, Duty, Violated, Violation

_START = TYPES[Start]
_U32 = (1 << 32) - 1
_TOLERANCE_US = 3
_MAX_HOLDS = 64
"""Largest number of stored readings of channel 0 that no SAMPLE has reported yet."""


class Pins:
    """Record of the pins since power-on."""

    def __init__(self, note: Callable[[Violated], None], period: int) -> None:
        """Begin in BOOT; `note` is called for each violation. `period` is the PWM's, in cycles."""
        self._note = note
        self._period = period
        self.duties: list[Duty] = []
        """Measured changes of the duty."""
        self._received = b""
        self.reset(0)

    def reset(self, cycle: int) -> None:
        """Note a reset of the processor; from now on the device is in BOOT, at 0 V."""
        self._low_from: int | None = cycle
        """Cycle from which the pin must be low; None while the device may be in RUN."""
        self._start: int | None = None
        """Sequence number of the START that is not answered yet; None if there is none."""
        self._is_noted = False
        self._holds: deque[int] = deque(maxlen=_MAX_HOLDS)
        self._offsets_us: set[int] = set()
        """Possible values of the board's time minus the device time in `t_us`, in µs."""

    def send(self, cycle: int, data: bytes) -> None:
        """Note the host's bytes; after a START the device may drive the pin."""
        self._received, messages = decoder.feed(self._received, data)
        for message in messages:
            if isinstance(message, Start):
                self.look(cycle)
                self._low_from, self._start = None, message.seq

    def hold(self, cycle: int) -> None:
        """Note the cycle at which the converter held channel 0; u is latched just after it."""
        self._holds.append(cycle)

    def measure(self, duty: Duty) -> None:
        """Note a change at the pin."""
        self.look(duty.cycle)
        self.duties.append(duty)
        if not _drives(duty):
            self._is_noted = False
        elif self._low_from is not None and duty.cycle >= self._low_from:
            self._outside_run(duty.cycle)

    def look(self, cycle: int) -> None:
        """Check the pin up to `cycle`; the last measured duty is assumed to continue."""
        if self._low_from is None or not self.duties or not _drives(self.duties[-1]):
            return
        if cycle - self._low_from > 2 * self._period:  # a duty is known at the end of its period
            self._outside_run(cycle)

    def tell(self, begun: int, message: Received) -> None:
        """Note a frame of the device; `begun` is the cycle at which the first byte began."""
        if isinstance(message, Spoilt | Unknown):
            return
        if isinstance(message, Ack) and (message.of_type, message.of_seq) == (_START, self._start):
            self._start = None
        if message.state == State.RUN:
            self._low_from = None
            if isinstance(message, Sample):
                self._check_latch(begun, message)
        elif self._low_from is None and self._start is None:
            self._low_from = begun

    def _outside_run(self, cycle: int) -> None:
        if not self._is_noted:
            self._note(Violated(cycle, Violation.DRIVEN_OUTSIDE_RUN))
        self._is_noted = True

    def _check_latch(self, begun: int, m: Sample) -> None:
        """Compare the pin's duty before the latch of a sample with the reported code."""
        hold = self._hold_of(begun, m)
        high = self._high_at(hold - self._period) if hold is not None else None
        wanted = (m.u_km1 * self._period + CODE_FULL_SCALE // 2) // CODE_FULL_SCALE
        if hold is not None and high not in (None, wanted):
            self._note(Violated(hold, Violation.CODE_NOT_AT_PIN))

    def _hold_of(self, begun: int, m: Sample) -> int | None:
        """Return the cycle of the hold of channel 0 for a sample; None until the clock is known."""
        # channel 0 may already be held for the next sample when a SAMPLE leaves. Each stored cycle
        # before the SAMPLE is possible, until later samples leave only one possibility.
        held = {hold // CYCLES_PER_US - m.t_us & _U32: hold for hold in self._holds if hold < begun}
        if self._offsets_us:
            near = {
                offset: hold
                for offset in self._offsets_us
                for us, hold in held.items()
                if (us - offset + _TOLERANCE_US) & _U32 <= 2 * _TOLERANCE_US
            }
        else:
            near = held
        self._offsets_us = set(near)
        return next(iter(near.values())) if len(near) == 1 else None

    def _high_at(self, cycle: int) -> int | None:
        return next((d.high for d in reversed(self.duties) if d.cycle <= cycle), None)


def _drives(duty: Duty) -> bool:
    return bool(duty.high) or duty.enabled
