"""A progress bar on standard error, so that standard output stays what a program can read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from armrig.quantities import number
from armrig.rig import Progress as Callback


@contextmanager
def bar(
    name: str, console: Console | None = None, *, note: Callable[[], str] = str
) -> Iterator[Callback]:
    """Show a bar and give the function that moves it: done, total.

    `note` is asked each time for what is to stand behind it.
    """
    columns = (
        TextColumn("{task.description:12}"),
        BarColumn(30),
        TaskProgressColumn(),
        TimeRemainingColumn(compact=True),
        TextColumn("{task.fields[note]}"),
    )
    with Progress(*columns, console=console or Console(stderr=True)) as shown:
        task = shown.add_task(name, total=None, note="")
        yield lambda done, total: shown.update(task, completed=done, total=total, note=note())


class TimingNote:
    """What the rig's timing stream says, in a few words, of the run so far."""

    def __init__(self, come: Callable[[], list[Any]]) -> None:
        """Take the function that returns the stream's new messages."""
        self._come = come
        self._missed = 0
        self._text = ""

    def __call__(self) -> str:
        """Return the last second's lateness, all ticks missed, and the setpoints held ahead."""
        for message in self._come():
            late, queue = message.wake_lateness_us, message.queue_depth
            self._missed += late.missed
            self._text = f"late {number(late.p99)} µs (p99), missed {self._missed}"
            self._text += f", queue {queue.p50:.0f}" if queue.n else ""
        return self._text
