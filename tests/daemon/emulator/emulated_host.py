"""A host in virtual time for the tests of the emulated device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from armrig_daemon.emulator.board import Change
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol import decoder, frame
from armrig_protocol import messages as wire
from armrig_protocol.frame import Spoilt, Unknown
from armrig_protocol.messages import SCHEMA_HASH, VERSION, Mode, State

US, MS, S = 1_000, 1_000_000, 1_000_000_000
BAUD = 1_000_000
EXCHANGE_NS, SAMPLE_NS = 160 * US, 360 * US  # 16 and 36 bytes at 1 Mbaud
CONVERSION_NS, HOLD_NS = 104 * US, 12 * US
QUIET = EmulatorSettings(baud=BAUD, boot_ms=5.0, adc_noise_v=0.0, pwm_bits=0, adc_bits=0)
CONFIG: dict[str, int] = {
    "ts_us": 1000,
    "u_min": 0,
    "u_max": 65535,
    "u_rest": 0,
    "slew": 0,
    "watchdog_ms": 100,
    "mode": Mode.EXCHANGE,
    "underrun": 0,
    "hold": 0,
    "oversampling": 1,
    "rail_ticks": 0,
    "turns": 0,
}
STATES = [s for s in State if s not in (State.HOST, State.BOOT)]
M = TypeVar("M", bound=wire.Message)


@dataclass
class Heard:
    """A message, and when its last byte had come."""

    t_ns: int
    message: wire.Message


class Host:
    """A host with a clock that it advances by hand; it counts seq as it should."""

    def __init__(
        self, settings: EmulatorSettings = QUIET, kind: type[Device] | None = None
    ) -> None:
        """Switch the device on and wait until it has booted."""
        self.now_ns = 0
        self.seq = 0
        self.nonce = 0
        self.changes: list[Change] = []
        self.heard: list[Heard] = []
        self.sent: list[tuple[int, bytes]] = []
        self.pending = b""
        self.device = (kind or Device)(settings, 0, self.changes.append)
        self.wait(round(settings.boot_ms * MS) + 1 * MS)

    def wait(self, dt_ns: int) -> list[wire.Message]:
        """Let time pass and return what came meanwhile."""
        self.now_ns += dt_ns
        came: list[wire.Message] = []
        for t_ns, data in self.device.advance(self.now_ns):
            self.pending, received = decoder.feed(self.pending, data)
            for item in received:
                assert not isinstance(item, (Spoilt, Unknown))
                came.append(item)
                if isinstance(item, wire.ConfigReply):
                    self.nonce = item.nonce
                self.heard.append(Heard(t_ns, item))
        return came

    def put(self, kind: type[wire.Message], *, seq: int | None = None, **fields: Any) -> int:
        """Send without waiting; return the time at which the frame will have arrived.

        ARM and START carry the nonce that was last heard, unless another is given.
        """
        if seq is None:
            self.seq = seq = (self.seq + 1) & 0xFFFF
        if kind in (wire.Arm, wire.Start):
            fields.setdefault("nonce", self.nonce)
        data = frame.encode(kind(0, seq, **fields))
        self.sent.append((self.now_ns, data))
        self.device.receive(self.now_ns, data)
        return self.now_ns + self.device.rx_backlog_ns(self.now_ns)

    def ask(
        self, kind: type[wire.Message], *, seq: int | None = None, **fields: Any
    ) -> list[wire.Message]:
        """Send, and return all messages within 3 ms."""
        self.put(kind, seq=seq, **fields)
        return self.wait(3 * MS)

    def hello(self) -> wire.HelloReply:
        """Return the answer to HELLO."""
        return only(wire.HelloReply, self.ask(wire.Hello, version=VERSION, schema=SCHEMA_HASH))

    def configure(self, **fields: int) -> wire.ConfigReply:
        """Return the answer to CONFIG."""
        return only(wire.ConfigReply, self.ask(wire.Config, **{**CONFIG, **fields}))

    def supply(self, k0: int, u: Sequence[int], **more: Any) -> int:
        """Put SETPOINTS on the wire; return when they will have arrived."""
        fields = {"n": len(u), "zero": 0, **more}
        return self.put(wire.Setpoints, k0=k0, u=(*u, *(0,) * (24 - len(u))), **fields)

    def reach(self, state: State, **config: int) -> Host:
        """Go to `state` by the shortest way."""
        boot_id = self.hello().boot_id
        if state in (State.READY, State.ARMED, State.RUN):
            config_crc = self.configure(**config).config_crc
        if state in (State.ARMED, State.RUN):
            self.ask(wire.Arm, boot_id=boot_id, config_crc=config_crc)
        if state is State.RUN:
            self.ask(wire.Start, k_stop=0)
        if state is State.FAULT:
            self.reach(State.RUN, u_max=100)
            self.ask(wire.Exchange, k=1, u=101)
        if state is State.ESTOP:
            self.ask(wire.Estop)
        assert self.device.state is state
        return self


def only(kind: type[M], messages: list[wire.Message]) -> M:
    (found,) = [m for m in messages if isinstance(m, kind)]
    return found


def codes(messages: list[wire.Message]) -> list[int]:
    return [m.code for m in messages if isinstance(m, wire.Ack)]


def events(messages: list[wire.Message]) -> list[tuple[int, int, int]]:
    return [(m.was, m.state, m.cause) for m in messages if isinstance(m, wire.Event)]


def bytes_of(
    emulated: EmulatorSettings, script: Sequence[tuple[int, bytes | wire.Message]]
) -> list[tuple[int, bytes]]:
    """Return a script's bytes with their times; frames get the seq, k and nonces they need."""
    boot_id, config_crc = Host(emulated).hello().boot_id, 0
    host, sent = Host(emulated), []  # hears what the device will answer to the same bytes
    for seq, (dt_ns, item) in enumerate(script, 1):
        for heard in host.wait(dt_ns):
            if isinstance(heard, wire.ConfigReply):
                config_crc = heard.config_crc
        data = item
        if not isinstance(data, bytes):
            message = item._replace(seq=seq)
            if isinstance(message, wire.Exchange):
                message = message._replace(k=seq)
            if isinstance(message, wire.Arm):
                message = message._replace(boot_id=boot_id, config_crc=config_crc)
            if isinstance(message, wire.Arm | wire.Start):
                message = message._replace(nonce=host.nonce)
            data = frame.encode(message)
        host.device.receive(host.now_ns, data)
        sent.append((host.now_ns, data))
    return sent
