"""What a recording holds beside samples: gaps, events, and timing, on the recording's own time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from armrig_core.manifest import Manifest, Outcome

_DEPTH_LIMIT = 32
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
class Distribution:
    """How a time was distributed over one second."""

    p50: float
    """Median, in µs."""
    p90: float
    """90th percentile, in µs."""
    p99: float
    """99th percentile, in µs."""
    p999: float
    """99.9th percentile, in µs."""
    max: float
    """Longest, in µs."""
    n: int
    """How many there were."""
    missed: int
    """How many were not in time at all."""


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


def check_whole_numbers(*told: Manifest | Outcome) -> None:
    """Raise ValueError where a whole number needs more than 64 bit: no time, index or count does.

    Python reads 400 digits as gladly, and then fails wherever they meet a float. And where what
    is nested lies deeper than anything we write: whoever prints it would exceed the recursion.
    """
    for part in told:
        for name in part.__struct_fields__:
            value = getattr(part, name)
            if isinstance(value, int) and not -(2**63) <= value < 2**63:
                msg = f"{name} does not fit into 64 bit"
                raise ValueError(msg)
            depth, layer = 0, [value]
            while layer := [v for outer in layer for v in _within(outer)]:
                depth += 1
                if depth > _DEPTH_LIMIT:
                    msg = f"{name} is nested more than {_DEPTH_LIMIT} deep"
                    raise ValueError(msg)


def _within(value: Any) -> Iterable[Any]:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list) else ()


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


def timing_of(message: Any, clock: Clock) -> Timing:
    """Return the timing in a protobuf message."""

    def distribution(part: Any) -> Distribution:
        return Distribution(**{name: getattr(part, name) for name in Distribution.__slots__})

    return Timing(
        t=clock.seconds(message.t_host_ns),
        wake_lateness_us=distribution(message.wake_lateness_us),
        device_tick_error_us=distribution(message.device_tick_error_us),
        link_round_trip_us=distribution(message.link_round_trip_us),
    )
