"""The loop and the emulated rig in virtual time: the same code, with nobody waiting.

Time passes only where the loop waits. So a run of 30 s takes a fraction of it, and the same
orders at the same times give the same bytes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Protocol

from armrig_daemon.decisions.state import Event, LinkUp, Ordered, Received, Rules
from armrig_daemon.emulator.board import Board
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.loop.loop import Loop
from armrig_daemon.pipe import Orders, Record, take_records

Lateness = Callable[[], int]
"""How much later than the deadline the host wakes, in ns."""
Line = Callable[[bytes], bytes]
"""What a line makes of the bytes that go in."""


class VirtualDevice(Protocol):
    """A device to which time is given: the emulated one, or the firmware's binary."""

    @property
    def board(self) -> Board:
        """The pins and the arm."""

    def receive(self, now_ns: int, data: bytes) -> None:
        """Put bytes on the wire to it."""

    def advance(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Let time pass; return frames, each with its last byte's departure."""

    def advance_until(self, limit_ns: int) -> tuple[int, list[tuple[int, bytes]]]:
        """Let time pass up to a limit, or less where something happens; return the time, too."""


SwitchOn = Callable[[EmulatorSettings, int], VirtualDevice]
"""Makes a device that is switched on at a time, in ns."""


def sound(data: bytes) -> bytes:
    """Give what went in."""
    return data


class VirtualPorts:
    """The ports of a loop whose clock is a number and whose line ends in an emulated device."""

    margin_ns = 150_000
    collections = 0

    def __init__(
        self,
        settings: EmulatorSettings,
        lateness: Lateness = lambda: 0,
        switched_on_ns: int = 0,
        switch_on: SwitchOn = Device,
    ) -> None:
        """Switch the device on, at time 0 or before it, and plug it in at time 0."""
        self.now = 0
        self.device = switch_on(settings, switched_on_ns)
        self.to_device: Line = sound
        self.from_device: Line = sound
        self._lateness = lateness
        self._line: deque[tuple[int, bytes]] = deque()
        self._inbox: deque[tuple[int, Event]] = deque([(0, LinkUp())])
        self._records = bytearray()

    def now_ns(self) -> int:
        """Return the virtual time."""
        return self.now

    def sleep_until(self, deadline_ns: int) -> int:
        """Let time pass to the deadline, or later by the host's lateness."""
        self._advance(max(self.now, deadline_ns + self._lateness()))
        return self.now

    def wait(self, until_ns: int) -> list[Event]:
        """Let time pass until the device has said something, an order is due, or `until_ns`."""
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
        """Put bytes on the line."""
        self.device.receive(self.now, self.to_device(data))
        return None

    def put(self, text: bytes) -> bool:
        """Keep what the service would get."""
        self._records += text
        return True

    def tidy(self) -> None:
        """Do nothing: the memory of a test is the test's."""

    def send(self, at_ns: int, event: Event) -> None:
        """Let an event happen at a time, not before those sent earlier."""
        self._inbox.append((at_ns, event))

    def take_records(self) -> list[bytes | Record]:
        """Return what the service would have got since the last call."""
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
    """A loop, its device, and a service that only keeps what it is told."""

    def __init__(
        self,
        rules: Rules,
        settings: EmulatorSettings,
        lateness: Lateness = lambda: 0,
        switched_on_ns: int = 0,
        switch_on: SwitchOn = Device,
    ) -> None:
        """Switch everything on at time 0, or the device before it."""
        self.ports = VirtualPorts(settings, lateness, switched_on_ns, switch_on)
        self.loop = Loop(rules, self.ports)
        self.records: list[bytes | Record] = []

    def order(self, order: Orders, at_ns: int | None = None) -> None:
        """Give an order, now or at a time."""
        self.ports.send(self.ports.now if at_ns is None else at_ns, Ordered(order))

    def run_until(self, until_ns: int) -> list[bytes | Record]:
        """Let the loop run until a time; return what it said meanwhile."""
        while self.ports.now < until_ns and not self.loop.ended:
            self.loop.turn()
        records = self.ports.take_records()
        self.records += records
        return records
