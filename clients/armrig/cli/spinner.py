"""Spinner during a wait, and a progress bar if the remaining work is known."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Timer
from time import monotonic
from typing import TYPE_CHECKING

from armrig_core.errors import InputError
from armrig_core.process.printable import printable

if TYPE_CHECKING:
    from rich.console import Console

MIN_WAIT_S = 1.0
"""Shortest wait that shows a spinner, in s."""

Count = Callable[[int, int, str], None]
"""Function of the number of finished items, the number of all items, and the next item's name."""


@contextmanager
def estimating(orders: str, console: Console | None = None) -> Iterator[Count]:
    """Show a spinner during an estimation, and suppress the warnings of libraries.

    If a matrix cannot be decomposed, the InputError names the `orders`, which may be too high.
    """
    import numpy as np

    with (
        spinner("estimating", console) as count,
        np.errstate(all="ignore"),
        warnings.catch_warnings(),
    ):
        # The search itself handles overflows.
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            yield count
        except np.linalg.LinAlgError as err:
            raise too_high(orders) from err


@contextmanager
def spinner(
    what: str, console: Console | None = None, after_s: float = MIN_WAIT_S
) -> Iterator[Count]:
    """Show a spinner after `after_s` if standard error is a terminal.

    The yielded function replaces the spinner with a bar that shows the item, the number of
    remaining items, and the time left.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

    console = console or Console(stderr=True)
    if not console.is_terminal:
        yield lambda done, total, name: None
        return
    waiting = SpinnerColumn(), TextColumn("{task.description} …", markup=False)
    shown = Progress(*waiting, console=console, transient=True)
    task = shown.add_task(what, total=None, left="")
    begun = monotonic()

    def count(done: int, total: int, name: str) -> None:
        shown.columns = (*waiting, BarColumn(30), TextColumn("{task.fields[left]}", markup=False))
        left = remaining(done, total, monotonic() - begun)
        doing = f"{what} {printable(name)}" if name else what
        shown.update(task, completed=done, total=total, description=doing, left=left)

    timer = Timer(after_s, shown.start)
    timer.daemon = True
    timer.start()
    try:
        yield count
    finally:
        timer.cancel()
        timer.join()
        if shown.live.is_started:  # otherwise a dumb terminal would print an empty line
            shown.stop()


def remaining(done: int, total: int, elapsed_s: float) -> str:
    """Return the remaining number and time as text, such as: 12 of 40 remain, about 8 s."""
    told = f"{total - done} of {total} remain"
    if not 0 < done < total:
        return told
    left_s = elapsed_s / done * (total - done)
    return f"{told}, about " + (f"{left_s:.0f} s" if left_s < 100 else f"{left_s / 60:.0f} min")


def too_high(orders: str) -> InputError:
    """Return the error for orders that are too high."""
    return InputError(f"the orders are too high for these data: lower {orders}")
