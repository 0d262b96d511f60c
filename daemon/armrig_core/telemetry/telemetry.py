"""The messages that armrig publishes and records, and the constant layout of a sample.

All `SAMPLE_FIELDS` have a fixed width and are always written. Each field of an encoded `Sample` is
therefore at a constant offset. The struct module can encode a sample, and numpy can read a million
samples at once. Other programs read a sample as plain protobuf. New fields are only appended. A
field's name ends in its unit.
"""

from __future__ import annotations

from struct import Struct
from typing import Final, Literal, NamedTuple

PACKAGE = "armrig.v1"

THETA_1: Final = "theta_1"
ALPHA: Final = "alpha"
VELOCITY: Final = "velocity"
ChannelName = Literal["theta_1", "alpha"]
OutputName = Literal["theta_1", "alpha", "velocity"]
"""Name of a model's output: a channel, or the rate of a channel."""


class Channel(NamedTuple):
    """A quantity that the device reads at each sample, with its names in samples and recordings."""

    name: str
    unit: str
    rail: str
    """Name of the `armrig_protocol.messages.Flag` that marks a reading at an end of its range."""
    valid: str
    """Name of the mask, in a recording, that is True where the channel's reading is valid."""
    turns: bool = False
    """True if the shaft turns through a dead band, so that its turns are counted."""
    rate: str = ""
    """Name of the channel's rate if the rate is an output; otherwise empty."""

    @property
    def value_field(self) -> str:
        """Name of the field with the value of the channel in a sample."""
        return f"{self.name}_{self.unit}"

    @property
    def counts_field(self) -> str:
        """Name of the field with the raw reading of the channel in a sample."""
        return f"{self.name}_counts"


CHANNELS: tuple[Channel, ...] = (
    Channel(THETA_1, "rad", rail="ADC0_RAIL", valid="valid", turns=True, rate=VELOCITY),
    Channel(ALPHA, "rad", rail="ADC1_RAIL", valid="valid_alpha"),
)
"""Channels of a sample, in addition to u. A new channel and its fields are appended."""

SAMPLE_FIELDS = (
    ("k", "fixed64"),
    ("t_sched_ns", "sfixed64"),
    ("t_host_ns", "sfixed64"),
    ("t_device_us", "fixed64"),
    *((channel.value_field, "double") for channel in CHANNELS[:2]),
    ("u_cmd_v", "double"),
    ("u_applied_v", "double"),
    *((channel.counts_field, "fixed32") for channel in CHANNELS[:2]),
    ("flags", "fixed32"),
)
"""Name and protobuf type of each field of `armrig.v1.Sample`, numbered from 1."""

LETTERS = {"fixed64": "Q", "sfixed64": "q", "double": "d", "fixed32": "I"}
"""Letter of the struct module for each protobuf type of fixed width."""

_WIRE_TYPES = {"fixed64": 1, "sfixed64": 1, "double": 1, "fixed32": 5}
_LAYOUT = Struct("<" + "".join("B" + LETTERS[kind] for _, kind in SAMPLE_FIELDS))
_TAGS = tuple(number << 3 | _WIRE_TYPES[kind] for number, (_, kind) in enumerate(SAMPLE_FIELDS, 1))

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
    """Time at which the conversion of theta_1 was triggered, on the unwrapped device clock."""
    theta_1_rad: float
    """Angle of the chassis from its potentiometer, which wraps; NaN for a reading at a rail."""
    alpha_rad: float
    """Angle of the arm relative to the chassis; NaN for a reading at a rail."""
    u_cmd_v: float
    """Voltage that is requested from this sample on."""
    u_applied_v: float
    """Voltage that the device reports as latched at this sample."""
    theta_1_counts: int
    """Raw reading, left-justified to 16 bit."""
    alpha_counts: int
    """Raw reading, left-justified to 16 bit."""
    flags: int
    """`armrig_protocol.messages.Flag` of the device."""


def encode_sample(sample: Sample) -> bytes:
    """Return a sample as protobuf `armrig.v1.Sample`, `SAMPLE_LENGTH` bytes."""
    k, t_sched, t_host, t_device, theta_1, alpha, u_cmd, u_applied, y0, y1, flags = sample
    a, b, c, d, e, f, g, h, i, j, m = _TAGS
    return _LAYOUT.pack(
        *(a, k, b, t_sched, c, t_host, d, t_device, e, theta_1, f, alpha),
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
