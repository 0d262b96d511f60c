"""Queue of frames that the line does not accept at once; a full queue drops further frames."""

from __future__ import annotations

from collections import deque
from typing import Final

CAPACITY_BYTES: Final = 1 << 16  # as in the driver of a USB-serial adapter


class Backlog:
    """Frames in the order of sending; the first frame may be partly sent."""

    def __init__(self) -> None:
        """Begin empty."""
        self._frames: deque[bytes] = deque()
        self.waiting_bytes = 0
        self.dropped_frames = 0
        self.dropped_bytes = 0

    def put(self, frame: bytes) -> None:
        """Append a frame; if the frame does not fit, drop and count the frame."""
        if self.waiting_bytes + len(frame) > CAPACITY_BYTES:
            self.dropped_frames += 1
            self.dropped_bytes += len(frame)
        else:
            self._frames.append(frame)
            self.waiting_bytes += len(frame)

    def first(self) -> bytes:
        """Return the next bytes to send; b"" if no frame is waiting."""
        return self._frames[0] if self._frames else b""

    def sent(self, n_bytes: int) -> None:
        """Remove the first `n_bytes`, which the caller has sent."""
        rest = self._frames.popleft()[n_bytes:]
        if rest:
            self._frames.appendleft(rest)
        self.waiting_bytes -= n_bytes

    def clear(self) -> None:
        """Discard all frames, because no program is connected."""
        self._frames.clear()
        self.waiting_bytes = 0
