"""Settings that a measuring program requests from the kernel, as the daemon's loop does."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
from contextlib import suppress

from armrig.lab.host import lock_memory, set_fifo

PARENT = "BENCH_PARENT"
"""Environment variable: the process that the programs must not outlive."""

_PR_SET_PDEATHSIG = 1  # <linux/prctl.h>
_PR_SET_TIMERSLACK = 29

_libc = ctypes.CDLL(None, use_errno=True)


def be_punctual(priority: int, *, lock: bool = False) -> bool:
    """Request SCHED_FIFO (not at priority 0) and the rest; return whether FIFO was granted."""
    _libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    fifo = set_fifo(priority)
    if lock:
        lock_memory()
        _keep_awake()
    gc.collect()
    gc.freeze()
    gc.disable()
    return fifo


def _keep_awake() -> None:
    """Hold the processors off deep idle states until this process ends; cyclictest does, too."""
    with suppress(OSError):
        fd = os.open("/dev/cpu_dma_latency", os.O_WRONLY | os.O_CLOEXEC)
        os.write(fd, (0).to_bytes(4, "little"))


def end_with_parent(number: signal.Signals | None = None) -> None:
    """Have the kernel end this process when the benchmark ends; with SIGKILL by default."""
    number = signal.SIGKILL if number is None else number  # Windows lacks it, and may import this
    _libc.prctl(_PR_SET_PDEATHSIG, number, 0, 0, 0)
    # It may have ended before we asked; then our parent is another one already.
    if str(os.getppid()) != os.environ.get(PARENT, str(os.getppid())):
        os.kill(os.getpid(), number)
