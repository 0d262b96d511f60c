"""Checks of numbers that a caller asks for, before numpy meets them."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def require_integers(**asked: tuple[Any, int]) -> None:
    """Refuse a value (value, lowest allowed) that is no integer or too low."""
    for name, (value, lowest) in asked.items():
        if isinstance(value, bool) or not isinstance(value, Integral) or int(value) < lowest:
            msg = f"{name}={value!r} must be an integer >= {lowest}"
            raise ValueError(msg)


def require_numbers(**asked: Any) -> None:
    """Refuse a value that is no real number."""
    for name, value in asked.items():
        if isinstance(value, bool) or not isinstance(value, Real):
            msg = f"{name}={value!r} must be a number"
            raise ValueError(msg)


def column(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return a copy (N,) of the values, NaN where they are masked.

    Another shape is refused, nothing is ravelled; complex values are refused, no part is dropped.
    """
    given = np.asanyarray(values)
    if np.iscomplexobj(given):
        msg = f"{name} is complex ({given.dtype}), it must be real; give {name}.real, or its "
        msg += "magnitude, if that is what was measured"
        raise ValueError(msg)
    taken = np.array(np.ma.filled(given.astype(np.float64), np.nan))
    if taken.ndim != 1 or taken.size == 0:
        msg = f"{name} has shape {taken.shape}, it must be (N,) with N >= 1; use {name}.ravel()"
        raise ValueError(msg)
    return taken
