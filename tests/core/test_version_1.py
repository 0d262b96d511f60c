"""What version 1 told by sentences alone has codes."""

from __future__ import annotations

import msgspec
import pytest
from armrig_core.codes import OutcomeCode
from armrig_core.manifest import Outcome, outcome_of
from armrig_core.version_1 import outcome_code


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
    """A sentence that is not known is of a run that ended early."""
    told = Outcome(outcome=text, samples=1, missing=0).metadata()

    assert "code" not in told
    assert outcome_code(text) == code
    assert outcome_of(told).code == code


def test_a_code_is_not_looked_for_in_a_sentence() -> None:
    """Also one that only a later release knows."""
    for code in (OutcomeCode.FAULT, "a code of tomorrow"):
        told = Outcome(outcome="complete", samples=1, missing=0, code=code).metadata()

        assert outcome_of(told).code == code


def test_a_reader_of_yesterday_reads_a_file_of_today() -> None:
    """The entries that it knows are where they were."""
    yesterday = msgspec.defstruct("Outcome", [("outcome", str), ("samples", int), ("missing", int)])
    told = Outcome(outcome="complete", samples=1, missing=0, code=OutcomeCode.COMPLETE).metadata()

    fields = {name: msgspec.json.decode(text) for name, text in told.items()}

    assert msgspec.convert(fields, yesterday) == yesterday("complete", 1, 0)
