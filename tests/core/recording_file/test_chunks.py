"""A chunk holds as many bytes as it declares."""

from __future__ import annotations

import struct

import pytest
import zstandard
from armrig_core.recording_file.budget import Budget, DamageError
from armrig_core.recording_file.chunks import Unpacker


def chunk(data: bytes, declared: int) -> bytes:
    """Return a chunk without a checksum, whose zstd frame does not contain its length."""
    packer = zstandard.ZstdCompressor().compressobj()
    packed = packer.compress(data) + packer.flush()
    head = struct.pack("<QQQII", 0, 0, declared, 0, 4) + b"zstd"
    return head + struct.pack("<Q", len(packed)) + packed


@pytest.mark.parametrize("declared", [99, 101])
def test_a_chunk_without_a_checksum_is_held_against_its_size(declared: int) -> None:
    unpacker = Unpacker(Budget(1000))

    assert unpacker.records(chunk(b"x" * 100, 100)) == b"x" * 100
    with pytest.raises(DamageError, match="the size of a chunk is wrong"):
        unpacker.records(chunk(b"x" * 100, declared))
