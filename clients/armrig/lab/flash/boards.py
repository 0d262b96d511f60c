"""Which boards are plugged in, and which of them is meant."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import serial
from armrig_core.errors import OperationError
from armrig_protocol.decoder import feed
from armrig_protocol.frame import encode
from armrig_protocol.messages import SCHEMA_HASH, VERSION, Hello, HelloReply

_UNOS = {
    (0x2341, 0x0043): "Arduino Uno R3",
    (0x2341, 0x0001): "Arduino Uno",
    (0x2A03, 0x0043): "Arduino Uno R3 (arduino.org)",
    (0x1A86, 0x7523): "Uno with a CH340",
}
"""By USB vendor and product. The CH340 is on other boards, too: avrdude asks the chip itself."""
_FREE_PORT = (
    "end it first, which leaves the motor at 0 V: Ctrl-C where `armrig lab` or `armrigd run` runs, "
    "or `systemctl stop armrigd@ID`"
)
WITHIN_S = 6.0
"""How long a board may take: its boot loader listens for a second or two, in s."""
_AGAIN_S = 0.25  # what comes during the boot is lost


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """A board at a serial port."""

    port: str
    name: str
    is_uno: bool
    """Whether it is known to be an Uno."""

    def __str__(self) -> str:
        """Return the board and where it is."""
        return f"{self.name} at {self.port}"


def plugged_in() -> list[Board]:
    """Return the boards at this machine's USB, in the order of their ports."""
    from serial.tools.list_ports import comports

    return [
        _board(port.device, port.vid, port.pid, port.description)
        for port in sorted(comports())
        if port.vid is not None
    ]


def chosen(port: str | None, boards: Sequence[Board]) -> Board:
    """Return the board at `port`, or the only Uno that is plugged in.

    Raises
    ------
    OperationError
        There is no such port; or none is given, and no Uno or more than one is there.
    """
    if port is not None:
        return _at(port, boards)
    unos = [board for board in boards if board.is_uno]
    if len(unos) == 1:
        return unos[0]
    if unos:
        msg = f"{len(unos)} boards: {_list(unos)}; say by --port which one"
    elif boards:
        msg = f"no Uno is plugged in, but {_list(boards)}; if it is one, say so by --port"
    else:
        msg = "no board is plugged in by USB; plug an Uno in, or give its port by --port"
    raise OperationError(msg)


@contextmanager
def held(board: Board) -> Iterator[None]:
    """Hold the board's port during the block, so that no daemon takes it.

    A daemon holds its port by the same lock. Where one does, not a byte is sent and no line of the
    port is moved: the port is open already, so that our opening does not reset the board.

    Raises
    ------
    OperationError
        The port cannot be opened, or somebody holds it.
    """
    port = board.port
    try:
        fd = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except PermissionError as err:
        raise OperationError(
            f"{port}: not permitted; add this user to the group of the port (dialout)"
        ) from err
    except OSError as err:
        raise OperationError(f"{port} cannot be opened: {err.strerror}") from err
    try:
        if not os.isatty(fd):
            raise OperationError(
                f"{port} is no serial port; give that of the board, such as /dev/ttyACM0"
            )
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as err:
            raise OperationError(
                f"{port} is held by another program, such as a rig's daemon; {_FREE_PORT}"
            ) from err
        yield
    finally:
        os.close(fd)


def _at(port: str, boards: Sequence[Board]) -> Board:
    if not Path(port).exists():
        there = f"; there is {_list(boards)}" if boards else ""
        raise OperationError(f"{port} is not there{there}")
    real = str(Path(port).resolve())  # of /dev/armrig-SERIAL
    for board in boards:
        if board.port == real:
            return Board(port=port, name=board.name, is_uno=board.is_uno)
    return Board(port=port, name="unknown board: no USB device", is_uno=False)


def _board(port: str, vendor: int, product: int, description: str) -> Board:
    name = _UNOS.get((vendor, product), "")
    ids = f"{vendor:04X}:{product:04X}"
    unknown = f"unknown board: {description or 'without a name'} ({ids})"
    return Board(port=port, name=f"{name} ({ids})" if name else unknown, is_uno=bool(name))


def _list(boards: Sequence[Board]) -> str:
    return ", ".join(map(str, boards))


def greeting(port: str, baud: int, within_s: float = WITHIN_S) -> HelloReply | None:
    """Open the port, which resets an Uno, and return its answer to HELLO; None where none comes.

    HELLO commands nothing: whatever the board runs, the motor does not turn by it. The caller
    holds the port (`boards.held`).

    Raises
    ------
    OperationError
        The port cannot be opened, or is gone.
    """
    until_s = time.monotonic() + within_s
    with _opened(port, baud) as line:
        pending, seq = b"", 0
        while time.monotonic() < until_s:
            line.write(b"\0" + encode(Hello(0, seq, VERSION, SCHEMA_HASH)))
            seq += 1
            again_s = time.monotonic() + _AGAIN_S
            while time.monotonic() < again_s:
                pending, messages = feed(pending, line.read(1) + line.read(line.in_waiting))
                for message in messages:
                    if isinstance(message, HelloReply):
                        return message
    return None


@contextmanager
def _opened(port: str, baud: int) -> Iterator[serial.Serial]:
    try:
        with serial.Serial(port, baudrate=baud, timeout=0.02, write_timeout=1.0) as line:
            yield line
    except (OSError, ValueError) as err:  # also SerialException, of a board that is unplugged
        raise OperationError(f"{port}: {' '.join(str(err).split())}") from err
