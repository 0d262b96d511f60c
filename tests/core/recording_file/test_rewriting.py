"""The compact copy contains the same as the first file, to the last field."""

from __future__ import annotations

import random
import zlib
from pathlib import Path

import pytest
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.opening import lock
from armrig_core.recording_file.rewriting import CHUNK_BYTES, Rewriter, compact
from mcap.reader import make_reader
from mcap.records import (
    Attachment,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    Metadata,
    Schema,
)
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

KEPT = (Header, Schema, Channel, Message, Metadata, Attachment)
SIZE = 1000


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of 2.5 MB in chunks of 10 kB, no two fields of which are the same."""
    path = tmp_path_factory.mktemp("rewriting") / "first"
    noise = random.Random(1)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=10_000)
        writer.start(profile="a profile", library="a library")
        channels = [
            writer.register_channel(
                topic,
                "protobuf",
                writer.register_schema(f"of {topic}", "protobuf", b"a schema"),
                of,
            )
            for topic, of in (("a", {}), ("b", {"of": "b"}))
        ]
        writer.add_metadata("before", {"a": "1"})
        writer.add_attachment(11, 12, "input.csv", "text/csv", b"u_v\n")
        for i in range(2500):
            data = noise.randbytes(SIZE)
            writer.add_message(channels[i % 2], 3 * i + 2, data, 3 * i + 1, 7 * i)
        writer.add_metadata("behind", {"b": "2"})
        writer.finish()
    return path


def _records(path: Path) -> list[object]:
    """Return the records of a file, up to its summary, which repeats them."""
    kept: list[object] = []
    with path.open("rb") as file:
        for record in StreamReader(file).records:
            if isinstance(record, DataEnd):
                break
            if isinstance(record, KEPT):
                kept.append(record)
    return kept


def _chunks(path: Path) -> list[ChunkIndex]:
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return summary.chunk_indexes


def test_every_record_is_copied_with_every_field(first: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"

    compact(first, copy)

    said, held = _records(copy), _records(first)
    assert sum(isinstance(record, Message) for record in said) == 2500
    for kind in KEPT:
        assert [r for r in said if isinstance(r, kind)] == [r for r in held if isinstance(r, kind)]


def test_chunks_of_the_copy_have_1_mib(first: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"

    compact(first, copy)

    sizes = [chunk.uncompressed_size for chunk in _chunks(copy)]
    assert len(sizes) == 3
    assert all(CHUNK_BYTES <= size < CHUNK_BYTES + 2 * SIZE for size in sizes[:-1])
    assert len(_chunks(first)) > 200


def test_the_copy_is_guarded_by_a_checksum(first: Path, tmp_path: Path) -> None:
    """0 would mean that there is no checksum."""
    copy = tmp_path / "copy"

    compact(first, copy)

    with copy.open("rb") as file:
        records = list(StreamReader(file).records)
    (end,) = [r for r in records if isinstance(r, DataEnd)]
    (footer,) = [r for r in records if isinstance(r, Footer)]
    data_end = 1 + 8 + 4  # opcode, length and checksum of the record that ends the data
    section = copy.read_bytes()[: footer.summary_start - data_end]
    assert end.data_section_crc == zlib.crc32(section) != 0


def test_an_existing_file_is_not_overwritten(first: Path, tmp_path: Path) -> None:
    with pytest.raises(FileExistsError):
        compact(first, first)


@pytest.mark.parametrize("wrong", ["cut off", "changed"])
def test_a_damaged_file_is_not_copied(first: Path, tmp_path: Path, wrong: str) -> None:
    data = bytearray(first.read_bytes())
    if wrong == "cut off":
        del data[-9:]
    else:
        data[len(data) // 2] ^= 1
    (spoilt := tmp_path / "spoilt").write_bytes(data)

    with pytest.raises(DamageError):
        compact(spoilt, tmp_path / "copy")


def test_a_copy_is_locked_while_it_is_written(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy, locked = tmp_path / "copy", []
    finish = Rewriter.finish

    def tried(self: Rewriter) -> None:
        with copy.open("rb") as file, pytest.raises(BlockingIOError):
            lock(file)
        locked.append(True)
        finish(self)

    monkeypatch.setattr(Rewriter, "finish", tried)
    compact(first, copy)

    assert locked
