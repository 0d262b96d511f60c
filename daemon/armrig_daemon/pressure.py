"""What else this machine was doing, read from the kernel once a second beside the timing."""

from __future__ import annotations

import contextlib
from math import nan
from pathlib import Path
from time import monotonic_ns

CPU = Path("/proc/pressure/cpu")


class Pressure:
    """Pressure stall information of the processors, and the run queue."""

    def __init__(self, path: Path = CPU) -> None:
        """Begin to count now."""
        self._path = path
        self._last = (monotonic_ns(), self._stalled_us())

    def read(self) -> tuple[float, int]:
        """Return two figures; NaN and -1 where this kernel does not tell.

        The share of the time since the last call in which some task waited for a processor, in
        percent, and how many tasks are runnable now.
        """
        now_ns, stalled_us = monotonic_ns(), self._stalled_us()
        (then_ns, before_us), self._last = self._last, (now_ns, stalled_us)
        share = nan
        if stalled_us is not None and before_us is not None and now_ns > then_ns:
            share = 100 * (stalled_us - before_us) * 1000 / (now_ns - then_ns)
        return share, _runnable()

    def _stalled_us(self) -> int | None:
        """Return the total of the line `some … total=N`."""
        with contextlib.suppress(OSError, ValueError, IndexError):
            some = self._path.read_text(encoding="ascii").splitlines()[0]
            return int(some.rsplit("total=", 1)[1])
        return None


def _runnable() -> int:
    with contextlib.suppress(OSError, ValueError, IndexError):
        fields = Path("/proc/loadavg").read_text(encoding="ascii").split()
        return int(fields[3].split("/")[0])
    return -1
