"""A serial port as the suite's line, in real time."""

from __future__ import annotations

import select
import time

from armrig_daemon.loop.link import open_link


class SerialLine:
    """A port that is ours alone."""

    def __init__(self, port: str, baud: int) -> None:
        """Open it.

        Raises
        ------
        LinkError
            It cannot be opened; `TakenPortError` where a daemon holds it.
        """
        self._port, self._baud = port, baud
        self._link = open_link(port, baud)

    def send(self, data: bytes) -> None:
        """Put bytes on the line, all of them."""
        self._link.write(data)

    def receive(self, within_ms: float) -> bytes:
        """Return what has come, as soon as anything has; nothing where `within_ms` pass before."""
        link = self._link
        if link.has_rest or select.select([link.fd], [], [], within_ms / 1000)[0]:
            return link.read()
        return b""

    def reopen(self, after_ms: float) -> None:
        """Close the port, and open it again `after_ms` later."""
        self._link.close()
        time.sleep(after_ms / 1000)
        self._link = open_link(self._port, self._baud)

    def now_ns(self) -> int:
        """Return the monotonic clock."""
        return time.monotonic_ns()

    def close(self) -> None:
        """Give the port back."""
        self._link.close()
