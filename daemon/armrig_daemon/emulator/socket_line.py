"""A Unix socket as the device's line: opened, reset and closed as a serial port is."""

from __future__ import annotations

import os
import select
import socket
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final

from armrig_core.emulator_socket import folder_fault, is_socket, lock_path, peer_fault
from armrig_core.errors import OperationError
from armrig_core.waiting import Waiter

from armrig_daemon.emulator.line import Line

_MOST_WAITING: Final = 8
"""Connections that wait to be accepted, at most; the kernel refuses more."""


class SocketLine(Line):
    """A listening Unix socket, and the one connection that has the port open."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        """Make a socket that `offer` puts at `path`; `stack` closes it."""
        super().__init__()
        self._path = path
        kind = socket.SOCK_STREAM | socket.SOCK_NONBLOCK
        self._listener = stack.enter_context(socket.socket(socket.AF_UNIX, kind))
        self.opened_fd = self._listener.fileno()
        stack.callback(self._close)

    def offer(self, port: Path, stack: ExitStack) -> None:
        """Make the socket in one step, in place of one at which no emulator answers."""
        path = self._path
        if fault := folder_fault(path):
            raise OperationError(f"{port}: {fault}")
        if fault := _occupied(path):
            raise OperationError(f"{port}: {fault}; choose another --port")
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        os.close(os.open(lock_path(path), flags, 0o600))
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        stack.callback(os.close, folder)
        # By the folder's descriptor, for the other name must not be too long where `path` is not.
        fresh = Path(f"/proc/self/fd/{folder}/.{os.getpid()}")
        self._listener.bind(os.fspath(fresh))
        fresh.chmod(0o600)
        self._listener.listen(_MOST_WAITING)
        fresh.replace(path)
        inode = path.lstat().st_ino

        def remove() -> None:
            with suppress(FileNotFoundError):
                if path.lstat().st_ino == inode:
                    path.unlink()
                    lock_path(path).unlink()

        stack.callback(remove)

    def was_opened(self) -> bool:
        """Return whether somebody opened the port since the last call.

        The connection of another user's program is closed at once, and so is a second connection
        while one program has the port open.
        """
        opened = False
        for _ in range(_MOST_WAITING):
            try:
                connection, _ = self._listener.accept()
            except BlockingIOError:
                break
            if peer_fault(connection) or (self.connected and not self._is_closed()):
                connection.close()
                continue
            self.hang_up()
            connection.setblocking(False)
            self.fd = connection.detach()
            self._watch_connection()
            self.connected = opened = True
        return opened

    def hang_up(self) -> None:
        """Close the connection: another program may open the port."""
        super().hang_up()
        self._waits_for_room = False
        if self.fd >= 0 and self._waiter is not None:
            self._waiter.forget(self.fd)
        self._close()

    def drain(self) -> None:
        """Send what waits, as far as the line takes it; drop it if the port was closed."""
        try:
            super().drain()
        except (BrokenPipeError, ConnectionResetError):
            self.backlog.clear()

    def watch(self, waiter: Waiter) -> None:
        """Add the line to a waiter, with the openings of its port."""
        super().watch(waiter)
        self._watch_connection()

    def _watch_connection(self) -> None:
        if self.fd >= 0 and self._waiter is not None:
            self._waiter.watch_terminal(self.fd)

    def _is_closed(self) -> bool:
        """Return whether the program that had the port open has closed it; its bytes may wait."""
        poll = select.poll()
        poll.register(self.fd, 0)
        return bool(poll.poll(0))

    def _close(self) -> None:
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


def _occupied(path: Path) -> str:
    """Return why no socket may be put at `path`, or nothing.

    A connection finds out whether an emulator answers; if nobody has its port open, that resets its
    device.
    """
    try:
        if not is_socket(path):
            return "is there and no socket"
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK) as probe:
            probe.connect(os.fspath(path))
    except (FileNotFoundError, ConnectionRefusedError):
        return ""
    except BlockingIOError:  # too many connections wait for it
        pass
    return "another emulator answers there"
