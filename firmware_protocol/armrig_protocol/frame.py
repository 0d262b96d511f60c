"""Encoding of a message to its bytes on the wire, and decoding of these bytes."""

from __future__ import annotations

from struct import Struct
from typing import Any, NamedTuple
from zlib import crc32

from armrig_protocol import cobs
from armrig_protocol.messages import ARRAYS, LAYOUTS, MESSAGES, TYPES, Config, Message

_CRC = Struct("<I")  # CRC-32/ISO-HDLC, which zlib computes
_RESIDUE = 0x2144DF1C  # CRC-32 of every text that ends in its own CRC-32, such as a valid frame
_HEADER = Struct("<BBH")
_TEXTS = {number: Struct("<B" + layout) for number, layout in LAYOUTS.items()}
_BODIES = {number: Struct("<x" + layout) for number, layout in LAYOUTS.items()}

LENGTHS = {number: text.size + _CRC.size for number, text in _TEXTS.items()}
"""Decoded length of each type of frame, including header and CRC, in bytes."""


def wire_length(message: type[Message]) -> int:
    """Return the length of a message of this class on the wire, including its 00, in bytes."""
    return LENGTHS[TYPES[message]] + 2


def config_crc(config: Config) -> int:
    """Return the CRC-32 of a CONFIG's body, by which ARM identifies the configuration."""
    return crc32(_TEXTS[TYPES[Config]].pack(TYPES[Config], *config)[_HEADER.size :])


class Unknown(NamedTuple):
    """A valid frame of a type that is not in the schema."""

    state: int
    seq: int
    type: int


class Spoilt(NamedTuple):
    """A piece of bytes that is not a valid frame; a device counts the piece, and never answers."""

    reason: str
    """`cobs`, `crc` or `length`: the check that failed."""


def encode(message: Message) -> bytes:
    """Return the bytes of `message` on the wire, including the 00 at their end.

    Raises struct.error if a field does not fit its type.
    """
    number = TYPES[type(message)]
    fields: tuple[Any, ...] = message
    if number in ARRAYS:  # the last field is an array
        fields = (*fields[:-1], *fields[-1])
    text = _TEXTS[number].pack(number, *fields)
    return cobs.stuff(text + _CRC.pack(crc32(text))) + b"\0"


def decode(stuffed: bytes) -> Message | Unknown | Spoilt:
    """Return the message in the bytes between two 00, or the reason why they are not a frame."""
    frame = cobs.unstuff(stuffed)
    if frame is None:
        return Spoilt("cobs")
    size = len(frame) - _CRC.size
    if size < _HEADER.size:
        return Spoilt("length")
    if crc32(frame) != _RESIDUE:
        return Spoilt("crc")
    number = frame[0]
    body = _BODIES.get(number)
    if body is None:
        _, state, seq = _HEADER.unpack_from(frame)
        return Unknown(state, seq, number)
    if body.size != size:
        return Spoilt("length")
    fields = body.unpack_from(frame)
    if number in ARRAYS:
        count = ARRAYS[number]
        fields = (*fields[:-count], fields[-count:])
    # Twice as fast as `_make`, which also checks the number of fields. The layout guarantees this
    # number.
    return tuple.__new__(MESSAGES[number], fields)
