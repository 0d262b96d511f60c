"""Firmware image: an Intel HEX file, and the bytes of flash that the file contains.

The wheel contains an image for each layout of the Uno, because users have no compiler for the
firmware.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from zlib import crc32

from armrig_core.errors import FileError, InputError
from armrig_core.process.bounded import read_bounded

IMAGES = ("uno", "tclab", "heatshield", "optoshield")
"""Names of the images: the arm's, and one for each supported shield."""
WITH_ENABLE_LINE = ("uno",)
"""Names of the images with an enable line, which switches the driver off outside a run."""
_MAX_FILE_B = 1 << 20  # 256 KiB of flash, the largest AVR, are 0.7 MiB of text
_DATA, _END, _SEGMENT, _LINEAR = 0, 1, 2, 4
_START_KINDS = (3, 5)  # address where the processor begins: an AVR begins at 0
_ERASED_BYTE = 0xFF


@dataclass(frozen=True, slots=True, kw_only=True)
class FirmwareImage:
    """Contents of a board's flash."""

    path: Path
    data: bytes
    """Bytes of the flash from address 0 on; a gap is filled with FF, like erased flash."""
    sha256: str
    """SHA-256 of the file."""

    @property
    def crc(self) -> int:
        """CRC-32 of the data, by which the device identifies its firmware in HELLO_R."""
        return crc32(self.data)


def image_path(name: str = "uno") -> Path:
    """Return the path of an image of `IMAGES`, in the wheel or in the checkout.

    Raises InputError if armrig has no image of this name.
    """
    if name not in IMAGES:
        raise InputError(f"no image has the name {name!r}; the names are {', '.join(IMAGES)}")
    file = f"armrig-{name}.hex"
    wheel = Path(str(files("armrig_core"))) / "firmware" / file
    if wheel.is_file():
        return wheel
    return Path(__file__).parents[3] / "firmware_protocol" / "firmware" / file


@cache
def image_crcs() -> dict[str, int]:
    """Return the CRC of each image in HELLO_R, by the image's name."""
    return {name: read_image(image_path(name)).crc for name in IMAGES}


def read_image(path: Path) -> FirmwareImage:
    """Read an Intel HEX file.

    Raises FileError if the file is not Intel HEX, is damaged or cut off, or has no data at address
    0. Raises OSError if the file cannot be read.
    """
    text = read_bounded(path, _MAX_FILE_B)
    try:
        data = _flash(text.decode("ascii").split())
    except ValueError as err:
        raise FileError(f"{path}: not a firmware image in Intel HEX: {err}") from err
    return FirmwareImage(path=path, data=data, sha256=sha256(text).hexdigest())


def _flash(lines: list[str]) -> bytes:
    memory: dict[int, bytes] = {}
    base = 0
    for number, line in enumerate(lines, 1):
        kind, address, data = _record(line, number)
        if kind == _DATA:
            memory[base + address] = data
        elif kind in (_SEGMENT, _LINEAR) and len(data) == 2:
            base = int.from_bytes(data, "big") << (4 if kind == _SEGMENT else 16)
        elif kind == _END:
            return _flash_bytes(memory)
        elif kind not in _START_KINDS:
            raise InputError(f"line {number} has the unknown type {kind}")
    raise InputError("it has no end; the file may be cut off")


def _record(line: str, number: int) -> tuple[int, int, bytes]:
    """Return the type of a record, its address and its data."""
    try:
        text = bytes.fromhex(line.removeprefix(":"))
    except ValueError:
        text = b""
    if not line.startswith(":") or len(text) < 5 or len(text) != text[0] + 5:
        raise InputError(f"line {number} is not a record")
    if sum(text) & 0xFF:
        raise InputError(f"the checksum of line {number} is wrong")
    return text[3], int.from_bytes(text[1:3], "big"), text[4:-1]


def _flash_bytes(memory: dict[int, bytes]) -> bytes:
    if 0 not in memory:
        raise InputError("it has no data at address 0, where the processor begins")
    end = max(address + len(data) for address, data in memory.items())
    if end > _MAX_FILE_B:
        raise InputError(f"its last address is {end:#x}; at most {_MAX_FILE_B:#x} is allowed")
    flash = bytearray([_ERASED_BYTE]) * end
    for address, data in memory.items():
        flash[address : address + len(data)] = data
    return bytes(flash)
