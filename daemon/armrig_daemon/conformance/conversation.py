"""Frames to a device and from it, one after the other, and the waiting for an answer.

A device answers in order. So all that a request brings has come when the PONG of a PING behind it
has: nothing here is judged by the host's clock, which only says when to give up.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from typing import Any, TypeVar

from armrig_protocol import decoder, frame
from armrig_protocol.frame import Spoilt, Unknown
from armrig_protocol.messages import (
    ConfigReply,
    Event,
    HelloReply,
    Message,
    Ping,
    Pong,
    State,
    Status,
)

from armrig_daemon.conformance.line import Line

PATIENCE_MS = 2_000
"""What an answer may take by the host's clock; no device takes a hundredth of it."""
M = TypeVar("M", bound=Message)


class Broken(Exception):  # noqa: N818 - it is the device's error
    """The device does otherwise; says what came."""


class EndlessError(Exception):
    """The device sends more, or takes longer, than the whole suite needs; says which."""


class Conversation:
    """What was sent, and what was heard."""

    def __init__(self, line: Line) -> None:
        """Begin with seq 0; nothing is sent."""
        self.line = line
        self.seq = 0
        self.facts: HelloReply | None = None
        """What the device said of itself last."""
        self.pong: Pong | None = None
        """Answer to the last PING."""
        self.status: Status | None = None
        """The last one."""
        self.state = 0
        """As the last frame of the device says."""
        self.silence_ms = 0.0
        """Longest time between two frames of ours."""
        self.spoilt = 0
        """Pieces of the device that were no frame."""
        self.breaks = 0
        """Frames of the device whose seq was not the last one's plus one."""
        self.nonce = self.config_crc = 0
        """Of the last CONFIG_R."""
        self._device_seq: int | None = None
        self._sent_ns = line.now_ns()
        self._pending = b""
        self._fresh = True
        self._heard: list[Message] = []
        self._pings = 0
        self._received = 0  # B
        self._limits = inf, inf

    def limit(self, ms: float = inf, received: float = inf) -> None:
        """End reading by `EndlessError` after `ms` of the line's clock or so many bytes from now.

        Every wait is bounded by itself, but not how many waits a device can cause.
        """
        self._limits = self.line.now_ns() + ms * 1e6, self._received + received

    def write(self, data: bytes) -> None:
        """Put bytes on the line."""
        self.note_silence()
        self._sent_ns = self.line.now_ns()
        self.line.send(data)

    def note_silence(self) -> None:
        """Take note of how long nothing was sent until now."""
        silence_ms = (self.line.now_ns() - self._sent_ns) / 1e6
        self.silence_ms = max(self.silence_ms, silence_ms)

    def put(self, kind: type[Message], *, seq: int | None = None, **fields: Any) -> int:
        """Send a frame and return its seq; the next one goes on from there."""
        self.seq = (self.seq + 1) & 0xFFFF if seq is None else seq
        message: Any = kind  # each has fields of its own
        self.write(frame.encode(message(0, self.seq, **fields)))
        return self.seq

    def put_together(self, messages: Sequence[Message]) -> None:
        """Send several frames as one piece; each gets its seq here."""
        data = b""
        for message in messages:
            self.seq = (self.seq + 1) & 0xFFFF
            data += frame.encode(message._replace(seq=self.seq))
        self.write(data)

    def listen(self, ms: float) -> list[Message]:
        """Return what comes within `ms`, but for STATUS."""
        end_ns = self.line.now_ns() + round(ms * 1e6)
        while (left_ms := (end_ns - self.line.now_ns()) / 1e6) > 0:
            self._read(left_ms)
        return self._taken()

    def until(
        self, found: Callable[[Message], bool], what: str, within_ms: float = PATIENCE_MS
    ) -> list[Message]:
        """Return what comes until one is `found`, that one the last, but for STATUS.

        Raises
        ------
        Broken
            It does not come.
        """
        end_ns = self.line.now_ns() + round(within_ms * 1e6)
        looked = 0
        while True:
            for at in range(looked, len(self._heard)):
                if found(self._heard[at]):
                    came, self._heard = self._heard[: at + 1], self._heard[at + 1 :]
                    return came
            looked = len(self._heard)
            left_ms = (end_ns - self.line.now_ns()) / 1e6
            if left_ms <= 0:
                names = ", ".join(type(m).__name__ for m in self._taken()[-5:])
                raise Broken(f"no {what}; what came: {names or 'nothing'}")
            self._read(left_ms)

    def fence(self) -> list[Message]:
        """Return what came before the answer to a PING that is sent now."""
        self._pings += 1
        self.put(Ping, host_ns=self._pings)
        came = self.until(
            lambda m: isinstance(m, Pong) and m.host_ns == self._pings, "PONG of a PING"
        )
        return came[:-1]

    def ask(self, kind: type[Message], *, seq: int | None = None, **fields: Any) -> list[Message]:
        """Send a frame and return all that answers it; not for what takes conversions."""
        self.put(kind, seq=seq, **fields)
        return self.fence()

    def _taken(self) -> list[Message]:
        came, self._heard = self._heard, []
        return came

    def _read(self, within_ms: float) -> None:
        end_ns, most = self._limits
        if self.line.now_ns() > end_ns:
            raise EndlessError("the device has taken longer than the whole suite may")
        if self._received > most:
            raise EndlessError(
                "the device has sent more than the whole suite may take: it floods the line"
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
            booted = isinstance(item, Event) and item.was == State.BOOT
            self.breaks += not (expected or booted)
            self._device_seq, self.state = item.seq, item.state
            if isinstance(item, Status):
                self.status = item
                continue
            if isinstance(item, Pong):
                self.pong = item
            if isinstance(item, ConfigReply):
                self.nonce, self.config_crc = item.nonce, item.config_crc
            if isinstance(item, HelloReply):
                self.facts = item
            self._heard.append(item)

    def reopen(self, after_ms: float = 0) -> None:
        """Close the port, and open it again; what was under way is lost, no fault of a device."""
        self.line.reopen(after_ms)
        self._pending, self._device_seq, self._fresh = b"", None, True
        self._heard.clear()


def only(kind: type[M], came: list[Message]) -> M:
    """Return the one message of this kind.

    Raises
    ------
    Broken
        There is none, or more than one.
    """
    found = [m for m in came if isinstance(m, kind)]
    if len(found) != 1:
        raise Broken(f"{len(found)} of {kind.__name__} among {len(came)} frames, not one")
    return found[0]
