"""Texts of others, as the editors of this world write them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from armrig_core.errors import FileError
from armrig_core.process.bounded import read_bounded, read_text

TEXT = "[rig]\r\nid = '1' # Prüfstand\r\n"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_a_byte_order_mark_is_removed_from_the_text(tmp_path: Path, encoding: str) -> None:
    """Editors of Windows write one before UTF-8, and end lines in their own way."""
    path = tmp_path / "text"
    path.write_bytes(TEXT.encode(encoding))

    assert read_text(path, 100) == TEXT


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (TEXT.encode("utf-16"), "it is saved as UTF-16: save it as UTF-8"),
        (b"\xfe\xff" + TEXT.encode("utf-16-be"), "it is saved as UTF-16: save it as UTF-8"),
        (TEXT.encode("latin-1"), "line 2 is not UTF-8: save it as UTF-8"),
    ],
)
def test_another_encoding_is_reported_with_the_remedy(
    tmp_path: Path, data: bytes, said: str
) -> None:
    path = tmp_path / "text"
    path.write_bytes(data)

    with pytest.raises(FileError) as refused:
        read_text(path, 100)
    assert str(refused.value) == said


def test_reading_is_limited_and_never_blocks(tmp_path: Path) -> None:
    long, pipe = tmp_path / "long", tmp_path / "pipe"
    long.write_bytes(b"12345")
    os.mkfifo(pipe)

    assert read_bounded(long, 5) == b"12345"
    with pytest.raises(OSError, match="more than the 4 B allowed"):
        read_bounded(long, 4)
    for path in (pipe, Path("/dev/zero"), tmp_path):
        with pytest.raises(OSError, match=r"not a regular file|Is a directory"):
            read_text(path, 100)
