"""Progress bar on standard error, so that programs can read standard output."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from armrig_protocol.messages import Flag
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from armrig.numerics.quantities import number
from armrig.rig.client import Rig
from armrig.rig.replies import Progress as Callback

_Arrived = Callable[[], list[Any]]
_WINDOW_NS = 1_000_000_000


@contextmanager
def bar(
    name: str, console: Console | None = None, *, note: Callable[[], str] = str
) -> Iterator[Callback]:
    """Show a progress bar, and yield the function that updates the bar.

    The function has two arguments: the amount of work done so far, and the total amount of work.

    At each update, the text that `note` returns is shown after the bar.
    """
    columns = (
        TextColumn("{task.description:12}", markup=False),
        BarColumn(30),
        TaskProgressColumn(),
        TimeRemainingColumn(compact=True),
        TextColumn("{task.fields[note]}", markup=False),
    )
    with Progress(*columns, console=console or Console(stderr=True)) as shown:
        task = shown.add_task(name, total=None, note="")
        yield lambda done, total: shown.update(task, completed=done, total=total, note=note())


class TimingNote:
    """Text on the timing of a run so far, computed from the rig's streams."""

    def __init__(self, N: int, samples: _Arrived, gaps: _Arrived, reports: _Arrived) -> None:
        """Store the run's length in samples.

        The other arguments are functions that return the new messages of their stream.
        """
        self._N = N
        self._samples, self._gaps, self._reports = samples, gaps, reports
        self._late: NDArray[np.int64] = np.zeros((0, 2), np.int64)
        self._k_first: int | None = None
        self._missing = 0
        self._queue = ""

    def __call__(self) -> str:
        """Return text: lateness in the last second, number of missing samples, queue depth."""
        arrived = [s for s in self._samples() if s.flags & Flag.RUN]
        if arrived and self._k_first is None:
            self._k_first = arrived[0].k
        if self._k_first is None:
            return ""
        late = [(s.t_sched_ns, s.t_host_ns - s.t_sched_ns) for s in arrived]
        self._late = np.concatenate([self._late, np.array(late, np.int64).reshape(-1, 2)])
        self._late = self._late[self._late[:, 0] > self._late[-1, 0] - _WINDOW_NS]
        # As in the recording: samples missing before and after the run do not count.
        end = self._k_first + self._N
        for gap in self._gaps():
            first = max(gap.k_first, self._k_first)
            self._missing += max(0, min(gap.k_first + gap.count, end) - first)
        for report in self._reports():
            queue = report.queue_depth
            self._queue = f", queue {queue.p50:.0f}" if queue.n else ""
        p99_us = float(np.percentile(self._late[:, 1], 99)) / 1e3
        return f"host late p99 {number(p99_us)} µs, missing {self._missing}{self._queue}"


@contextmanager
def timing_note(rig: Rig, N: int) -> Iterator[TimingNote]:
    """Yield a `TimingNote` for a run of N samples, and receive the rig's streams in the block."""
    with (
        rig.arrivals("sample") as samples,
        rig.arrivals("gap") as gaps,
        rig.arrivals("timing") as reports,
    ):
        yield TimingNote(N, samples, gaps, reports)
