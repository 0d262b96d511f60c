"""Consistent overhead byte stuffing: no 00 inside a frame, so that 00 can end one.

References
----------
.. [1] S. Cheshire and M. Baker, "Consistent overhead byte stuffing",
   IEEE/ACM Trans. Networking 7 (1999) 159-172.
"""

from __future__ import annotations

LONGEST = 253
"""Longest text that needs one byte of overhead and no group code FF; frames are shorter."""


def stuff(text: bytes) -> bytes:
    """Return `text` without any 00, one byte longer; `text` is at most `LONGEST` bytes."""
    if len(text) > LONGEST:
        raise ValueError(f"{len(text)} bytes are too many to stuff: at most {LONGEST}")
    stuffed = bytearray(b"\0" + text)
    at = 0
    for run in text.split(b"\0"):
        code = len(run) + 1
        stuffed[at] = code
        at += code
    return bytes(stuffed)


def unstuff(stuffed: bytes) -> bytes | None:
    """Return what was stuffed, or None where a code points behind the end.

    `stuffed` has no 00 in it: those end frames, and are gone before this.
    """
    text = bytearray(stuffed)
    at, end = 0, len(text)
    while at < end:
        code = text[at]
        text[at] = 0
        at += code
    return bytes(text[1:]) if at == end else None
