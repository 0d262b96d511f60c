"""Lateness of the machine: a process just above the loop's priority wakes each 1 ms.

Lateness here is due to the kernel, or to the host of a virtual machine, and not to armrig. At each
wakeup the process also writes a byte to a pseudo-terminal and measures its arrival. A kernel worker
of ordinary priority moves the byte, as it moves the rig's bytes (docs/timing.md).

`python kernel_lateness.py` answers each line on its standard input with the greatest lateness and
the greatest delivery time since the last line, in ns, and the number of wakeups.
"""

from __future__ import annotations

import contextlib
import gc
import os
import subprocess
import sys
import time
import tty
from pathlib import Path
from typing import NamedTuple

from armrig_core.waiting import TERMINAL_BYTES, Waiter

PRIORITY = 81  # the loop has 80, as configured by default
_PERIOD_NS = 1_000_000


class Lateness(NamedTuple):
    """Measurements of the control since the last question."""

    worst_ms: float
    delivery_ms: float
    """Longest time from writing a byte to a pseudo-terminal to its arrival, in ms."""
    wakes: int


class Control:
    """The control, as a benchmark holds it."""

    def __init__(self) -> None:
        self._popen = subprocess.Popen(
            [sys.executable, str(Path(__file__))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.policy = self._line()

    def lateness(self) -> Lateness:
        """Return the worst since the last call."""
        assert self._popen.stdin is not None
        self._popen.stdin.write("\n")
        self._popen.stdin.flush()
        worst_ns, delivery_ns, wakes = map(int, self._line().split())
        return Lateness(worst_ns / 1e6, delivery_ns / 1e6, wakes)

    def end(self) -> None:
        """End it."""
        self._popen.kill()
        self._popen.communicate()

    def _line(self) -> str:
        assert self._popen.stdout is not None
        return self._popen.stdout.readline().strip()


def main() -> None:
    """Wake, and answer, until the standard input ends."""
    policy = "the ordinary policy"
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        policy = f"SCHED_FIFO {PRIORITY}"
    master, slave = os.openpty()
    tty.setraw(slave)
    waiter = Waiter()
    waiter.watch(0)
    waiter.watch_terminal(slave)
    print(policy, flush=True)
    gc.disable()
    worst_ns = delivery_ns = wakes = written_ns = 0
    due_ns = time.monotonic_ns() + _PERIOD_NS
    while True:
        ready = {fd for fd, _ in waiter.wait_until(due_ns)}
        now_ns = time.monotonic_ns()
        if slave in ready:
            os.read(slave, TERMINAL_BYTES)
            delivery_ns, written_ns = max(delivery_ns, now_ns - written_ns), 0
        if 0 in ready:
            if not os.read(0, 4096):
                return
            if written_ns:  # one that is still on its way has taken so long at least
                delivery_ns = max(delivery_ns, now_ns - written_ns)
            print(worst_ns, delivery_ns, wakes, flush=True)
            worst_ns = delivery_ns = wakes = 0
        if now_ns >= due_ns:
            worst_ns, wakes = max(worst_ns, now_ns - due_ns), wakes + 1
            due_ns += ((now_ns - due_ns) // _PERIOD_NS + 1) * _PERIOD_NS
            if not written_ns:
                written_ns = now_ns
                os.write(master, b"x")


if __name__ == "__main__":
    main()
