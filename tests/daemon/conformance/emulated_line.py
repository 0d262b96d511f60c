"""The emulated device as the suite's line, in virtual time."""

from __future__ import annotations

from collections import deque

from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.settings import EmulatorSettings

_MS = 1_000_000


class EmulatedLine:
    """A device of the emulator at the end of a line that takes no time of its own."""

    def __init__(self, settings: EmulatorSettings, *, resets: bool = True) -> None:
        """Switch it on; `resets` has the opening of the port reset it, as an Uno's."""
        self._now_ns = 0
        self._resets = resets
        self.device = Device(settings, 0)
        self._due: deque[tuple[int, bytes]] = deque()

    def send(self, data: bytes) -> None:
        """Put bytes on the wire."""
        self.device.receive(self._now_ns, data)

    def receive(self, within_ms: float) -> bytes:
        """Let time pass until a frame has come, or for `within_ms`."""
        end_ns = self._now_ns + round(within_ms * _MS)
        while not self._due:
            next_ns = self.device.next_ns()
            self._due.extend(self.device.advance(min(next_ns, end_ns)))
            if next_ns > end_ns:
                break
        if not self._due or self._due[0][0] > end_ns:
            self._now_ns = end_ns
            return b""
        t_ns, data = self._due.popleft()
        self._now_ns = max(self._now_ns, t_ns)
        return data

    def reopen(self, after_ms: float) -> None:
        """Let time pass; what was on its way is lost."""
        self._now_ns += round(after_ms * _MS)
        self.device.advance(self._now_ns)
        self._due.clear()
        if self._resets:
            self.device.reset(self._now_ns)

    def now_ns(self) -> int:
        """Return the time that has passed."""
        return self._now_ns
