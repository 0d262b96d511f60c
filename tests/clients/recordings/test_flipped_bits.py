"""One flipped bit of a head or an attachment: all samples are read, and it is reported."""

from __future__ import annotations

import struct
from io import BytesIO
from itertools import product
from pathlib import Path

import armrig
import pytest
from armrig.numerics.quantities import plural
from armrig.recordings.files.container import read, stream_messages
from armrig.recordings.files.verification import verify
from armrig_core.recording_file.manifest import CALIBRATION
from armrig_core.rig.calibration import Calibration
from mcap.opcode import Opcode
from mcap.reader import make_reader

from tests.clients.made_recordings import manifest, recorded, sample, timing, written
from tests.sampling import sampled

K = list(range(30))
MESSAGES = [*(sample(k) for k in K), timing(1)]
DATA = recorded(MESSAGES, manifest=manifest(samples=30), u=[1.0] * 30, flush_every=10)
_HEAD = struct.Struct("<BQ")


def _heads() -> list[int]:
    """Return the places of the records before the index."""
    at, places = 8, []
    while DATA[at] != Opcode.DATA_END:
        places.append(at)
        at += _HEAD.size + _HEAD.unpack_from(DATA, at)[1]
    return places


def _flipped(folder: Path, at: int, bit: int, data: bytes = DATA) -> Path:
    """Write a file with one bit changed."""
    spoilt = bytearray(data)
    spoilt[at + bit // 8] ^= 1 << bit % 8
    return written(folder, bytes(spoilt))


BITS = list(product(_heads(), range(8 * _HEAD.size)))


@pytest.mark.parametrize("part", sampled(range(8)))
def test_a_flipped_bit_of_a_header_loses_no_sample(tmp_path: Path, part: int) -> None:
    """Each record before the index: header, metadata, attachments, chunks and their indexes."""
    for at, bit in BITS[part::8]:
        recording = armrig.load(_flipped(tmp_path, at, bit))

        assert recording.samples["k"].tolist() == K, (at, bit)
        assert recording.truncated, (at, bit)
        assert recording.damage, (at, bit)


def test_records_listed_in_the_index_are_read_whole(tmp_path: Path) -> None:
    first = next(at for at in _heads() if DATA[at] == Opcode.ATTACHMENT)

    path = _flipped(tmp_path, first, 6)
    found = verify(path)

    checks = {check.about: check for check in found.checks}
    assert checks["file"].text.startswith(
        "the data section contains a record of opcode 73; the other records were found by the "
        "file's index, 0 records left out; saved: 30 samples, "
    )
    assert armrig.load(path).calibration == Calibration()
    assert checks["input"].text != "no input.csv is attached"
    assert armrig.load(path, start=0.1, stop=0.2).samples.size == 10
    assert (
        len(list(stream_messages(path, "timing"))) == 0
    )  # a replay needs the steps without a hole


def test_a_forged_index_reads_no_byte_twice(tmp_path: Path) -> None:
    spoilt = bytearray(DATA)
    spoilt[9] ^= 0x40  # the head of the header
    summary = make_reader(BytesIO(DATA)).get_summary()
    assert summary is not None
    first, second, *_ = (struct.pack("<Q", c.chunk_start_offset) for c in summary.chunk_indexes)
    forged = bytes(spoilt).replace(second, first)  # the second chunk, at the place of the first

    recording = armrig.load(written(tmp_path, forged))

    assert recording.samples["k"].tolist() in (K[20:], [*K[:10], *K[20:]])
    assert f"{plural(3 - recording.samples.size // 10, 'record')} left out" in recording.damage
    assert recording.truncated


def test_samples_without_order_are_reported_for_a_file_read_by_its_index(tmp_path: Path) -> None:
    unordered = recorded([sample(k) for k in (0, 1, 2, 1, 3)])

    recording = armrig.load(_flipped(tmp_path, 8, 6, unordered))  # the head of the header

    assert recording.samples["k"].tolist() == K[:3]
    assert "0 records left out; sample 1 comes after sample 2: " in recording.damage


def test_only_the_name_of_an_attachment_selects_the_input(tmp_path: Path) -> None:
    spoilt = bytearray(DATA)
    spoilt[8] ^= 0x40  # the head of the header
    at = spoilt.rindex(b"application/json")  # in the index of the calibration
    spoilt[at : at + 16] = b"csv of input.csv"

    content = read(written(tmp_path, bytes(spoilt)))

    assert content is not None
    assert list(content.attachments) == [CALIBRATION]
    assert content.input is not None
    assert DATA[content.input.at :].index(b"input.csv") < content.input.length


def _attachment(name: str) -> range:
    """Return the range of an attachment's content in the file, from its times to its CRC."""
    named = len(name).to_bytes(4, "little") + name.encode()
    begin = DATA.index(named) - 16
    assert DATA[begin - 9] == Opcode.ATTACHMENT
    return range(begin, begin + int.from_bytes(DATA[begin - 8 : begin], "little"))


def test_a_flipped_bit_of_the_calibration_leaves_the_samples(tmp_path: Path) -> None:
    for at in _attachment("calibration.json"):
        recording = armrig.load(_flipped(tmp_path, at, at % 8))

        assert recording.samples.size == 30, at
        assert recording.calibration is None
        assert recording.truncated
        assert recording.damage.startswith("the checksum of the attachment '"), at
        assert "is wrong: it is left out" in recording.damage


@pytest.mark.parametrize(
    ("name", "about", "why"),
    [
        ("calibration.json", "file", "the checksum of the attachment 'calibration.json' is wrong"),
        ("input.csv", "input", "the checksum of the attached input is wrong"),
    ],
)
def test_a_damaged_attachment_is_named(tmp_path: Path, name: str, about: str, why: str) -> None:
    found = verify(_flipped(tmp_path, _attachment(name)[-10], 0))

    failed = {check.about: check.text for check in found.checks if check.level == "unusable"}
    assert failed[about].startswith(why)
    assert found.samples == 30
