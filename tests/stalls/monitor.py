"""`monitor.py [CPU]`: measure the stalls of the host.

The program waits for deadlines and compares the clock with each of them. Without an argument, it
waits for a processor as any program does. It also passes bytes through a pseudo-terminal, because a
worker of the kernel carries those, with a priority of its own.

With the number of a processor, the program runs on that processor at the highest real-time
priority. It then waits for the host and the kernel only, as a loop on that processor does. If the
priority is refused, the number is ignored.

The monitor is a process of its own, because a thread would also wait for the interpreter of the
tests. It answers each line of its standard input with the stalls since the last answer, and exits
at the end of its input.
"""

from __future__ import annotations

import json
import os
import pty
import select
import sys
import time
import tty
from contextlib import suppress

PERIOD_NS = 5_000_000
SHORTEST_NS = 10_000_000  # shorter stalls are not reported


def main(cpu: int | None) -> None:
    """Wait, compare and answer until the end of the input."""
    if cpu is not None:
        with suppress(PermissionError):
            highest = os.sched_get_priority_max(os.SCHED_FIFO)
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(highest))
            os.sched_setaffinity(0, [cpu])
    stalls: list[tuple[int, int]] = []
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.write(master, b"x")
    now_ns = sent_ns = time.monotonic_ns()
    while True:
        # From the last reading, so that a stall after it counts wherever it lies.
        due_ns = now_ns + PERIOD_NS
        asked, _, _ = select.select([0], [], [], PERIOD_NS / 1e9)
        now_ns = time.monotonic_ns()
        if now_ns - due_ns > SHORTEST_NS:
            stalls.append((due_ns, now_ns))
        has_come = bool(select.select([slave], [], [], 0)[0])
        if (asked or has_come) and now_ns - sent_ns > SHORTEST_NS + PERIOD_NS:
            stalls.append((sent_ns, now_ns))
        if has_come:
            os.read(slave, 1)
            os.write(master, b"x")
            sent_ns = now_ns
        if asked:
            if not os.read(0, 1):
                return
            print(json.dumps(stalls), flush=True)
            stalls.clear()


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else None)
