"""Reports of the daemon in a recording: gaps, events, notes, timing and comparisons of clocks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from itertools import groupby
from math import floor
from typing import Any

from armrig_core.commands.codes import GapCode
from armrig_core.telemetry import protobuf

from armrig.numerics.quantities import plural

_LEVELS = ("unknown", "debug", "info", "warning", "error", "fatal")


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """Consecutive missing samples."""

    k_first: int
    """Index of the first missing sample, as in `Sample.k`."""
    count: int
    """Number of missing samples."""
    t: float
    """Time at which the first missing sample was due, in s from the recording's first sample."""
    u_held_v: float
    """Voltage held at the motor during the gap, in V."""
    reason: str
    """Reason for the gap."""
    code: str
    """Code of the reason: an `armrig_core.commands.codes.GapCode`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Log message of the daemon."""

    t: float
    """Time, in s from the recording's first sample."""
    level: str
    """Level: debug, info, warning, error or fatal."""
    message: str
    """Text of the message."""
    emulator_stall_ns: int
    """Time for which the clock of an emulated rig stopped, in ns; 0 if it did not stop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Note:
    """A line of text that a person wrote during the run."""

    t: float
    """Time at which the note arrived, in s from the recording's first sample."""
    text: str
    """Text of the note."""
    owner: str
    """Author of the note."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TimingPercentiles:
    """Distribution of a quantity over one second, in the quantity's unit."""

    p50: float
    """Median."""
    p90: float
    """90th percentile."""
    p99: float
    """99th percentile."""
    p999: float
    """99.9th percentile."""
    max: float
    """Greatest value."""
    n: int
    """Number of values."""
    missed: int
    """Number of missed sampling times."""


_ABSENT_COUNT = protobuf.ABSENT["fixed64"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Timing that the daemon measured during the second before `t`."""

    t: float
    """Time, in s from the recording's first sample."""
    wake_lateness_us: TimingPercentiles
    """Lateness of the host relative to the sample's deadline, in µs."""
    device_tick_error_us: TimingPercentiles
    """Absolute error of the sampling interval, measured with the device's clock, in µs."""
    link_round_trip_us: TimingPercentiles
    """Round trip of the link, from request to answer, in µs."""
    queue_depth: TimingPercentiles
    """Number of setpoints in the device's queue; `n` is 0 for a device without a queue."""
    collections: int
    """Number of garbage collections since the loop started; each stalls the loop. -1: unknown."""
    cpu_pressure_percent: float
    """Part of this second in which a task waited for a processor, in %; NaN: unknown."""
    run_queue: int
    """Number of runnable tasks of the host; -1: unknown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceClock:
    """Comparison of device clock and host clock at `t`; recorded times are not corrected by it."""

    t: float
    """Time, in s from the recording's first sample."""
    offset_ns: int
    """Host's monotonic time minus the device's time, in ns."""
    offset_std_ns: float
    """Standard deviation of the offset, in ns."""
    drift_ppm: float
    """Growth of the offset, in parts per million; positive if the device's clock is slow."""
    drift_std_ppm: float
    """Standard deviation of the drift, in parts per million."""
    bound_ns: float
    """Largest error of the offset that a constant asymmetry of the link can cause, in ns."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingClock:
    """Conversion of host times to seconds from the recording's first sample."""

    zero_ns: int
    """Time at which the first sample was due, on the host's monotonic clock, in ns."""
    offset_ns: int
    """Real-time clock minus monotonic clock, in ns."""

    def seconds(self, host_ns: int) -> float:
        """Convert a time of the monotonic clock to s from the first sample."""
        return (host_ns - self.zero_ns) / 1e9


def reports_of(messages: Mapping[str, list[Any]], clock: RecordingClock) -> dict[str, Any]:
    """Return the fields of a `Recording` for the daemon's protobuf messages, by stream.

    Notes of people are not events of the daemon: `disturbances` searches the events.
    """
    logs = messages.get("event", [])
    return {
        "gaps": tuple(_gap(message, clock) for message in messages.get("gap", [])),
        "events": tuple(_event(message, clock) for message in logs if not is_note(message)),
        "notes": tuple(
            Note(t=clock.seconds(note.t_host_ns), text=note.message, owner=note.owner)
            for note in filter(is_note, logs)
        ),
        "timing": tuple(_timing(message, clock) for message in messages.get("timing", [])),
        "clock": tuple(
            DeviceClock(t=clock.seconds(message.t_host_ns), **_values(message, DeviceClock, "t"))
            for message in messages.get("clock", [])
        ),
    }


def is_note(message: Any) -> bool:
    """Return True if the `name` of a log record shows that a person wrote the record."""
    return bool(message.name == protobuf.NOTE)


def _gap(message: Any, clock: RecordingClock) -> Gap:
    return Gap(
        k_first=message.k_first,
        count=message.count,
        t=clock.seconds(message.t_from_ns),
        u_held_v=message.u_held_v,
        reason=message.reason,
        code=message.code or GapCode.UNKNOWN,
    )


def _event(message: Any, clock: RecordingClock) -> Event:
    stamp = message.timestamp
    real_ns = stamp.seconds * 1_000_000_000 + stamp.nanos
    level = _LEVELS[message.level] if 0 <= message.level < len(_LEVELS) else str(message.level)
    return Event(
        t=clock.seconds(real_ns - clock.offset_ns),
        level=level,
        message=message.message,
        emulator_stall_ns=message.emulator_stall_ns,
    )


def _timing(message: Any, clock: RecordingClock) -> Timing:
    measured = ("wake_lateness_us", "device_tick_error_us", "link_round_trip_us", "queue_depth")
    return Timing(
        t=clock.seconds(message.t_host_ns),
        **{
            name: TimingPercentiles(**_values(getattr(message, name), TimingPercentiles))
            for name in measured
        },
        collections=-1 if message.collections == _ABSENT_COUNT else message.collections,
        cpu_pressure_percent=message.cpu_pressure_percent,
        run_queue=message.run_queue,
    )


def _values(message: Any, kind: type, *others: str) -> dict[str, Any]:
    """Return the values of the fields of `kind` that are not in `others`."""
    names = (field.name for field in fields(kind))
    return {name: getattr(message, name) for name in names if name not in others}


def gap_lines(gaps: Iterable[Gap]) -> list[str]:
    """Return lines of text that list the gaps; gaps that begin in the same second share a line."""
    return [_gap_line(list(some)) for _, some in groupby(gaps, key=lambda gap: floor(gap.t))]


def _gap_line(gaps: list[Gap]) -> str:
    count = sum(gap.count for gap in gaps)
    samples = plural(count, "sample")
    reasons = ", ".join(dict.fromkeys(gap.reason for gap in gaps))
    if len(gaps) == 1:
        return f"{samples} at {gaps[0].t:.3f} s, {reasons}"
    return (
        f"{samples} in {plural(len(gaps), 'gap')} from {gaps[0].t:.3f} s to {gaps[-1].t:.3f} "
        f"s, {reasons}"
    )
