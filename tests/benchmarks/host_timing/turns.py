"""Turns of the daemon and of the programs that it is compared with, in short rounds.

The daemon runs in its turns only. The turns follow each other closely, so that other load of the
machine affects all programs alike.
"""

from __future__ import annotations

import ctypes
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any, Literal

import numpy as np
from armrig.lab.host import PRIORITY, probe_rights
from armrig.recordings.files.loading import load
from armrig.recordings.recording import Recording
from armrig.rig.replies import RunEndedError
from armrig_core.access.endpoint import endpoint
from armrig_core.errors import InputError, OperationError
from numpy.typing import NDArray

from tests.benchmarks.host_timing import targets
from tests.benchmarks.host_timing.contestants import RIG, SPIN_NS
from tests.benchmarks.host_timing.targets import Rate
from tests.integration.driving import bring_to_rest
from tests.integration.processes import Bench

ROOT = Path(__file__).parents[3]
ROUNDS = 4
SUBSCRIBERS = 4
MAX_EXCHANGE_HZ = 1000  # at 1 Mbaud; the device's own timer goes further
MIN_TICKS = 10
MAX_S = 600
MAX_US = 20_000
"""End of cyclictest's histogram, in µs; a later wake-up counts as this, in cyclictest's favour."""
_SLACK_S = 15.0
_SETTLE_S = 0.3  # the last samples are on their way to the subscribers
_PR_SET_PDEATHSIG = 1  # <linux/prctl.h>
_libc = ctypes.CDLL(None)

Popen = subprocess.Popen[bytes]


def ticks_of_a_turn(rate_hz: int, seconds: float) -> int:
    """Return the ticks of a turn, if all rounds take `seconds`; refuse an impossible rate."""
    if not 1 <= rate_hz <= 2000 or 1_000_000 % rate_hz:
        raise InputError(
            f"rate {rate_hz} Hz: 1 to 2000 with a period of whole µs, such as 100 or 1000"
        )
    if not 0.1 <= seconds <= MAX_S:
        raise InputError(f"{seconds:g} s for each program: 0.1 to {MAX_S} are allowed")
    return max(MIN_TICKS, round(rate_hz * seconds / ROUNDS))


def measure(ticks_of: dict[int, int], say: Callable[[str], None]) -> list[Rate]:
    """Return the measurements of all rounds; a turn at each rate has so many ticks."""
    rates = [Rate(rate_hz=rate_hz) for rate_hz in ticks_of]
    for n in range(1, ROUNDS + 1):
        for rate in rates:
            say(f"round {n} of {ROUNDS}: {rate.rate_hz} Hz")
            ticks = ticks_of[rate.rate_hz]
            cyclictest(rate, ticks)
            bare_loop(rate, ticks)
            c_loop(rate, ticks)
            bare_put(rate, ticks)
            # Another value at each sample: a sample with its neighbour's index is seen.
            u = np.random.default_rng(n).uniform(0.5, 4.5, ticks)
            with served() as bench:
                if rate.rate_hz <= MAX_EXCHANGE_HZ:
                    with subscribers(bench.rig().endpoint):
                        exchange(rate, bench, u)
                scheduled(rate, bench, u)
            if rate.rate_hz <= MAX_EXCHANGE_HZ:
                unspun = Rate(rate_hz=rate.rate_hz)
                with served(spin_us=0) as bench, subscribers(bench.rig().endpoint):
                    exchange(unspun, bench, u)
                for cpu_us in unspun.times_us[targets.DAEMON_CPU]:
                    rate.add(targets.DAEMON_CPU + targets.UNSPUN, cpu_us)
    return rates


@contextmanager
def program(*command: str) -> Iterator[Popen]:
    """Run a program with pipes to and from it; the kernel ends it with this process."""
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=ROOT,
        preexec_fn=lambda: _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0),
    )
    with process:
        try:
            yield process
        finally:
            process.kill()


def contestant(name: str, *arguments: object) -> Any:
    """Run a function of `contestants` as a program."""
    module = "tests.benchmarks.host_timing.contestants"
    return program(sys.executable, "-m", module, name, *map(str, arguments))


def output(process: Popen, within_s: float) -> bytes:
    """Return what a program prints until it ends by itself; raise if it fails or takes longer."""
    try:
        printed, _ = process.communicate(timeout=within_s)
    except subprocess.TimeoutExpired as err:
        raise OperationError(f"{_name(process)} did not end within {within_s:.0f} s") from err
    if process.returncode:
        raise OperationError(f"{_name(process)} ended with exit code {process.returncode}")
    return printed


def line(process: Popen) -> str:
    """Return the next line that a program prints."""
    printed = process.stdout.readline().decode().strip() if process.stdout else ""
    if not printed:
        raise OperationError(f"{_name(process)} did not start; see its message above")
    return printed


def _name(process: Popen) -> str:
    return " ".join(str(word) for word in process.args[-4:] if str(word)[:1] not in "-/{")


def cyclictest(rate: Rate, ticks: int) -> None:
    """Add the lateness of cyclictest, if it is installed and allowed."""
    # Debian puts it into a directory that a user's PATH may not contain.
    found = shutil.which("cyclictest", path=f"{os.environ['PATH']}:/usr/sbin:/usr/bin")
    if found is None or not all(probe_rights()):
        rate.remarks.append("cyclictest is not installed, or not allowed")
        return
    sizes = ["-i", str(1_000_000 // rate.rate_hz), "-l", str(ticks), "-h", str(MAX_US)]
    with program(found, "-q", "-m", "-p", str(PRIORITY), *sizes) as process:
        printed = output(process, _within_s(rate, ticks)).decode(errors="replace")
    rate.add(targets.REFERENCE, cyclictest_lateness_us(printed))


def cyclictest_lateness_us(printed: str) -> NDArray[np.float64]:
    """Return the lateness of each wake-up from the histogram of one thread, in µs, sorted."""
    bins = np.array(re.findall(r"^(\d+)\s+(\d+)\s*$", printed, re.MULTILINE), np.int64)
    bins = bins.reshape(-1, 2)
    greatest = re.search(r"^# Max Latencies:\s*(\d+)", printed, re.MULTILINE)
    if not bins[:, 1].any() or greatest is None:
        end = " ".join(printed.split())[-120:] or "nothing"
        raise OperationError(f"cyclictest printed no histogram of one thread: {end}")
    overflows = re.search(r"^# Histogram Overflows:\s*(\d+)", printed, re.MULTILINE)
    over = np.full(int(overflows[1]) if overflows else 0, float(MAX_US))
    over[-1:] = max(float(greatest[1]), MAX_US)
    return np.concatenate([np.repeat(bins[:, 0], bins[:, 1]).astype(np.float64), over])


def bare_loop(rate: Rate, ticks: int) -> None:
    """Add lateness and processor time of a loop that only sleeps, spins, writes and reads."""
    with (
        contestant("echo") as echo,
        contestant("bare_loop", line(echo), 10**9 // rate.rate_hz, ticks) as loop,
    ):
        late_ns, cpu_ns = json.loads(output(loop, _within_s(rate, ticks)))
    rate.add(targets.BARE, np.array(late_ns) / 1e3)
    rate.add(targets.BARE_CPU, np.array(cpu_ns) / 1e3)


def c_loop(rate: Rate, ticks: int) -> None:
    """Add processor time of a loop in C with the same system calls, if a compiler is installed."""
    compiler = shutil.which("cc")
    if compiler is None:
        rate.remarks.append("no C compiler is installed: no loop in C")
        return
    with tempfile.TemporaryDirectory(prefix="armrig-bench-") as directory:
        loop = f"{directory}/c_loop"
        source = Path(__file__).with_name("c_loop.c")
        subprocess.run([compiler, "-O2", "-o", loop, str(source)], check=True)
        for spin, spin_ns in (("", SPIN_NS), (targets.UNSPUN, 0)):
            sizes = [str(10**9 // rate.rate_hz), str(ticks), str(spin_ns)]
            with program(loop, *sizes) as process:
                cpu_ns = json.loads(output(process, _within_s(rate, ticks)))
            rate.add(targets.C_CPU + spin, np.array(cpu_ns) / 1e3)


def bare_put(rate: Rate, ticks: int) -> None:
    """Add the time from a bare zenoh put to the callbacks."""
    with tempfile.TemporaryDirectory(prefix="armrig-bench-") as directory:
        where = endpoint(RIG, PurePosixPath(directory))
        with contestant("publish", where, 10**9 // rate.rate_hz, ticks) as publisher:
            line(publisher)
            with subscribers(where) as processes:
                time.sleep(_SETTLE_S)  # until the publisher knows its subscribers
                publisher.stdin.write(b"\n")
                publisher.stdin.flush()
                line(publisher)
                for received in heard(processes):
                    rate.add(targets.PUT, (received[:, 2] - received[:, 1]) / 1e3)


@contextmanager
def subscribers(where: str) -> Iterator[list[Popen]]:
    """Run the subscribers of an endpoint."""
    with ExitStack() as stack:
        processes = [
            stack.enter_context(contestant("subscribe", where)) for _ in range(SUBSCRIBERS)
        ]
        for process in processes:
            line(process)
        yield processes


def heard(processes: list[Popen]) -> list[NDArray[np.int64]]:
    """End the subscribers; return k, the sample's host time and the callback's, (n, 3) for each."""
    time.sleep(_SETTLE_S)
    received = [output(process, _SLACK_S) for process in processes]
    return [np.frombuffer(data, np.int64).reshape(-1, 3) for data in received]


@contextmanager
def served(*, terminal: bool = False, spin_us: int = SPIN_NS // 1000) -> Iterator[Bench]:
    """Run the daemon with an emulated rig at a Unix socket, or at a pseudo-terminal."""
    with tempfile.TemporaryDirectory(prefix="armrig-bench-") as directory:
        bench = Bench(Path(directory), terminal=terminal)
        bench.configure(watchdog_ms=100, more=f"[timing]\nspin_us = {spin_us}")
        try:
            bench.emulate()
            bench.serve()
            yield bench
        finally:
            bench.end()


def exchange(rate: Rate, bench: Bench, u: NDArray[np.float64]) -> None:
    """Add lateness and processor time of the daemon's loop in exchange mode."""
    recording = played(bench, rate, u, "exchange", targets.DAEMON_CPU)
    gaps = [(gap.k_first, gap.count, gap.code) for gap in recording.gaps]
    rate.add(targets.DAEMON, targets.wake_lateness_us(recording.samples, gaps, recording.Ts))


def scheduled(rate: Rate, bench: Bench, u: NDArray[np.float64]) -> None:
    """Add processor time, and the time from a sample's arrival to the subscribers, if scheduled."""
    with subscribers(bench.rig().endpoint) as processes:
        samples = played(bench, rate, u, "scheduled", targets.SCHEDULED_CPU).samples
        add_received(rate, samples["k"].astype(np.int64), heard(processes))


def add_received(rate: Rate, k: NDArray[np.int64], received: list[NDArray[np.int64]]) -> None:
    """Add the times of the run's samples, and count the samples that a subscriber missed."""
    for triples in received:
        of_run = triples[np.isin(triples[:, 0], k)]
        rate.add(targets.SUBSCRIBER, (of_run[:, 2] - of_run[:, 1]) / 1e3)
        rate.counts["subscribers missed"] += k.size - np.unique(of_run[:, 0]).size


def played(
    bench: Bench,
    rate: Rate,
    u: NDArray[np.float64],
    pacing: Literal["exchange", "scheduled"],
    cpu: str,
) -> Recording:
    """Play `u`; return its recording; add `cpu`, and count the lost and the misplaced samples."""
    loop, readings = bench.loop_pid(bench.processes[-1]), list[tuple[int, int]]()

    def read(done: int, total: int) -> None:
        with suppress(OSError):  # the loop may have ended
            cpu_ns = int(Path(f"/proc/{loop}/schedstat").read_text().split()[0])
            readings.append((time.monotonic_ns(), cpu_ns))

    bring_to_rest(bench)
    with bench.rig() as rig:
        rig.arm("benchmark", 1 / rate.rate_hz)
        pwm_bits = int(str(rig.status().device["pwm_bits"]))
        try:
            path = rig.run(u, pacing=pacing, experiment="benchmark", progress=read)
        except RunEndedError as err:
            path = err.recording
            rate.remarks.append(f"{pacing}: {err}")
    recording = load(path)
    samples = recording.samples
    rate.add(cpu, targets.cpu_per_tick_us(readings, samples["t_host_ns"].astype(np.int64)))
    rate.counts[f"{pacing} requested"] += u.size
    rate.counts[f"{pacing} lost"] += u.size - samples.size
    wrong = targets.misplaced(u, samples, recording.manifest.k_first, pwm_bits)
    rate.counts[f"{pacing} misplaced"] += wrong
    return recording


def _within_s(rate: Rate, ticks: int) -> float:
    return 3 * ticks / rate.rate_hz + _SLACK_S
