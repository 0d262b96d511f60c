"""Consistent overhead byte stuffing (COBS) removes 00 from a frame, so that a 00 can end the frame.

References
----------
.. [1] S. Cheshire and M. Baker, "Consistent overhead byte stuffing",
   IEEE/ACM Trans. Networking 7 (1999) 159-172.
"""

from __future__ import annotations

MAX_TEXT = 253
"""Length of the longest text that needs only one additional byte; frames are shorter."""


def stuff(text: bytes) -> bytes:
    """Return `text` stuffed: one byte longer, without any 00; `text` has at most `MAX_TEXT` B."""
    if len(text) > MAX_TEXT:
        raise ValueError(f"{len(text)} bytes are too many to stuff: at most {MAX_TEXT}")
    stuffed = bytearray(b"\0" + text)
    at = 0
    for run in text.split(b"\0"):
        code = len(run) + 1
        stuffed[at] = code
        at += code
    return bytes(stuffed)


def unstuff(stuffed: bytes) -> bytes | None:
    """Return the text without stuffing; None if a code byte points beyond the end of `stuffed`.

    `stuffed` contains no 00: the decoder has removed the 00 at the end of the frame.
    """
    text = bytearray(stuffed)
    at, end = 0, len(text)
    while at < end:
        code = text[at]
        text[at] = 0
        at += code
    return bytes(text[1:]) if at == end else None
