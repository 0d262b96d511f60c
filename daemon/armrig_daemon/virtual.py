"""The loop and the emulated rig in virtual time: the same code without waiting.

Virtual time passes only while the loop waits. A run of 30 s therefore takes a fraction of 30 s, and
the same orders at the same virtual times give the same bytes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from armrig_daemon.decisions.state import Event, LinkUp, Ordered, Received, Rules
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.emulator.uno import AnyDevice
from armrig_daemon.loop.loop import Loop
from armrig_daemon.pipe import Orders, Record, take_records

Lateness = Callable[[], int]
"""Function that returns the host's lateness after a deadline, in ns."""
Line = Callable[[bytes], bytes]
"""Function that returns the bytes that a line delivers for the sent bytes."""


SwitchOn = Callable[[EmulatorSettings, int], AnyDevice]
"""Function that creates a device that is switched on at a given time, in ns."""


class VirtualPorts:
    """Ports of a loop with a virtual clock and a line to an emulated device."""

    margin_ns = 150_000
    collections = 0

    def __init__(
        self,
        settings: EmulatorSettings,
        lateness: Lateness = lambda: 0,
        switched_on_ns: int = 0,
        switch_on: SwitchOn = Device,
    ) -> None:
        """Switch the device on at `switched_on_ns`, at most 0; connect the device at time 0."""
        self.now = 0
        self.device = switch_on(settings, switched_on_ns)
        self.to_device: Line = bytes  # unchanged
        self.from_device: Line = bytes
        self._lateness = lateness
        self._line: deque[tuple[int, bytes]] = deque()
        self._inbox: deque[tuple[int, Event]] = deque([(0, LinkUp())])
        self._records = bytearray()

    def now_ns(self) -> int:
        """Return the virtual time, in ns."""
        return self.now

    def sleep_until(self, deadline_ns: int) -> int:
        """Advance to the deadline plus the host's lateness; return the time."""
        self._advance(max(self.now, deadline_ns + self._lateness()))
        return self.now

    def wait(self, until_ns: int) -> list[Event]:
        """Advance to the device's next bytes, the next order or `until_ns`; return the events."""
        while True:
            ready = self._ready()
            if ready or self.now >= until_ns:
                return ready
            order_ns = self._inbox[0][0] if self._inbox else until_ns
            limit_ns = max(self.now, min(until_ns, order_ns))
            if self._line:
                self._advance(min(limit_ns, self._line[0][0]))
            else:
                self.now, frames = self.device.advance_until(limit_ns)
                self._line.extend(frames)

    def write(self, data: bytes) -> Event | None:
        """Put bytes on the line to the device."""
        self.device.receive(self.now, self.to_device(data))
        return None

    def put(self, text: bytes) -> bool:
        """Store a record for the service; return True."""
        self._records += text
        return True

    def tidy(self) -> None:
        """Do nothing: garbage is collected as usual."""

    def send(self, at_ns: int, event: Event) -> None:
        """Schedule an event for `at_ns`; it follows all events that were scheduled before."""
        self._inbox.append((at_ns, event))

    def take_records(self) -> list[bytes | Record]:
        """Return the messages for the service since the last call."""
        return take_records(self._records)

    def _advance(self, to_ns: int) -> None:
        self.now = to_ns
        self._line.extend(self.device.advance(to_ns))

    def _ready(self) -> list[Event]:
        events: list[Event] = []
        while self._line and self._line[0][0] <= self.now:
            data = self.from_device(self._line.popleft()[1])
            if data:
                events.append(Received(data))
        while self._inbox and self._inbox[0][0] <= self.now:
            events.append(self._inbox.popleft()[1])
        return events


class VirtualRig:
    """A loop and its device, with a service that only stores the messages of the loop."""

    def __init__(
        self,
        rules: Rules,
        settings: EmulatorSettings,
        lateness: Lateness = lambda: 0,
        switched_on_ns: int = 0,
        switch_on: SwitchOn = Device,
    ) -> None:
        """Switch on the device at `switched_on_ns`, at most 0, and the loop at time 0."""
        self.ports = VirtualPorts(settings, lateness, switched_on_ns, switch_on)
        self.loop = Loop(rules, self.ports)
        self.records: list[bytes | Record] = []

    def order(self, order: Orders, at_ns: int | None = None) -> None:
        """Send an order now, or at the time `at_ns`."""
        self.ports.send(self.ports.now if at_ns is None else at_ns, Ordered(order))

    def run_until(self, until_ns: int) -> list[bytes | Record]:
        """Run the loop until a time; return its messages."""
        while self.ports.now < until_ns and not self.loop.ended:
            self.loop.turn()
        records = self.ports.take_records()
        self.records += records
        return records
