"""Signals that the page draws, and bins of samples in time; a bin has the range of each signal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil, degrees, inf, log10, nan
from types import MappingProxyType
from typing import Literal, NamedTuple

import msgspec
import numpy as np
from armrig_core.commands.commands import OutputRange
from armrig_core.process.printable import with_degrees
from armrig_core.rig.channels import COUNTS, symbol
from armrig_core.rig.description import Description, builtin
from armrig_core.rig.volts import U_MAX_V
from armrig_core.telemetry.telemetry import Sample
from armrig_protocol.messages import Flag
from numpy.typing import NDArray

Rows = NDArray[np.float64]
"""(n, 1 + 2 S): t in s, then the least and the largest value of each of S signals."""

WIDTH_S = 0.01
"""Width of a bin in s: one pixel if 1000 pixels show 10 s. If the sampling time is longer, each
sample has its own bin.
"""
RATE_S = 0.1
"""Time in s between the two values of a rate; a converter step changes the arm's by 3.5 °/s."""
_STEPS = 1024  # of the Uno's converter
_CENTRED = 0.1  # a range is symmetric if its middle is nearer to 0 than this part of its width
TURN = 360.0
"""A turn in °."""
COLUMNS = 6
"""Number of columns of the samples: see `signals`."""
_RUN = int(Flag.RUN)
_CLOCK_S = 1e-6  # resolution of the times, in s
_MAX_ROWS_BEFORE = 1000  # most earlier rows for a rate; a rig at 1 kHz needs 200


class OwnScale(NamedTuple):
    """The input's own value: offset + per_volt · u."""

    per_volt: float
    offset: float
    unit: str
    rest_v: float
    """Voltage at which the actuator does nothing, in V."""


class Signal(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A signal of the page: the input, an output, or the rate of an output."""

    key: str
    """Name of the signal: `u`, or the name of the output or its rate."""
    label: str
    """Name for people, such as θ₁."""
    unit: str
    """Unit of the values that the page shows; angles are in °."""
    kind: Literal["input", "value", "turning", "rate", "turned"]
    channel: int = 0
    """Number of the channel that the signal belongs to."""
    scale: float = 1.0
    """Factor from the unit of the samples to the unit of the page."""
    step: float = 0.01
    """Change of the signal by one step of the Uno's converter, on average."""
    is_symmetric: bool = False
    """True if the range of the signal is drawn symmetrically about 0."""
    limits: tuple[float, float] = (-inf, inf)
    """Smallest and largest value that a run may have; JSON has null for an infinite one."""
    own: OwnScale | None = None
    """Scale of the input for people; None if it is the voltage at the pin."""


def signals_of(
    description: Description,
    ranges: Mapping[str, OutputRange] = MappingProxyType({}),
    volts: tuple[float, float] = (0.0, U_MAX_V),
) -> tuple[Signal, ...]:
    """Return the signals of a rig in the order of the values in a row.

    `ranges` are the limits that the rig's daemon reports; they narrow those of the description.
    `volts` is the range of the input. If the daemon limits the rotation in a run, this rotation is
    a signal, too.
    """
    given = description.input
    own = OwnScale(given.per_volt, given.offset, given.unit, given.rest_v)
    found = [
        Signal(
            key="u",
            label=symbol(given.name),
            unit="V" if description.text else given.unit,  # imported data have no volts
            kind="input",
            own=own if description.text and (given.is_scaled or given.rest_v) else None,
            # The ends of the axis need no line.
            limits=(volts[0] or -inf, volts[1] if volts[1] < U_MAX_V else inf),
        )
    ]
    for number, channel in enumerate(description.channels):
        output = description.outputs[channel.name]
        scale, unit = 1.0, with_degrees(channel.unit)
        if unit == "rad":
            scale, unit = degrees(1.0), "°"
        ends = output.value(0), output.value(COUNTS - 1)
        step = abs(ends[1] - ends[0]) / _STEPS * scale
        limit = ranges.get(channel.name, OutputRange())
        low = max(output.low, -inf if limit.low is None else limit.low)
        high = min(output.high, inf if limit.high is None else limit.high)
        value = Signal(
            key=channel.name,
            label=symbol(channel.name),
            unit=unit,
            kind="turning" if channel.turns else "value",
            channel=number,
            scale=scale,
            step=step,
            is_symmetric=abs(sum(ends)) < _CENTRED * abs(ends[1] - ends[0]),
            limits=(low * scale, high * scale),
        )
        found.append(value)
        if limit.turns:
            turned = Signal(
                key=f"{channel.name}_turned",
                label=f"turns of {value.label}",
                unit="turns",
                kind="turned",
                channel=number,
                is_symmetric=True,
                limits=(-limit.turns, limit.turns),
            )
            found.append(turned)
        if channel.turns or channel.rate:
            rate = Signal(
                key=channel.rate or f"{channel.name}_rate",
                label=f"rate of {value.label}",
                unit=f"{unit}/s",
                kind="rate",
                channel=number,
                step=step / RATE_S,
                is_symmetric=True,
            )
            found.append(rate)
    return tuple(found)


ARM_SIGNALS = signals_of(builtin("arm"))
"""Signals of the arm, the default rig."""


class RunRotation:
    """Rotation of the first channel since the start of the run, counted as the device does it."""

    def __init__(self) -> None:
        """Begin without a sample."""
        self._before: Sample | None = None
        self._counts = nan

    def add(self, samples: Sequence[Sample]) -> list[float]:
        """Return the rotation at each sample, in turns; NaN without a run, or without its start."""
        turns = []
        for sample in samples:
            before, self._before = self._before, sample
            if before is None or not sample.flags & _RUN:
                self._counts = nan
            elif not before.flags & _RUN:
                self._counts = 0.0
            else:
                change = sample.counts_0 - before.counts_0
                self._counts += (change + COUNTS // 2) % COUNTS - COUNTS // 2
            turns.append(self._counts / COUNTS)
        return turns


def signals(
    samples: Sequence[Sample],
    drawn: Sequence[Signal] = ARM_SIGNALS,
    turned: Sequence[float] | None = None,
) -> Rows:
    """Return an array (n, 6): k, t in s, u in V, both channels, and `turned`; NaN if unknown."""
    found = np.array(
        [(s.k, s.t_sched_ns / 1e9, s.u_applied_v, s.value_0, s.value_1, nan) for s in samples],
        np.float64,
    ).reshape(-1, COLUMNS)
    if turned is not None:
        found[:, -1] = turned
    for signal in drawn:
        found[:, 3 + signal.channel] *= signal.scale
    return found


def rate(before: Rows, now: Rows, *, channel: int = 0, wraps: bool = True) -> Rows:
    """Return the rate of a channel at each row of `now`, (N,) in its unit per s.

    The rate in a row is the difference between the row's value and an older value, divided by the
    time between the two values. The older value is the newest known value at least `RATE_S` before
    the row. If the channel wraps, the two angles are assumed to differ by less than half a turn.

    `before` (m, 6) contains the samples before `now` (N, 6), both from `signals`: see
    `needed_before`. The rate is NaN for a sample without a value, and if the older value is more
    than 2 `RATE_S` before the sample and not in the previous sample.
    """
    every, place_of_value = np.concatenate([before, now]), 3 + channel
    known = every[np.isfinite(every[:, place_of_value])]
    slope = np.full(now.shape[0], np.nan)
    if known.shape[0]:
        place = np.searchsorted(known[:, 1], now[:, 1] - RATE_S + _CLOCK_S, "right") - 1
        older = known[np.maximum(place, 0)]
        elapsed = now[:, 1] - older[:, 1]
        near = (elapsed <= 2 * RATE_S + _CLOCK_S) | (now[:, 0] - older[:, 0] == 1)
        change = now[:, place_of_value] - older[:, place_of_value]
        if wraps:
            change -= TURN * np.round(change / TURN)
        use = near & (place >= 0)
        slope[use] = change[use] / elapsed[use]
    return slope


def needed_before(found: Rows) -> Rows:
    """Return the newest rows, at most `_MAX_ROWS_BEFORE`, that the rates of later samples need."""
    found = found[-_MAX_ROWS_BEFORE:]
    first = int(np.searchsorted(found[:, 1], found[-1, 1] - 2 * RATE_S))
    return found[min(first, found.shape[0] - 1) :]


def columns_of(before: Rows, now: Rows, drawn: Sequence[Signal]) -> Rows:
    """Return the values of the signals at each row of `now`, (N, S)."""
    turning = {signal.channel for signal in drawn if signal.kind == "turning"}
    return np.column_stack(
        [
            rate(before, now, channel=signal.channel, wraps=signal.channel in turning)
            if signal.kind == "rate"
            else now[:, {"input": 2, "turned": -1}.get(signal.kind, 3 + signal.channel)]
            for signal in drawn
        ]
    )


def binned(before: Rows, found: Rows, drawn: Sequence[Signal] = ARM_SIGNALS) -> Rows:
    """Return a row for each bin of samples; a wrap of an angle divides its bin into two rows.

    The values are rounded to 0.01 or, for a small step of the converter, to a tenth of the step or
    less. `before` contains the samples before `found`: see `needed_before`.
    """
    places = [10.0 ** max(2, 1 + ceil(-log10(signal.step))) for signal in drawn]
    values = np.rint(columns_of(before, found, drawn) * places) / places
    each = np.column_stack([found[:, 1], np.repeat(values, 2, axis=1)])
    return coarser(each, WIDTH_S, drawn)


def coarser(rows: Rows, width_s: float, drawn: Sequence[Signal] = ARM_SIGNALS) -> Rows:
    """Return rows in wider bins; a new bin begins where an angle jumps by more than half a turn."""
    if not rows.shape[0]:
        return rows
    bins = np.floor(rows[:, 0] / width_s + 1e-6)
    begins = np.diff(bins, prepend=np.nan) != 0
    for column, signal in zip(range(1, rows.shape[1], 2), drawn, strict=True):
        if signal.kind == "turning":
            # A potentiometer wraps inside its dead band, whose unknown angles are skipped.
            first_y, n = rows[:, column], np.arange(rows.shape[0])
            known = np.maximum.accumulate(np.where(np.isnan(first_y), 0, n))
            # The comparison is False for NaN.
            begins |= np.abs(np.diff(first_y[known], prepend=first_y[:1])) > TURN / 2
    first = np.flatnonzero(begins)
    made = np.empty((first.size, rows.shape[1]))
    made[:, 0] = rows[first, 0]
    # fmin and fmax ignore NaN, unless all values are NaN.
    made[:, 1::2] = np.fmin.reduceat(rows[:, 1::2], first)
    made[:, 2::2] = np.fmax.reduceat(rows[:, 2::2], first)
    return made


def as_lists(rows: Rows) -> list[list[float]]:
    """Return rows for JSON, with t rounded to 0.001.

    Unknown values are NaN, which the encoder writes as null.
    """
    lists: list[list[float]] = rows.tolist()
    return [[round(row[0], 3), *row[1:]] for row in lists]
