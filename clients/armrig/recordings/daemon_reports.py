"""What a recording holds beside samples: gaps, events, timing and clock, on its own time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from itertools import groupby
from math import floor
from operator import attrgetter
from typing import Any

from armrig_core import protobuf

from armrig.numerics.quantities import plural

_LEVELS = ("unknown", "debug", "info", "warning", "error", "fatal")


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """Samples that are missing."""

    k_first: int
    """Index of the first of them, counted as `Sample.k`."""
    count: int
    """How many."""
    t: float
    """When the first was due, in s from the recording's first sample."""
    u_held_v: float
    """Voltage that the motor kept meanwhile, in V."""
    reason: str
    """Why they are missing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """What the daemon had to say."""

    t: float
    """When, in s from the recording's first sample."""
    level: str
    """debug, info, warning, error or fatal."""
    message: str
    """What happened."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Note:
    """A line that a person wrote during the run."""

    t: float
    """When it came, in s from the recording's first sample."""
    text: str
    """What it says."""
    owner: str
    """Author."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Distribution:
    """How a quantity was distributed over one second, in its own unit."""

    p50: float
    """Median."""
    p90: float
    """90th percentile."""
    p99: float
    """99th percentile."""
    p999: float
    """99.9th percentile."""
    max: float
    """Greatest."""
    n: int
    """How many there were."""
    missed: int
    """How many were not in time at all."""


_NOT_SAID = protobuf.ABSENT["fixed64"]
_DISTRIBUTION = tuple(f.name for f in fields(Distribution))
_distribution_values = attrgetter(*_DISTRIBUTION)


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Timing as the daemon measured it while it ran, over the second before `t`."""

    t: float
    """When, in s from the recording's first sample."""
    wake_lateness_us: Distribution
    """Of the host, against the sample's deadline, in µs."""
    device_tick_error_us: Distribution
    """Of the device's clock, against the sampling time, in µs."""
    link_round_trip_us: Distribution
    """Of the link, from request to answer, in µs."""
    queue_depth: Distribution
    """Setpoints that the device held ahead; n is 0 where it had no queue."""
    collections: int
    """Garbage collections of the loop since it was started: each is a stall; -1: unknown."""
    cpu_pressure_percent: float
    """Share of the second in which some task of the host waited for a processor; NaN: unknown."""
    run_queue: int
    """Tasks of the host that were runnable; -1: unknown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceClock:
    """The device's clock against the host's, as known at `t`; no time recorded is changed by it."""

    t: float
    """When, in s from the recording's first sample."""
    offset_ns: int
    """Host's monotonic time less 1000 times the device's µs."""
    offset_std_ns: float
    """Standard deviation of the offset, in ns."""
    drift_ppm: float
    """What the offset gains, in parts per million; positive where the device's clock is slow."""
    drift_std_ppm: float
    """Standard deviation of the drift, in parts per million."""
    bound_ns: float
    """The most that a constant asymmetry of the way can hide in the offset, in ns."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Clock:
    """Host times to seconds from the recording's first sample."""

    zero_ns: int
    """When the first sample was due, on the host's monotonic clock."""
    offset_ns: int
    """Real-time clock less monotonic clock."""

    def seconds(self, host_ns: int) -> float:
        """Return a time of the monotonic clock in s from the first sample."""
        return (host_ns - self.zero_ns) / 1e9


def gap_of(message: Any, clock: Clock) -> Gap:
    """Return the gap in a protobuf message."""
    return Gap(
        k_first=message.k_first,
        count=message.count,
        t=clock.seconds(message.t_from_ns),
        u_held_v=message.u_held_v,
        reason=message.reason,
    )


def event_of(message: Any, clock: Clock) -> Event:
    """Return the event in a protobuf message."""
    stamp = message.timestamp
    real_ns = stamp.seconds * 1_000_000_000 + stamp.nanos
    level = _LEVELS[message.level] if 0 <= message.level < len(_LEVELS) else str(message.level)
    return Event(t=clock.seconds(real_ns - clock.offset_ns), level=level, message=message.message)


def is_note(message: Any) -> bool:
    """Return whether a person wrote a log record, by its `name`."""
    return bool(message.name == protobuf.NOTE)


def note_of(message: Any, clock: Clock) -> Note:
    """Return the note in a protobuf message."""
    return Note(t=clock.seconds(message.t_host_ns), text=message.message, owner=message.owner)


def timing_of(message: Any, clock: Clock) -> Timing:
    """Return the timing in a protobuf message."""
    return Timing(
        t=clock.seconds(message.t_host_ns),
        wake_lateness_us=_distribution(message.wake_lateness_us),
        device_tick_error_us=_distribution(message.device_tick_error_us),
        link_round_trip_us=_distribution(message.link_round_trip_us),
        queue_depth=_distribution(message.queue_depth),
        collections=-1 if message.collections == _NOT_SAID else message.collections,
        cpu_pressure_percent=message.cpu_pressure_percent,
        run_queue=message.run_queue,
    )


def _distribution(message: Any) -> Distribution:
    return Distribution(**dict(zip(_DISTRIBUTION, _distribution_values(message), strict=True)))


def device_clock_of(message: Any, clock: Clock) -> DeviceClock:
    """Return the comparison of the clocks in a protobuf message."""
    return DeviceClock(
        t=clock.seconds(message.t_host_ns),
        offset_ns=message.offset_ns,
        offset_std_ns=message.offset_std_ns,
        drift_ppm=message.drift_ppm,
        drift_std_ppm=message.drift_std_ppm,
        bound_ns=message.bound_ns,
    )


def gap_lines(gaps: Iterable[Gap]) -> list[str]:
    """Return what is missing, at most one line a second; the counts are whole."""
    return [_gap_line(list(some)) for _, some in groupby(gaps, key=lambda gap: floor(gap.t))]


def _gap_line(gaps: list[Gap]) -> str:
    count = sum(gap.count for gap in gaps)
    samples = plural(count, "sample")
    reasons = ", ".join(dict.fromkeys(gap.reason for gap in gaps))
    if len(gaps) == 1:
        return f"{samples} at {gaps[0].t:.3f} s, {reasons}"
    return f"{samples} in {len(gaps)} gaps from {gaps[0].t:.3f} s to {gaps[-1].t:.3f} s, {reasons}"
