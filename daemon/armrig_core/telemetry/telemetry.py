"""The messages that armrig publishes and records, and the constant layout of a sample.

All fields of a sample have a fixed width and are always written. Each field of an encoded `Sample`
is therefore at a constant offset. The struct module can encode a sample, and numpy can read a
million samples at once. Other programs read a sample as plain protobuf. New fields are only
appended. Two values and two readings have the names of the rig's channels; a field's name ends in
its unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from keyword import iskeyword
from operator import itemgetter
from struct import Struct
from typing import NamedTuple

from armrig_core.rig.channels import DeviceChannel, sample_names

PACKAGE = "armrig.v1"

_KINDS = (
    *("fixed64", "sfixed64", "sfixed64", "fixed64"),
    *("double", "double", "double", "double"),
    *("fixed32", "fixed32", "fixed32"),
)
"""Protobuf type of each field of `armrig.v1.Sample`, numbered from 1."""


def sample_fields(channels: Sequence[DeviceChannel]) -> tuple[tuple[str, str], ...]:
    """Return name and protobuf type of each field of the sample of a rig with these channels."""
    return tuple(zip(sample_names(channels), _KINDS, strict=True))


LETTERS = {"fixed64": "Q", "sfixed64": "q", "double": "d", "fixed32": "I"}
"""Letter of the struct module for each protobuf type of fixed width."""

_WIRE_TYPES = {"fixed64": 1, "sfixed64": 1, "double": 1, "fixed32": 5}
_LAYOUT = Struct("<" + "".join("B" + LETTERS[kind] for kind in _KINDS))
_TAGS = tuple(number << 3 | _WIRE_TYPES[kind] for number, kind in enumerate(_KINDS, 1))

SAMPLE_LENGTH = _LAYOUT.size
"""Length of an encoded sample, in bytes."""


class Sample(NamedTuple):
    """State of the rig at one instant, as published and recorded."""

    k: int
    """Index of the sample, counted by the host in sampling times; a jump in the index is a gap."""
    t_sched_ns: int
    """Due time of the sample, on the host's monotonic clock."""
    t_host_ns: int
    """Time at which the host requested the sample (in a scheduled run: received it); same clock."""
    t_device_us: int
    """Time at which the conversion of channel 0 was triggered, on the unwrapped device clock."""
    value_0: float
    """Value of channel 0, in its unit; NaN for a reading at a rail, or without such a channel."""
    value_1: float
    """Value of channel 1, in its unit; NaN for a reading at a rail, or without such a channel."""
    u_cmd_v: float
    """Voltage that is requested from this sample on."""
    u_applied_v: float
    """Voltage that the device reports as latched at this sample."""
    counts_0: int
    """Raw reading of channel 0, left-justified to 16 bit."""
    counts_1: int
    """Raw reading of channel 1, left-justified to 16 bit."""
    flags: int
    """`armrig_protocol.messages.Flag` of the device."""


@cache
def sample_class(names: tuple[str, ...]) -> type[Sample]:
    """Return `Sample` with the names of a rig for its fields, in addition to those by number.

    A field keeps its name by number if Python does not allow the rig's name.
    """
    allowed = (
        name.isidentifier() and not iskeyword(name) and not hasattr(tuple, name) for name in names
    )
    fields = tuple(
        name if is_allowed else by_number
        for name, is_allowed, by_number in zip(names, allowed, Sample._fields, strict=True)
    )
    values = {name: property(itemgetter(i)) for i, name in enumerate(fields)}
    by_number = {name: getattr(Sample, name) for name in Sample._fields}
    made = {"__slots__": (), "_fields": fields, "__repr__": _repr, **values, **by_number}
    return type("Sample", (Sample,), made)


def _repr(sample: Sample) -> str:
    fields = (f"{name}={value!r}" for name, value in sample._asdict().items())
    return f"Sample({', '.join(fields)})"


def encode_sample(sample: Sample) -> bytes:
    """Return a sample as protobuf `armrig.v1.Sample`, `SAMPLE_LENGTH` bytes."""
    k, t_sched, t_host, t_device, value_0, value_1, u_cmd, u_applied, y0, y1, flags = sample
    a, b, c, d, e, f, g, h, i, j, m = _TAGS
    return _LAYOUT.pack(
        *(a, k, b, t_sched, c, t_host, d, t_device, e, value_0, f, value_1),
        *(g, u_cmd, h, u_applied, i, y0, j, y1, m, flags),
    )


def decode_sample(data: bytes) -> Sample | None:
    """Return the sample in `data`; None if `data` does not have the constant layout."""
    if len(data) != SAMPLE_LENGTH:
        return None
    values = _LAYOUT.unpack(data)
    return Sample._make(values[1::2]) if values[::2] == _TAGS else None


class Outgoing(NamedTuple):
    """One message on its way to the subscribers and the file."""

    stream: str
    t_host_ns: int
    """Monotonic time of the content, in ns."""
    t_sched_ns: int
    """Monotonic time at which the content was due, in ns."""
    sequence: int
    data: bytes
