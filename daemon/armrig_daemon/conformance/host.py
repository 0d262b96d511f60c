"""The host that tests a device: it sends frames, waits for the answers, and leads to a state.

A device answers in order. All answers to a request have therefore arrived before the PONG of a
later PING. No rule is judged by the host's clock. This clock only limits the waits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from typing import Any, TypeVar

from armrig_core.process.printable import plural
from armrig_protocol import decoder, frame
from armrig_protocol import messages as wire
from armrig_protocol.frame import Spoilt, Unknown
from armrig_protocol.messages import SCHEMA_HASH, VERSION, Mode, State

from armrig_daemon.conformance.line import Line

PATIENCE_MS = 2_000
"""Longest wait for an answer, in ms of the host's clock; devices answer in less than 20 ms."""
M = TypeVar("M", bound=wire.Message)
BOOT_MS = 8_000
"""Longest time of a boot, including the boot loader, in ms."""
_HELLO_MS = 200
ALIVE_MS = 40
"""Interval between the KEEPALIVEs of a waiting host, in ms."""
CONFIG: dict[str, int] = {
    "ts_us": 10_000,
    "u_min": 0,
    "u_max": 65_535,
    "u_rest": 0,
    "slew": 0,
    "watchdog_ms": 250,
    "mode": Mode.EXCHANGE,
    "underrun": 0,
    "hold": 0,
    "oversampling": 1,
    "rail_ticks": 0,
    "turns": 0,
}


class Broken(Exception):  # noqa: N818 - the device's error
    """The device breaks a rule; the message describes the behaviour of the device."""


class EndlessError(Exception):
    """The device sends more data or takes longer than the suite's limits allow."""


class LineHost:
    """A host at one end of a line."""

    def __init__(self, line: Line, baud: int = 500_000) -> None:
        """Set the next seq to 0 and send nothing; `baud` is the speed of the line, in bit/s."""
        self.line = line
        self.baud = baud
        self.k = 0
        """Index of the last EXCHANGE."""
        self.seq = 0
        self.facts: wire.HelloReply | None = None
        """Last HELLO_R of the device."""
        self.pong: wire.Pong | None = None
        """Answer to the last PING."""
        self.status: wire.Status | None = None
        """Last STATUS of the device."""
        self.state = 0
        """State in the last frame of the device."""
        self.silence_ms = 0.0
        """Longest time between two frames of the host."""
        self.spoilt = 0
        """Number of pieces from the device that are not frames."""
        self.breaks = 0
        """Number of frames from the device whose seq is not the last seq plus one."""
        self.nonce = self.config_crc = 0
        """Values of the last CONFIG_R."""
        self._device_seq: int | None = None
        self._sent_ns = line.now_ns()
        self._pending = b""
        self._fresh = True
        self._heard: list[wire.Message] = []
        self._pings = 0
        self._received = 0  # B
        self._limits = inf, inf

    def limit(self, ms: float = inf, received: float = inf) -> None:
        """Set limits: a read then raises `EndlessError` after `ms` or after `received` bytes.

        Each wait has its own limit, but a device can cause an unlimited number of waits.
        """
        self._limits = self.line.now_ns() + ms * 1e6, self._received + received

    def write(self, data: bytes) -> None:
        """Put bytes on the line."""
        self.note_silence()
        self._sent_ns = self.line.now_ns()
        self.line.send(data)

    def note_silence(self) -> None:
        """Note the time since the last frame of the host."""
        silence_ms = (self.line.now_ns() - self._sent_ns) / 1e6
        self.silence_ms = max(self.silence_ms, silence_ms)

    def put(self, kind: type[wire.Message], *, seq: int | None = None, **fields: Any) -> int:
        """Send a frame; return its seq, which is by default the last seq plus one.

        ARM and START contain the values of the last CONFIG_R, unless `fields` contains other
        values.
        """
        if kind is wire.Arm:
            defaults = {"boot_id": self.known.boot_id, "config_crc": self.config_crc}
            fields = {**defaults, "nonce": self.nonce, **fields}
        if kind is wire.Start:
            fields = {"k_stop": 0, "nonce": self.nonce, **fields}
        self.seq = (self.seq + 1) & 0xFFFF if seq is None else seq
        message: Any = kind  # each type has its own fields
        self.write(frame.encode(message(0, self.seq, **fields)))
        return self.seq

    def put_together(self, messages: Sequence[wire.Message]) -> None:
        """Send several frames, with consecutive seq, as one piece."""
        data = b""
        for message in messages:
            self.seq = (self.seq + 1) & 0xFFFF
            data += frame.encode(message._replace(seq=self.seq))
        self.write(data)

    def listen(self, ms: float) -> list[wire.Message]:
        """Return the messages that arrive within `ms`, except STATUS."""
        end_ns = self.line.now_ns() + round(ms * 1e6)
        while (left_ms := (end_ns - self.line.now_ns()) / 1e6) > 0:
            self._read(left_ms)
        return self._taken()

    def until(
        self, matches: Callable[[wire.Message], bool], expected: str, within_ms: float = PATIENCE_MS
    ) -> list[wire.Message]:
        """Return the messages, except STATUS, up to the first message for which `matches` is true.

        Raises Broken if `matches` is false for every message that arrives in time.
        """
        end_ns = self.line.now_ns() + round(within_ms * 1e6)
        looked = 0
        while True:
            for at in range(looked, len(self._heard)):
                if matches(self._heard[at]):
                    messages, self._heard = self._heard[: at + 1], self._heard[at + 1 :]
                    return messages
            looked = len(self._heard)
            left_ms = (end_ns - self.line.now_ns()) / 1e6
            if left_ms <= 0:
                names = ", ".join(type(m).__name__ for m in self._taken()[-5:])
                raise Broken(f"no {expected}; received: {names or 'nothing'}")
            self._read(left_ms)

    def fence(self) -> list[wire.Message]:
        """Send a PING and return the messages before its PONG."""
        self._pings += 1
        self.put(wire.Ping, host_ns=self._pings)
        messages = self.until(
            lambda m: isinstance(m, wire.Pong) and m.host_ns == self._pings, "PONG of a PING"
        )
        return messages[:-1]

    def ask(
        self, kind: type[wire.Message], *, seq: int | None = None, **fields: Any
    ) -> list[wire.Message]:
        """Send a frame that requests no conversion, and return its answers."""
        self.put(kind, seq=seq, **fields)
        return self.fence()

    def _taken(self) -> list[wire.Message]:
        messages, self._heard = self._heard, []
        return messages

    def _read(self, within_ms: float) -> None:
        end_ns, most = self._limits
        if self.line.now_ns() > end_ns:
            raise EndlessError("the device took longer than the whole suite may take")
        if self._received > most:
            raise EndlessError(
                "the device sent more than the whole suite allows: it floods the line"
            )
        data = self.line.receive(within_ms)
        self._received += len(data)
        self._pending, received = decoder.feed(self._pending, data)
        for item in received:
            if isinstance(item, Spoilt | Unknown):
                self.spoilt += not self._fresh
                continue
            self._fresh = False
            expected = self._device_seq is None or item.seq == (self._device_seq + 1) & 0xFFFF
            booted = isinstance(item, wire.Event) and item.was == State.BOOT
            self.breaks += not (expected or booted)
            self._device_seq, self.state = item.seq, item.state
            if isinstance(item, wire.Status):
                self.status = item
                continue
            if isinstance(item, wire.Pong):
                self.pong = item
            if isinstance(item, wire.ConfigReply):
                self.nonce, self.config_crc = item.nonce, item.config_crc
            if isinstance(item, wire.HelloReply):
                self.facts = item
            self._heard.append(item)

    def reopen(self, after_ms: float = 0) -> None:
        """Close and reopen the port; frames lost on the line are not counted as errors."""
        self.line.reopen(after_ms)
        self._pending, self._device_seq, self._fresh = b"", None, True
        self._heard.clear()

    @property
    def known(self) -> wire.HelloReply:
        """Last HELLO_R of the device."""
        if self.facts is None:
            raise Broken("no HELLO_R yet")
        return self.facts

    @property
    def rx_us(self) -> int:
        """Time at which the last PING arrived, by the device's clock."""
        if self.pong is None:
            raise Broken("no PONG yet")
        return self.pong.rx_us

    def hello(self, within_ms: float = PATIENCE_MS) -> wire.HelloReply:
        """Return the answer to HELLO; repeat HELLO, because a booting device receives nothing."""
        end_ns = self.line.now_ns() + round(within_ms * 1e6)
        while True:
            self.put(wire.Hello, version=VERSION, schema=SCHEMA_HASH)
            try:
                self.until(lambda m: isinstance(m, wire.HelloReply), "HELLO_R", _HELLO_MS)
            except Broken:
                if self.line.now_ns() > end_ns:
                    raise
            else:
                return self.known

    def configure(self, **fields: int) -> wire.ConfigReply:
        """Return the answer to CONFIG."""
        self.put(wire.Config, **{**CONFIG, **fields})
        return only(wire.ConfigReply, self.fence())

    def exchange(self, u: int, *, k: int | None = None) -> wire.Message:
        """Return the answer to an EXCHANGE, normally SAMPLE; k is the next index by default."""
        self.k = self.k + 1 if k is None else k
        seq = self.put(wire.Exchange, k=self.k & 0xFFFF_FFFF, u=u)

        def answers(m: wire.Message) -> bool:
            mine = isinstance(m, wire.Ack) and m.of_seq == seq
            return (
                mine or isinstance(m, wire.Event) or (isinstance(m, wire.Sample) and m.k == self.k)
            )

        return self.until(answers, "answer to EXCHANGE")[-1]

    def sample(self, u: int = 0, *, k: int | None = None) -> wire.Sample:
        """Return the SAMPLE of an EXCHANGE."""
        answer = self.exchange(u, k=k)
        if not isinstance(answer, wire.Sample):
            raise Broken(f"{type(answer).__name__} as answer to EXCHANGE")
        return answer

    def to_idle(self) -> None:
        """Go to IDLE from any state."""
        self.put(wire.Stop)  # takes effect with any seq, and ends RUN
        self.hello()
        self.k = 0
        self.fence()
        if self.state in (State.FAULT, State.ESTOP):
            self.ask(wire.ClearFault, token=self.known.token)
        if self.state != State.IDLE:
            raise Broken(f"state {self.state} after STOP and CLEAR_FAULT, not IDLE")

    def reach(self, state: State, **config: int) -> None:
        """Go from IDLE to `state` by the shortest way; `config` overrides values of `CONFIG`."""
        if state is State.ESTOP:
            self.ask(wire.Estop)
        elif state is State.FAULT:
            self.reach(State.RUN, u_max=1_000)
            self.exchange(1_001)
        elif state is not State.IDLE:
            self.configure(**config)
            if state is not State.READY:
                self.ask(wire.Arm)
            if state is State.RUN:
                self.ask(wire.Start)
        self.fence()
        if self.state != state:
            raise Broken(f"state {self.state} on the way to {state.name}")

    def enter(self, state: State, **config: int) -> None:
        """Go to `state` from any state; `config` overrides values of `CONFIG`."""
        self.to_idle()
        self.reach(state, **config)

    def alive(
        self, ms: float, until: Callable[[wire.Message], bool] | None = None
    ) -> list[wire.Message]:
        """Send KEEPALIVEs for `ms`, or until a message matches; return the messages."""
        end_ns = self.line.now_ns() + round(ms * 1e6)
        messages: list[wire.Message] = []
        while self.line.now_ns() < end_ns:
            self.put(wire.Keepalive)
            messages += self.listen(ALIVE_MS)
            if until is not None and any(map(until, messages)):
                break
        return messages


def only(kind: type[M], messages: list[wire.Message]) -> M:
    """Return the only message of this kind.

    Raises Broken if there is no message of this kind, or more than one message.
    """
    matches = [m for m in messages if isinstance(m, kind)]
    if len(matches) != 1:
        raise Broken(
            f"{len(matches)} {kind.__name__} among {plural(len(messages), 'frame')} instead of one"
        )
    return matches[0]
