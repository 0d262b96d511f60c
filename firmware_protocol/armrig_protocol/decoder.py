"""Decoder of the received bytes to messages; the bytes may arrive in pieces of any length.

The decoder is a pure function of the leftover bytes and the new bytes. A caller can therefore store
the leftover bytes in its own state. A replay returns the same messages, and a test can split the
bytes at any place.
"""

from __future__ import annotations

from armrig_protocol.frame import Spoilt, Unknown, decode
from armrig_protocol.messages import MAX_DECODED, Message

MAX_STUFFED = MAX_DECODED + 1
"""Length of the longest stuffed frame without its 00, in bytes."""

Received = Message | Unknown | Spoilt
"""Type of the items that the decoder returns."""


def feed(pending: bytes, data: bytes) -> tuple[bytes, list[Received]]:
    """Return the leftover bytes of an incomplete frame, and the items of all complete frames.

    `pending` contains the leftover bytes of the last call, at most `MAX_STUFFED` + 1 bytes; it is
    empty at the first call. `data` contains the new bytes.
    """
    texts = (pending + data).split(b"\0")
    leftover = texts.pop()
    received: list[Received] = []
    for text in texts:
        if len(text) > MAX_STUFFED:
            received.append(Spoilt("length"))
        elif text:
            received.append(decode(text))
    # One byte more than the longest frame shows that the frame is too long.
    return leftover[: MAX_STUFFED + 1], received
