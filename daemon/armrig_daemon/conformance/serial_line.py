"""A line over a serial port, in real time."""

from __future__ import annotations

import select
import time

from armrig_daemon.loop.link import open_link


class SerialLine:
    """A serial port that is opened exclusively."""

    def __init__(self, port: str, baud: int) -> None:
        """Open the port; raise LinkError if this fails, `TakenPortError` if the port is in use."""
        self._port, self._baud = port, baud
        self._link = open_link(port, baud)

    def send(self, data: bytes) -> None:
        """Put all bytes on the line."""
        self._link.write(data)

    def receive(self, within_ms: float) -> bytes:
        """Return the received bytes as soon as there are any; b"" after `within_ms`."""
        link = self._link
        if link.has_rest or select.select([link.fd], [], [], within_ms / 1000)[0]:
            return link.read()
        return b""

    def reopen(self, after_ms: float) -> None:
        """Close the port, and open it `after_ms` later."""
        self._link.close()
        time.sleep(after_ms / 1000)
        self._link = open_link(self._port, self._baud)

    def now_ns(self) -> int:
        """Return the time of the monotonic clock, in ns."""
        return time.monotonic_ns()

    def close(self) -> None:
        """Close the port."""
        self._link.close()
