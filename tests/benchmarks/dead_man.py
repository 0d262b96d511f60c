"""How soon the motor stands at 0 V after a run's client has gone; figures of docs/safety.md.

Real processes, a pseudo-terminal, and the emulator's own witness of the voltage.
"""

from __future__ import annotations

import contextlib
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from processes import Bench, wait_for

DEAD_MAN_S = 1.0
RUNNER = """
import sys
from armrig.rig import Rig
with Rig(connect=sys.argv[1]) as rig:
    rig.arm("benchmark", Ts=0.005)
    rig.run([1.0, 4.0] * 2000, dead_man=float(sys.argv[2]))
"""


def once(bench: Bench, number: signal.Signals, wait_s: float) -> float:
    """Return the time from the signal to 0 V, in ms."""
    endpoint = f"unixsock-stream/{bench.folder}/armrig/1.sock"
    begun = len(bench.voltage_changes())
    client = subprocess.Popen(
        [sys.executable, "-c", RUNNER, endpoint, str(DEAD_MAN_S)], stderr=subprocess.DEVNULL
    )
    try:
        wait_for(lambda: len(bench.voltage_changes()) > begun + 150)
        time.sleep(wait_s)  # anywhere between two signs
        client.send_signal(number)
        stopped_ms = 1e3 * bench.went_to_0_v_after(time.monotonic_ns())
        wait_for(lambda: bench.phase() == "safe")
        with bench.rig() as rig:
            last = rig.status().last_run
            assert last is not None
            assert "its client went away" in last.outcome, last.outcome
        return stopped_ms
    finally:
        client.kill()
        client.wait()


def main() -> None:
    """Try each so many times, 20 by default."""
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    bench = Bench(Path(tempfile.mkdtemp(prefix="armrig-bench-")))
    try:
        bench.emulate()
        bench.serve()
        for number in (signal.SIGKILL, signal.SIGSTOP):
            stopped = [once(bench, number, 0.1 * i / n) for i in range(n)]
            print(
                f"{number.name} of the client, dead-man {DEAD_MAN_S:g} s: 0 V after "
                f"{min(stopped):.0f} … {statistics.median(stopped):.0f} … {max(stopped):.0f} ms "
                f"(least, median, worst; n = {n})",
                flush=True,
            )
    finally:
        for process in reversed(bench.processes):
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.end()


if __name__ == "__main__":
    main()
