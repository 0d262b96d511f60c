"""Bytes in any pieces to messages.

A decoder is a function of what was left over and what has come, so that it can live inside
any state, be replayed, and be tried with the bytes cut anywhere.
"""

from __future__ import annotations

from armrig_protocol.frame import Spoilt, Unknown, decode
from armrig_protocol.messages import MAX_DECODED, Message

LONGEST = MAX_DECODED + 1
"""Longest stuffed frame without its 00."""

Received = Message | Unknown | Spoilt
"""What the line can bring."""


def feed(pending: bytes, data: bytes) -> tuple[bytes, list[Received]]:
    """Return what is left over, and what came.

    Parameters
    ----------
    pending : bytes
        What the last call left over; empty at first. Never longer than `LONGEST` + 1.
    data : bytes
        Any bytes.
    """
    texts = (pending + data).split(b"\0")
    rest = texts.pop()
    received: list[Received] = []
    for text in texts:
        if len(text) > LONGEST:
            received.append(Spoilt("length"))
        elif text:
            received.append(decode(text))
    # One byte more than fits is enough to remember that it was too long.
    return rest[: LONGEST + 1], received
