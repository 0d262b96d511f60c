"""Frames on the wire: the golden vectors, and what holds for any bytes."""

from __future__ import annotations

import json
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from struct import Struct
from typing import Any
from zlib import crc32

import pytest
from armrig_protocol import cobs
from armrig_protocol.decoder import MAX_STUFFED, Received, feed
from armrig_protocol.frame import Spoilt, Unknown, encode
from armrig_protocol.messages import ARRAYS, LAYOUTS, MESSAGES, Exchange, Message
from hypothesis import given
from hypothesis import strategies as st

VECTORS = json.loads(
    (Path(__file__).parents[2] / "firmware_protocol/vectors/frames.json").read_text()
)


def _message(number: int, raw: bytes) -> Message:
    fields = Struct("<" + LAYOUTS[number]).unpack(raw)
    if number in ARRAYS:
        fields = (*fields[: -ARRAYS[number]], fields[-ARRAYS[number] :])
    return MESSAGES[number]._make(fields)


@st.composite
def messages(draw: st.DrawFn) -> Message:
    """Any message with any field values."""
    number = draw(st.sampled_from(sorted(MESSAGES)))
    size = Struct("<" + LAYOUTS[number]).size
    return _message(number, draw(st.binary(min_size=size, max_size=size)))


def _feed_in_pieces(pieces: Iterable[bytes]) -> list[Received]:
    pending, received = b"", []
    for piece in pieces:
        pending, more = feed(pending, piece)
        received += more
    return received


def _event(vector: dict[str, Any]) -> Received:
    name = vector.pop("event")
    classes = {c.__name__: c for c in (*MESSAGES.values(), Unknown, Spoilt)}
    fields = {k: tuple(v) if isinstance(v, list) else v for k, v in vector.items()}
    return classes[name](**fields)


@pytest.mark.parametrize("vector", VECTORS, ids=[v["doc"] for v in VECTORS])
def test_encoding_and_decoding_match_the_golden_vectors(vector: dict[str, Any]) -> None:
    wire = bytes.fromhex(vector["wire"])
    expected = [_event(dict(event)) for event in vector["events"]]

    _, received = feed(b"", wire)

    assert received == expected
    assert [type(r) for r in received] == [type(e) for e in expected]
    alone = len(expected) == 1 and not isinstance(expected[0], Unknown | Spoilt)
    if alone and not wire.startswith(b"\0"):
        assert encode(expected[0]) == wire


def test_every_message_has_a_vector() -> None:
    named = {event["event"] for vector in VECTORS for event in vector["events"]}

    assert {message.__name__ for message in MESSAGES.values()} <= named


def test_the_protocol_page_contains_the_encoding_of_its_example() -> None:
    text = (Path(__file__).parents[2] / "firmware_protocol/PROTOCOL.md").read_text()

    wire = encode(Exchange(0, 2, 256, 32768))

    assert f"\n{wire.hex(' ')}\n" in text


def test_the_crc_equals_the_check_value_of_the_catalogue() -> None:
    """CRC-32/ISO-HDLC of 123456789 is CBF43926."""
    assert crc32(b"123456789") == 0xCBF43926  # CRC-32/ISO-HDLC


@given(messages())
def test_decoding_undoes_encoding(message: Message) -> None:
    assert feed(b"", encode(message)) == (b"", [message])


@given(st.binary(max_size=cobs.MAX_TEXT))
def test_unstuffing_undoes_stuffing(text: bytes) -> None:
    stuffed = cobs.stuff(text)

    assert 0 not in stuffed
    assert len(stuffed) == len(text) + 1
    assert cobs.unstuff(stuffed) == text


def test_a_text_too_long_to_stuff_is_refused() -> None:
    """From 254 bytes on a group code would be needed."""
    with pytest.raises(ValueError, match="254 bytes are too many"):
        cobs.stuff(bytes(cobs.MAX_TEXT + 1))


@given(
    st.lists(st.one_of(messages().map(encode), st.binary(max_size=100)), max_size=6),
    st.lists(st.integers(0, 400), max_size=12),
)
def test_the_same_bytes_give_the_same_events_however_they_are_cut(
    parts: list[bytes], cuts: list[int]
) -> None:
    wire = b"".join(parts)
    at = [0, *sorted(c for c in cuts if c < len(wire)), len(wire)]

    pieces = [wire[a:b] for a, b in pairwise(at)]

    assert _feed_in_pieces(pieces) == feed(b"", wire)[1]
    assert _feed_in_pieces(wire[i : i + 1] for i in range(len(wire))) == feed(b"", wire)[1]


@given(messages(), st.integers(0, 10_000))
def test_one_flipped_bit_never_gives_another_message(message: Message, where: int) -> None:
    wire = bytearray(encode(message))
    bit = where % (8 * (len(wire) - 1))
    wire[bit // 8] ^= 1 << bit % 8
    after = Exchange(0, 1, 2, 3)

    _, received = feed(b"", bytes(wire) + b"\0" + encode(after))

    assert received[-1] == after
    assert received[:-1]
    assert all(isinstance(event, Spoilt) for event in received[:-1])


@given(st.lists(st.binary(max_size=300), max_size=20))
def test_pending_bytes_are_bounded(pieces: list[bytes]) -> None:
    pending = b""
    for piece in pieces:
        pending, _ = feed(pending, piece.replace(b"\0", b"\x01"))

        assert len(pending) <= MAX_STUFFED + 1


def test_an_overlong_frame_is_spoilt_and_not_truncated() -> None:
    text = b"\xff\x00\x01\x00".ljust(MAX_STUFFED - 5, b"x")
    longest = cobs.stuff(text + crc32(text).to_bytes(4, "little"))
    assert len(longest) == MAX_STUFFED

    assert _feed_in_pieces([longest, b"\0"]) == [Unknown(0, 1, 0xFF)]
    assert _feed_in_pieces([longest + b"x", b"\0"]) == [Spoilt("length")]
