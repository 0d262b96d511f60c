"""Watch of the Unix socket's file, which another program may delete while the daemon runs.

Without the file no client can connect, not even to stop the motor. Connected clients stay.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from armrig_core.access.daemon_lock import DaemonFacts, write_facts
from armrig_core.access.emulator_socket import lock_path

_Inode = tuple[int, int] | None


class SocketFile:
    """Watch of the socket and of its lock file; call `look` once a second."""

    def __init__(self, socket: Path, facts: DaemonFacts, open_again: Callable[[], str]) -> None:
        """Write the facts; `open_again` opens the socket, and returns why it failed, or ""."""
        self._socket, self._facts, self._open_again = socket, facts, open_again
        self._files = self._note_files()
        self._has_failed = False

    def look(self) -> str:
        """Open a deleted socket again; return a line for the log if another program changed it."""
        files = self._find()
        if files == self._files:
            return ""
        if any(new and new != old for new, old in zip(files, self._files, strict=True)):
            self._files, why = files, "and another program listens there: end that program"
        elif not (why := self._failure()):
            self._files, self._has_failed = self._note_files(), False
            return f"{self._socket}: another program deleted this socket; it is open again"
        elif self._has_failed:  # tried again each second, and reported once
            return ""
        else:
            self._has_failed = True
        return f"{self._socket}: deleted, {why}; no client can connect: restart armrigd"

    def _failure(self) -> str:
        """Open the socket again; return why it failed, or ""."""
        try:
            self._socket.parent.mkdir(mode=0o700, exist_ok=True)
            # The old session keeps the lock of this file, for the clients that it has.
            lock_path(self._socket).unlink(missing_ok=True)
        except OSError as err:
            return str(err.strerror)
        return self._open_again()

    def _note_files(self) -> list[_Inode]:
        with suppress(OSError):  # such as a full disk: then a client knows less about a silence
            write_facts(self._socket, self._facts)
        return self._find()

    def _find(self) -> list[_Inode]:
        return [_inode(self._socket), _inode(lock_path(self._socket))]


def _inode(path: Path) -> _Inode:
    """Return device and inode of a file; None if there is no file."""
    with suppress(OSError):
        stat = path.lstat()
        return stat.st_dev, stat.st_ino
    return None
