"""How avrdude is called, which writes a program by an Uno's boot loader, and what it says."""

from __future__ import annotations

import codecs
import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from selectors import EVENT_READ, DefaultSelector
from tempfile import TemporaryFile
from time import monotonic

from armrig_core.errors import OperationError

CHIP = "ATmega328P"
FLASH_BYTES = 32256
"""What an Uno's boot loader (Optiboot, 512 B) leaves of 32 KiB, in B."""
LOADER_BAUD = 115_200
"""Speed of Optiboot's line, whatever the firmware's."""
OLD_LOADER_BAUD = 57_600
"""Speed of ATmegaBOOT's line, the boot loader of boards before the Uno and of some copies."""
OPTIBOOT_MAJOR = 4
"""Least major version of an Optiboot of an Uno; ATmegaBOOT says 1.16."""
BROWN_OUT = {4: "4.3 V", 5: "2.7 V", 6: "1.8 V", 7: "none"}
"""Brown-out level by the three low bits of the extended fuse (data sheet, table 28-5)."""
WANTED_FUSE = 0xFC
"""Extended fuse of 4.3 V: 16 MHz want 3.8 V at least (data sheet, figure 29-1)."""
INSTALL = "avrdude writes the firmware, and is not installed: apt install avrdude"
_LONGEST_S = 90.0  # three attempts to be heard take 17 s, an Uno full of program 10 s
_BLOCKS = 50  # a whole bar of avrdude's
_BAR = re.compile(r"(Reading|Writing|Verifying) +\| (#*)")
_NOT_WHOLE = "the board may hold half a program: leave the motor unplugged, and flash again"
_UNTOUCHED = "nothing was written"

# What avrdude's lines mean, the first that is found; 7.1 and 6.3 say them alike.
_REASONS = (
    (
        r"expected signature for|invalid device signature",
        f"the chip on the board is no {CHIP}: it is no Uno; nothing was written",
    ),
    (
        r"verif\w+ (?:error|mismatch)",
        f"what the board holds is not what was written; {_NOT_WHOLE}",
    ),
    (
        r"not in sync|not responding|protocol e|unable to open programmer|can't open programmer",
        "the board's boot loader does not answer; another cable or socket may help, and another "
        "program must not have the port; it must be an Uno with Optiboot",
    ),
)
_OLD_LOADER = (
    "the boot loader is ATmegaBOOT or one like it, and not Optiboot: it may leave the hardware's "
    "watchdog on, and a board that this has reset would be reset for ever; nothing was written. "
    "Write Optiboot by an ISP programmer (docs/hardware.md), or take an Uno"
)


Moved = Callable[[int, int, str], None]
"""Takes how many blocks of how many are done, and what is being done."""


def find() -> str | None:
    """Return avrdude's path, or None."""
    return shutil.which("avrdude")


def loader(program: str, port: str) -> str:
    """Return the version of the board's Optiboot, such as "4.4".

    Raises
    ------
    OperationError
        The boot loader does not answer, or is another one.
    """
    try:
        said = _run(_question(program, port, LOADER_BAUD), _ignore, _UNTOUCHED)[1]
    except OperationError as silent:
        try:
            _run(_question(program, port, OLD_LOADER_BAUD), _ignore, _UNTOUCHED)
        except OperationError:
            raise silent from None
        raise OperationError(_OLD_LOADER) from None
    found = re.search(r"Firmware Version *: *(\d+)\.(\d+)", said)
    if found is None or int(found[1]) < OPTIBOOT_MAJOR:
        raise OperationError(_OLD_LOADER)
    return f"{found[1]}.{found[2]}"


def _question(program: str, port: str, baud: int) -> list[str]:
    """Return the call that asks a boot loader for its version, and writes nothing."""
    chosen = ("-p", CHIP.lower(), "-c", "arduino", "-P", port, "-b", str(baud))
    return [program, *chosen, "-x", "attempts=3", "-v"]


def fuse(program: str, programmer: str, port: str | None) -> int:
    """Return the extended fuse, read by an ISP programmer; no boot loader of an Uno reads it.

    Raises
    ------
    OperationError
        It cannot be read.
    """
    at = [] if port is None else ["-P", port]
    call = [program, "-p", CHIP.lower(), "-c", programmer, *at, "-U", "efuse:r:-:h"]
    try:
        out = _run(call, _ignore, _UNTOUCHED)[0].split()
    except OperationError as err:
        msg = (
            f"avrdude reads nothing by {programmer}: plug the programmer in, and connect it to the "
        )
        raise OperationError(f"{msg}board's ISP pins; --port names its port if it has one") from err
    value = int(out[-1], 16) if out and re.fullmatch("0x[0-9a-f]{1,2}", out[-1]) else 0
    if not value:
        msg = f"avrdude reads no extended fuse by {programmer}: a boot loader answers 0 to it; "
        raise OperationError(msg + "an ISP programmer is needed, such as usbasp")
    return value


def command(program: str, *, port: str, image: Path) -> list[str]:
    """Return the call that writes `image` and reads it back."""
    return [
        program,
        *("-p", CHIP.lower(), "-c", "arduino", "-P", port, "-b", str(LOADER_BAUD)),
        "-D",  # Optiboot erases each page by itself, and knows no erasing of the whole chip
        *("-x", "attempts=3"),  # of 10, which take a minute
        *("-U", f"flash:w:{image}:i"),
    ]


def write(call: Sequence[str], moved: Moved) -> None:
    """Run avrdude, and tell `moved` how far it is.

    Raises
    ------
    OperationError
        It failed, or did not end.
    """
    _run(call, moved, _NOT_WHOLE)


def _run(call: Sequence[str], moved: Moved, after: str) -> tuple[str, str]:
    """Return what avrdude printed and what it said; `after` is what a failure leaves behind."""
    with TemporaryFile() as printed:
        avrdude = subprocess.Popen(
            call, stdin=subprocess.DEVNULL, stdout=printed, stderr=subprocess.PIPE
        )
        try:
            said = _read(avrdude, moved)
            code = avrdude.wait(timeout=_LONGEST_S)
        except subprocess.TimeoutExpired as err:
            raise OperationError(f"avrdude did not end within {_LONGEST_S:.0f} s; {after}") from err
        except KeyboardInterrupt as err:
            raise KeyboardInterrupt(f"interrupted; {after}") from err
        finally:
            avrdude.kill()
            avrdude.wait()
            if avrdude.stderr is not None:
                avrdude.stderr.close()
        if code:
            raise OperationError(reason(said, after))
        printed.seek(0)
        return printed.read(4096).decode("ascii", "replace"), said


def _ignore(done: int, total: int, name: str) -> None:
    """Take no note of progress."""


def _read(avrdude: subprocess.Popen[bytes], moved: Moved) -> str:
    """Return all that avrdude says, up to its end."""
    until_s = monotonic() + _LONGEST_S
    decoder = codecs.getincrementaldecoder("utf-8")("replace")
    said = ""
    if avrdude.stderr is None:
        return said
    with DefaultSelector() as selector:
        selector.register(avrdude.stderr, EVENT_READ)
        while True:
            left_s = until_s - monotonic()
            if left_s <= 0 or not selector.select(left_s):
                raise subprocess.TimeoutExpired(avrdude.args, _LONGEST_S)
            piece = avrdude.stderr.read1(4096)  # type: ignore[attr-defined]
            if not piece:
                return said
            said += decoder.decode(piece)
            moved(*progress(said))


def progress(said: str) -> tuple[int, int, str]:
    """Return how many blocks of how many avrdude's newest bar shows, and what it does."""
    bars = _BAR.findall(said)
    if not any(doing == "Writing" for doing, _ in bars):  # what is read before is the signature
        return 0, _BLOCKS, "asking the boot loader"
    doing, blocks = bars[-1]
    return len(blocks), _BLOCKS, "writing" if doing == "Writing" else "reading back"


def reason(said: str, after: str = _NOT_WHOLE) -> str:
    """Return why avrdude failed, in a line for a person."""
    for pattern, meaning in _REASONS:
        if re.search(pattern, said, re.IGNORECASE):
            return meaning
    lines = [line.strip() for line in said.splitlines()]
    lines = [line for line in lines if re.match(r"avrdude(?: error| OS error)?: ", line)]
    # Of a port without such lines, as a pseudo-terminal: said at its end, whatever failed before.
    lines = [line for line in lines if "ioctl(" not in line]
    last = lines[-1] if lines else "nothing"
    return f"avrdude failed and said: {last}; {after}"
