"""Decoding of bytes, in any pieces, to messages.

The decoder is a pure function of the leftover bytes and the new bytes. It can therefore be part of
any state, be replayed, and be tested with the bytes in any pieces.
"""

from __future__ import annotations

from armrig_protocol.frame import Spoilt, Unknown, decode
from armrig_protocol.messages import MAX_DECODED, Message

MAX_STUFFED = MAX_DECODED + 1
"""Length of the longest stuffed frame without its 00, in bytes."""

Received = Message | Unknown | Spoilt
"""An item that the decoder can return."""


def feed(pending: bytes, data: bytes) -> tuple[bytes, list[Received]]:
    """Return the leftover bytes and the received items.

    Parameters
    ----------
    pending : bytes
        Leftover bytes of the last call; empty at first. At most `MAX_STUFFED` + 1 bytes.
    data : bytes
        New bytes.
    """
    texts = (pending + data).split(b"\0")
    rest = texts.pop()
    received: list[Received] = []
    for text in texts:
        if len(text) > MAX_STUFFED:
            received.append(Spoilt("length"))
        elif text:
            received.append(decode(text))
    # One byte more than the longest frame shows that the frame is too long.
    return rest[: MAX_STUFFED + 1], received
