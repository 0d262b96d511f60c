"""Paths of the firmware's binary and of the harness that runs it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from armrig_core.errors import FileError, OperationError
from armrig_core.rig.firmware_image import read_image, shipped_image

VARIABLE = "ARMRIG_FIL"
_PROTOCOL = Path(__file__).parents[3] / "firmware_protocol"  # of a checkout


def harness_program(environ: Mapping[str, str], checkout: Path = _PROTOCOL) -> Path:
    """Return the path of the harness: the value of ARMRIG_FIL, or the program in the checkout.

    Raises
    ------
    OperationError
        The program does not exist; the message shows how to build it.
    """
    program = Path(environ.get(VARIABLE) or checkout / "simavr" / "fil")
    if not program.is_file():
        raise OperationError(
            f"{program}: no such program; build it in a checkout by `make fil` (Debian's "
            f"libsimavr-dev), or set {VARIABLE} to its path"
        )
    return program


def firmware_image(image: Path | None) -> Path:
    """Return the path of the firmware: `image`, or the shipped firmware of the Uno.

    Raises
    ------
    OperationError
        The file does not exist, cannot be read, or is not a complete Intel HEX file.
    """
    found = image or shipped_image()
    if not found.is_file():
        raise OperationError(f"{found}: no such firmware; `make firmware` builds it in a checkout")
    try:
        read_image(found)  # simavr would also run an incomplete file
    except FileError as err:
        raise OperationError(str(err)) from err
    except OSError as err:
        raise OperationError(f"{found}: {err.strerror}") from err
    return found
