"""Layouts of the Uno: the pins of each image of the firmware.

The headers in firmware_protocol/firmware/boards/uno/layouts contain the same pins for the firmware.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

from armrig_core.rig.firmware_image import image_crcs, read_image


class Layout(NamedTuple):
    """Pins of the board that an image uses."""

    pwm: str
    """PWM pin: D9 with the enable line D7, or D3 without an enable line."""
    pwm_bits: int
    period: int
    """Period of the PWM, in cycles."""
    first: int
    """Analogue pin of the first channel, which is converted last."""
    second: int
    """Analogue pin of the second channel; the same pin if the rig has one sensor."""


LAYOUTS: Final = {
    "uno": Layout("D9", 10, 1 << 10, 0, 1),
    "tclab": Layout("D3", 8, 8 << 8, 0, 2),
    "heatshield": Layout("D3", 8, 8 << 8, 0, 0),
    "optoshield": Layout("D3", 8, 8 << 8, 1, 1),
}
"""Layouts by the name of the image."""
ARM: Final = LAYOUTS["uno"]


def layout_of(image: Path) -> Layout:
    """Return the layout of an image by its CRC; the arm's for an image that is not armrig's."""
    crc = read_image(image).crc
    return next((LAYOUTS[name] for name, shipped in image_crcs().items() if shipped == crc), ARM)
