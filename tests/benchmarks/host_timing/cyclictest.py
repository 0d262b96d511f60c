"""Debian's cyclictest, where it is installed: how it is called and what it says.

Its histogram is in whole microseconds, rounded down, and it skips deadlines that it has missed.
Where it may, it keeps the processors from idling by /dev/cpu_dma_latency while it runs.
"""

from __future__ import annotations

import re
import shutil

import numpy as np
from armrig_core.errors import OperationError
from numpy.typing import NDArray

MOST_US = 20_000
"""End of its histogram, in µs; a later wakeup counts as this, in cyclictest's favour."""
_LINE = re.compile(r"^(\d+)\s+(\d+)\s*$", re.MULTILINE)
_OVERFLOWS = re.compile(r"^# Histogram Overflows:\s*(\d+)", re.MULTILINE)
_GREATEST = re.compile(r"^# Max Latencies:\s*(\d+)", re.MULTILINE)


def find() -> str | None:
    """Return the program's path, or None."""
    # Debian puts it where a user's PATH does not always look.
    return shutil.which("cyclictest") or shutil.which("cyclictest", path="/usr/sbin:/usr/bin")


def command(program: str, *, period_us: int, count: int, priority: int, lock: bool) -> list[str]:
    """Return the call; it does not even start where SCHED_FIFO is not allowed."""
    locked = ["-m"] if lock else []
    sizes = ["-i", str(period_us), "-l", str(count), "-h", str(MOST_US)]
    return [program, "-q", *locked, "-p", str(priority), *sizes]


def lateness_us(output: str) -> NDArray[np.float64]:
    """Return the lateness of each wake-up, in µs and in order of size.

    Raises
    ------
    OperationError
        There is no histogram of one thread in `output`.
    """
    bins = np.array(_LINE.findall(output), np.int64).reshape(-1, 2)
    greatest = _GREATEST.search(output)
    if not bins.size or not bins[:, 1].any() or greatest is None:
        end = " ".join(output.split())[-120:] or "nothing"
        raise OperationError(f"cyclictest printed no histogram of one thread: {end}")
    late = np.repeat(bins[:, 0], bins[:, 1]).astype(np.float64)
    overflows = _OVERFLOWS.search(output)
    over = np.full(int(overflows[1]) if overflows else 0, float(MOST_US))
    over[-1:] = max(float(greatest[1]), MOST_US)
    return np.concatenate([late, over])
