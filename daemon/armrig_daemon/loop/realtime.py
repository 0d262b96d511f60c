"""What the kernel can give a loop: its clock, its priority, its memory kept in place."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import time
from typing import Any

_PR_SET_PDEATHSIG = 1  # <linux/prctl.h>
_PR_SET_TIMERSLACK = 29
_MCL_CURRENT_AND_FUTURE = 3

_libc = ctypes.CDLL(None, use_errno=True)


def now_ns() -> int:
    """Return the monotonic time, which no one steps."""
    return time.monotonic_ns()


def prepare(priority: int, cpu: int | None) -> dict[str, Any]:
    """Ask the kernel for all that helps, and return what it gave.

    Nothing here is needed to run: what is refused is told, with the way to get it.
    """
    _libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    refused = []
    fifo = _set_fifo(priority)
    if priority and not fifo:
        refused.append("SCHED_FIFO (set LimitRTPRIO= or run under systemd's unit)")
    locked = _libc.mlockall(_MCL_CURRENT_AND_FUTURE) == 0
    if not locked:
        refused.append("mlockall (set LimitMEMLOCK=infinity)")
    awake = _keep_awake()
    if not awake:
        refused.append("/dev/cpu_dma_latency (a udev rule may give the group write access)")
    pinned = _pin(cpu)
    if cpu is not None and not pinned:
        refused.append(f"cpu {cpu} (allowed are {sorted(os.sched_getaffinity(0))})")
    gc.collect()
    gc.freeze()
    gc.disable()  # nothing here makes cycles; a collection costs milliseconds
    return {
        "fifo": priority if fifo else 0,
        "mlockall": locked,
        "cpu": cpu,
        "awake": awake,
        "refused": refused,
    }


def _set_fifo(priority: int) -> bool:
    if not priority:
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    return True


_awake: list[int] = []  # the descriptor must stay open for as long as the wish shall hold


def _keep_awake() -> bool:
    """Ask the processors not to sleep so deeply that waking up takes long."""
    try:
        fd = os.open("/dev/cpu_dma_latency", os.O_WRONLY | os.O_CLOEXEC)
    except OSError:
        return False
    os.write(fd, (0).to_bytes(4, "little"))
    _awake.append(fd)
    return True


def _pin(cpu: int | None) -> bool:
    if cpu is None:
        return False
    try:
        os.sched_setaffinity(0, {cpu})
    except (OSError, OverflowError, ValueError):
        return False
    return True


def leave_fifo() -> None:
    """Go back to the ordinary policy, which children and threads inherit from here on."""
    if os.sched_getscheduler(0) != os.SCHED_OTHER:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def end_with_parent(parent: int | None = None) -> None:
    """Have the kernel end this process, by SIGTERM, when its parent ends.

    Parameters
    ----------
    parent : int, optional
        The process that started this one; it may have ended before this is called.
    """
    parent = os.getppid() if parent is None else parent
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent:  # it ended before we asked
        os.kill(os.getpid(), signal.SIGTERM)


def ignore_signals() -> None:
    """Ignore what ends a process from here on, for one that is at its end.

    Python gives each signal its default back on its way out: a second one would kill us there.
    """
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
