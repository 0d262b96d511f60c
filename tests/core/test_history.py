"""The recent history as bytes: it comes back as it was, and nothing else is accepted."""

from __future__ import annotations

import pytest
from armrig_core.errors import MalformedReplyError
from armrig_core.telemetry.history import ANSWER_LIMIT, NUMBER_LIMIT, decode_past, encode_past
from armrig_core.telemetry.topics import STREAMS
from hypothesis import given
from hypothesis import strategies as st

messages = st.lists(st.tuples(st.sampled_from(STREAMS), st.binary(max_size=200)), max_size=20)


@given(st.binary(min_size=16, max_size=16), st.integers(0, NUMBER_LIMIT - 20), messages)
def test_a_history_reply_is_decoded_to_the_encoded_messages(
    life: bytes, first: int, given: list[tuple[str, bytes]]
) -> None:
    past = decode_past(encode_past(life, first, -5, given))

    assert past == (life, first, -5, tuple(given))


@given(messages, st.data())
def test_a_damaged_history_reply_is_refused_or_decoded(
    given: list[tuple[str, bytes]], data: st.DataObject
) -> None:
    whole = bytearray(encode_past(bytes(16), 0, 0, given))
    cut = whole[: data.draw(st.integers(0, len(whole)))]
    for _ in range(data.draw(st.integers(0, 3))):
        if cut:
            cut[data.draw(st.integers(0, len(cut) - 1))] = data.draw(st.integers(0, 255))
    try:
        past = decode_past(bytes(cut))
    except MalformedReplyError:
        return
    assert all(stream in STREAMS for stream, _ in past.messages)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        bytes(31),
        bytes(32) + b"\x07" + bytes(4),
        bytes(33),
        bytes(33) + b"\5\0\0\0ab",
        encode_past(bytes(16), NUMBER_LIMIT, 0, [("event", b"")]),
        encode_past(bytes(16), 0, 0, [("event", bytes(ANSWER_LIMIT))]),
    ],
)
def test_a_malformed_history_reply_is_refused(data: bytes) -> None:
    with pytest.raises(MalformedReplyError):
        decode_past(data)
