"""Evaluation of the measured times: percentiles, ratios, and verdicts on the targets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from armrig_core.codes import GapCode
from armrig_core.volts import applied_code, code_of, volts_of
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]

REFERENCE = "cyclictest lateness"
STAND_IN = "stand-in lateness"
BARE = "bare loop lateness"
BARE_TRIP = "bare loop round trip"
BARE_CPU = "bare loop CPU per tick"
DAEMON = "daemon lateness"
DAEMON_CPU = "daemon CPU per tick"
DELIVERY = "scheduled delivery lateness"
TICK_ERROR = "scheduled device tick error"
PUT = "bare put to callback"
PIPED = "put behind a pipe to callback"
BESIDE = "cyclictest beside the daemon"
SUBSCRIBER = "sample to subscriber"

DEFINITIONS = {
    REFERENCE: "wake-up less deadline of cyclictest -m at the loop's priority, alone; whole µs, "
    "rounded down",
    STAND_IN: "in cyclictest's place, which is not installed or not allowed: the same of a Python "
    "program around clock_nanosleep",
    BARE: "wake-up less deadline of a Python loop that sleeps, spins as the daemon's does, writes "
    "a request and reads a fixed answer on a pseudo-terminal, alone",
    BARE_TRIP: "that loop's write to read, answered by a program that works out nothing; no wire "
    "is modelled",
    BARE_CPU: "that loop's thread CPU time per tick, spin included, one value each 0.1 s",
    DAEMON: "t_host_ns - t_sched_ns of each sample in exchange mode, as recorded, under zenoh, "
    "MCAP and the subscribers; a wake-up that missed ticks counts from the first it missed",
    DAEMON_CPU: "CPU time of the loop's process (schedstat) per sample in exchange mode, spin "
    "included, one value each 0.1 s",
    DELIVERY: "scheduled mode: arrival at the loop less when the device's timer was due, the "
    "modelled wire and the emulator's own lateness included",
    TICK_ERROR: "scheduled mode: |interval - Ts| on the device's clock",
    PUT: "from just before a sample's encoding and put in one process to the callback in "
    "another; same payload, rate, socket and number of subscribers as the daemon's",
    PIPED: "the same, but another process encodes and writes to a pipe, and one reads it and puts: "
    "the limit of any daemon whose loop is alone in its process",
    BESIDE: "scheduled mode: cyclictest's lateness at one priority below the loop's while the "
    "daemon runs under zenoh, MCAP and the subscribers: what this kernel gives under that load",
    SUBSCRIBER: "scheduled mode: from a sample's arrival at the loop (t_host_ns) to the callback "
    "in another process: decode, core, pipe, service and zenoh; exchange mode cannot be compared, "
    "there t_host_ns is when the sample was asked for",
}
"""Definition of each time, by its name."""

WAKE_RATE_HZ, LOSSLESS_RATE_HZ, LOSSLESS_S = 1000, 2000, 60.0
WAKE_P99, WAKE_P999, LATENCY = 0.1, 1.0, 1.3
OWN_WORK_US = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Tail:
    """Percentiles of a time, in µs."""

    n: int
    """Number of times."""
    p50: float
    p99: float
    p999: float
    max: float


@dataclass(slots=True, kw_only=True)
class Rate:
    """Measurements at one rate, pooled over the rounds."""

    rate_hz: int
    times_us: dict[str, list[Vector]] = field(default_factory=dict)
    """Times by name, one array each round, in µs."""
    counts: dict[str, int] = field(default_factory=dict)
    """Samples requested, lost and misplaced, by mode."""
    remarks: list[str] = field(default_factory=list)
    """Errors of the measurement."""

    def add(self, name: str, times_us: ArrayLike) -> None:
        """Pool some times."""
        self.times_us.setdefault(name, []).append(np.asarray(times_us, np.float64).ravel())

    def count(self, name: str, n: int) -> None:
        """Count on."""
        self.counts[name] = self.counts.get(name, 0) + n

    def pooled(self, name: str) -> Vector:
        """Return all times of a name, (0,) if there are none."""
        return np.concatenate(self.times_us.get(name, [np.zeros(0)]))

    def tails(self) -> dict[str, Tail]:
        """Return the percentiles of each time that was measured."""
        pools = {name: self.pooled(name) for name in DEFINITIONS}
        return {name: tail(x) for name, x in pools.items() if x.size}


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A measured number with its target."""

    rate_hz: int
    what: str
    value: float
    limit: float
    unit: str
    """"×" of the reference, µs, or samples."""
    met: bool | None
    """None where the target is not of this rate, or the run was too short for it."""
    remark: str = ""


def tail(x_us: Vector) -> Tail:
    """Return the percentiles of some times; there must be one."""
    p50, p99, p999 = (float(v) for v in np.percentile(x_us, (50, 99, 99.9)))
    return Tail(n=x_us.size, p50=p50, p99=p99, p999=p999, max=float(x_us.max()))


def wake_lateness_us(
    samples: NDArray[np.void], gaps: Sequence[tuple[int, int, str]], Ts: float
) -> Vector:
    """Return the lateness of the loop for each sample, in µs.

    Parameters
    ----------
    samples : structured array
        With `k`, `t_sched_ns` and `t_host_ns`.
    gaps : sequence of (k_first, count, code)
        A sample after skipped ticks is late by these, too, so that skipping hides no stall.
    """
    late = (samples["t_host_ns"] - samples["t_sched_ns"]) / 1e3
    missed = {first + count: count for first, count, code in gaps if code == GapCode.HOST_LATE}
    more = np.array([missed.get(int(k), 0) for k in samples["k"]], np.float64)
    return np.asarray(late + more * Ts * 1e6)


def misplaced(
    u: Sequence[float] | Vector, samples: NDArray[np.void], k_first: int, pwm_bits: int
) -> int:
    """Return how many samples carry another input than that of their index.

    Both what was commanded and what the device latched are compared, to the last code.
    """
    wrong = 0
    rows = (samples["k"].astype(np.int64) - k_first).tolist()
    both = zip(rows, samples["u_cmd_v"].tolist(), samples["u_applied_v"].tolist(), strict=True)
    for i, commanded, applied in both:
        if not 0 <= i < len(u):
            wrong += 1
            continue
        code = code_of(float(u[i]))
        expected = volts_of(code), volts_of(applied_code(code, pwm_bits))
        wrong += (commanded, applied) != expected
    return wrong


def cpu_per_tick_us(
    readings: Sequence[tuple[int, int]], ticks_ns: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the CPU time per tick between readings that follow each other, in µs.

    Parameters
    ----------
    readings : sequence of (time_ns, cpu_ns)
        When CPU time was read and what it was.
    ticks_ns : array
        When each tick was, in order.
    """
    at, cpu = np.array(readings, np.int64).reshape(-1, 2).T
    inside = (at >= ticks_ns[0]) & (at <= ticks_ns[-1]) if ticks_ns.size else at < at
    at, cpu = at[inside], cpu[inside]
    ticks = np.diff(np.searchsorted(ticks_ns, at))
    used = np.diff(cpu)
    return np.asarray(used[ticks > 0] / ticks[ticks > 0] / 1e3)


def against_targets(rate: Rate, seconds: float) -> list[Target]:
    """Return the numbers that have a target, as far as their parts were measured."""
    tails = rate.tails()
    return [
        *_wake(rate, tails),
        *_own_work(rate, tails),
        *_latency(rate, tails),
        *_loss(rate, seconds),
    ]


def _wake(rate: Rate, tails: Mapping[str, Tail]) -> list[Target]:
    name = REFERENCE if REFERENCE in tails else STAND_IN
    if name not in tails or DAEMON not in tails:
        return []
    reference, daemon = tails[name], tails[DAEMON]
    judged = rate.rate_hz == WAKE_RATE_HZ
    remark = "" if judged else f"the target is for {WAKE_RATE_HZ} Hz"
    if name == STAND_IN:
        remark = "against the stand-in, not cyclictest"
    beside = tails.get(BESIDE)
    of_beside = f"; {daemon.p999 / beside.p999:.2f} × {BESIDE}" if beside else ""
    pairs = (
        ("p99", daemon.p99, reference.p99, WAKE_P99, remark),
        ("p99.9", daemon.p999, reference.p999, WAKE_P999, (remark + of_beside).strip("; ")),
    )
    return [
        Target(
            rate_hz=rate.rate_hz,
            what=f"wake lateness {which}",
            value=value / below if below else float("inf"),
            limit=limit,
            unit="×",
            met=(value <= limit * below) if judged and name == REFERENCE else None,
            remark=note,
        )
        for which, value, below, limit, note in pairs
    ]


def _own_work(rate: Rate, tails: Mapping[str, Tail]) -> list[Target]:
    if DAEMON_CPU not in tails or BARE_CPU not in tails:
        return []
    work = tails[DAEMON_CPU].p50 - tails[BARE_CPU].p50
    return [
        Target(
            rate_hz=rate.rate_hz,
            what="own work per tick",
            value=work,
            limit=OWN_WORK_US,
            unit="µs",
            met=work <= OWN_WORK_US,
        )
    ]


def _latency(rate: Rate, tails: Mapping[str, Tail]) -> list[Target]:
    if PUT not in tails or SUBSCRIBER not in tails:
        return []
    ratio = tails[SUBSCRIBER].p50 / tails[PUT].p50
    remark = f"p99 {tails[SUBSCRIBER].p99 / tails[PUT].p99:.2f} ×"
    if PIPED in tails:
        remark += f"; behind a pipe {tails[PIPED].p50 / tails[PUT].p50:.2f} ×"
    return [
        Target(
            rate_hz=rate.rate_hz,
            what="sample to subscriber p50",
            value=ratio,
            limit=LATENCY,
            unit="×",
            met=ratio <= LATENCY,
            remark=remark,
        )
    ]


def _loss(rate: Rate, seconds: float) -> list[Target]:
    if "scheduled asked" not in rate.counts:
        return []
    wrong = rate.counts["scheduled lost"] + rate.counts["scheduled misplaced"]
    judged, long = rate.rate_hz == LOSSLESS_RATE_HZ, seconds >= LOSSLESS_S
    remark = f"of {rate.counts['scheduled asked']}"
    if not judged:
        remark += f"; the target is for {LOSSLESS_RATE_HZ} Hz"
    elif not long and not wrong:
        remark += f"; {seconds:g} s, the target is for {LOSSLESS_S:g} s"
    return [
        Target(
            rate_hz=rate.rate_hz,
            what="scheduled: lost or misplaced",
            value=wrong,
            limit=0,
            unit="samples",
            met=(wrong == 0 if long or wrong else None) if judged else None,
            remark=remark,
        )
    ]
