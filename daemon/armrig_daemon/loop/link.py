"""The line to the device, read and written without ever waiting.

A serial port is opened by pyserial. An emulated rig may have a Unix socket in its place.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import termios
from pathlib import Path
from typing import Final

import serial
from armrig_core.emulator_socket import (
    folder_fault,
    is_socket,
    lock_path,
    peer_fault,
    socket_path,
)
from armrig_core.errors import ArmrigError
from armrig_core.waiting import TERMINAL_BYTES, Waiter

READ = 2048
"""Bytes handed on at once: with what is sent for them they fit into one record of the pipe."""
SEND_BUFFER_BYTES: Final = 1 << 16
"""SO_SNDBUF of a socket, in bytes: room for 171 frames, each of which takes about 0.75 kB of it.

At Ts 0.5 ms an exchange sends 100 frames in the 50 ms after which S4 ends it. More room would only
give the device more old frames.
"""

_TAKEN = (
    "it is taken by another program, maybe another rig's daemon; end that one, or give "
    "this rig a port of its own"
)


class LinkError(ArmrigError, OSError):
    """The port cannot be opened or is gone; says which and why."""


class NoPortError(LinkError):
    """There is no such port: the rig may not be plugged in yet."""


class TakenPortError(LinkError):
    """Another program holds the port."""


def open_link(port: str, baud: int) -> Link:
    """Open a serial port, or the socket of an emulated rig if `port` is `unix:PATH`.

    Raises
    ------
    LinkError
        The port cannot be opened; `NoPortError` if it is not there, `TakenPortError` if another
        program holds it.
    """
    try:
        path = socket_path(port)
    except ValueError as err:
        raise LinkError(str(err)) from err
    return Link(port, baud) if path is None else SocketLink(port, path)


class Link:
    """An open port. Each failure of it is a `LinkError`.

    Reading takes all that the terminal holds, in one call: another one would find it empty, and on
    an empty terminal the kernel waits for its worker before it says so.
    """

    def __init__(self, port: str, baud: int) -> None:
        """Open `port` for us alone."""
        try:
            self._serial = serial.Serial(
                port, baudrate=baud, timeout=0, write_timeout=0, exclusive=True
            )
            _tell_nothing_from_the_end(self._serial.fileno())
        except (OSError, ValueError, termios.error) as err:
            kind, reason = _reason(port, err)
            raise kind(f"{port} cannot be opened: {reason}") from err
        self._begin(port, self._serial.fileno())
        with contextlib.suppress(OSError, ValueError, termios.error, NotImplementedError):
            # Best effort: a pseudo-terminal has no such mode, and needs none.
            self._serial.set_low_latency_mode(True)

    def _begin(self, port: str, fd: int) -> None:
        self.port = port
        self.fd = fd
        self._rest = b""

    def watch(self, waiter: Waiter) -> None:
        """Add the port to a waiter, which reports each arrival of bytes once."""
        waiter.watch_terminal(self.fd)

    @property
    def has_rest(self) -> bool:
        """Whether bytes were read that `read` has not returned yet."""
        return bool(self._rest)

    def read(self) -> bytes:
        """Return bytes that are there, at most `READ`, the oldest first."""
        data = self._rest or self._read_terminal()
        self._rest = data[READ:]
        return data[:READ]

    def _read_terminal(self) -> bytes:
        try:
            data = os.read(self.fd, TERMINAL_BYTES)
        except BlockingIOError:
            return b""
        except OSError as err:
            raise LinkError(f"{self.port} is gone: {err.strerror}") from err
        if not data:
            raise LinkError(f"{self.port} is gone: end of file")
        return data

    def write(self, data: bytes) -> None:
        """Send all of `data`, or fail: a frame is never left half sent in silence."""
        try:
            sent = os.write(self.fd, data)
        except BlockingIOError:
            sent = 0
        except OSError as err:
            raise LinkError(f"{self.port} is gone: {err.strerror}") from err
        if sent < len(data):
            raise LinkError(f"{self.port} takes no more bytes: the device does not read")

    def close(self) -> None:
        """Give the port back."""
        with contextlib.suppress(OSError, termios.error):
            self._serial.close()


class SocketLink(Link):
    """An open socket of an emulated rig, whose bytes no kernel worker carries.

    One program at a time opens it, as it does a port, and the opening resets the device.
    """

    def __init__(self, port: str, path: Path) -> None:
        """Open the socket at `path` for us alone."""
        with contextlib.ExitStack() as stack:
            try:
                connection = _connected(path, stack)
            except OSError as err:
                kind, reason = _socket_reason(port, err)
                raise kind(f"{port} cannot be opened: {reason}") from err
            self._held = stack.pop_all()
        self._begin(port, connection.fileno())

    def watch(self, waiter: Waiter) -> None:
        """Add the socket to a waiter, by level: to look at a socket never waits."""
        waiter.watch(self.fd)

    def close(self) -> None:
        """Give the port back."""
        self._held.close()


def _connected(path: Path, stack: contextlib.ExitStack) -> socket.socket:
    """Lock the port and connect to its emulator; `stack` closes first the socket, then the lock."""
    if fault := folder_fault(path):
        raise LinkError(fault)
    if not is_socket(path):
        raise LinkError("it is no socket; give that of an emulator")
    lock = os.open(lock_path(path), os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
    stack.callback(os.close, lock)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise TakenPortError(_TAKEN) from None
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    stack.enter_context(connection)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    connection.connect(os.fspath(path))
    if fault := peer_fault(connection):
        raise LinkError(fault)
    return connection


def _tell_nothing_from_the_end(fd: int) -> None:
    """Have a read of a line with nothing on it fail with EAGAIN; pyserial has it give 0 bytes."""
    attributes = termios.tcgetattr(fd)
    attributes[6][termios.VMIN] = 1
    termios.tcsetattr(fd, termios.TCSANOW, attributes)


def latency_timer_ms(port: str) -> int | None:
    """Return the latency timer of an FTDI adapter, in ms, or None for any other port."""
    name = Path(port).resolve().name
    with contextlib.suppress(OSError, ValueError):
        path = Path("/sys/bus/usb-serial/devices") / name / "latency_timer"
        return int(path.read_text(encoding="ascii"))
    return None


def _socket_reason(port: str, err: OSError) -> tuple[type[LinkError], str]:
    if isinstance(err, LinkError):
        return type(err), str(err)
    if isinstance(err, FileNotFoundError):
        return NoPortError, f"it is not there; start `armrigd emulate --port {port}`"
    if isinstance(err, ConnectionRefusedError):
        return NoPortError, f"no emulator answers; start `armrigd emulate --port {port}`"
    if isinstance(err, BlockingIOError):
        return LinkError, "its emulator accepts no connection; end it, and start it again"
    return LinkError, err.strerror or str(err)


def _reason(port: str, err: Exception) -> tuple[type[LinkError], str]:
    if not Path(port).exists():
        return (
            NoPortError,
            "it is not there; plug the rig in, or give its port as [device] port",
        )
    text = str(err).lower()
    if not Path(port).is_char_device() or "inappropriate ioctl" in text:
        return LinkError, "it is no serial port; give that of the rig, such as /dev/ttyACM0"
    if "exclusively lock" in text or "busy" in text:
        return TakenPortError, _TAKEN
    if "permission" in text:
        return LinkError, "not permitted; add this user to the group of the port (dialout)"
    return LinkError, str(err).splitlines()[0]
