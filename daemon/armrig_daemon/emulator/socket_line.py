"""A Unix socket as the device's line; opening it resets the device, as with a serial port."""

from __future__ import annotations

import os
import select
import socket
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final

from armrig_core.access.emulator_socket import is_socket, lock_path, require_safe_folder, stranger
from armrig_core.errors import InputError, OperationError
from armrig_core.process.waiting import Waiter

from armrig_daemon.emulator.line import EmulatedLine

_MAX_PENDING_CONNECTIONS: Final = 8
"""Largest number of connections that wait to be accepted; the kernel refuses more."""


class SocketLine(EmulatedLine):
    """A listening Unix socket, and the connection of the program that has the port open."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        """Create a socket, which `offer` places at `path`; `stack` closes the socket."""
        super().__init__()
        self._path = path
        kind = socket.SOCK_STREAM | socket.SOCK_NONBLOCK
        self._listener = stack.enter_context(socket.socket(socket.AF_UNIX, kind))
        self.opened_fd = self._listener.fileno()
        stack.callback(self._close)

    def offer(self, port: Path, stack: ExitStack) -> None:
        """Create the socket in one step; replace a socket at which no emulator answers."""
        path = self._path
        try:
            require_safe_folder(path)
        except InputError as err:
            raise OperationError(f"{port}: {err}") from err
        if fault := _obstacle(path):
            raise OperationError(f"{port}: {fault}; choose another --port")
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        os.close(os.open(lock_path(path), flags, 0o600))
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        stack.callback(os.close, folder)
        # Bind by the folder's descriptor: a socket's path is limited, and the temporary path may
        # be too long even if `path` is not.
        fresh = Path(f"/proc/self/fd/{folder}/.{os.getpid()}")
        self._listener.bind(os.fspath(fresh))
        fresh.chmod(0o600)
        self._listener.listen(_MAX_PENDING_CONNECTIONS)
        fresh.replace(path)
        inode = path.lstat().st_ino

        def remove() -> None:
            with suppress(FileNotFoundError):
                if path.lstat().st_ino == inode:
                    path.unlink()
                    lock_path(path).unlink()

        stack.callback(remove)

    def was_opened(self) -> bool:
        """Return whether a program has opened the port since the last call.

        Connections of other users' programs are closed at once. While a program has the port open,
        a second connection is also closed.
        """
        opened = False
        for _ in range(_MAX_PENDING_CONNECTIONS):
            try:
                connection, _ = self._listener.accept()
            except BlockingIOError:
                break
            if stranger(connection) is not None or (self.connected and not self._is_closed()):
                connection.close()
                continue
            self.hang_up()
            connection.setblocking(False)
            self.fd = connection.detach()
            self._watch_connection()
            self.connected = opened = True
        return opened

    def hang_up(self) -> None:
        """Close the connection, so that another program may open the port."""
        super().hang_up()
        self._waits_for_room = False
        if self.fd >= 0 and self._waiter is not None:
            self._waiter.forget(self.fd)
        self._close()

    def drain(self) -> None:
        """Send as many waiting frames as possible; if the port was closed, discard them."""
        try:
            super().drain()
        except (BrokenPipeError, ConnectionResetError):
            self.backlog.clear()

    def watch(self, waiter: Waiter) -> None:
        """Let a waiter also wait for the line's bytes and for the opening of its port."""
        super().watch(waiter)
        self._watch_connection()

    def _watch_connection(self) -> None:
        if self.fd >= 0 and self._waiter is not None:
            self._waiter.watch_terminal(self.fd)

    def _is_closed(self) -> bool:
        """Return whether the program has closed the port; its last bytes may still be unread."""
        poll = select.poll()
        poll.register(self.fd, 0)
        return bool(poll.poll(0))

    def _close(self) -> None:
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


def _obstacle(path: Path) -> str:
    """Return the reason why no socket may be created at `path`; "" if it may be created."""
    try:
        if not is_socket(path):
            return "exists and is not a socket"
        # If no program has opened the port of another emulator, this resets its device.
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK) as probe:
            probe.connect(os.fspath(path))
    except (FileNotFoundError, ConnectionRefusedError):
        return ""
    except BlockingIOError:  # too many connections are waiting
        pass
    return "another emulator answers there"
