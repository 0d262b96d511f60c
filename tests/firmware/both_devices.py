"""The emulated device twice: with the Python firmware and with the C core; they must not differ."""

from __future__ import annotations

from typing import Any

from armrig_daemon.emulator.board import Change
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol import decoder, frame
from armrig_protocol.messages import (
    ConfigReply,
    Event,
    Exchange,
    HelloReply,
    Message,
    Sample,
    State,
)

from tests.firmware.core_device import CoreDevice

US, MS, S = 1_000, 1_000_000, 1_000_000_000


class BothDevices:
    """Two devices that get the same bytes at the same times, and a host that knows both."""

    def __init__(self, settings: EmulatorSettings) -> None:
        """Switch both on."""
        self.now_ns = 0
        self.seq = 0
        self.k = 0
        self.boot_id = self.config_crc = self.nonce = self.token = 0
        self.held = 0
        """Index after the last setpoint sent."""
        self.sent: list[bytes] = []
        self.heard: list[Message] = []
        self.changes: tuple[list[Change], list[Change]] = ([], [])
        self.devices = (
            Device(settings, 0, self.changes[0].append),
            CoreDevice(settings, 0, self.changes[1].append),
        )
        self._pending = b""

    def wait(self, dt_ns: int) -> None:
        """Let time pass; both must send the same, and drive the motor alike."""
        self.now_ns += dt_ns
        python, core = (device.advance(self.now_ns) for device in self.devices)
        assert python == core, _difference(python, core)
        assert self.changes[0] == self.changes[1]
        for wire in (data for _, data in core):
            self._pending, received = decoder.feed(self._pending, wire)
            for item in received:
                self._hear(item)

    def write(self, data: bytes) -> None:
        """Put bytes on both wires."""
        if data:
            self.sent.append(data)
        for device in self.devices:
            device.receive(self.now_ns, data)

    def put(self, kind: type[Message], *, seq: int | None = None, **fields: Any) -> None:
        """Send a frame."""
        if seq is None:
            self.seq = seq = (self.seq + 1) & 0xFFFF
        self.write(frame.encode(kind(0, seq, **fields)))

    def reset(self) -> None:
        """Reset both processors."""
        for device in self.devices:
            device.reset(self.now_ns)
        self._pending = b""

    def _hear(self, item: Any) -> None:
        self.heard.append(item)
        if isinstance(item, HelloReply):
            self.boot_id, self.token = item.boot_id, item.token
        elif isinstance(item, ConfigReply):
            self.nonce, self.config_crc = item.nonce, item.config_crc
        elif isinstance(item, Event):
            self.token = item.token
            if item.state != State.RUN:
                self.held = 0
        elif isinstance(item, Sample | Exchange):
            self.k = item.k


def _difference(python: list[tuple[int, bytes]], core: list[tuple[int, bytes]]) -> str:
    for a, b in zip(python, core, strict=False):
        if a != b:
            told = [(t, frame.decode(wire[:-1]) if wire[:-1] else wire) for t, wire in (a, b)]
            return f"Python {told[0]}\nC      {told[1]}"
    return f"Python sent {len(python)} frames, C {len(core)}"
