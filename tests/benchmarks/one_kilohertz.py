"""1 kHz over 1 Mbaud on real processes: what was lost, how it was timed, what it cost.

`make bench` runs it: emulator, loop, service with zenoh and MCAP, and two subscribers in
processes of their own. Figures of one machine at one time; a benchmark, not a test.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import armrig
import numpy as np
from armrig.rig.client import Rig

from tests.integration.processes import Bench, Process

SUBSCRIBER = """
import json, sys, zenoh
from armrig.rig.client import open_session
from armrig_core.telemetry import decode_sample
ks = []
def take(sample):
    decoded = decode_sample(sample.payload.to_bytes())
    if decoded.flags & 1:
        ks.append(decoded.k)
with open_session(sys.argv[1], rig="1") as session:
    subscriber = session.declare_subscriber("rig/1/sample", take)
    print("ready", flush=True)
    sys.stdin.readline()
print(json.dumps({"received": len(ks), "span": ks[-1] - ks[0] + 1}))
"""


def cpu_s(pid: int) -> float:
    """Return the processor time that a process has used, in s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def subscribe(endpoint: str) -> subprocess.Popen[str]:
    """Start a subscriber and wait until it listens."""
    process = subprocess.Popen(
        [sys.executable, "-c", SUBSCRIBER, endpoint],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    if process.stdout is None or process.stdout.readline() != "ready\n":
        raise SystemExit("a subscriber did not start")
    return process


def play(bench: Bench, seconds: int, pacing: str) -> None:
    """Run for a time and print the numbers."""
    emulator, daemon = bench.emulate(), bench.serve()
    pids = {
        "service": daemon.popen.pid,
        "loop": bench.loop_pid(daemon),
        "emulator": emulator.popen.pid,
    }
    with bench.rig() as rig:
        subscribers = [subscribe(rig.endpoint) for _ in range(2)]
        path, used = _record(rig, pids, seconds, pacing)
        time.sleep(0.5)  # the last samples are on their way to the subscribers
        heard = [json.loads(s.communicate("\n")[0].splitlines()[-1]) for s in subscribers]
    recording = armrig.load(path)
    n, asked = recording.samples.size, seconds * 1000
    print(f"{asked} ticks, {n} samples recorded, {asked - n} skipped, in {path.name}")
    told = sum(gap.count for gap in recording.gaps)
    print(f"gaps in the file account for {told} samples; of those, by reason:")
    reasons: dict[str, int] = {}
    for gap in recording.gaps:
        reasons[gap.reason] = reasons.get(gap.reason, 0) + gap.count
    for reason, count in sorted(reasons.items()):
        print(f"  {count:6d}  {reason}")
    for subscriber in heard:
        print(f"subscriber: {subscriber['received']} of {subscriber['span']} ticks")
    late_us = (recording.samples["t_host_ns"] - recording.samples["t_sched_ns"]) / 1e3
    error_us = np.abs(np.diff(recording.samples["t_device_us"].astype(np.int64)) - 1000)
    for name, values in (("wake lateness", late_us), ("interval error", error_us)):
        p50, p99, p999 = np.percentile(values, [50, 99, 99.9])
        print(f"{name}: p50 {p50:.1f}, p99 {p99:.1f}, p99.9 {p999:.1f}, max {values.max():.1f} µs")
    for name, value in used.items():
        print(f"{name}: {100 * value / seconds:.1f} % of one core")


def _record(
    rig: Rig, pids: dict[str, int], seconds: int, pacing: str
) -> tuple[Path, dict[str, float]]:
    u = armrig.telegraph(seconds * 1000, 0.05, seed=1)
    rig.arm("benchmark", Ts=0.001)
    before = {name: cpu_s(pid) for name, pid in pids.items()}
    path = rig.run(u, pacing=pacing, experiment="benchmark")  # type: ignore[arg-type]
    return path, {name: cpu_s(pid) - before[name] for name, pid in pids.items()}


def main() -> None:
    """Run for 60 s in each mode, or for the seconds in the first argument."""
    seconds = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    for pacing in ("exchange", "scheduled"):
        print(f"-- {pacing}")
        run(seconds, pacing)


def run(seconds: int, pacing: str) -> None:
    """Start everything, play, and end everything."""
    bench = Bench(Path(tempfile.mkdtemp(prefix="armrig-bench-")), terminal=True)
    processes: list[Process] = bench.processes
    try:
        play(bench, seconds, pacing)
    finally:
        for process in reversed(processes):
            process.end()


if __name__ == "__main__":
    main()
