"""What systemd is told of the service, by its own protocol: datagrams of lines.

References
----------
.. [1] Linux man-pages of systemd, sd_notify(3), section "Description".
"""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Mapping, MutableMapping

from armrig_core.journal import priority

JOURNAL = "/run/systemd/journal/socket"
"""Where the journal takes entries with fields."""
_VARIABLE = "NOTIFY_SOCKET"
_OURS = "ARMRIG_"
_IDENTIFIER = "armrigd"


class Notifier:
    """The way to systemd, or to nobody where no systemd has started us.

    `is_asked` tells whether there is one.
    """

    def __init__(self, environ: MutableMapping[str, str]) -> None:
        """Take the address from the environment: what we start shall not speak for us."""
        address = environ.pop(_VARIABLE, "")
        self.is_asked = bool(address)
        # A name that begins with @ is one of the kernel's own space, which begins with a 0.
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self._status = ""
        self._socket: socket.socket | None = None
        if address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)

    def ready(self) -> None:
        """Tell that the service answers."""
        self._send("READY=1")

    def status(self, line: str) -> None:
        """Tell how the service is, where that is news; for `systemctl status`."""
        if line != self._status:
            self._status = line
            self._send(f"STATUS={line}")

    def progress(self) -> None:
        """Tell that the loop has come on: systemd ends a service of which it hears this too late.

        To be called for what the loop has said, and never by a timer, which would speak for a loop
        that hangs.
        """
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Tell that the service ends."""
        self._send("STOPPING=1")

    def _send(self, line: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # it must not end the service that nobody hears it
                self._socket.sendto(line.encode(), self._address)


def journal_entry(level: str, message: str, fields: Mapping[str, str]) -> bytes:
    """Return a line with its fields, as the journal takes it by its own protocol.

    Each field is a name, and its length and its bytes: what stands in it cannot become another.

    Parameters
    ----------
    level : str
        Of a line of the log.
    message : str
        The line.
    fields : mapping
        What it is about: `run` is ARMRIG_RUN in the journal. An empty one is left out.

    References
    ----------
    .. [2] systemd, "Native Journal Protocol", docs/JOURNAL_NATIVE_PROTOCOL.md.
    """
    entry = {
        "PRIORITY": str(priority(level)),
        "SYSLOG_IDENTIFIER": _IDENTIFIER,
        "MESSAGE": message,
        **{_OURS + name.upper(): value for name, value in fields.items() if value},
    }
    parts = []
    for name, value in entry.items():
        data = value.encode("utf-8", "replace")
        parts.append(b"%s\n%s%s\n" % (name.encode(), struct.pack("<Q", len(data)), data))
    return b"".join(parts)


def send_to_journal(entry: bytes, address: str = JOURNAL) -> bool:
    """Send an entry without waiting; return whether the journal has taken it."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as out:
        out.setblocking(False)
        try:
            out.sendto(entry, address)
        except OSError:
            return False
    return True
