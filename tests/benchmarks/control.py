"""What the machine itself costs: a process just above the loop's priority that wakes each 1 ms.

What is late here was late by the kernel, or by the host below a virtual machine, and not by armrig.
`python control.py` answers each line on its standard input with the greatest lateness, in ns, since
the last one, and how often it woke.
"""

from __future__ import annotations

import contextlib
import gc
import os
import select
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

PRIORITY = 81  # the loop has 80, as configured by default
_PERIOD_NS = 1_000_000


class Lateness(NamedTuple):
    """What the control saw since it was last asked."""

    worst_ms: float
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
        worst_ns, wakes = self._line().split()
        return Lateness(int(worst_ns) / 1e6, int(wakes))

    def end(self) -> None:
        """End it."""
        self._popen.kill()
        self._popen.communicate()

    def _line(self) -> str:
        assert self._popen.stdout is not None
        return self._popen.stdout.readline().strip()


def main() -> None:
    """Wake, and answer, until nobody is there to be answered."""
    policy = "the ordinary policy"
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        policy = f"SCHED_FIFO {PRIORITY}"
    print(policy, flush=True)
    gc.disable()
    worst_ns = wakes = 0
    due_ns = time.monotonic_ns() + _PERIOD_NS
    while True:
        left_s = max(0, due_ns - time.monotonic_ns()) / 1e9
        if select.select([0], [], [], left_s)[0]:
            if not os.read(0, 4096):
                return
            print(worst_ns, wakes, flush=True)
            worst_ns = wakes = 0
        late_ns = time.monotonic_ns() - due_ns
        if late_ns >= 0:
            worst_ns, wakes = max(worst_ns, late_ns), wakes + 1
            due_ns += (late_ns // _PERIOD_NS + 1) * _PERIOD_NS


if __name__ == "__main__":
    main()
