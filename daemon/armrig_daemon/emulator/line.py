"""The device's end of a line: its bytes, and whether a program has the other end open."""

from __future__ import annotations

import ctypes
import os
import termios
import tty
from contextlib import ExitStack
from pathlib import Path
from select import EPOLLHUP, EPOLLOUT
from struct import Struct

from armrig_core.errors import OperationError
from armrig_core.waiting import Waiter

from armrig_daemon.emulator.backlog import Backlog

IN_CLOSE, IN_OPEN = 0x08 | 0x10, 0x20  # <sys/inotify.h>
READ_BYTES = 64  # what a USB bridge's buffer holds; the rest waits in the kernel
_INOTIFY_EVENT = Struct("iIII")
_libc = ctypes.CDLL(None, use_errno=True)


class Line:
    """The device's end of a line, and whether a program has the other end open."""

    fd = -1
    """Bytes of the program that opened the port; negative if a socket has none."""
    opened_fd: int
    """It can be read when a program opens the port."""

    def __init__(self) -> None:
        """Begin with nobody at the other end."""
        self.connected = False
        """A program has the port open; the read that fails says that none has any more."""
        self.has_input = False
        """Bytes have come that were not all read yet, or the port was closed."""
        self._is_hung_up = False
        self.backlog = Backlog()
        """What the line, whose reader stalls, has no room for yet."""
        self._waits_for_room = False
        self._waiter: Waiter | None = None

    def offer(self, port: Path, stack: ExitStack) -> None:
        """Let programs open the line as `port`; `stack` takes the port away.

        Raises
        ------
        OperationError, OSError
            The port cannot be made.
        """
        raise NotImplementedError

    def watch(self, waiter: Waiter) -> None:
        """Add the line to a waiter, with the openings of its port."""
        self._waiter = waiter
        waiter.watch(self.opened_fd)

    def was_opened(self) -> bool:
        """Return whether somebody opened the port since the last call."""
        raise NotImplementedError

    def flush(self) -> None:
        """Throw away what waits on the line, either way."""
        self.backlog.clear()
        self.has_input = self._is_hung_up = False

    def watch_room(self) -> None:
        """Have the waiter report room on the line while bytes wait for it, and no longer."""
        waits = bool(self.backlog.waiting_bytes)
        if waits != self._waits_for_room and self._waiter is not None:
            self._waits_for_room = waits
            self._waiter.watch_room(self.fd, wanted=waits)

    def note_ready(self, flags: int) -> None:
        """Take note of what the kernel tells, once, of `fd`: `EPOLL…` flags."""
        if flags & EPOLLOUT:
            self.drain()
        self._is_hung_up |= bool(flags & EPOLLHUP)
        self.has_input |= bool(flags & ~EPOLLOUT)

    def read(self) -> bytes:
        """Return what has come, at most `READ_BYTES`; nothing where nobody is connected."""
        try:
            data = os.read(self.fd, READ_BYTES)
            is_closed = not data  # how a socket ends
        except BlockingIOError:
            data, is_closed = b"", False
        except OSError:  # EIO: the last one closed the port; ECONNRESET: what we sent was not read
            data, is_closed = b"", True
        # A short read took all; what a port that was closed has left is read up to the error.
        self.has_input = len(data) == READ_BYTES or (bool(data) and self._is_hung_up)
        if is_closed:
            self.hang_up()
        return data

    def hang_up(self) -> None:
        """Take note that nobody has the port open."""
        self.connected = self._is_hung_up = False
        self.backlog.clear()

    def write(self, frame: bytes) -> None:
        """Send, behind what waits already; nothing where nobody is connected."""
        if not self.connected:
            return
        idle = not self.backlog.waiting_bytes
        self.backlog.put(frame)
        if idle:
            self.drain()

    def drain(self) -> None:
        """Send what waits, as far as the line takes it."""
        try:
            while data := self.backlog.first():
                self.backlog.sent(os.write(self.fd, data))
        except BlockingIOError:
            return


class Terminal(Line):
    """The master's end of a pseudo-terminal."""

    def __init__(self, stack: ExitStack) -> None:
        """Open it in raw mode; `stack` closes it."""
        super().__init__()
        self.fd, slave = os.openpty()
        stack.callback(os.close, self.fd)
        tty.setraw(slave)
        self.slave = Path(os.ttyname(slave))
        self._opened = os.fdopen(_watch(self.slave), "rb", buffering=0)
        stack.enter_context(self._opened)
        self.opened_fd = self._opened.fileno()
        os.close(slave)
        os.set_blocking(self.fd, False)
        self._closed = False

    def offer(self, port: Path, stack: ExitStack) -> None:
        """Make the link in one step, over one that an emulator left behind."""
        if port.exists() and not port.is_symlink():
            raise OperationError(f"{port}: is there and no link; choose another --port")
        fresh = port.with_name(f"{port.name}.{os.getpid()}")
        fresh.symlink_to(self.slave)
        fresh.replace(port)

        def remove() -> None:
            if port.is_symlink() and port.readlink() == self.slave:
                port.unlink()

        stack.callback(remove)

    def watch(self, waiter: Waiter) -> None:
        """Add the line to a waiter, with the openings of its port."""
        super().watch(waiter)
        waiter.watch_terminal(self.fd)

    def was_opened(self) -> bool:
        """Return whether somebody opened the port since the last call.

        Opened after it was closed, that is. By POLLHUP alone, one who closes it and opens it at
        once would not be seen. (Who opens it beside its owner, twice, resets the device without
        need; the daemon opens it exclusively.)
        """
        opened = False
        for _, mask, _, _ in _INOTIFY_EVENT.iter_unpack(self._opened.read(4096) or b""):
            opened |= self._closed and bool(mask & IN_OPEN)
            self._closed = bool(mask & IN_CLOSE)
        self.connected |= opened
        return opened

    def flush(self) -> None:
        """Throw away what waits on the line, either way."""
        super().flush()
        termios.tcflush(self.fd, termios.TCIOFLUSH)


def _watch(path: Path) -> int:
    """Return an inotify descriptor that tells of `path` being opened and closed."""
    fd: int = _libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
    if fd < 0 or _libc.inotify_add_watch(fd, os.fsencode(path), IN_OPEN | IN_CLOSE) < 0:
        msg = f"{path}: inotify: {os.strerror(ctypes.get_errno())}"
        if fd >= 0:
            os.close(fd)
        raise OperationError(msg)
    return fd
