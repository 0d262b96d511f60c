"""Where the firmware's binary is, and the harness that runs it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from armrig_core.errors import FileError, OperationError
from armrig_core.firmware_image import read_image, shipped_image

VARIABLE = "ARMRIG_FIL"
_PROTOCOL = Path(__file__).parents[3] / "firmware_protocol"  # of a checkout


def harness_program(environ: Mapping[str, str], checkout: Path = _PROTOCOL) -> Path:
    """Return the harness: what ARMRIG_FIL names, or that of the checkout.

    Raises
    ------
    OperationError
        There is none; says how to build it.
    """
    program = Path(environ.get(VARIABLE) or checkout / "simavr" / "fil")
    if not program.is_file():
        raise OperationError(
            f"{program}: no such program; build it in a checkout by `make fil` (Debian's "
            f"libsimavr-dev), or say by {VARIABLE} where it is"
        )
    return program


def firmware_image(image: Path | None) -> Path:
    """Return the firmware to run: `image`, or the Uno's that is shipped.

    Raises
    ------
    OperationError
        The file does not exist, cannot be read, or is not a complete Intel HEX file.
    """
    found = image or shipped_image()
    if not found.is_file():
        raise OperationError(f"{found}: no such firmware; `make firmware` builds it in a checkout")
    try:
        read_image(found)  # simavr runs a file that was cut off, up to the cut
    except FileError as err:
        raise OperationError(str(err)) from err
    except OSError as err:
        raise OperationError(f"{found}: {err.strerror}") from err
    return found
