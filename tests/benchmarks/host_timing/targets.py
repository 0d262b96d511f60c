"""Evaluation of the measured times: percentiles, ratios, and comparison with the targets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from armrig_core.commands.codes import GapCode
from armrig_core.rig.volts import code_of, device_code, volts_of
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]

REFERENCE = "cyclictest lateness"
BARE = "bare loop lateness"
BARE_CPU = "bare loop CPU per tick"
DAEMON = "daemon lateness"
DAEMON_CPU = "daemon CPU per tick"
SCHEDULED_CPU = "daemon CPU, scheduled mode"
C_CPU = "C loop CPU per tick"
UNSPUN = ", without spin"
PUT = "bare put to callback"
SUBSCRIBER = "sample to subscriber"

DEFINITIONS = {
    REFERENCE: "lateness of cyclictest -m at the loop's priority, alone; whole µs, rounded down",
    BARE: "lateness of a Python loop that only sleeps, spins, writes and reads a terminal, alone",
    BARE_CPU: "thread CPU time of that loop per tick, spin included, one value each 0.1 s",
    DAEMON: "t_host_ns - t_sched_ns in exchange mode, with zenoh, MCAP and subscribers",
    DAEMON_CPU: "CPU time of the loop's process per sample in exchange mode, spin included",
    SCHEDULED_CPU: "CPU time of the loop's process per sample in scheduled mode, without a spin",
    C_CPU: "thread CPU time of a loop in C that makes the same system calls, spin included, alone",
    DAEMON_CPU + UNSPUN: "the same with [timing] spin_us = 0",
    C_CPU + UNSPUN: "the same, with the spin slept",
    PUT: "from just before a sample's encoding and put in one process to the callback in another",
    SUBSCRIBER: "scheduled mode: from a sample's arrival at the loop (t_host_ns) to the callback",
}

PERCENTILES = (50, 99, 99.9, 100)
WAKE_RATE_HZ, LOSSLESS_RATE_HZ, LOSSLESS_S = 1000, 2000, 60.0
MAX_WAKE_P99, MAX_WAKE_P999, MAX_LATENCY = 0.1, 1.0, 1.3
MAX_OWN_WORK_US, MAX_SCHEDULED_US = 60.0, 130.0
MAX_CPU = {"": 1.5, UNSPUN: 2.2}
"""Processor time of a tick, times that of the loop in C, with and without spin."""


@dataclass(slots=True, kw_only=True)
class Rate:
    """Measurements at one rate, pooled over the rounds."""

    rate_hz: int
    times_us: dict[str, list[Vector]] = field(default_factory=dict)
    """Times by name, one array each round, in µs."""
    counts: Counter[str] = field(default_factory=Counter)
    """Samples requested, lost and misplaced, by mode."""
    remarks: list[str] = field(default_factory=list)
    """Errors of the measurement."""

    def add(self, name: str, times_us: ArrayLike) -> None:
        """Pool some times."""
        self.times_us.setdefault(name, []).append(np.asarray(times_us, np.float64).ravel())

    def tails(self) -> dict[str, Vector]:
        """Return number, p50, p99, p99.9 and maximum of each measured time."""
        pools = {n: np.concatenate(self.times_us[n]) for n in DEFINITIONS if n in self.times_us}
        return {n: np.append(x.size, np.percentile(x, PERCENTILES)) for n, x in pools.items()}


class Target(NamedTuple):
    """A measured number with its target."""

    what: str
    value: float
    limit: float
    unit: str
    """"×" of the reference, µs, or samples."""
    judged: bool = True
    """False if the target is not of this rate, or the run was too short for it."""

    @property
    def verdict(self) -> str:
        """Return "met", "NOT MET", or "-" if the target is not judged."""
        return ("met" if self.value <= self.limit else "NOT MET") if self.judged else "-"


def wake_lateness_us(
    samples: NDArray[np.void], gaps: Sequence[tuple[int, int, str]], Ts: float
) -> Vector:
    """Return the lateness of the loop for each sample, in µs; gaps are (k_first, count, code).

    The lateness of a sample after skipped ticks includes them: skipping hides no stall.
    """
    late = (samples["t_host_ns"] - samples["t_sched_ns"]) / 1e3
    missed = {first + count: count for first, count, code in gaps if code == GapCode.HOST_LATE}
    more = np.array([missed.get(int(k), 0) for k in samples["k"]], np.float64)
    return np.asarray(late + more * Ts * 1e6)


def misplaced(
    u: Sequence[float] | Vector, samples: NDArray[np.void], k_first: int, pwm_bits: int
) -> int:
    """Return how many samples have another commanded or latched input than that of their index."""
    wrong = 0
    for k, commanded, applied in samples[["k", "u_cmd_v", "u_applied_v"]].tolist():
        i = k - k_first
        if 0 <= i < len(u):
            code = code_of(float(u[i]))
            expected = volts_of(code), volts_of(device_code(code, pwm_bits))
            wrong += (commanded, applied) != expected
        else:
            wrong += 1
    return wrong


def cpu_per_tick_us(readings: Sequence[tuple[int, int]], ticks_ns: NDArray[np.int64]) -> Vector:
    """Return the CPU time per tick between successive readings (time_ns, cpu_ns), in µs."""
    at, cpu = np.array(readings, np.int64).reshape(-1, 2).T
    inside = (at >= ticks_ns[0]) & (at <= ticks_ns[-1]) if ticks_ns.size else at < at
    ticks = np.diff(np.searchsorted(ticks_ns, at[inside]))
    used = np.diff(cpu[inside])
    return np.asarray(used[ticks > 0] / ticks[ticks > 0] / 1e3)


def against_targets(rate: Rate, seconds: float) -> list[Target]:
    """Return the numbers that have a target, if their parts were measured."""
    tails, found = rate.tails(), list[Target]()
    if {REFERENCE, DAEMON} <= tails.keys():
        at_rate = rate.rate_hz == WAKE_RATE_HZ
        for what, at, limit in (("p99", 2, MAX_WAKE_P99), ("p99.9", 3, MAX_WAKE_P999)):
            daemon, reference = tails[DAEMON][at], tails[REFERENCE][at]
            ratio = daemon / reference if reference else float("inf")
            found.append(Target(f"wake lateness {what}", ratio, limit, "×", at_rate))
    if {BARE_CPU, DAEMON_CPU} <= tails.keys():
        work_us = tails[DAEMON_CPU][1] - tails[BARE_CPU][1]
        found.append(Target("own work per tick", work_us, MAX_OWN_WORK_US, "µs"))
    if SCHEDULED_CPU in tails:
        found.append(Target(SCHEDULED_CPU, tails[SCHEDULED_CPU][1], MAX_SCHEDULED_US, "µs"))
    for spin, most in MAX_CPU.items():
        if {C_CPU + spin, DAEMON_CPU + spin} <= tails.keys():
            ratio = tails[DAEMON_CPU + spin][1] / tails[C_CPU + spin][1]
            found.append(Target(f"CPU per tick{spin}", ratio, most, "×"))
    if {PUT, SUBSCRIBER} <= tails.keys():
        ratio = tails[SUBSCRIBER][1] / tails[PUT][1]
        found.append(Target("sample to subscriber p50", ratio, MAX_LATENCY, "×"))
    if "scheduled requested" in rate.counts:
        wrong = rate.counts["scheduled lost"] + rate.counts["scheduled misplaced"]
        # A short run can show a loss, but not that there is none.
        judged = rate.rate_hz == LOSSLESS_RATE_HZ and (seconds >= LOSSLESS_S or wrong > 0)
        found.append(Target("scheduled: lost or misplaced", wrong, 0, "samples", judged))
    return found
