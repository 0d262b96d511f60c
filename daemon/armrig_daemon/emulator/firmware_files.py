"""Where the firmware's binary is, and the harness that runs it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from armrig_core.firmware_image import shipped_image

from armrig_daemon.emulator.harness import HarnessError

VARIABLE = "ARMRIG_FIL"
_PROTOCOL = Path(__file__).parents[3] / "firmware_protocol"  # of a checkout


def harness_program(environ: Mapping[str, str], checkout: Path = _PROTOCOL) -> Path:
    """Return the harness: what ARMRIG_FIL names, or that of the checkout.

    Raises
    ------
    HarnessError
        There is none; says how to build it.
    """
    program = Path(environ.get(VARIABLE) or checkout / "fil" / "fil")
    if not program.is_file():
        msg = (
            f"{program}: no such program; build it in a checkout by `make fil` (Debian's "
            f"libsimavr-dev), or say by {VARIABLE} where it is"
        )
        raise HarnessError(msg)
    return program


def firmware_image(image: Path | None) -> Path:
    """Return the firmware to run: `image`, or the Uno's that is shipped.

    Raises
    ------
    HarnessError
        There is none; says which file was looked for.
    """
    found = image or shipped_image()
    if not found.is_file():
        msg = f"{found}: no such firmware; `make firmware` builds it in a checkout"
        raise HarnessError(msg)
    return found
