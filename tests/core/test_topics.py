"""Keys and topics of a rig."""

from __future__ import annotations

import pytest
from armrig_core.errors import InputTypeError
from armrig_core.telemetry import topics
from armrig_core.telemetry.topics import RECORDED, STREAMS, check_own_id, check_rig_id, playback_id

LONGEST = "a" * 40


def test_each_rig_has_separate_keys() -> None:
    assert topics.stream_key("lab-2", "gap") == "rig/lab-2/gap"
    assert topics.command_key("lab-2", "arm") == "rig/lab-2/cmd/arm"
    assert topics.command_key("lab-2", "arm", "ada") == "rig/lab-2/cmd/arm/ada"
    assert topics.schema_key("lab-2", "**") == "rig/lab-2/schema/**"
    assert topics.history_key("lab-2") == "rig/lab-2/history"
    assert topics.alive_key("lab-2") == "rig/lab-2/alive"


@pytest.mark.parametrize("rig", ["", LONGEST + "a", "A", "a/b", "*", "a\n", "ä"])
def test_an_id_that_is_not_valid_in_a_key_is_refused(rig: str) -> None:
    with pytest.raises(ValueError, match="use 1 to 40 characters, each a-z, 0-9 or -"):
        check_rig_id(rig)
    assert topics.stream_of(f"/rig/{rig}/gap") == ""
    assert topics.rig_of_alive(f"rig/{rig}/alive") == ""


def test_an_id_that_is_not_text_is_refused() -> None:
    with pytest.raises(InputTypeError, match=r"rig id 7 is not text: give .* in quotes, .* '7'"):
        check_rig_id(7)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("rig", "played"),
    [
        ("1", "played-1"),
        ("played-1", "played-1"),
        (LONGEST, "played-" + "a" * 33),
        ("played", "played-played"),
    ],
)
def test_a_recording_is_played_under_an_id_that_no_rig_can_have(rig: str, played: str) -> None:
    assert playback_id(rig) == played == check_rig_id(played)
    with pytest.raises(ValueError, match="belongs to a recording that `armrig play` plays"):
        check_own_id(played)
    assert (rig == played) or check_own_id(rig) == rig


def test_the_key_of_a_liveliness_token_names_its_rig() -> None:
    assert topics.rig_of_alive("rig/lab-2/alive") == "lab-2"
    for key in ("rig/lab-2/sample", "rag/lab-2/alive", "rig/lab-2/alive/x", "rig/lab-2"):
        assert topics.rig_of_alive(key) == ""


def test_the_topic_of_a_message_names_its_stream() -> None:
    for stream in RECORDED:
        assert topics.stream_of(topics.topic("lab-2", stream)) == stream
    assert set(RECORDED) - set(STREAMS) == {"trace"}
    for other in ("/rig/1/other", "rig/1/gap", "/rig/1/gap/x", "/rag/1/gap", "/rig/1/"):
        assert topics.stream_of(other) == ""
