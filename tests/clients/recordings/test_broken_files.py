"""No broken file of a recording does harm, and its sound part is read."""

from __future__ import annotations

import resource
import struct
import sys
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import zstandard
from armrig.recordings import grid
from armrig.recordings.files import container, sample_rows
from armrig.recordings.files.loading import load
from armrig.recordings.recording import Recording
from armrig_core.errors import FileError
from armrig_core.recording_file import budget, file_records
from armrig_core.recording_file.manifest import RUN, Outcome
from armrig_core.telemetry import telemetry
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from tests.clients.made_recordings import (
    event,
    manifest,
    recorded,
    sample,
    timing,
    written,
)
from tests.clients.recordings.test_recording import METADATA, ROW_HEAD, a_run, as_protobuf, tried
from tests.fuzz.cuts import edges


def _nested(depth: int) -> str:
    return '{"a":' + "[" * depth + "]" * depth + "}"


def _record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def _chunk(data: bytes) -> bytes:
    packed = zstandard.compress(data)
    head = struct.pack("<QQQII", 0, 0, len(data), zlib.crc32(data), 4) + b"zstd"
    return _record(0x06, head + struct.pack("<Q", len(packed)) + packed)


def _channel_record(topic: str) -> bytes:
    text = struct.pack("<I", len(topic)) + topic.encode()
    return _record(0x04, struct.pack("<HH", 1, 0) + text + bytes(8))


@pytest.mark.parametrize("change", ["a chunk", "a checksum", "the end"])
def test_samples_before_a_damage_are_kept_and_not_reported_as_cut_off(
    tmp_path: Path, change: str
) -> None:
    whole = bytearray(recorded([sample(k) for k in range(30)], flush_every=10))
    end = whole.index(struct.pack("<BQ", 0x0F, 4))
    last = whole.rindex(b"zstd", 0, end)
    whole[{"a chunk": last + 20, "a checksum": end + 9, "the end": end}[change]] ^= 0x40

    rec = load(written(tmp_path, bytes(whole)))

    kept = 20 if change == "a chunk" else 30
    assert (rec.N, rec.truncated, rec.cut_off) == (kept, True, False)


@pytest.mark.parametrize("claimed", [{"samples": 10**15}, {"k_first": 2**80}, {"Ts": 1e300}])
def test_a_manifest_cannot_exhaust_the_memory(tmp_path: Path, claimed: dict[str, Any]) -> None:
    with pytest.raises(FileError, match=r"run\.mcap: "):
        load(written(tmp_path, recorded([sample(50)], manifest=a_run(**claimed))))


def test_a_file_cut_anywhere_is_read_up_to_the_cut(tmp_path: Path) -> None:
    """L3: a prefix without holes, or one line that names the file's kind.

    The file is cut at every byte near the beginning of a record, and at some bytes within;
    `tests.fuzz.cuts` cuts at every byte.
    """
    whole = recorded([sample(k) for k in range(40)], flush_every=8, chunk_size=1 << 20)
    path = tmp_path / "cut.mcap.active"
    lengths: list[int] = []
    near = {edge + byte for edge in [*edges(whole), len(whole) - 8] for byte in range(-2, 12)}
    for cut in sorted(near.union(range(0, len(whole), 41)).intersection(range(len(whole)))):
        path.write_bytes(whole[:cut])
        rec, told = tried(path)
        if rec is None:
            assert told.count("\n") == 0
            assert not lengths, f"cut at {cut} B lost what a shorter file gave"
            continue
        assert rec.truncated
        assert f"saved: {rec.N} samples" in rec.damage
        np.testing.assert_array_equal(rec.samples["k"], np.arange(rec.N))
        lengths.append(rec.N)

    assert lengths == sorted(lengths)
    assert set(lengths) == {0, 8, 16, 24, 32, 40}


@settings(max_examples=150)
@given(st.data())
def test_a_flipped_bit_is_detected_or_harmless(data: st.DataObject) -> None:
    at = data.draw(st.integers(0, len(SMALL) * 8 - 1))
    spoilt = bytearray(SMALL)
    spoilt[at // 8] ^= 1 << at % 8
    path = Path(SMALL_DIRECTORY.name) / "flipped.mcap"
    path.write_bytes(spoilt)
    rec, _ = tried(path)
    if rec is None:
        return
    if rec.samples["k"].tolist() != list(range(rec.samples.size)):
        assert "1 record left out" in rec.damage
        assert rec.samples.size == 20
    assert (rec.samples["u_applied_v"] == 1.0).all()


@settings(max_examples=100)
@given(st.binary(max_size=300), st.integers(0, 400))
def test_random_bytes_of_a_file_raise_no_other_error(noise: bytes, at: int) -> None:
    path = Path(SMALL_DIRECTORY.name) / "noise.mcap"
    path.write_bytes(file_records.MAGIC + SMALL[8:at] + noise)
    rec, told = tried(path)
    assert rec is not None or told.count("\n") == 0


@pytest.mark.parametrize(
    ("k", "why"),
    [(1, "each k must be larger"), (1 << 62, "less than 2^62"), ((1 << 64) - 1, "less than 2^62")],
)
def test_a_sample_number_that_decreases_or_overflows_ends_the_reading(
    tmp_path: Path, k: int, why: str
) -> None:
    """Not every program has integers of 62 bit."""
    wrong = sample(3)._replace(k=k)

    rec = load(written(tmp_path, recorded([sample(0), sample(1), wrong, sample(4)])))

    assert rec.N == 2
    assert why in rec.damage


def _chunk_head(size: int, compression: bytes, packed: int) -> bytes:
    head = struct.pack("<QQQII", 0, 0, size, 0, len(compression)) + compression
    return head + struct.pack("<Q", packed)


@pytest.mark.parametrize(
    ("opcode", "body", "why"),
    [
        pytest.param(
            *(0x09, bytes(24) + struct.pack("<Q", 2**64 - 1) + bytes(4), "a record cannot be read"),
            id="an attachment longer than memory",  # its length overflowed a C integer
        ),
        pytest.param(
            *(0x06, _chunk_head(1 << 62, b"zstd", 0), f"larger than the {8 << 20} B allowed"),
            id="a chunk that declares too much",
        ),
        pytest.param(
            *(0x06, _chunk_head(4, b"bzip9", 4) + bytes(4), "compression 'bzip9': allowed are"),
            id="compression",
        ),
        pytest.param(
            0x06,
            _chunk_head(9, b"", 9) + struct.pack("<BQ", 0x06, 0),
            "(opcode 6) that must not be in a chunk",  # nested chunks would unpack without end
            id="a chunk in a chunk",
        ),
    ],
)
def test_a_record_that_cannot_be_read_ends_the_reading(
    tmp_path: Path, opcode: int, body: bytes, why: str
) -> None:
    assert why in load(written(tmp_path, _with_record(opcode, body))).damage


def test_a_chunk_larger_than_its_declared_size_is_not_unpacked(tmp_path: Path) -> None:
    """Zeros that would fill 2 GB, in 64 kB of file."""
    packer = zstandard.ZstdCompressor().compressobj()
    packed = b"".join([*(packer.compress(bytes(1 << 24)) for _ in range(128)), packer.flush()])
    body = _chunk_head(4096, b"zstd", len(packed)) + packed
    before = _peak_mib()

    rec = load(written(tmp_path, _with_record(0x06, body)))

    assert "the size of a chunk is wrong" in rec.damage
    assert _peak_mib() - before < 64


@pytest.fixture
def limited(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Give a function that sets limits on the cost of reading."""

    def limit(module: ModuleType = budget, **limits: int) -> None:
        for name, value in limits.items():
            monkeypatch.setattr(module, name, value)

    return limit


def test_a_flood_of_messages_ends_the_reading(tmp_path: Path, limited: Callable[..., None]) -> None:
    limited(MESSAGES_LIMIT=10_000, MESSAGES_PER_BYTE=0)
    messages = [sample(0), *(event(0, "x") for _ in range(100)), sample(1)]

    rec = load(written(tmp_path, recorded(messages)))

    assert rec.N == 1
    assert "messages other than samples" in rec.damage


def test_a_stream_of_any_length_is_read_message_by_message(
    tmp_path: Path, limited: Callable[..., None]
) -> None:
    """The limit is on the messages that are in memory at the same time."""
    limited(MESSAGES_LIMIT=10_000, MESSAGES_PER_BYTE=0)
    messages = [sample(0), *(timing(k) for k in range(40))]
    path = written(tmp_path, recorded(messages, flush_every=2))

    times = [message.t_host_ns for message in container.stream_messages(path, "timing")]

    assert times == [timing(k).t_host_ns for k in range(40)]
    assert len(load(path).timing) < 40


HOSTILE = {
    "channels": _channel_record("/rig/1/" + "x" * 90) * 200,
    "channels with nothing": _record(0x04, bytes(16)) * 200,
    "schemas": _record(0x03, struct.pack("<HI", 1, 50_000) + bytes(50_008)) * 4,
    "messages": _record(0x05, struct.pack("<HIQQ", 999, 0, 0, 0) + bytes(50_000)) * 4,
}


@pytest.mark.parametrize("records", HOSTILE.values(), ids=HOSTILE.keys())
def test_every_record_in_a_chunk_counts_by_its_length(
    tmp_path: Path, limited: Callable[..., None], records: bytes
) -> None:
    limited(UNPACKED_LIMIT=3 * len(records), UNPACKED_PER_BYTE=0)

    rec = load(written(tmp_path, _broken_off(_chunk(records) * 10)))

    assert f"more than {3 * len(records)} B in its unpacked chunks" in rec.damage
    assert _read_of(rec) < len(_broken_off(_chunk(records) * 4))


@pytest.mark.parametrize(
    "record",
    [
        pytest.param(_channel_record(""), id="channel"),
        pytest.param(_record(0x03, bytes(14)), id="schema"),
        pytest.param(_record(0x05, bytes(22)), id="message"),
    ],
)
@pytest.mark.parametrize("within_a_chunk", [True, False])
def test_every_record_counts_towards_the_work_limit(
    tmp_path: Path, limited: Callable[..., None], record: bytes, within_a_chunk: bool
) -> None:
    limited(WORK_LIMIT=900, BYTES_PER_WORK=1 << 30)
    chunk = _chunk(record * 1000) if within_a_chunk else record * 1000

    rec = load(written(tmp_path, _broken_off(chunk)))

    assert "more than 900 units of work with records" in rec.damage


def test_samples_of_another_layout_count_towards_the_work_limit(
    tmp_path: Path, limited: Callable[..., None]
) -> None:
    limited(WORK_LIMIT=900, BYTES_PER_WORK=1 << 30)
    messages = [as_protobuf(sample(k)) if k % 2 else sample(k) for k in range(1000)]

    rec = load(written(tmp_path, recorded(messages)))

    assert "units of work" in rec.damage
    assert 50 < rec.N < 500


def test_names_of_channels_of_other_programs_are_not_stored(tmp_path: Path) -> None:
    foreign = b"A" * 100_000
    schema = _record(0x03, struct.pack("<HI", 77, len(foreign)) + foreign + bytes(8))
    metadata = _record(0x0C, struct.pack("<I", len(foreign)) + foreign + bytes(4))
    content = container.Content()
    reader = container._Reader(content, container.READ)
    for record in (schema, metadata):
        reader.add_record(record[0], record[9:])

    assert reader.schemas == {}
    assert content.metadata == {}
    assert "without its footer" in load(written(tmp_path, _broken_off(schema + metadata))).damage


@pytest.mark.parametrize("flush_every", [0, 30, 50])
def test_a_file_has_no_more_samples_than_a_run(
    tmp_path: Path, limited: Callable[..., None], flush_every: int
) -> None:
    limited(sample_rows, SAMPLES_LIMIT=250, _MAX_PENDING_BYTES=0)
    data = recorded([sample(k) for k in range(300)], flush_every=flush_every)

    rec = load(written(tmp_path, data))

    assert rec.N == 250
    assert "more than 250 samples" in rec.damage


def test_samples_do_not_keep_their_chunk_in_memory() -> None:
    """One sample in each of many chunks of 8 MB must not keep all of them in memory."""
    chunk = ROW_HEAD + telemetry.encode_sample(sample(0)) + bytes(100_000)
    rows = sample_rows.SampleRows()
    before = sys.getrefcount(chunk)

    taken = rows.add_run(memoryview(chunk), 0)
    rows.settle()

    assert taken == len(ROW_HEAD) + telemetry.SAMPLE_LENGTH
    assert sys.getrefcount(chunk) == before


def test_a_grid_has_no_more_rows_than_a_run(tmp_path: Path, limited: Callable[..., None]) -> None:
    limited(grid, SAMPLES_LIMIT=250)

    assert load(written(tmp_path, recorded([sample(k) for k in (0, 1, 249)]))).N == 250
    with pytest.raises(FileError, match="too many for a recording"):
        load(written(tmp_path, recorded([sample(k) for k in (0, 1, 250)])))


@pytest.mark.parametrize(("came", "missing"), [(0, 200_000), (7, 200_070)])
def test_a_grid_has_a_bounded_number_of_missing_samples(came: int, missing: int) -> None:
    """200 000, and ten more for each sample that came; one more is refused."""
    k = np.arange(came, dtype=np.uint64)

    ended = Outcome(outcome="complete", samples=came, missing=missing, code="complete")

    rows = grid.grid(k, manifest(k_first=0, samples=came + missing), ended, ())

    assert (rows.k_first, rows.N) == (0, came + missing)
    with pytest.raises(ValueError, match=f"{missing + 1} of the samples .* are missing: too many"):
        grid.grid(k, manifest(k_first=0, samples=came + missing + 1), ended, ())


@pytest.mark.parametrize(
    ("entries", "why"),
    [
        pytest.param(
            None, r"not made by armrig; `armrig import \S+run\.mcap .* lists the topics", id="none"
        ),
        pytest.param({"rig": '"1"'}, "run_id", id="of another shape"),
        *(
            (METADATA | {name: text}, f"{name} {why}")
            for name, text, why in (
                ("clock_offset_ns", "1" + "0" * 400, "does not fit into 64 bit"),
                ("clock_offset_ns", "-" + "9" * 309, "does not fit into 64 bit"),
                ("clock_offset_ns", str(2**63), "does not fit into 64 bit"),
                ("k_first", "1" + "0" * 400, "does not fit into 64 bit"),
                ("details", _nested(100), "is nested more than 32 levels deep"),
            )
        ),
        pytest.param(METADATA | {"details": _nested(100_000)}, "recursion", id="recursion"),
        pytest.param(METADATA | {"experiment": "[" * 100_000}, "recursion", id="no end"),
    ],
)
def test_an_invalid_manifest_is_reported_in_one_line(
    tmp_path: Path, entries: dict[str, str] | None, why: str
) -> None:
    out = BytesIO()
    writer = Writer(out)
    writer.start()
    if entries:
        writer.add_metadata(RUN, entries)
    writer.finish()

    with pytest.raises(FileError, match=why) as caught:
        load(written(tmp_path, out.getvalue()))

    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


def test_a_change_outside_the_chunks_is_detected(tmp_path: Path) -> None:
    """The manifest has no checksum of its own, but the file has one over all data."""
    whole = recorded([sample(0)])
    assert whole.count(b'"seed":1') == 1

    rec = load(written(tmp_path, whole.replace(b'"seed":1', b'"seed":2')))

    assert rec.N == 1
    assert "checksum over all data" in rec.damage


def _with_record(opcode: int, body: bytes) -> bytes:
    """Return a recording whose last record, before where it breaks off, is this one."""
    return _broken_off(_record(opcode, body))


def _broken_off(rest: bytes) -> bytes:
    """Return a recording that goes on with this and then breaks off."""
    whole = recorded([], outcome=None, calibration=None)
    return whole[: whole.index(struct.pack("<BQ", 0x0F, 4))] + rest  # DataEnd


def _read_of(rec: Recording) -> int:
    return int(rec.damage.rsplit(" samples, ", 1)[1].split()[0])


def _peak_mib() -> float:
    scale = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * scale / (1 << 20)


SMALL = recorded([sample(k) for k in range(30)], flush_every=10)
SMALL_DIRECTORY = TemporaryDirectory(prefix="armrig-tests-")
