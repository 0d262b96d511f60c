"""Turns of the contestants, in short rounds of one run, and their pooled measurements.

The daemon runs in its turns only, so that it does not disturb the others. The turns follow each
other closely, so that other load of the machine meets all contestants alike.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

import msgspec
import numpy as np
from armrig.lab.host import PRIORITY
from armrig.recordings.loading import load
from armrig.recordings.recording import Recording
from armrig.rig.client import Rig
from armrig.rig.replies import RunEndedError
from armrig.rig.session import RigError
from armrig_core.endpoint import endpoint
from armrig_core.errors import InputError
from numpy.typing import NDArray

from tests.benchmarks.host_timing import cyclictest, targets
from tests.benchmarks.host_timing.machine import Machine
from tests.benchmarks.host_timing.programs import (
    RIG,
    Daemon,
    daemon,
    line,
    output,
    program,
    subscribers,
    tell,
)
from tests.benchmarks.host_timing.sleeper import Done, Task
from tests.benchmarks.host_timing.targets import Rate

ROUNDS = 4
EXCHANGE_MOST_HZ = 1000
"""Above it exchange mode is not carried at 1 Mbaud; the device's own timer goes further."""
SPIN_NS = 120_000
"""Spin of the daemon's loop before each deadline, and so of the bare loop, in ns."""
LEAST_TICKS = 10
MOST_S = 600
"""Beyond it one run has more samples than one command should carry, and the memory holds."""
_SLACK_S = 15.0
_SETTLE_S = 0.3  # the last samples are on their way to the subscribers
_PHASE_S = 10.0

Say = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Settings of a measurement."""

    rates_hz: tuple[int, ...]
    seconds: float
    """Time of each contestant at each rate, over all rounds, in s."""
    burners: int = 0
    """Processes that only use a processor, next to every contestant."""

    def __post_init__(self) -> None:
        """Refuse a rate that the daemon cannot sample."""
        for rate in self.rates_hz:
            if not 1 <= rate <= 2000 or 1_000_000 % rate:
                raise InputError(
                    f"rate {rate} Hz: 1 to 2000 with a period of whole µs, such as 100 or 1000"
                )
        if not self.rates_hz:
            raise InputError("no rate to measure at: give some, such as --rates 100,1000")
        if not 0.1 <= self.seconds <= MOST_S:
            raise InputError(f"{self.seconds:g} s for each contestant: 0.1 to {MOST_S} are allowed")

    def ticks(self, rate_hz: int) -> int:
        """Return the ticks of one turn."""
        return max(LEAST_TICKS, round(rate_hz * self.seconds / ROUNDS))


def measure(plan: Plan, host: Machine, say: Say = lambda text: None) -> list[Rate]:
    """Let all take their turns and return what they measured, for each rate.

    Raises
    ------
    RigError
        A program does not start, or does not end.
    """
    rates = [Rate(rate_hz=rate) for rate in plan.rates_hz]
    with burning(plan.burners):
        for n in range(1, ROUNDS + 1):
            for rate in rates:
                ticks, turn = plan.ticks(rate.rate_hz), f"round {n} of {ROUNDS}: {rate.rate_hz} Hz"
                say(f"{turn} alone")
                _reference(rate, ticks, host)
                _bare(rate, ticks, host)
                _put(rate, ticks, targets.PUT)
                _put(rate, ticks, targets.PIPED, "piped")
                say(f"{turn} under full load")
                with daemon() as running:
                    _loaded(rate, ticks, running, host, seed=n)
    return rates


@contextmanager
def burning(count: int) -> Iterator[None]:
    """Use up so many processors during the block."""
    with ExitStack() as stack:
        for _ in range(count):
            stack.enter_context(program("tests.benchmarks.host_timing.burner"))
        yield


def _within_s(rate: Rate, ticks: int) -> float:
    return 3 * ticks / rate.rate_hz + _SLACK_S


def _reference(rate: Rate, ticks: int, host: Machine) -> None:
    """Take cyclictest's turn, or that of its stand-in."""
    command = _cyclictest(rate, ticks, host, PRIORITY)
    if command is None:
        period_ns = 1_000_000_000 // rate.rate_hz
        task = Task(period_ns=period_ns, count=ticks, priority=PRIORITY if host.fifo else 0)
        done = _slept(task, _within_s(rate, ticks))
        rate.add(targets.STAND_IN, np.array(done.late_ns) / 1e3)
        return
    with program(*command, module=False) as process:
        printed = output(process, _within_s(rate, ticks)).decode(errors="replace")
    rate.add(targets.REFERENCE, cyclictest.lateness_us(printed))


def _cyclictest(rate: Rate, ticks: int, host: Machine, priority: int) -> list[str] | None:
    """Return the call of cyclictest, or None if it is not installed or not permitted."""
    found = cyclictest.find()
    if found is None or not host.fifo:
        return None
    period_us = 1_000_000 // rate.rate_hz
    return cyclictest.command(
        found, period_us=period_us, count=ticks, priority=priority, lock=host.memory_lock
    )


@contextmanager
def _beside(rate: Rate, ticks: int, host: Machine) -> Iterator[None]:
    """Have cyclictest measure the kernel during the block, just below the loop's priority."""
    command = _cyclictest(rate, ticks, host, PRIORITY - 1)
    if command is None:
        yield
        return
    with program(*command, module=False) as process:
        yield
        printed = output(process, _within_s(rate, ticks)).decode(errors="replace")
    rate.add(targets.BESIDE, cyclictest.lateness_us(printed))


def _bare(rate: Rate, ticks: int, host: Machine) -> None:
    """Take the bare loop's turn."""
    with program("tests.benchmarks.host_timing.echo") as echo:
        task = Task(
            period_ns=1_000_000_000 // rate.rate_hz,
            count=ticks,
            priority=PRIORITY if host.fifo else 0,
            spin_ns=SPIN_NS,
            port=line(echo),
        )
        done = _slept(task, _within_s(rate, ticks))
    rate.add(targets.BARE, np.array(done.late_ns) / 1e3)
    rate.add(targets.BARE_TRIP, np.array(done.trip_ns) / 1e3)
    rate.add(targets.BARE_CPU, np.array(done.cpu_ns) / 1e3)


def _slept(task: Task, within_s: float) -> Done:
    argument = msgspec.json.encode(task).decode()
    with program("tests.benchmarks.host_timing.sleeper", argument) as process:
        return msgspec.json.decode(output(process, within_s), type=Done)


def _put(rate: Rate, ticks: int, name: str, *way: str) -> None:
    """Measure the bare zenoh put, by itself or after a pipe."""
    with tempfile.TemporaryDirectory(prefix="armrig-bench-") as directory:
        where = endpoint(RIG, PurePosixPath(directory))
        with program("tests.benchmarks.host_timing.publisher", where, RIG, *way) as publisher:
            line(publisher)
            with subscribers(where) as listening:
                time.sleep(_SETTLE_S)  # until the publisher knows of its subscribers
                tell(publisher, f"{1_000_000_000 // rate.rate_hz} {ticks}")
                line(publisher)
                time.sleep(_SETTLE_S)
                for heard in listening.heard():
                    rate.add(name, (heard[:, 2] - heard[:, 1]) / 1e3)


def _loaded(rate: Rate, ticks: int, running: Daemon, host: Machine, seed: int) -> None:
    """Take the daemon's turns: exchange mode where the line carries it, and scheduled mode."""
    # Another value at each sample: one that lands on its neighbour's index is seen.
    u = np.random.default_rng(seed).uniform(0.5, 4.5, ticks)
    with running.rig() as rig:
        if rate.rate_hz <= EXCHANGE_MOST_HZ:
            with subscribers(running.endpoint):
                recording, readings = _played(rig, rate, u, "exchange", running.loop_pid())
            _exchanged(rate, recording, readings)
        with subscribers(running.endpoint) as listening, _beside(rate, ticks, host):
            recording, _ = _played(rig, rate, u, "scheduled", None)
            time.sleep(_SETTLE_S)
            heard = listening.heard()
    _scheduled(rate, recording, heard)


def _exchanged(rate: Rate, recording: Recording, readings: list[tuple[int, int]]) -> None:
    gaps = [(gap.k_first, gap.count, gap.code) for gap in recording.gaps]
    samples = recording.samples
    rate.add(targets.DAEMON, targets.wake_lateness_us(samples, gaps, recording.Ts))
    ticks_ns = samples["t_host_ns"].astype(np.int64)
    rate.add(targets.DAEMON_CPU, targets.cpu_per_tick_us(readings, ticks_ns))


def _scheduled(rate: Rate, recording: Recording, heard: Sequence[NDArray[np.int64]]) -> None:
    samples = recording.samples
    rate.add(targets.DELIVERY, (samples["t_host_ns"] - samples["t_sched_ns"]) / 1e3)
    k = samples["k"].astype(np.int64)
    t = np.diff(samples["t_device_us"].astype(np.int64))[np.diff(k) == 1]
    rate.add(targets.TICK_ERROR, np.abs(t - recording.Ts * 1e6))
    for triples in heard:
        ours = triples[np.isin(triples[:, 0], k)]
        rate.add(targets.SUBSCRIBER, (ours[:, 2] - ours[:, 1]) / 1e3)
        rate.count("subscribers missed", k.size - np.unique(ours[:, 0]).size)


def _played(
    rig: Rig,
    rate: Rate,
    u: NDArray[np.float64],
    pacing: Literal["exchange", "scheduled"],
    loop: int | None,
) -> tuple[Recording, list[tuple[int, int]]]:
    """Play `u`; return its recording and readings of the loop's CPU time meanwhile."""
    readings: list[tuple[int, int]] = []

    def read(done: int, total: int) -> None:
        with suppress(OSError):  # the loop may have ended, or the kernel does not report it
            cpu = int(Path(f"/proc/{loop}/schedstat").read_text().split()[0])
            readings.append((time.monotonic_ns(), cpu))

    _ready(rig)
    rig.arm("armrig bench", 1 / rate.rate_hz)
    pwm_bits = int(str(rig.status().device["pwm_bits"]))
    try:
        path = rig.run(u, pacing=pacing, experiment="benchmark", progress=read)
    except RunEndedError as err:
        path = err.recording
        rate.remarks.append(f"{pacing}: {err}")
    recording = load(path)
    path.unlink()
    samples = recording.samples
    rate.count(f"{pacing} asked", u.size)
    rate.count(f"{pacing} lost", u.size - samples.size)
    wrong = targets.misplaced(u, samples, recording.manifest.k_first, pwm_bits)
    rate.count(f"{pacing} misplaced", wrong)
    return recording, readings


def _ready(rig: Rig) -> None:
    """Wait until the rig can be taken, out of a fault if it must be."""
    until = time.monotonic() + _PHASE_S
    while (status := rig.status()).phase != "safe":
        if time.monotonic() > until:
            raise RigError(f"rig {rig.rig} is {status.phase} {status.reason}, not safe")
        if status.phase == "fault":
            rig.reset()
        time.sleep(0.05)
