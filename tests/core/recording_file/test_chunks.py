"""A chunk holds as many bytes as it declares, and no file costs more than its budget."""

from __future__ import annotations

import hashlib
import struct
from io import BytesIO

import pytest
import zstandard
from armrig_core.recording_file import budget
from armrig_core.recording_file.budget import Budget, DamageError
from armrig_core.recording_file.byte_source import ByteSource
from armrig_core.recording_file.chunks import Unpacker
from armrig_core.recording_file.file_records import MAGIC, RecordSelection, file_records
from mcap.opcode import Opcode


def test_a_budget_may_be_spent_to_its_last_unit() -> None:
    """The limits depend on the size of the file."""
    spent = Budget(6_400)
    limit = budget.WORK_LIMIT + 100

    spent.spend(budget.WORK, limit - 1)
    spent.spend(budget.WORK, 1)
    with pytest.raises(DamageError, match=f"more than {limit} units of work with records"):
        spent.spend(budget.WORK, 1)

    spent.regain(budget.WORK)
    spent.spend(budget.WORK, limit)


@pytest.mark.parametrize("is_hashed", [False, True])
def test_skipped_bytes_are_counted(is_hashed: bool) -> None:
    data = b"0123456789"
    source = ByteSource(BytesIO(data + b"behind its end"), len(data), is_hashed=is_hashed)

    assert source.read(2) == b"01"
    source.pass_over(3)

    assert (source.at, source.left, source.passed) == (5, 5, True)
    assert source.read(99) == b"56789"
    assert (source.at, source.left) == (10, 0)
    assert not is_hashed or source.sha256() == hashlib.sha256(data).hexdigest()


FOOTER = struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0) + MAGIC
END = struct.pack("<BQI", Opcode.DATA_END, 4, 0)


def records_of(data: bytes, wanted: RecordSelection) -> list[tuple[int, bytes]]:
    """Return opcode and content of each record."""
    found = file_records(ByteSource(BytesIO(data), len(data)), wanted, lambda _: None)
    return [(record.opcode, record.body) for record in found]


def test_a_footer_within_the_data_is_reported_as_damage() -> None:
    """Data that follow it would be lost without a word."""
    assert records_of(END + FOOTER, RecordSelection()) == []
    with pytest.raises(DamageError, match="the data section contains a record of opcode 2"):
        records_of(FOOTER, RecordSelection())


@pytest.mark.parametrize("longer", [0, 1])
def test_the_records_after_an_overlong_attachment_are_read(longer: int) -> None:
    limit = 300
    long, short = (
        struct.pack("<BQ", opcode, len(body)) + body
        for opcode, body in (
            (Opcode.ATTACHMENT, b"a" * (limit + longer)),
            (Opcode.METADATA, b"follows"),
        )
    )

    found = records_of(long + short + END + FOOTER, RecordSelection(attachment=limit))

    opcodes = [opcode for opcode, _ in found]
    assert opcodes == [Opcode.ATTACHMENT, Opcode.METADATA][longer:]
    assert found[-1] == (Opcode.METADATA, b"follows")


def chunk(data: bytes, declared: int) -> bytes:
    """Return a chunk without a checksum, whose zstd frame does not contain its length."""
    packer = zstandard.ZstdCompressor().compressobj()
    packed = packer.compress(data) + packer.flush()
    head = struct.pack("<QQQII", 0, 0, declared, 0, 4) + b"zstd"
    return head + struct.pack("<Q", len(packed)) + packed


@pytest.mark.parametrize("declared", [99, 101])
def test_a_chunk_without_a_checksum_is_compared_with_its_size(declared: int) -> None:
    unpacker = Unpacker(Budget(1000))

    assert unpacker.records(chunk(b"x" * 100, 100)) == b"x" * 100
    with pytest.raises(DamageError, match="the size of a chunk is wrong"):
        unpacker.records(chunk(b"x" * 100, declared))
