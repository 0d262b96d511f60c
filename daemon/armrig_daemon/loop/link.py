"""The serial port, opened by pyserial and read and written without ever waiting."""

from __future__ import annotations

import contextlib
import os
import termios
from pathlib import Path

import serial
from armrig_core.waiting import TERMINAL_BYTES

READ = 2048
"""Bytes handed on at once: with what is sent for them they fit into one record of the pipe."""


class LinkError(OSError):
    """The port cannot be opened or is gone; says which and why."""


class NoPortError(LinkError):
    """There is no such port: the rig may not be plugged in yet."""


class TakenPortError(LinkError):
    """Another program holds the port."""


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
            msg = f"{port} cannot be opened: {reason}"
            raise kind(msg) from err
        self.port = port
        self.fd = self._serial.fileno()
        self._rest = b""
        with contextlib.suppress(OSError, ValueError, termios.error, NotImplementedError):
            # Best effort: a pseudo-terminal has no such mode, and needs none.
            self._serial.set_low_latency_mode(True)

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
            msg = f"{self.port} is gone: {err.strerror}"
            raise LinkError(msg) from err
        if not data:
            msg = f"{self.port} is gone: end of file"
            raise LinkError(msg)
        return data

    def write(self, data: bytes) -> None:
        """Send all of `data`, or fail: a frame is never left half sent in silence."""
        try:
            sent = os.write(self.fd, data)
        except BlockingIOError:
            sent = 0
        except OSError as err:
            msg = f"{self.port} is gone: {err.strerror}"
            raise LinkError(msg) from err
        if sent < len(data):
            msg = f"{self.port} takes no more bytes: the device does not read"
            raise LinkError(msg)

    def close(self) -> None:
        """Give the port back."""
        with contextlib.suppress(OSError, termios.error):
            self._serial.close()


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
        return (
            TakenPortError,
            "it is taken by another program, maybe another rig's daemon; end that one, or give "
            "this rig a port of its own",
        )
    if "permission" in text:
        return LinkError, "not permitted; add this user to the group of the port (dialout)"
    return LinkError, str(err).splitlines()[0]
