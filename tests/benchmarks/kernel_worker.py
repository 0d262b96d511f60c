"""Time of the kernel's workers from bytes to the readers of terminals, by the kernel's trace.

`flush_to_ldisc` in a worker of ordinary priority hands bytes of a serial port, or of a
pseudo-terminal, to the reader (docs/timing.md). The worker waits for a processor as other programs
do. Each terminal has its own work, which any worker may get, so a second terminal does not show the
waits of the rig's.

References
----------
.. [1] Linux, Documentation/trace/ftrace.rst; include/trace/events/workqueue.h.
"""

from __future__ import annotations

import contextlib
import os
import re
import time
from collections.abc import Iterator
from pathlib import Path

_TRACING = Path("/sys/kernel/tracing")
_EVENT = re.compile(
    rb" (\d+\.\d+): workqueue_(queue_work|execute_start): work struct[= ](\w+):? "
    rb"function[= ]flush_to_ldisc"
)


PRIORITY = 79
"""Just below the loop's, as configured by default."""


@contextlib.contextmanager
def raised() -> Iterator[None]:
    """Give the present workers the real-time priority `PRIORITY`, and take it back."""
    try:
        _schedule(os.SCHED_FIFO, PRIORITY)
        yield
    finally:
        _schedule(os.SCHED_OTHER, 0)


def _schedule(policy: int, priority: int) -> None:
    for name in Path("/proc").glob("[0-9]*/comm"):
        with contextlib.suppress(OSError):  # one may have ended meanwhile
            if name.read_text(encoding="ascii", errors="replace").startswith("kworker/u"):
                os.sched_setscheduler(int(name.parent.name), policy, os.sched_param(priority))


class KernelWorker:
    """A trace of the works of all terminals."""

    def __init__(self) -> None:
        """Begin to trace.

        Raises
        ------
        OSError
            The kernel's trace is not there (`mount -t tracefs none /sys/kernel/tracing`), or this
            user may not use it.
        """
        self._instance = _TRACING / "instances" / f"armrig-{os.getpid()}"
        self._instance.mkdir()
        for name, value in {
            "trace_clock": "mono",
            "buffer_size_kb": "16384",
            "events/workqueue/workqueue_queue_work/enable": "1",
            "events/workqueue/workqueue_execute_start/enable": "1",
        }.items():
            (self._instance / name).write_text(value, encoding="ascii")
        self._pipe = os.open(self._instance / "trace_pipe", os.O_RDONLY | os.O_NONBLOCK)
        self._given: dict[bytes, float] = {}

    def slowest_ms(self) -> float:
        """Return the longest time since the last call from bytes given to a worker at work, in ms.

        A work that still waits has taken so long at least.
        """
        now = time.monotonic()
        slowest = 0.0
        for match in _EVENT.finditer(self._traced()):
            t, event, work = float(match[1]), match[2], match[3]
            if event == b"queue_work":
                self._given.setdefault(work, t)
            elif work in self._given:
                slowest = max(slowest, t - self._given.pop(work))
        return 1e3 * max([slowest, *(now - t for t in self._given.values())])

    def end(self) -> None:
        """Trace no more."""
        os.close(self._pipe)
        self._instance.rmdir()

    def _traced(self) -> bytes:
        pieces = []
        while True:
            try:
                pieces.append(os.read(self._pipe, 1 << 20))
            except BlockingIOError:
                return b"".join(pieces)
