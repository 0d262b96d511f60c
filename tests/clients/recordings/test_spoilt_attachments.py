"""An attachment with a flipped bit is left out, and named; the samples after it stay."""

from __future__ import annotations

from pathlib import Path

import armrig
import pytest
from armrig.recordings.verification import verify
from mcap.opcode import Opcode

from tests.clients.made_recordings import recorded, sample, written

DATA = recorded([sample(k) for k in range(5)], u=[1.0] * 5)


def _attachment(name: str) -> range:
    """Return the range of an attachment's content in the file, from its times to its CRC."""
    named = len(name).to_bytes(4, "little") + name.encode()
    begin = DATA.index(named) - 16
    assert DATA[begin - 9] == Opcode.ATTACHMENT
    return range(begin, begin + int.from_bytes(DATA[begin - 8 : begin], "little"))


@pytest.mark.parametrize("bit", [0, 7])
def test_every_flipped_bit_of_the_calibration_leaves_the_samples(tmp_path: Path, bit: int) -> None:
    for at in _attachment("calibration.json"):
        spoilt = bytearray(DATA)
        spoilt[at] ^= 1 << bit

        recording = armrig.load(written(tmp_path, bytes(spoilt)))

        assert recording.samples.size == 5, at
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
def test_a_spoilt_attachment_is_named(tmp_path: Path, name: str, about: str, why: str) -> None:
    spoilt = bytearray(DATA)
    spoilt[_attachment(name)[-10]] ^= 1

    found = verify(written(tmp_path, bytes(spoilt)))

    failed = {check.about: check.text for check in found.checks if check.result == "failed"}
    assert failed[about].startswith(why)
    assert found.samples == 5
