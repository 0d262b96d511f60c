"""Calls of avrdude, which writes programs through an Uno's boot loader; parsing of its output."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Timer
from typing import IO, cast

import serial
from armrig_core.errors import OperationError
from armrig_core.process.printable import plural
from armrig_protocol.decoder import feed
from armrig_protocol.frame import encode
from armrig_protocol.messages import SCHEMA_HASH, VERSION, Hello, HelloReply

CHIP = "ATmega328P"
FLASH_BYTES = 32256
"""Size of an Uno's flash memory in B: 32 KiB minus the boot loader (Optiboot, 512 B)."""
LOADER_BAUD = 115_200
"""Baud rate of Optiboot; it does not depend on the baud rate of the firmware."""
OLD_LOADER_BAUD = 57_600
"""Baud rate of ATmegaBOOT, the boot loader of older boards and of some copies of the Uno."""
OPTIBOOT_MAJOR = 4
"""Least major version of an Uno's Optiboot; ATmegaBOOT reports version 1.16."""
_TIMEOUT_S = 90.0  # three attempts to connect take 17 s; writing all of an Uno's flash takes 10 s
_BLOCKS = 50  # length of avrdude's full progress bar
_BAR = re.compile(r"(Reading|Writing|Verifying) +\| (#*)")
_INCOMPLETE = "the program may be incomplete: leave the motor unplugged, and flash again"
_UNTOUCHED = "nothing was written"

# Meanings of avrdude's lines; the first match counts. Versions 7.1 and 6.3 print the same lines.
_REASONS = (
    (
        r"expected signature for|invalid device signature",
        f"the chip on the board is not an {CHIP}, so it is not an Uno; nothing was written",
    ),
    (
        r"verif\w+ (?:error|mismatch)",
        f"the board's memory differs from the written program; {_INCOMPLETE}",
    ),
    (
        r"not in sync|not responding|protocol e|unable to open programmer|can't open programmer",
        "the board's boot loader does not answer; another cable or socket may help, and another "
        "program must not use the port; the board must be an Uno with Optiboot",
    ),
)
_OLD_LOADER = (
    "the boot loader is ATmegaBOOT or similar, not Optiboot: it may leave the hardware's watchdog "
    "on, so that the board would be reset for ever; nothing was written. Write Optiboot with an "
    "ISP programmer (docs/hardware.md), or use an Uno"
)


Moved = Callable[[int, int, str], None]
"""Callback with the number of blocks done, the number of all blocks, and the current step."""
_UNOS = {
    (0x2341, 0x0043): "Arduino Uno R3",
    (0x2341, 0x0001): "Arduino Uno",
    (0x2A03, 0x0043): "Arduino Uno R3 (arduino.org)",
    (0x1A86, 0x7523): "Uno with a CH340",
}
"""Names by USB vendor and product. Other boards use the CH340, too, so avrdude checks the chip."""
_LEONARDOS = {(0x2341, 0x8036), (0x2341, 0x0036), (0x2A03, 0x8036), (0x2A03, 0x0036)}
"""USB ids of the board and of its boot loader."""
_FREE_PORT = (
    "end that program first, so that it sets the motor to 0 V: press Ctrl-C in `armrig lab` or "
    "`armrigd run`, or run `systemctl stop armrigd@ID`"
)
WITHIN_S = 6.0
"""Longest time until a board answers, in s; its boot loader first waits for a second or two."""
_REPEAT_S = 0.25  # bytes during the boot are lost


def find() -> str:
    """Return the path of avrdude; raise OperationError if it is not installed."""
    program = shutil.which("avrdude")
    if program is None:
        raise OperationError(
            "avrdude, which writes the firmware, is not installed: apt install avrdude"
        )
    return program


def loader(program: str, port: str) -> str:
    """Return the version of the board's Optiboot, such as "4.4".

    Raises OperationError if the boot loader does not answer, or is not Optiboot.
    """
    try:
        output = _run(_question(program, port, LOADER_BAUD), _ignore, _UNTOUCHED)
    except OperationError as silent:
        try:
            _run(_question(program, port, OLD_LOADER_BAUD), _ignore, _UNTOUCHED)
        except OperationError:
            raise silent from None
        raise OperationError(_OLD_LOADER) from None
    match = re.search(r"Firmware Version *: *(\d+)\.(\d+)", output)
    if match is None or int(match[1]) < OPTIBOOT_MAJOR:
        raise OperationError(_OLD_LOADER)
    return f"{match[1]}.{match[2]}"


def _question(program: str, port: str, baud: int) -> list[str]:
    """Return the command line that reads a boot loader's version and writes nothing."""
    options = ("-p", CHIP.lower(), "-c", "arduino", "-P", port, "-b", str(baud))
    return [program, *options, "-x", "attempts=3", "-v"]


def command(program: str, *, port: str, image: Path) -> list[str]:
    """Return the command line that writes `image` to the board and verifies the written data."""
    return [
        program,
        *("-p", CHIP.lower(), "-c", "arduino", "-P", port, "-b", str(LOADER_BAUD)),
        "-D",  # Optiboot erases each page itself, and cannot erase the whole chip
        *("-x", "attempts=3"),  # the default, 10, takes a minute
        *("-U", f"flash:w:{image}:i"),
    ]


def write(call: Sequence[str], moved: Moved) -> None:
    """Run avrdude, and report its progress to `moved`.

    Raises OperationError if avrdude failed, or did not end in time.
    """
    _run(call, moved, _INCOMPLETE)


def _run(call: Sequence[str], moved: Moved, after: str) -> str:
    """Run avrdude, and return its messages. `after` is the end of an error's message."""
    none, output = subprocess.DEVNULL, ""
    with subprocess.Popen(
        call, stdin=none, stdout=none, stderr=subprocess.PIPE, text=True, errors="replace"
    ) as avrdude:
        ends = Timer(_TIMEOUT_S, avrdude.kill)
        ends.start()
        try:
            stderr = cast("IO[str]", avrdude.stderr)
            while character := stderr.read(1):  # a bar grows within its line
                output += character
                if character in "#\n":
                    moved(*progress(output))
            avrdude.wait()
        except KeyboardInterrupt as err:
            raise KeyboardInterrupt(f"interrupted; {after}") from err
        finally:
            is_late = not ends.is_alive()
            ends.cancel()
            avrdude.kill()
    if is_late:
        raise OperationError(f"avrdude did not end within {_TIMEOUT_S:.0f} s; {after}")
    if avrdude.returncode:
        raise OperationError(reason(output, after))
    return output


def _ignore(done: int, total: int, name: str) -> None:
    """Ignore the progress."""


def progress(output: str) -> tuple[int, int, str]:
    """Return the number of blocks done, the number of all blocks, and the current step."""
    bars = _BAR.findall(output)
    if not any(doing == "Writing" for doing, _ in bars):  # avrdude first reads the signature
        return 0, _BLOCKS, "asking the boot loader"
    doing, blocks = bars[-1]
    return len(blocks), _BLOCKS, "writing" if doing == "Writing" else "reading back"


def reason(output: str, after: str = _INCOMPLETE) -> str:
    """Return the reason why avrdude failed, in one line."""
    for pattern, meaning in _REASONS:
        if re.search(pattern, output, re.IGNORECASE):
            return meaning
    lines = [line.strip() for line in output.splitlines()]
    lines = [line for line in lines if re.match(r"avrdude(?: error| OS error)?: ", line)]
    # avrdude always ends with this message on a port without modem lines (a pseudo-terminal).
    lines = [line for line in lines if "ioctl(" not in line]
    last = lines[-1] if lines else "nothing"
    return f"avrdude failed and printed: {last}; {after}"


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialBoard:
    """A board at a serial port."""

    port: str
    name: str
    is_uno: bool
    """True if the board is known to be an Uno."""
    is_leonardo: bool = False
    """True if the board is a Leonardo, which has another processor (ATmega32U4)."""

    def __str__(self) -> str:
        """Return the board and its port."""
        return f"{self.name} at {self.port}"


def usb_boards() -> list[SerialBoard]:
    """Return the boards that are connected by USB, in the order of their ports."""
    from serial.tools.list_ports import comports

    return [
        _board(port.device, port.vid, port.pid, port.description)
        for port in sorted(comports())
        if port.vid is not None
    ]


def choose_board(port: str | None, boards: Sequence[SerialBoard]) -> SerialBoard:
    """Return the board at `port`, or the only Uno that is plugged in.

    Raises OperationError if `port` does not exist or belongs to a Leonardo, or if `port` is None
    and not exactly one Uno is plugged in.
    """
    if port is not None:
        refuse_leonardo(port, boards)
        return _at(port, boards)
    unos = [board for board in boards if board.is_uno]
    if len(unos) == 1:
        return unos[0]
    if unos:
        msg = f"{plural(len(unos), 'board')}: {_list(unos)}; choose one by --port"
    elif boards:
        msg = f"no Uno is plugged in, but {_list(boards)}; if it is an Uno, give --port"
    else:
        msg = "no board is plugged in by USB; plug an Uno in, or give its port by --port"
    raise OperationError(msg)


def refuse_leonardo(port: str, boards: Sequence[SerialBoard]) -> None:
    """Raise OperationError if the board at `port` is a Leonardo, which kits of TCLab contain."""
    real = str(Path(port).resolve())
    for board in boards:
        if board.port == real and board.is_leonardo:
            raise OperationError(
                f"{board}: armrig's firmware runs on an Uno ({CHIP}) only; put the shield on an Uno"
            )


@contextmanager
def lock_port(board: SerialBoard) -> Iterator[None]:
    """Lock the board's port during the block, so that no daemon uses it.

    A daemon locks its port in the same way. If a daemon holds the port, no byte is sent, and the
    board is not reset: only the first opening of a port resets the board.

    Raises OperationError if the port cannot be opened, or another program holds it.
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
                f"{port} is not a serial port; give the board's port, such as /dev/ttyACM0"
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


def _at(port: str, boards: Sequence[SerialBoard]) -> SerialBoard:
    if not Path(port).exists():
        there = f"; there is {_list(boards)}" if boards else ""
        raise OperationError(f"{port} does not exist{there}")
    real = str(Path(port).resolve())  # /dev/armrig-SERIAL is a link
    for board in boards:
        if board.port == real:
            return replace(board, port=port)
    return SerialBoard(port=port, name="unknown board: no USB device", is_uno=False)


def _board(port: str, vendor: int, product: int, description: str) -> SerialBoard:
    uno, is_leonardo = _UNOS.get((vendor, product)), (vendor, product) in _LEONARDOS
    unknown = f"unknown board: {description or 'without a name'}"
    name = uno or ("Arduino Leonardo" if is_leonardo else unknown)
    name += f" ({vendor:04X}:{product:04X})"
    return SerialBoard(port=port, name=name, is_uno=bool(uno), is_leonardo=is_leonardo)


def _list(boards: Sequence[SerialBoard]) -> str:
    return ", ".join(map(str, boards))


def greeting(port: str, baud: int, within_s: float = WITHIN_S) -> HelloReply | None:
    """Open the port, which resets an Uno, and return the answer to HELLO; None without an answer.

    HELLO contains no command, so the motor does not move, even if another program is on the board.
    The caller must hold the port (`held`).

    Raises OperationError if the port cannot be opened, or was removed.
    """
    until_s = time.monotonic() + within_s
    try:
        with serial.Serial(port, baudrate=baud, timeout=0.02, write_timeout=1.0) as line:
            pending, seq = b"", 0
            while time.monotonic() < until_s:
                line.write(b"\0" + encode(Hello(0, seq, VERSION, SCHEMA_HASH)))
                seq += 1
                repeat_s = time.monotonic() + _REPEAT_S
                while time.monotonic() < repeat_s:
                    pending, messages = feed(pending, line.read(1) + line.read(line.in_waiting))
                    for message in messages:
                        if isinstance(message, HelloReply):
                            return message
    except (OSError, ValueError) as err:  # also SerialException, if the board is unplugged
        raise OperationError(f"{port}: {' '.join(str(err).split())}") from err
    return None
