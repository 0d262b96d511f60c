"""What a person sees while waiting: a spinner, and a bar where it is known how much remains."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Timer
from time import monotonic

import numpy as np
from armrig_core.errors import InputError
from armrig_core.printable import printable
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

AFTER_S = 1.0
"""A wait that is shorter shows nothing, in s."""

Count = Callable[[int, int, str], None]
"""Takes how many are done, how many there are, and the name of what is done next."""

_WAITING = SpinnerColumn(), TextColumn("{task.description} …", markup=False)
_COUNTING = *_WAITING, BarColumn(30), TextColumn("{task.fields[left]}", markup=False)


@contextmanager
def estimating(orders: str, console: Console | None = None) -> Iterator[Count]:
    """Show a spinner during an estimation, without warnings of libraries.

    Parameters
    ----------
    orders : str
        Names those that may be too high.

    Raises
    ------
    InputError
        A matrix of the estimation could not be decomposed.
    """
    with (
        spinner("estimating", console) as count,
        np.errstate(all="ignore"),
        warnings.catch_warnings(),
    ):
        # The search sees overflows on its way, and its verdict tells them.
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            yield count
        except np.linalg.LinAlgError as err:
            raise too_high(orders) from err


@contextmanager
def spinner(what: str, console: Console | None = None, after_s: float = AFTER_S) -> Iterator[Count]:
    """Show a spinner on standard error, where that is a terminal, after a while.

    The function that it gives makes it a bar: what is done now, how many remain, the time left.
    """
    console = console or Console(stderr=True)
    if not console.is_terminal:
        yield lambda done, total, name: None
        return
    shown = Progress(*_WAITING, console=console, transient=True)
    task = shown.add_task(what, total=None, left="")
    begun = monotonic()

    def count(done: int, total: int, name: str) -> None:
        shown.columns = _COUNTING
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
        if shown.live.is_started:  # or a dumb terminal gets an empty line
            shown.stop()


def remaining(done: int, total: int, elapsed_s: float) -> str:
    """Return how many remain, and for how long: 12 of 40 remain, about 8 s."""
    told = f"{total - done} of {total} remain"
    if not 0 < done < total:
        return told
    left_s = elapsed_s / done * (total - done)
    return f"{told}, about " + (f"{left_s:.0f} s" if left_s < 100 else f"{left_s / 60:.0f} min")


def too_high(orders: str) -> InputError:
    """Return what says that these orders are too high."""
    return InputError(f"the orders are too high for these data: lower {orders}")
