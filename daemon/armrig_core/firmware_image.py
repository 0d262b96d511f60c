"""A firmware's image: an Intel HEX file, and the bytes of flash in it.

That of the Uno is shipped: a user has no compiler for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from zlib import crc32

from armrig_core.bounded import read_bounded
from armrig_core.errors import FileError, InputError

UNO = "armrig-uno.hex"
_LONGEST_FILE = 1 << 20  # B; 256 KiB of flash, the most of its kind, are 0.7 MiB of text
_DATA, _END, _SEGMENT, _LINEAR = 0, 1, 2, 4
_STARTS = (3, 5)  # where the processor begins: an AVR begins at 0
_ERASED = 0xFF


@dataclass(frozen=True, slots=True, kw_only=True)
class FirmwareImage:
    """What is written to a board."""

    path: Path
    data: bytes
    """The flash from address 0 on; a hole is FF, as erased flash is."""
    sha256: str
    """Of the file."""

    @property
    def crc(self) -> int:
        """CRC-32 of the data, by which the device says in HELLO_R which firmware it runs."""
        return crc32(self.data)


def shipped_image() -> Path:
    """Return the Uno's firmware: that of the wheel, or of the checkout."""
    wheel = Path(str(files("armrig_core"))) / "firmware" / UNO
    if wheel.is_file():
        return wheel
    return Path(__file__).parents[2] / "firmware_protocol" / "firmware" / UNO


def read_image(path: Path) -> FirmwareImage:
    """Read an Intel HEX file.

    Raises
    ------
    FileError
        It is none, is spoilt or cut off, or does not begin at address 0.
    OSError
        It cannot be read.
    """
    text = read_bounded(path, _LONGEST_FILE)
    try:
        data = _flash(text.decode("ascii").split())
    except ValueError as err:
        raise FileError(f"{path}: no firmware in Intel HEX: {err}") from err
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
            return _joined(memory)
        elif kind not in _STARTS:
            raise InputError(f"line {number} is of the unknown kind {kind}")
    raise InputError("it has no end; maybe it was cut off")


def _record(line: str, number: int) -> tuple[int, int, bytes]:
    """Return the kind of a record, its address and its data."""
    try:
        text = bytes.fromhex(line.removeprefix(":"))
    except ValueError:
        text = b""
    if not line.startswith(":") or len(text) < 5 or len(text) != text[0] + 5:
        raise InputError(f"line {number} is no record")
    if sum(text) & 0xFF:
        raise InputError(f"the checksum of line {number} is wrong")
    return text[3], int.from_bytes(text[1:3], "big"), text[4:-1]


def _joined(memory: dict[int, bytes]) -> bytes:
    if 0 not in memory:
        raise InputError("nothing stands at address 0, where the processor begins")
    end = max(address + len(data) for address, data in memory.items())
    if end > _LONGEST_FILE:
        raise InputError(f"it goes up to address {end:#x}")
    flash = bytearray([_ERASED]) * end
    for address, data in memory.items():
        flash[address : address + len(data)] = data
    return bytes(flash)
