"""The recent messages of a rig: the request for them and the answer.

A subscriber may miss messages or connect late. The daemon keeps published messages for a while and
numbers them across all streams. A client requests all messages from a given number on. It receives
as many messages as one answer can contain, and then requests the messages after the last received
message. If the daemon no longer keeps the first requested message, the client knows exactly which
messages are lost.
"""

from __future__ import annotations

from collections.abc import Iterable
from struct import Struct, error
from typing import Annotated, NamedTuple

import msgspec
from msgspec import Meta

from armrig_core.errors import MalformedReplyError
from armrig_core.telemetry.topics import STREAMS

REPLY_LIMIT = 64 << 10
"""Length at which an answer ends, in B; the last message may exceed this length."""
ANSWER_LIMIT = 1 << 20
"""Longest answer that a client reads, in B; the answers of a daemon are much shorter."""
NUMBER_LIMIT = 1 << 62
"""Upper bound of the message numbers; every message has a smaller number."""
_HEAD = Struct("<16sQq")  # life of the daemon, number of the first message, clock offset in ns
_MESSAGE = Struct("<BI")  # index of the stream in STREAMS; length in B


class HistoryRequest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A request for the history, as JSON."""

    first: Annotated[int, Meta(ge=0, lt=NUMBER_LIMIT)] = 0
    """Number of the first requested message; 0 is the oldest message that the daemon keeps."""


class Past(NamedTuple):
    """Answer to a request for the history: consecutive messages."""

    life: bytes
    """16 B that identify one start of a daemon; the message numbers begin again at each start."""
    first: int
    """Number of the first message; above the requested number if older messages are lost."""
    clock_offset_ns: int
    """Real-time clock minus monotonic clock of the publishing host, in ns."""
    messages: tuple[tuple[str, bytes], ...]
    """Stream and bytes of each message."""


def encode_past(
    life: bytes, first: int, clock_offset_ns: int, messages: Iterable[tuple[str, bytes]]
) -> bytes:
    """Return an answer as bytes."""
    parts = [_HEAD.pack(life, first, clock_offset_ns)]
    for stream, data in messages:
        parts += (_MESSAGE.pack(STREAMS.index(stream), len(data)), data)
    return b"".join(parts)


def decode_past(data: bytes) -> Past:
    """Return the answer that `data` encodes.

    Raises MalformedReplyError if `data` is not an answer.
    """
    if len(data) > ANSWER_LIMIT:
        raise MalformedReplyError(f"{len(data)} B: an answer has at most {ANSWER_LIMIT} B")
    try:
        life, first, offset_ns = _HEAD.unpack_from(data)
        at = _HEAD.size
        messages: list[tuple[str, bytes]] = []
        while at < len(data):
            stream, length = _MESSAGE.unpack_from(data, at)
            at += _MESSAGE.size
            if stream >= len(STREAMS) or length > len(data) - at:
                raise MalformedReplyError(f"no message: stream {stream}, {length} B")
            messages.append((STREAMS[stream], data[at : at + length]))
            at += length
    except error as err:
        raise MalformedReplyError(f"{len(data)} B: not an answer with messages") from err
    if first + len(messages) > NUMBER_LIMIT:
        raise MalformedReplyError(f"the answer begins with the number {first}, which is too large")
    return Past(life, first, offset_ns, tuple(messages))
