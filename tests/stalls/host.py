"""The stalls of the host."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

GAP_NS = 20_000_000
"""Two stalls with less between them are one: a loop does not catch up in so short a time."""
_MONITOR = Path(__file__).with_name("monitor.py")


class Stall(NamedTuple):
    """A time in which a process could not run, by the monotonic clock."""

    began_ns: int
    ended_ns: int


class Host:
    """The host's stalls since the monitor was started."""

    def __init__(self) -> None:
        cpus = [[], *([str(cpu)] for cpu in os.sched_getaffinity(0))]
        self._monitors = [
            subprocess.Popen(
                [sys.executable, "-I", "-S", str(_MONITOR), *cpu],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                bufsize=0,
            )
            for cpu in cpus
        ]
        self._stalls: list[Stall] = []
        self._ask()  # a monitor measures from its first answer on

    def longest_ns(self, began_ns: int, ended_ns: int) -> int:
        """Return the longest stall that overlaps a time, in ns; 0 without any."""
        self._ask()
        stalls = merged(self._stalls)
        overlapping = [s for s in stalls if s.began_ns < ended_ns and began_ns < s.ended_ns]
        return max((stall.ended_ns - stall.began_ns for stall in overlapping), default=0)

    def end(self) -> None:
        """End the monitors."""
        for monitor in self._monitors:
            with monitor:
                assert monitor.stdin is not None
                monitor.stdin.close()

    def _ask(self) -> None:
        for monitor in self._monitors:
            assert monitor.stdin is not None
            assert monitor.stdout is not None
            monitor.stdin.write(b"\n")
            self._stalls += [Stall(*times) for times in json.loads(monitor.stdout.readline())]


def merged(stalls: list[Stall]) -> list[Stall]:
    """Return the stalls in their order; those with less than `GAP_NS` between them are one."""
    whole: list[Stall] = []
    for stall in sorted(stalls):
        if whole and stall.began_ns - whole[-1].ended_ns < GAP_NS:
            stall = Stall(whole[-1].began_ns, max(whole.pop().ended_ns, stall.ended_ns))
        whole.append(stall)
    return whole

