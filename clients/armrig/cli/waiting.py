"""An estimation as a person waits for it: a sign of life, and no library's warnings."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer

import numpy as np
from rich.console import Console

from armrig.models.fit import Fit

AFTER_S = 1.0
"""What takes no longer needs no sign of life, in s."""


class OrdersTooHighError(ValueError):
    """The numerics gave up."""


@contextmanager
def estimating(orders: str, console: Console | None = None) -> Iterator[None]:
    """Estimate in here; `orders` names those that may be too high.

    Raises
    ------
    OrdersTooHighError
        A matrix of the estimation could not be decomposed.
    """
    with waiting("estimating", console), np.errstate(all="ignore"), warnings.catch_warnings():
        # Overflows on the way are seen by the search, and told by its verdict.
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            yield
        except np.linalg.LinAlgError as err:
            raise _too_high(orders) from err


def require_finite(fit: Fit, orders: str) -> None:
    """Refuse a model that is no numbers."""
    if not (np.isfinite(fit.theta).all() and np.isfinite(fit.loss)):
        raise _too_high(orders)


@contextmanager
def waiting(what: str, console: Console | None = None, after_s: float = AFTER_S) -> Iterator[None]:
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


def _too_high(orders: str) -> OrdersTooHighError:
    return OrdersTooHighError(f"the orders are too high for these data: lower {orders}")
