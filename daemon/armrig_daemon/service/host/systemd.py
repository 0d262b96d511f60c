"""Reports to systemd and to the journal, as datagrams in their protocols.

References
----------
.. [1] Linux man-pages of systemd, sd_notify(3), section "Description".
"""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Mapping, MutableMapping

from armrig_core.process.journal import priority

JOURNAL = "/run/systemd/journal/socket"
"""Socket at which the journal accepts entries with fields."""
_VARIABLE = "NOTIFY_SOCKET"
_OURS = "ARMRIG_"
_IDENTIFIER = "armrigd"


class Notifier:
    """Connection to systemd; it does nothing if systemd has not started this process.

    `is_asked` is true if systemd has started this process.
    """

    def __init__(self, environ: MutableMapping[str, str]) -> None:
        """Remove the address from the environment, because child processes must not use it."""
        address = environ.pop(_VARIABLE, "")
        self.is_asked = bool(address)
        # An address that begins with @ is in the abstract namespace: @ means a zero byte.
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self._status = ""
        self._socket: socket.socket | None = None
        if address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)

    def ready(self) -> None:
        """Report that the service answers."""
        self._send("READY=1")

    def status(self, line: str) -> None:
        """Report a changed status, for `systemctl status`."""
        if line != self._status:
            self._status = line
            self._send(f"STATUS={line}")

    def progress(self) -> None:
        """Report progress of the loop; if no report comes for too long, systemd ends the service.

        Call this at reports of the loop, never by a timer, because a timer would also run while the
        loop hangs.
        """
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Report that the service ends."""
        self._send("STOPPING=1")

    def _send(self, line: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # a missing receiver must not end the service
                self._socket.sendto(line.encode(), self._address)


def journal_entry(level: str, message: str, fields: Mapping[str, str]) -> bytes:
    """Return a line with its fields in the journal's native protocol.

    Each field has a name, a length and its bytes, so that no value can add another field.

    `message` is the line, with its level and its fields. The field `run` becomes ARMRIG_RUN in the
    journal. An empty field is omitted.

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
