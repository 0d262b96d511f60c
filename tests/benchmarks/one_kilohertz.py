"""1 kHz over 1 Mbaud on real processes: lost samples, timing, and processor time of each process.

`make bench` runs it for 60 s in each mode, `python -m tests.benchmarks.one_kilohertz SECONDS` for
another time: emulator at a pseudo-terminal, loop, service with zenoh and MCAP, four subscribers.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from pathlib import Path
from typing import Literal

import armrig
import numpy as np

from tests.benchmarks.host_timing.targets import Rate
from tests.benchmarks.host_timing.turns import add_received, heard, played, served, subscribers
from tests.integration.processes import Bench


def cpu_s(pid: int) -> float:
    """Return the processor time that a process has used, in s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def play(bench: Bench, seconds: int, pacing: Literal["exchange", "scheduled"]) -> None:
    """Play an experiment and print the numbers."""
    emulator, daemon = bench.processes
    pids = {"service": daemon.popen.pid, "emulator": emulator.popen.pid}
    pids["loop"] = bench.loop_pid(daemon)
    rate = Rate(rate_hz=1000)
    u = armrig.telegraph(seconds * 1000, 0.05, seed=1)
    with subscribers(bench.rig().endpoint) as processes:
        before_s = {name: cpu_s(pid) for name, pid in pids.items()}
        recording = played(bench, rate, u, pacing)
        used_s = {name: cpu_s(pid) - before_s[name] for name, pid in pids.items()}
        add_received(rate, recording.samples["k"].astype(np.int64), heard(processes))
    reasons = Counter[str]()
    for gap in recording.gaps:
        reasons[f"missing: {gap.reason}"] += gap.count
    for name, count in (*rate.counts.items(), *sorted(reasons.items())):
        print(f"{count:7d}  {name}")
    samples = recording.samples
    late_us = (samples["t_host_ns"] - samples["t_sched_ns"]) / 1e3
    error_us = np.abs(np.diff(samples["t_device_us"].astype(np.int64)) - 1000)
    for name, values in (("wake lateness", late_us), ("interval error", error_us)):
        p50, p99, p999 = np.percentile(values, [50, 99, 99.9])
        print(f"{name}: p50 {p50:.1f}, p99 {p99:.1f}, p99.9 {p999:.1f}, max {values.max():.1f} µs")
    for name, value in used_s.items():
        print(f"{name}: {100 * value / seconds:.1f} % of one core")
    for remark in rate.remarks:
        print(remark)


def main() -> None:
    """Play in each mode, with new processes."""
    seconds = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    modes: tuple[Literal["exchange", "scheduled"], ...] = ("exchange", "scheduled")
    for pacing in modes:
        print(f"-- {pacing}", flush=True)
        with served(terminal=True) as bench:
            play(bench, seconds, pacing)


if __name__ == "__main__":
    main()
