"""Channels of a rig: what the device reads at each sample, and the value of a reading."""

from __future__ import annotations

import re
import unicodedata
from bisect import bisect
from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
from math import nan
from typing import Literal, NamedTuple

import msgspec

from armrig_core.errors import InputError

MAX_CHANNELS = 2
"""Number of readings in each sample of the device; a rig may use fewer."""
_LOWERED = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
COUNTS = 65536
"""Full scale of a reading, in counts."""
HALF_COUNTS = COUNTS // 2
MAX_VALUE = 1e15
"""Largest magnitude of a value, so that differences and squares of values are finite."""
RAIL_COUNTS = 64
"""Width of each end of the converter's range in which a reading counts as a broken wire."""
Rail = Literal["", "low", "high"]
"""End of the converter's range, at 0 V or at the reference; empty for none."""
_RAILS = ("ADC0_RAIL", "ADC1_RAIL")
_WORDS = (("%", "percent"), ("°", "deg"), ("Ω", "ohm"), ("µ", "u"), ("μ", "u"), ("/", "_per_"))


class DeviceChannel(NamedTuple):
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
    """Part of the rig whose motion the channel shows, such as "arm"; otherwise empty."""

    @property
    def value_field(self) -> str:
        """Name of the field with the value of the channel in a sample."""
        return value_field(self.name, self.unit)

    @property
    def counts_field(self) -> str:
        """Name of the field with the raw reading of the channel in a sample."""
        return f"{self.name}_counts"


Points = tuple[tuple[float, float], ...]
"""Readings in counts, each with its value in the output's unit, in the order of the readings."""


class Conversion(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """Conversion of a channel's counts: value = (counts - zero_counts) · per_count, or by points.

    Points are joined by straight lines; the first and the last line continue beyond the points.
    """

    zero_counts: float
    per_count: float
    """Change of the value by one count; 0 for a reading that the rig does not use."""
    points: Points = ()
    valid_rail: Rail = ""
    """End of the range at which a reading is a value, and no broken wire."""

    def value_at_rail(self, counts: float) -> float:
        """Return the value of a reading at an end of the range; NaN unless this end is valid."""
        end = "low" if counts < HALF_COUNTS else "high"
        return self.value(counts) if end == self.valid_rail else nan

    def value(self, counts: float) -> float:
        """Return the value of a reading in counts, in the channel's unit; NaN if it is not used."""
        if self.points:
            return _on_lines(self.points, counts)
        return (counts - self.zero_counts) * self.per_count if self.per_count else nan

    def counts(self, value: float) -> float:
        """Return the reading of a value, in counts, without the limits of the converter."""
        if self.points:
            return _on_lines(sorted((y, x) for x, y in self.points), value)
        return value / self.per_count + self.zero_counts

    def step(self, counts: float) -> float:
        """Return the change of the value by one count at a reading, in the channel's unit."""
        return self.value(counts + 0.5) - self.value(counts - 0.5)


def check_points(points: Sequence[tuple[float, float]]) -> None:
    """Raise InputError if points are no function of the reading that has an inverse."""
    if len(points) < 2 or not all(abs(x) <= MAX_VALUE for point in points for x in point):
        raise InputError(
            "points: give at least two pairs [counts, value] of finite numbers, within "
            f"±{MAX_VALUE:g}"
        )
    if outside := [x for x, _ in points if not 0 <= x <= COUNTS]:
        raise InputError(
            f"points: {outside[0]:g} counts; the converter reads 0 to {COUNTS - 1} counts, so give "
            f"counts of 0 to {COUNTS}"
        )
    for (x, y), (x_next, y_next) in pairwise(points):
        if x_next <= x:
            raise InputError(f"points: {x_next:g} after {x:g}: the counts must increase")
        if (y_next - y) * (points[1][1] - points[0][1]) <= 0:
            raise InputError(
                f"points: {y:g} at {x:g} counts, and then {y_next:g}: the values must increase, or "
                "decrease, from each point to the next"
            )


def _on_lines(points: Sequence[tuple[float, float]], x: float) -> float:
    """Return the ordinate at x on the lines through points."""
    at = bisect(points, x, 1, len(points) - 1, key=lambda point: point[0])
    (left, low), (right, high) = points[at - 1], points[at]
    return low + (x - left) * (high - low) / (right - left)


NO_CONVERSION = Conversion(0.0, 0.0)
"""Conversion of a reading that the rig does not use."""


def channel(
    number: int, name: str, unit: str, *, turns: bool = False, rate: str = "", body: str = ""
) -> DeviceChannel:
    """Return the channel of a rig's output; `number` is the number of the device's reading."""
    valid = f"valid_{name}" if number else "valid"
    return DeviceChannel(name, unit, _RAILS[number], valid, turns, rate, body)


def value_field(name: str, unit: str) -> str:
    """Return a name for the value of an output that protobuf allows, such as `T1_degC`."""
    for sign, word in _WORDS:
        unit = unit.replace(sign, word)
    word = re.sub(r"[^A-Za-z0-9_]", "", unit)
    return f"{name}_{word}" if word else name


def symbol(name: str) -> str:
    """Return a name for people: a Greek letter for its word, and a lowered number after a _."""
    word, _, number = name.partition("_")
    if "_" in name and not number.isdigit():
        return name
    with suppress(KeyError):
        word = unicodedata.lookup(f"GREEK SMALL LETTER {word}")
    return word + number.translate(_LOWERED)


def tex_symbol(name: str) -> str:
    """Return a name as TeX: a Greek letter for its word, and a lowered number after a _."""
    word, _, number = name.partition("_")
    return ("\\" if symbol(word) != word else "") + word + (f"_{number}" if number else "")


def sample_names(channels: Sequence[DeviceChannel]) -> tuple[str, ...]:
    """Return the names of the fields in a sample of a rig with these channels."""
    unused = [f"unused_{number}" for number in range(len(channels), MAX_CHANNELS)]
    values = (*(channel.value_field for channel in channels), *unused)
    counts = (*(channel.counts_field for channel in channels), *(f"{n}_counts" for n in unused))
    times = ("k", "t_sched_ns", "t_host_ns", "t_device_us")
    return (*times, *values, "u_cmd_v", "u_applied_v", *counts, "flags")
