"""How soon the motor stands at 0 V after what may happen; the table of docs/safety.md.

Real processes, a pseudo-terminal, and the emulator's own witness of the voltage.
"""

from __future__ import annotations

import contextlib
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import armrig
from processes import Bench, wait_for

RUNNER = """
import sys
from armrig.rig import Rig
with Rig(connect=sys.argv[1]) as rig:
    rig.arm("benchmark", Ts=0.005)
    rig.run([1.0, 4.0] * 2000)
"""
EVENTS = ("armrig stop", "SIGTERM", "kill service", "kill loop", "kill both", "freeze loop")


def once(event: str) -> tuple[float, float | None]:
    """Return the time to 0 V, and the age of the newest sample of a file left behind, in ms."""
    bench = Bench(Path(tempfile.mkdtemp(prefix="armrig-bench-")))
    bench.emulate()
    daemon = bench.serve()
    loop_pid = bench.loop_pid(daemon)
    endpoint = f"unixsock-stream/{bench.folder}/armrig/1.sock"
    client = subprocess.Popen([sys.executable, "-c", RUNNER, endpoint], stderr=subprocess.DEVNULL)
    try:
        wait_for(lambda: len(bench.voltage_changes()) > 150)
        with bench.rig() as rig:
            at_ns = time.monotonic_ns()
            if event == "armrig stop":
                rig.stop()
            if event in ("kill loop", "kill both"):
                os.kill(loop_pid, signal.SIGKILL)
            if event in ("kill service", "kill both"):
                daemon.kill()
            if event == "SIGTERM":
                daemon.kill(signal.SIGTERM)
            if event == "freeze loop":
                os.kill(loop_pid, signal.SIGSTOP)
            stopped_ms = 1e3 * bench.went_to_0_v_after(at_ns)
        with contextlib.suppress(ProcessLookupError):
            os.kill(loop_pid, signal.SIGCONT)
        left = list(bench.recordings.glob("*.active"))
        if event in ("kill service", "kill both") and left:
            newest_ns = int(armrig.load(left[0]).samples["t_host_ns"][-1])
            return stopped_ms, (at_ns - newest_ns) / 1e6
        return stopped_ms, None
    finally:
        client.kill()
        client.wait()
        for process in reversed(bench.processes):
            process.end()


def main() -> None:
    """Try each so many times, 10 by default."""
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    for event in EVENTS:
        results = [once(event) for _ in range(n)]
        stopped = [ms for ms, _ in results]
        ages = [age for _, age in results if age is not None]
        text = (
            f"{event:14s} 0 V after {statistics.median(stopped):.1f} ms, worst {max(stopped):.1f}"
        )
        if ages:
            text += f"; newest sample {statistics.median(ages):.0f} ms old, worst {max(ages):.0f}"
        print(f"{text} (n = {n})", flush=True)


if __name__ == "__main__":
    main()
