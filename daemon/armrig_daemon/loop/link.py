"""The line to the device, read and written without waiting.

pyserial opens a serial port. An emulated rig may have a Unix socket instead.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import socket
import termios
from pathlib import Path
from typing import Final

import serial
from armrig_core.access.emulator_socket import (
    is_socket,
    lock_path,
    require_safe_folder,
    socket_path,
    stranger,
)
from armrig_core.errors import ArmrigError, InputError
from armrig_core.process.waiting import TERMINAL_BYTES, Waiter

READ = 2048
"""Largest number of bytes that a step handles; one record contains them and their answers."""
SEND_BUFFER_BYTES: Final = 1 << 16
"""SO_SNDBUF of a socket, in bytes. The kernel doubles it: 171 frames of about 0.75 kB fit.

In exchange mode, at most `MAX_UNECHOED` EXCHANGE frames have no answer yet. With more room, the
device would only receive more old frames after a stall.
"""

_TAKEN = (
    "it is in use by another program, maybe another rig's daemon; end that program, or give "
    "this rig a port of its own"
)


class LinkError(ArmrigError, OSError):
    """The port cannot be opened or is gone; the message names the port and the reason."""


class NoPortError(LinkError):
    """The port does not exist: the rig may not be plugged in yet."""


class TakenPortError(LinkError):
    """Another program holds the port."""


def open_link(port: str, baud: int) -> Link:
    """Open a serial port, or the socket of an emulated rig if `port` is `unix:PATH`.

    Raises LinkError if the port cannot be opened; `NoPortError` if it does not exist,
    `TakenPortError` if another program has opened it.
    """
    try:
        path = socket_path(port)
    except ValueError as err:
        raise LinkError(str(err)) from err
    return Link(port, baud) if path is None else SocketLink(port, path)


class Link:
    """Open port. Each failure of the port raises a `LinkError`.

    A single call reads all received bytes. A second call would be slow, because it would find the
    terminal empty: the kernel returns from such a read only after a kernel worker has run.
    """

    def __init__(self, port: str, baud: int) -> None:
        """Open `port` exclusively."""
        try:
            self._serial = serial.Serial(
                port, baudrate=baud, timeout=0, write_timeout=0, exclusive=True
            )
            _distinguish_empty_from_end(self._serial.fileno())
        except (OSError, ValueError, termios.error) as err:
            kind, reason = _reason(port, err)
            raise kind(f"{port} cannot be opened: {reason}") from err
        self._begin(port, self._serial.fileno())
        with contextlib.suppress(OSError, ValueError, termios.error, NotImplementedError):
            # A failure is ignored: a pseudo-terminal has no low-latency mode, and needs none.
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
        """True if `read` has not returned all received bytes yet."""
        return bool(self._rest)

    def read(self) -> bytes:
        """Return the received bytes, at most `READ`, the oldest first."""
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
        """Send all of `data`; raise LinkError if the port accepts only a part."""
        try:
            sent = os.write(self.fd, data)
        except BlockingIOError:
            sent = 0
        except OSError as err:
            raise LinkError(f"{self.port} is gone: {err.strerror}") from err
        if sent < len(data):
            why = "because the device does not read them"
            raise LinkError(f"{self.port} accepts no more bytes, {why}")

    def close(self) -> None:
        """Give the port back."""
        with contextlib.suppress(OSError, termios.error):
            self._serial.close()


class SocketLink(Link):
    """Open socket of an emulated rig; unlike a terminal, it is read without a kernel worker.

    As with a serial port, only one program at a time can open the socket, and opening it resets the
    device.
    """

    def __init__(self, port: str, path: Path) -> None:
        """Open the socket at `path` exclusively."""
        with contextlib.ExitStack() as stack:
            try:
                connection = _connect(path, stack)
            except OSError as err:
                kind, reason = _socket_reason(port, err)
                raise kind(f"{port} cannot be opened: {reason}") from err
            self._held = stack.pop_all()
        self._begin(port, connection.fileno())

    def watch(self, waiter: Waiter) -> None:
        """Add the socket to a waiter, level-triggered; querying a socket needs no kernel worker."""
        waiter.watch(self.fd)

    def close(self) -> None:
        """Give the port back."""
        self._held.close()


def _connect(path: Path, stack: contextlib.ExitStack) -> socket.socket:
    """Lock the port and connect to its emulator; `stack` later closes the socket, then the lock."""
    try:
        require_safe_folder(path)
    except InputError as err:
        raise LinkError(str(err)) from err
    if not is_socket(path):
        raise LinkError("it is no socket; give the socket of an emulator")
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
    if (uid := stranger(connection)) is not None:
        raise LinkError(
            f"a program of another user (uid {uid}) answers; start the emulator as this user"
        )
    return connection


def _distinguish_empty_from_end(fd: int) -> None:
    """Let a read of an empty line fail with EAGAIN; pyserial's setting lets it return 0 bytes."""
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
    # pyserial passes on the errno of opening and locking; the errno of termios is in the context.
    unset = err if isinstance(err, termios.error) else err.__context__
    number = unset.args[0] if isinstance(unset, termios.error) else getattr(err, "errno", None)
    if not Path(port).is_char_device() or number == errno.ENOTTY:
        return LinkError, "it is no serial port; give the rig's port, such as /dev/ttyACM0"
    if number in (errno.EAGAIN, errno.EBUSY):
        return TakenPortError, _TAKEN
    if number in (errno.EACCES, errno.EPERM):
        return LinkError, "not permitted; add this user to the group of the port (dialout)"
    return LinkError, str(err).splitlines()[0]
