"""What a rig has published of late, as it is asked for and answered: message after message.

Who listens may miss a message, or come late. What was published is kept for a while, and numbered
in one row, whatever its stream; who asks for all from a number on gets them in their order, as many
as one answer takes, and asks again behind the last of them. A number that is not there any more
tells exactly what is lost.
"""

from __future__ import annotations

from collections.abc import Iterable
from struct import Struct, error
from typing import Annotated, NamedTuple

import msgspec
from msgspec import Meta

from armrig_core.errors import MalformedReplyError
from armrig_core.topics import STREAMS

REPLY_LIMIT = 64 << 10
"""An answer ends with the message that reaches this length, in B."""
ANSWER_LIMIT = 1 << 20
"""Longest answer that is read, in B; no message of a daemon's is nearly as long."""
NUMBER_LIMIT = 1 << 62
"""Above the number of any message."""
_HEAD = Struct("<16sQq")  # the daemon's life, number of the first message, clock offset in ns
_MESSAGE = Struct("<BI")  # stream, as its place in STREAMS; length


class HistoryRequest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A question for the history, as JSON."""

    first: Annotated[int, Meta(ge=0, lt=NUMBER_LIMIT)] = 0
    """Number of the first message wanted; 0 is the oldest that is kept."""


class Past(NamedTuple):
    """An answer: messages that follow each other."""

    life: bytes
    """16 B that are another daemon's, or another start's, where the numbers begin anew."""
    first: int
    """Number of the first message; later than what was asked for where older ones are gone."""
    clock_offset_ns: int
    """Real-time clock less monotonic clock, where the messages were made."""
    messages: tuple[tuple[str, bytes], ...]
    """Stream and bytes of each."""


def encode_past(
    life: bytes, first: int, clock_offset_ns: int, messages: Iterable[tuple[str, bytes]]
) -> bytes:
    """Return an answer as bytes."""
    parts = [_HEAD.pack(life, first, clock_offset_ns)]
    for stream, data in messages:
        parts += (_MESSAGE.pack(STREAMS.index(stream), len(data)), data)
    return b"".join(parts)


def decode_past(data: bytes) -> Past:
    """Return the answer in bytes.

    Raises
    ------
    MalformedReplyError
        They are none.
    """
    if len(data) > ANSWER_LIMIT:
        raise MalformedReplyError(f"{len(data)} B are no history, which has at most {ANSWER_LIMIT}")
    try:
        life, first, offset_ns = _HEAD.unpack_from(data)
        at = _HEAD.size
        messages: list[tuple[str, bytes]] = []
        while at < len(data):
            stream, length = _MESSAGE.unpack_from(data, at)
            at += _MESSAGE.size
            if stream >= len(STREAMS) or length > len(data) - at:
                raise MalformedReplyError(f"a message of stream {stream} and {length} B is none")
            messages.append((STREAMS[stream], data[at : at + length]))
            at += length
    except error as err:
        raise MalformedReplyError(f"{len(data)} B are no history") from err
    if first + len(messages) > NUMBER_LIMIT:
        raise MalformedReplyError(f"there is no message of number {first}")
    return Past(life, first, offset_ns, tuple(messages))
