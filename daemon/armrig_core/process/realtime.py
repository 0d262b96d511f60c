"""Requests of the loop to the kernel: clock, priority, locked memory."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import signal
import time
from pathlib import Path
from typing import Any

_PR_SET_PDEATHSIG = 1  # <linux/prctl.h>
_PR_SET_TIMERSLACK = 29
_MCL_CURRENT_AND_FUTURE = 3

_libc = ctypes.CDLL(None, use_errno=True)


now_ns = time.monotonic_ns
"""Function that returns the time of the monotonic clock, in ns; this clock never jumps."""


def prepare(priority: int, cpu: int | None) -> dict[str, Any]:
    """Ask the kernel for real-time properties, and return the granted properties.

    The loop also runs without these properties; each refused property is reported with a remedy.
    """
    _libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    refused = []
    fifo = _set_fifo(priority)
    if priority and not fifo:
        refused.append("SCHED_FIFO (set LimitRTPRIO= or run under systemd's unit)")
    elif fifo != priority:
        refused.append(f"priority {priority} (it is {fifo}; set LimitRTPRIO={priority})")
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
    gc.disable()  # no code here makes reference cycles; a collection costs milliseconds
    return {
        "fifo": fifo,
        "mlockall": locked,
        "cpu": cpu,
        "awake": awake,
        "refused": refused,
    }


def _set_fifo(priority: int) -> int:
    """Request a SCHED_FIFO priority; return the granted priority, or 0 without SCHED_FIFO."""
    if not priority:
        leave_fifo()
        return _fifo_priority()
    try:
        if _fifo_priority():
            # systemd has set the policy. A sandbox with RestrictRealtime= then refuses a request
            # for the policy, but not a change of its priority.
            os.sched_setparam(0, os.sched_param(priority))
        else:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return _fifo_priority()
    return priority


def _fifo_priority() -> int:
    """Return the SCHED_FIFO priority of this process; 0 under another policy."""
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    return os.sched_getparam(0).sched_priority if policy == os.SCHED_FIFO else 0


_awake: list[int] = []  # the request is in force while the descriptor is open


def _keep_awake() -> bool:
    """Keep the processors out of sleep states with a long wake-up time."""
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


def leave_fifo(but: int | None = None) -> bool:
    """Return to the ordinary scheduling policy, which later children and threads inherit.

    The thread with the id `but` keeps its priority. The result is True if no other thread of this
    process is at SCHED_FIFO any more. If a filter of system calls forbids sched_setscheduler, the
    threads stay at SCHED_FIFO.
    """
    for path in Path("/proc/self/task").iterdir():  # all threads, also those of numpy's libraries
        thread = int(path.name)
        with contextlib.suppress(OSError):
            if thread != but and os.sched_getscheduler(thread) != os.SCHED_OTHER:
                os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
    return not _fifo_priority()


def be_prompt(thread: int) -> None:
    """If permitted, set the lowest real-time priority for `thread`, a thread that only waits."""
    with contextlib.suppress(OSError):
        if os.sched_getscheduler(thread) == os.SCHED_OTHER:
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(1))


def end_with_parent(parent: int | None = None, by: signal.Signals = signal.SIGTERM) -> None:
    """Let the kernel end this process by the signal `by` when its parent ends.

    `parent` is the id of the process that started this process; it may already have ended.
    """
    parent = os.getppid() if parent is None else parent
    _libc.prctl(_PR_SET_PDEATHSIG, by, 0, 0, 0)
    if os.getppid() != parent:  # the parent ended before this request
        os.kill(os.getpid(), by)


def ignore_signals() -> None:
    """Ignore further signals that end a process; call this at the end of a process.

    At its exit Python restores the default action of each signal. A second signal would then kill
    the process.
    """
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
