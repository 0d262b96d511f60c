"""The master's end of a pseudo-terminal: bytes, and who is at the other end."""

from __future__ import annotations

import ctypes
import os
import termios
import tty
from contextlib import ExitStack
from pathlib import Path
from select import EPOLLHUP, EPOLLOUT
from struct import Struct

from armrig_daemon.emulator.backlog import Backlog

IN_CLOSE, IN_OPEN = 0x08 | 0x10, 0x20  # <sys/inotify.h>
READ_BYTES = 64  # what a USB bridge's buffer holds; the rest waits in the kernel
_INOTIFY_EVENT = Struct("iIII")
_libc = ctypes.CDLL(None, use_errno=True)


class PortError(Exception):
    """The port cannot be made; says which and why."""


class Line:
    """The master's end of a pseudo-terminal, and who is at the other end."""

    def __init__(self, stack: ExitStack) -> None:
        """Open it in raw mode; `stack` closes it."""
        self.master, slave = os.openpty()
        stack.callback(os.close, self.master)
        tty.setraw(slave)
        self.slave = Path(os.ttyname(slave))
        self.opened = os.fdopen(_watch(self.slave), "rb", buffering=0)
        stack.enter_context(self.opened)
        os.close(slave)
        os.set_blocking(self.master, False)
        self.connected = False
        """Somebody has it open; the read that fails tells that nobody has any more."""
        self.has_input = False
        """Bytes have come that were not all read yet, or the port was closed."""
        self._is_hung_up = False
        self.backlog = Backlog()
        """What the terminal, whose reader stalls, has no room for yet."""
        self._closed = False

    def was_opened(self) -> bool:
        """Return whether somebody opened the port since the last call.

        Opened after it was closed, that is. By POLLHUP alone, one who closes it and opens it at
        once would not be seen. (Who opens it beside its owner, twice, resets the device without
        need; the daemon opens it exclusively.)
        """
        opened = False
        for _, mask, _, _ in _INOTIFY_EVENT.iter_unpack(self.opened.read(4096) or b""):
            opened |= self._closed and bool(mask & IN_OPEN)
            self._closed = bool(mask & IN_CLOSE)
        self.connected |= opened
        return opened

    def flush(self) -> None:
        """Throw away what waits on the line, either way."""
        self.backlog.clear()
        self.has_input = self._is_hung_up = False
        termios.tcflush(self.master, termios.TCIOFLUSH)

    def note_ready(self, flags: int) -> None:
        """Take note of what the kernel tells, once, of the master: `EPOLL…` flags."""
        if flags & EPOLLOUT:
            self.drain()
        self._is_hung_up |= bool(flags & EPOLLHUP)
        self.has_input |= bool(flags & ~EPOLLOUT)

    def read(self) -> bytes:
        """Return what has come, at most `READ_BYTES`; nothing where nobody is connected."""
        try:
            data = os.read(self.master, READ_BYTES)
        except BlockingIOError:
            data = b""
        except OSError:  # EIO: the last one closed the port
            data, self.connected, self._is_hung_up = b"", False, False
            self.backlog.clear()
        # A short read took all; what a port that was closed has left is read up to the error.
        self.has_input = len(data) == READ_BYTES or (bool(data) and self._is_hung_up)
        return data

    def write(self, frame: bytes) -> None:
        """Send, behind what waits already; nothing where nobody is connected."""
        if not self.connected:
            return
        idle = not self.backlog.waiting_bytes
        self.backlog.put(frame)
        if idle:
            self.drain()

    def drain(self) -> None:
        """Send what waits, as far as the terminal takes it."""
        try:
            while data := self.backlog.first():
                self.backlog.sent(os.write(self.master, data))
        except BlockingIOError:
            return


def _watch(path: Path) -> int:
    """Return an inotify descriptor that tells of `path` being opened and closed."""
    fd: int = _libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
    if fd < 0 or _libc.inotify_add_watch(fd, os.fsencode(path), IN_OPEN | IN_CLOSE) < 0:
        msg = f"{path}: inotify: {os.strerror(ctypes.get_errno())}"
        raise PortError(msg)
    return fd
