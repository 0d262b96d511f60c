"""Golden vectors of the messages: for each message, all bits 0, all bits 1, and mixed bits."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from hashlib import shake_128
from struct import Struct
from typing import Any

from armrig_protocol import cobs
from armrig_protocol.crc import crc32

FILLINGS = ("zero", "ones", "mixed")


def vectors_of(name: str, number: int, layout: str, fields: Sequence[str]) -> Iterator[str]:
    """Yield a message's vectors, one per line.

    The vectors are made from the schema alone, not by the codec that they test.

    Parameters
    ----------
    layout : str
        Layout of the bytes between the type and the CRC, in the letters of the struct module.
    fields : sequence of str
        Names of the fields; the last field takes all remaining values.
    """
    text = Struct("<" + layout)
    # The bytes depend on the name alone: a field added at the end changes no byte before it.
    mixed = shake_128(name.encode()).digest(text.size)
    raws = (bytes(text.size), b"\xff" * text.size, mixed)
    for filling, raw in zip(FILLINGS, raws, strict=True):
        values: list[Any] = list(text.unpack(raw))
        if len(values) > len(fields):
            values[len(fields) - 1 :] = [values[len(fields) - 1 :]]
        frame = bytes([number]) + raw
        wire = cobs.stuff(frame + crc32(frame).to_bytes(4, "little")) + b"\0"
        event = {"event": name, **dict(zip(fields, values, strict=True))}
        vector = {"doc": f"{name} {filling}", "wire": wire.hex(), "events": [event]}
        yield json.dumps(vector)


def is_generated(line: str) -> bool:
    """Return whether a line of the file is generated; all other lines are written by hand."""
    name, _, filling = json.loads(line)["doc"].partition(" ")
    return name.isidentifier() and filling in FILLINGS


def vectors_text(before: str, generated: Sequence[str]) -> str:
    """Return the text of the file: the lines written by hand, then the generated lines."""
    lines = [line.rstrip(",") for line in before.splitlines()[1:-1]]
    by_hand = [line for line in lines if not is_generated(line)]
    return "[\n" + ",\n".join([*by_hand, *generated]) + "\n]\n"
