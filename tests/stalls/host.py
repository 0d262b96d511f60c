"""The stalls of the host."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

STOPS = "SHAKE_STOPS"
"""Environment variable: file in which `make shake` writes each process that it stops, and when."""
_MONITOR = Path(__file__).with_name("monitor.py")


class Stall(NamedTuple):
    """A time in which a process could not run, by the monotonic clock."""

    began_ns: int
    ended_ns: int

    def overlaps(self, began_ns: int, ended_ns: int) -> bool:
        """Return whether a part of the stall lies between two times."""
        return self.began_ns < ended_ns and began_ns < self.ended_ns


class Host:
    """The host's stalls since the monitor was started."""

    def __init__(self) -> None:
        self._monitor = subprocess.Popen(
            [sys.executable, "-I", "-S", str(_MONITOR)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
        )
        self._stalls: list[Stall] = []
        self._ask()  # the monitor measures from its first answer on

    def longest_ns(self, began_ns: int, ended_ns: int) -> int:
        """Return the longest stall that overlaps a time, in ns; 0 without any."""
        self._ask()
        stalls = self._stalls + stops_of(os.getpid(), os.environ.get(STOPS))
        overlapping = [stall for stall in stalls if stall.overlaps(began_ns, ended_ns)]
        return max((stall.ended_ns - stall.began_ns for stall in overlapping), default=0)

    def end(self) -> None:
        """End the monitor."""
        with self._monitor as monitor:
            assert monitor.stdin is not None
            monitor.stdin.close()

    def _ask(self) -> None:
        monitor = self._monitor
        assert monitor.stdin is not None
        assert monitor.stdout is not None
        monitor.stdin.write(b"\n")
        self._stalls += [Stall(*times) for times in json.loads(monitor.stdout.readline())]


def stops_of(pid: int, path: str | None) -> list[Stall]:
    """Return when `make shake` stopped a process of ours.

    Parameters
    ----------
    pid : int
        Process of the tests; the stopped process is that one or descends from it.
    path : str, optional
        File of the stops. A line contains both times and the stopped process with its ancestors.
    """
    lines = Path(path).read_text().splitlines() if path else []
    numbers = [[int(number) for number in line.split()] for line in lines]
    return [Stall(began, ended) for began, ended, *pids in numbers if pid in pids]
