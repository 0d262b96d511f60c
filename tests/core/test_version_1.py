"""Codes of the sentences of version 1."""

from __future__ import annotations

import msgspec
import pytest
from armrig_core import protobuf
from armrig_core.codes import GapCode, OutcomeCode
from armrig_core.manifest import Outcome, outcome_of
from armrig_core.version_1 import emulator_stall_ns, gap_code, outcome_code


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("complete", OutcomeCode.COMPLETE),
        ("continued", OutcomeCode.CONTINUED),
        ("stopped", OutcomeCode.STOPPED),
        ("stopped by Ada", OutcomeCode.STOPPED),
        ("disarmed", OutcomeCode.DISARMED),
        ("the daemon was ended", OutcomeCode.DAEMON_ENDED),
        ("the loop ended", OutcomeCode.DAEMON_ENDED),
        ("its client went away: no sign of it for 0.6 s", OutcomeCode.CLIENT_GONE),
        ("its recording ended: No space left on device", OutcomeCode.RECORDING),
        ("its recording was moved while it was written", OutcomeCode.MOVED),
        ("cut off: its daemon died", OutcomeCode.CUT_OFF),
        ("the host paused for 264 ms", OutcomeCode.UNKNOWN),
        ("complete, or nearly so", OutcomeCode.UNKNOWN),
    ],
)
def test_a_file_without_a_code_ended_as_its_sentence_says(text: str, code: OutcomeCode) -> None:
    told = Outcome(outcome=text, samples=1, missing=0).metadata()

    assert "code" not in told
    assert outcome_code(text) == code
    assert outcome_of(told).code == code


def test_a_code_is_not_looked_for_in_a_sentence() -> None:
    for code in (OutcomeCode.FAULT, "a code of tomorrow"):
        told = Outcome(outcome="complete", samples=1, missing=0, code=code).metadata()

        assert outcome_of(told).code == code


def test_a_reader_of_yesterday_reads_a_file_of_today() -> None:
    yesterday = msgspec.defstruct("Outcome", [("outcome", str), ("samples", int), ("missing", int)])
    told = Outcome(outcome="complete", samples=1, missing=0, code=OutcomeCode.COMPLETE).metadata()

    fields = {name: msgspec.json.decode(text) for name, text in told.items()}

    assert msgspec.convert(fields, yesterday) == yesterday("complete", 1, 0)


def test_an_event_without_a_number_has_the_stall_in_its_sentence() -> None:
    sentence = "emulator held up 35 ms by this machine; its device's clock stood still"

    assert emulator_stall_ns(sentence) == 35_000_000
    assert emulator_stall_ns(f"Ada: {sentence}") == 0


@pytest.mark.parametrize(
    ("reason", "code"),
    [
        ("the host was late", GapCode.HOST_LATE),
        ("the device was late", GapCode.DEVICE_LATE),
        ("a frame was lost", GapCode.FRAME_LOST),
        ("no answer came", GapCode.NO_ANSWER),
        ("the service did not keep up", GapCode.SERVICE_LATE),
        (
            "the recorder was cut off for longer than the daemon keeps what it published",
            GapCode.RECORDER_CUT_OFF,
        ),
        ("the host paused for 264 ms", GapCode.UNKNOWN),
        ("", GapCode.UNKNOWN),
    ],
)
def test_a_gap_without_a_code_has_the_code_of_its_sentence(reason: str, code: GapCode) -> None:
    assert gap_code(reason) == code


def test_a_reader_of_yesterday_reads_a_gap_of_today() -> None:
    late = GapCode.HOST_LATE
    today = protobuf.message_class(protobuf.GAP)(k_first=3, reason=late.sentence, code=late)

    assert (
        today.SerializeToString()[:-11]
        == protobuf.message_class(protobuf.GAP)(k_first=3, reason=late.sentence).SerializeToString()
    )
