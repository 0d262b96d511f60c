"""A spinner while a person waits; an estimation under it gives no warnings of libraries."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer

import numpy as np
from rich.console import Console

AFTER_S = 1.0
"""A wait that is shorter shows no spinner, in s."""


class OrdersTooHighError(ValueError):
    """A matrix could not be decomposed, or the model has an infinite or undefined parameter."""


@contextmanager
def estimating(orders: str, console: Console | None = None) -> Iterator[None]:
    """Show a spinner during an estimation; `orders` names those that may be too high.

    Raises
    ------
    OrdersTooHighError
        A matrix of the estimation could not be decomposed.
    """
    with spinner("estimating", console), np.errstate(all="ignore"), warnings.catch_warnings():
        # The search sees overflows on its way, and its verdict tells them.
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            yield
        except np.linalg.LinAlgError as err:
            raise too_high(orders) from err


@contextmanager
def spinner(what: str, console: Console | None = None, after_s: float = AFTER_S) -> Iterator[None]:
    """Show a spinner on standard error, where that is a terminal, after a while."""
    console = console or Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    shown = console.status(f"{what} …")
    timer = Timer(after_s, shown.start)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()
        shown.stop()


def too_high(orders: str) -> OrdersTooHighError:
    """Return what says that these orders are too high."""
    return OrdersTooHighError(f"the orders are too high for these data: lower {orders}")
