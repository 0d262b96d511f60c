"""Stops of processes, as a debugger stops them.

A process that SIGSTOP stopped would be continued by our SIGCONT even if a test stopped it, too. A
stop by ptrace leaves the process in the state that the test gave it, and ends if we are killed.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

WALL: Final = 0x40000000  # __WALL: wait for threads, too
_SEIZE: Final = 0x4206
_INTERRUPT: Final = 0x4207
_DETACH: Final = 17

_ptrace = ctypes.CDLL(None).ptrace
_ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
_ptrace.restype = ctypes.c_long


@contextmanager
def stopped(pid: int) -> Iterator[bool]:
    """Stop all threads of a process; give whether that was possible."""
    signals: dict[int, int] = {}
    with suppress(FileNotFoundError):  # it has ended
        for thread in Path(f"/proc/{pid}/task").iterdir():
            tid = int(thread.name)
            if _ptrace(_SEIZE, tid, None, None) == 0:
                _ptrace(_INTERRUPT, tid, None, None)
                signals[tid] = 0
    for tid in signals:
        _, status = os.waitpid(tid, WALL)
        # A signal that came first is given back with the detachment; a stop (an event) is not.
        if os.WIFSTOPPED(status) and not status >> 16:
            signals[tid] = os.WSTOPSIG(status)
    try:
        yield bool(signals)
    finally:
        for tid, signal in signals.items():
            _ptrace(_DETACH, tid, None, signal)
