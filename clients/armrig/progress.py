"""A progress bar on standard error, so that standard output stays what a program can read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from armrig.rig import Progress as Callback


@contextmanager
def bar(name: str, console: Console | None = None) -> Iterator[Callback]:
    """Show a bar and give the function that moves it: done, total."""
    columns = (
        TextColumn("{task.description:12}"),
        BarColumn(40),
        TaskProgressColumn(),
        TimeRemainingColumn(compact=True),
    )
    with Progress(*columns, console=console or Console(stderr=True)) as shown:
        task = shown.add_task(name, total=None)
        yield lambda done, total: shown.update(task, completed=done, total=total)
