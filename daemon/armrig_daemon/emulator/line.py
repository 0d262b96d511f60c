"""The device's end of a line; it also detects whether a program has the other end open."""

from __future__ import annotations

import ctypes
import os
import termios
import tty
from collections import deque
from contextlib import ExitStack
from pathlib import Path
from select import EPOLLHUP, EPOLLOUT
from struct import Struct

from armrig_core.errors import OperationError
from armrig_core.process.waiting import Waiter

IN_CLOSE, IN_OPEN = 0x08 | 0x10, 0x20  # <sys/inotify.h>
READ_BYTES = 64  # size of a USB bridge's buffer; the rest waits in the kernel
CAPACITY_BYTES = 1 << 16  # as in the driver of a USB-serial adapter
_INOTIFY_EVENT = Struct("iIII")
_libc = ctypes.CDLL(None, use_errno=True)


class Backlog:
    """Queue of frames that the line does not accept at once; the first may be partly sent."""

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

    def remove_first(self, n_bytes: int) -> None:
        """Remove the first `n_bytes`, which the caller has sent."""
        remainder = self._frames.popleft()[n_bytes:]
        if remainder:
            self._frames.appendleft(remainder)
        self.waiting_bytes -= n_bytes

    def clear(self) -> None:
        """Discard all frames, because no program is connected."""
        self._frames.clear()
        self.waiting_bytes = 0


class EmulatedLine:
    """The device's end of a line, which knows whether a program has the other end open."""

    fd = -1
    """Descriptor to read the program's bytes from; negative while a socket is unconnected."""
    opened_fd: int
    """Descriptor that is readable after a program has opened the port."""

    def __init__(self) -> None:
        """Begin with a closed port."""
        self.connected = False
        """True while a program has the port open; a failed read makes it False."""
        self.has_input = False
        """True if bytes are waiting to be read, or the port was closed."""
        self._is_hung_up = False
        self.backlog = Backlog()
        """Frames that wait because the reader of the line stalls."""
        self._waits_for_room = False
        self._waiter: Waiter | None = None

    def offer(self, port: Path, stack: ExitStack) -> None:
        """Create `port`, by which programs open the line; `stack` removes it.

        Raises OperationError or OSError if the port cannot be created.
        """
        raise NotImplementedError

    def watch(self, waiter: Waiter) -> None:
        """Let a waiter also wait for the line's bytes and for a program that opens the port."""
        self._waiter = waiter
        waiter.watch(self.opened_fd)

    def was_opened(self) -> bool:
        """Return whether a program has opened the port since the last call."""
        raise NotImplementedError

    def flush(self) -> None:
        """Discard the waiting bytes of both directions."""
        self.backlog.clear()
        self.has_input = self._is_hung_up = False

    def watch_room(self) -> None:
        """Let the waiter report room on the line, but only while frames are waiting to be sent."""
        waits = bool(self.backlog.waiting_bytes)
        if waits != self._waits_for_room and self._waiter is not None:
            self._waits_for_room = waits
            self._waiter.watch_room(self.fd, wanted=waits)

    def note_ready(self, flags: int) -> None:
        """Note the `EPOLL…` flags of `fd`, which the kernel reports once."""
        if flags & EPOLLOUT:
            self.drain()
        self._is_hung_up |= bool(flags & EPOLLHUP)
        self.has_input |= bool(flags & ~EPOLLOUT)

    def read(self) -> bytes:
        """Return the received bytes, at most `READ_BYTES`; b"" if no program is connected."""
        try:
            data = os.read(self.fd, READ_BYTES)
            is_closed = not data  # how a socket ends
        except BlockingIOError:
            data, is_closed = b"", False
        except OSError:  # EIO: the port was closed; ECONNRESET: sent bytes were not read
            data, is_closed = b"", True
        # A short read took all bytes. If the port was closed, reads go on until one fails.
        self.has_input = len(data) == READ_BYTES or (bool(data) and self._is_hung_up)
        if is_closed:
            self.hang_up()
        return data

    def hang_up(self) -> None:
        """Record that the port was closed."""
        self.connected = self._is_hung_up = False
        self.backlog.clear()

    def write(self, frame: bytes) -> None:
        """Send a frame after the waiting frames; do nothing if no program is connected."""
        if not self.connected:
            return
        idle = not self.backlog.waiting_bytes
        self.backlog.put(frame)
        if idle:
            self.drain()

    def drain(self) -> None:
        """Send the waiting frames, as far as the line accepts them."""
        try:
            while data := self.backlog.first():
                self.backlog.remove_first(os.write(self.fd, data))
        except BlockingIOError:
            return


class Terminal(EmulatedLine):
    """The master's end of a pseudo-terminal."""

    def __init__(self, stack: ExitStack) -> None:
        """Open a pseudo-terminal in raw mode; `stack` closes it."""
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
        """Create the link `port` to the terminal; replace an earlier emulator's link atomically."""
        is_link = port.is_symlink()
        if (port.exists() or is_link) and not (
            is_link and port.readlink().parent == self.slave.parent
        ):
            raise OperationError(f"{port}: exists and is no emulator's link; choose another --port")
        fresh = port.with_name(f"{port.name}.{os.getpid()}")
        fresh.symlink_to(self.slave)
        fresh.replace(port)

        def remove() -> None:
            if port.is_symlink() and port.readlink() == self.slave:
                port.unlink()

        stack.callback(remove)

    def watch(self, waiter: Waiter) -> None:
        """Let a waiter also wait for the line's bytes and for a program that opens the port."""
        super().watch(waiter)
        waiter.watch_terminal(self.fd)

    def was_opened(self) -> bool:
        """Return whether a program has opened the port since the last call.

        An opening counts only if the port was closed before. POLLHUP alone would miss a program
        that closes and reopens the port at once. (If a second program opens and closes a port that
        is already open, the next opening counts although the port is open. The daemon prevents
        this: it opens the port exclusively.)
        """
        opened = False
        for _, mask, _, _ in _INOTIFY_EVENT.iter_unpack(self._opened.read(4096) or b""):
            opened |= self._closed and bool(mask & IN_OPEN)
            self._closed = bool(mask & IN_CLOSE)
        self.connected |= opened
        return opened

    def flush(self) -> None:
        """Discard the waiting bytes of both directions."""
        super().flush()
        termios.tcflush(self.fd, termios.TCIOFLUSH)


def _watch(path: Path) -> int:
    """Return an inotify descriptor that reports each opening and closing of `path`."""
    fd: int = _libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
    if fd < 0 or _libc.inotify_add_watch(fd, os.fsencode(path), IN_OPEN | IN_CLOSE) < 0:
        msg = f"{path}: inotify: {os.strerror(ctypes.get_errno())}"
        if fd >= 0:
            os.close(fd)
        raise OperationError(msg)
    return fd
