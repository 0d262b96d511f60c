"""Firmware images in Intel HEX, made record by record."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from zlib import crc32

import pytest
from armrig_core.errors import FileError
from armrig_core.rig.firmware_image import read_image

END = ":00000001FF"


def _record(kind: int, address: int, data: bytes, spoilt: int = 0) -> str:
    text = bytes([len(data), *address.to_bytes(2, "big"), kind]) + data
    return ":" + (text + bytes([(-sum(text) + spoilt) & 0xFF])).hex().upper()


def _written(path: Path, *records: str) -> Path:
    path.write_text("\n".join(records) + "\n")
    return path


def test_the_bytes_are_placed_by_address_in_any_order_of_records(tmp_path: Path) -> None:
    """A segment counts 16 bytes, a linear address counts 65536; a gap is erased flash."""
    path = _written(
        tmp_path / "a.hex",
        _record(0, 4, b"\x05\x06"),
        _record(0, 0, b"\x01\x02"),
        _record(2, 0, b"\x00\x02"),
        _record(0, 3, b"\x07"),
        _record(4, 0, b"\x00\x01"),
        _record(0, 1, b"\x08"),
        _record(3, 0, bytes(4)),
        _record(5, 0, bytes(4)),
        END,
    )

    image = read_image(path)

    wanted = bytearray(b"\xff" * 0x10002)
    wanted[0:6] = b"\x01\x02\xff\xff\x05\x06"
    wanted[0x23] = 0x07
    wanted[0x10001] = 0x08
    assert image.data == wanted
    assert (image.path, image.crc) == (path, crc32(wanted))
    assert image.sha256 == sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("records", "says"),
    [
        ([_record(0, 0, b"ab"), _record(0, 2, b"cd", spoilt=1), END], "checksum of line 2 is"),
        ([_record(0, 0, b"ab"), "00000001FF"], "line 2 is not a record"),
        ([":0100000061"], "line 1 is not a record"),
        ([_record(0, 0, b"ab"), ":02000006zz"], "line 2 is not a record"),
        ([_record(0, 0, b"ab")], "it has no end; the file may be cut off"),
        ([_record(0, 2, b"ab"), END], "no data at address 0"),
        ([_record(4, 0, b"\0"), END], "line 1 has the unknown type 4"),
        (
            [_record(0, 0, b"a"), _record(4, 0, b"\0\x10"), _record(0, 0, b"b"), END],
            "its last address is 0x100001; at most 0x100000 is allowed",
        ),
    ],
)
def test_a_damaged_image_is_refused_with_its_line(
    tmp_path: Path, records: list[str], says: str
) -> None:
    with pytest.raises(FileError, match=rf"a\.hex: not a firmware image in Intel HEX: .*{says}"):
        read_image(_written(tmp_path / "a.hex", *records))


def test_lines_after_the_end_record_are_ignored(tmp_path: Path) -> None:
    path = _written(tmp_path / "a.hex", _record(0, 0, b"ab"), END, "a comment")

    assert read_image(path).data == b"ab"
