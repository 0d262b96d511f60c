"""What the line does not take at once: kept in order up to a bound, then dropped by the frame."""

from __future__ import annotations

from collections import deque
from typing import Final

CAPACITY: Final = 1 << 16  # as much as the driver of a USB-serial adapter keeps


class Backlog:
    """Frames in the order in which they leave, the first of them perhaps begun."""

    def __init__(self) -> None:
        """Begin empty."""
        self._frames: deque[bytes] = deque()
        self.waiting_bytes = 0
        self.dropped_frames = 0
        self.dropped_bytes = 0

    def put(self, frame: bytes) -> None:
        """Keep a frame behind the others; one that finds no room is dropped whole and counted."""
        if self.waiting_bytes + len(frame) > CAPACITY:
            self.dropped_frames += 1
            self.dropped_bytes += len(frame)
        else:
            self._frames.append(frame)
            self.waiting_bytes += len(frame)

    def first(self) -> bytes:
        """Return what is to leave next, in one piece; empty where nothing waits."""
        return self._frames[0] if self._frames else b""

    def sent(self, n_bytes: int) -> None:
        """Note that `n_bytes` of the first piece have left."""
        rest = self._frames.popleft()[n_bytes:]
        if rest:
            self._frames.appendleft(rest)
        self.waiting_bytes -= n_bytes

    def clear(self) -> None:
        """Forget what waits: nobody is there to have it."""
        self._frames.clear()
        self.waiting_bytes = 0
