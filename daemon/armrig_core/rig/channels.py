"""Channels of a rig: what the device reads at each sample, and the value of a reading."""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import nan
from typing import NamedTuple

import msgspec

MAX_CHANNELS = 2
"""Number of readings in each sample of the device; a rig may use fewer."""
_RAILS = ("ADC0_RAIL", "ADC1_RAIL")
_WORDS = (("%", "percent"), ("°", "deg"), ("Ω", "ohm"), ("µ", "u"), ("μ", "u"), ("/", "_per_"))


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
    body: str = ""
    """Part of the rig whose motion the channel shows, such as "chassis"; otherwise empty."""

    @property
    def value_field(self) -> str:
        """Name of the field with the value of the channel in a sample."""
        return value_field(self.name, self.unit)

    @property
    def counts_field(self) -> str:
        """Name of the field with the raw reading of the channel in a sample."""
        return f"{self.name}_counts"


class Conversion(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """Conversion of a channel's counts: value = (counts - zero_counts) · per_count."""

    zero_counts: float
    per_count: float
    """Change of the value by one count; 0 for a reading that the rig does not use."""

    def value(self, counts: float) -> float:
        """Return the value of a reading in counts, in the channel's unit; NaN if it is not used."""
        if not self.per_count:
            return nan
        return (counts - self.zero_counts) * self.per_count


NO_CONVERSION = Conversion(0.0, 0.0)
"""Conversion of a reading that the rig does not use."""


def channel(
    number: int, name: str, unit: str, *, turns: bool = False, rate: str = "", body: str = ""
) -> Channel:
    """Return the channel of a rig's output; `number` is the number of the device's reading."""
    valid = f"valid_{name}" if number else "valid"
    return Channel(name, unit, _RAILS[number], valid, turns, rate, body)


def value_field(name: str, unit: str) -> str:
    """Return a name for the value of an output that protobuf allows, such as `T1_degC`."""
    for sign, word in _WORDS:
        unit = unit.replace(sign, word)
    word = re.sub(r"[^A-Za-z0-9_]", "", unit)
    return f"{name}_{word}" if word else name


def sample_names(channels: Sequence[Channel]) -> tuple[str, ...]:
    """Return the names of the fields in a sample of a rig with these channels."""
    unused = [f"unused_{number}" for number in range(len(channels), MAX_CHANNELS)]
    values = (*(channel.value_field for channel in channels), *unused)
    counts = (*(channel.counts_field for channel in channels), *(f"{n}_counts" for n in unused))
    times = ("k", "t_sched_ns", "t_host_ns", "t_device_us")
    return (*times, *values, "u_cmd_v", "u_applied_v", *counts, "flags")
