"""How avrdude is called, which writes a program by an Uno's boot loader, and what it says."""

from __future__ import annotations

import codecs
import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from selectors import EVENT_READ, DefaultSelector
from time import monotonic

CHIP = "ATmega328P"
FLASH_BYTES = 32256
"""What an Uno's boot loader (Optiboot, 512 B) leaves of 32 KiB, in B."""
LOADER_BAUD = 115_200
"""Speed of Optiboot's line, whatever the firmware's."""
INSTALL = "avrdude writes the firmware, and is not installed: apt install avrdude"
_LONGEST_S = 90.0  # three attempts to be heard take 17 s, an Uno full of program 10 s
_BLOCKS = 50  # a whole bar of avrdude's
_BAR = re.compile(r"(Reading|Writing|Verifying) +\| (#*)")
_NOT_WHOLE = "the board may hold half a program: leave the motor unplugged, and flash again"

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


class FlashError(RuntimeError):
    """avrdude did not write the program; says why, and what to do."""


Moved = Callable[[int, int, str], None]
"""Takes how many blocks of how many are done, and what is being done."""


def find() -> str | None:
    """Return avrdude's path, or None."""
    return shutil.which("avrdude")


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
    FlashError
        It failed, or did not end.
    """
    avrdude = subprocess.Popen(
        call, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    try:
        said = _read(avrdude, moved)
        code = avrdude.wait(timeout=_LONGEST_S)
    except subprocess.TimeoutExpired as err:
        msg = f"avrdude did not end within {_LONGEST_S:.0f} s; {_NOT_WHOLE}"
        raise FlashError(msg) from err
    except KeyboardInterrupt as err:
        msg = f"interrupted; {_NOT_WHOLE}"
        raise KeyboardInterrupt(msg) from err
    finally:
        avrdude.kill()
        avrdude.wait()
        if avrdude.stderr is not None:
            avrdude.stderr.close()
    if code:
        raise FlashError(reason(said))


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


def reason(said: str) -> str:
    """Return why avrdude failed, in a line for a person."""
    for pattern, meaning in _REASONS:
        if re.search(pattern, said, re.IGNORECASE):
            return meaning
    lines = [line.strip() for line in said.splitlines()]
    lines = [line for line in lines if re.match(r"avrdude(?: error| OS error)?: ", line)]
    # Of a port without such lines, as a pseudo-terminal: said at its end, whatever failed before.
    lines = [line for line in lines if "ioctl(" not in line]
    last = lines[-1] if lines else "nothing"
    return f"avrdude failed and said: {last}; {_NOT_WHOLE}"
