"""The stalls of the host.

As a program, `host.py [CPU]` compares the clock with deadlines, because a thread would also wait
for the interpreter of the tests. With the number of a processor, it runs there, and at the highest
real-time priority, if it may, as a loop does.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from contextlib import suppress
from typing import Any

PERIOD_NS = 5_000_000
SHORTEST_NS = 10_000_000  # shorter stalls are not reported
GAP_NS = 20_000_000
"""Two stalls with less between them are one: a loop does not catch up in so short a time."""
Stall = tuple[int, int]
"""Begin and end of a time in which a process could not run, in ns of the monotonic clock."""


class Host:
    """The host's stalls since the monitors were started: one for each processor, and one more."""

    def __init__(self) -> None:
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "bufsize": 0}
        self._monitors = [
            subprocess.Popen([sys.executable, "-I", "-S", __file__, *cpu], **pipes)
            for cpu in [[], *([str(cpu)] for cpu in os.sched_getaffinity(0))]
        ]
        self._stalls: list[Stall] = []
        self._ask()  # a monitor measures from its first answer on

    def longest_ns(self, began_ns: int, ended_ns: int) -> int:
        """Return the longest stall that overlaps a time, in ns; 0 without any."""
        self._ask()
        times = (stall for stall in self._stalls if stall[0] < ended_ns and began_ns < stall[1])
        return max((end - begin for begin, end in times), default=0)

    def end(self) -> None:
        for monitor in self._monitors:
            with monitor:
                monitor.stdin.close()

    def _ask(self) -> None:
        for monitor in self._monitors:
            monitor.stdin.write(b"\n")
            self._stalls += map(tuple, json.loads(monitor.stdout.readline()))


def monitor(cpu: int | None) -> None:
    """Answer each line of input with the stalls since the last answer."""
    if cpu is not None:
        os.sched_setaffinity(0, [cpu])
        with suppress(PermissionError):
            highest = os.sched_get_priority_max(os.SCHED_FIFO)
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(highest))
    stalls: list[Stall] = []
    now_ns = time.monotonic_ns()
    while True:
        # From the last reading, so that a stall after it counts wherever it lies.
        due_ns = now_ns + PERIOD_NS
        asked, _, _ = select.select([0], [], [], PERIOD_NS / 1e9)
        now_ns = time.monotonic_ns()
        if now_ns - due_ns > SHORTEST_NS:
            is_near = stalls and due_ns - stalls[-1][1] < GAP_NS
            stalls.append((stalls.pop()[0] if is_near else due_ns, now_ns))
        if asked:
            if not os.read(0, 1):
                return
            print(json.dumps(stalls), flush=True)
            stalls.clear()


if __name__ == "__main__":
    monitor(int(sys.argv[1]) if len(sys.argv) > 1 else None)
