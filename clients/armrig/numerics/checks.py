"""Checks of a caller's arguments, before the arguments are converted to arrays."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from numbers import Integral, Number, Real
from typing import Any

import numpy as np
from armrig_core.errors import InputError, InputTypeError
from numpy.typing import ArrayLike, NDArray

MAX_ORDER = 10_000
"""Largest order of a model."""
_MAX_SIZE = 10**8  # numbers in 0.8 GB


def require_integers(most: int = _MAX_SIZE, /, **asked: tuple[Any, int]) -> None:
    """Refuse a value that is no integer from its lower limit to `most`: name=(value, limit)."""
    for name, (value, lowest) in asked.items():
        if isinstance(value, bool) or not isinstance(value, Integral) or int(value) < lowest:
            raise InputError(f"{name}={value!r} must be an integer >= {lowest}")
        if int(value) > most:
            raise InputError(f"{name}={value!r} must be at most {most}")


def require_numbers(**asked: Any) -> None:
    """Refuse a value that is not a real number."""
    for name, value in asked.items():
        if isinstance(value, bool) or not isinstance(value, Real):
            raise InputError(f"{name}={value!r} must be a number")


def require_flags(**asked: Any) -> None:
    """Refuse a value that is neither True nor False."""
    for name, value in asked.items():
        if not isinstance(value, bool | np.bool_):
            raise InputError(f"{name}={value!r} must be True or False")


def require_known(**asked: tuple[Any, Collection[str]]) -> None:
    """Refuse a value that is not one of the allowed texts: name=(value, allowed)."""
    for name, (value, allowed) in asked.items():
        if value not in allowed:
            names = [f'"{x}"' for x in allowed]
            either = " or ".join(names) if len(names) == 2 else f"one of {', '.join(names)}"
            raise InputError(f"{name}={value!r} must be {either}")


def several(name: str, values: Any) -> list[int]:
    """Return the values of an argument as a list; refuse a single value and an empty sequence."""
    if not isinstance(values, Iterable) or isinstance(values, str):
        got = f"{name}={values!r} must be several numbers"
        raise InputTypeError(f"{got}, such as {name}=range(1, 5) or {name}=(1, 2, 4)")
    numbers = [*values]
    if not numbers:
        raise InputError(f"{name} is empty; give numbers, such as {name}=range(1, 5)")
    return numbers


def several_of(name: str, values: Iterable[str], allowed: Collection[str]) -> list[Any]:
    """Return the names of an argument as a list; refuse an unknown name and an empty sequence."""
    names = [*values]
    if unknown := [value for value in names if value not in allowed]:
        raise InputError(f"{name} has {unknown[0]!r}; each must be one of {', '.join(allowed)}")
    if not names:
        raise InputError(f"{name} is empty; give at least one of {', '.join(allowed)}")
    return names


def column(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return a copy (N,) of the values, with NaN for masked values.

    Values of another shape and complex values are refused.
    """
    if values is None or hasattr(values, "dataset") or hasattr(values, "Ts"):
        kind = "missing" if values is None else f"a {type(values).__name__}"
        msg = f"{name} is {kind}; give an array of numbers, (N,)"
        msg += f", such as data.{name}" if name in ("u", "y") else ""
        raise InputTypeError(msg)
    array = np.asanyarray(values)
    are_numbers = array.dtype.kind == "O" and all(isinstance(x, Number) for x in array.ravel())
    if array.dtype.kind in "USO" and not are_numbers:
        first = array.ravel()[0] if array.size else ""
        raise InputError(
            f"{name} contains text or other objects ({str(first)[:20]!r}); give numbers with a "
            "decimal point, or read a file with armrig.load_data(path)"
        )
    if np.iscomplexobj(array):
        raise InputError(
            f"{name} is complex ({array.dtype}), but must be real; give {name}.real, or the "
            "magnitude if the magnitude was measured"
        )
    taken = real_copy(array)
    if taken.ndim != 1 or taken.size == 0:
        raise InputError(
            f"{name} has shape {taken.shape}, but must be (N,), N >= 1; {_way_out(name, taken)}"
        )
    return taken


def real_copy(array: NDArray[Any]) -> NDArray[np.float64]:
    """Return a column-major copy of real numbers, with NaN for masked values."""
    taken = np.array(array, dtype=np.float64, order="F")
    if isinstance(array, np.ma.MaskedArray):
        taken[np.ma.getmaskarray(array)] = np.nan
    return taken


def _way_out(name: str, taken: NDArray[np.float64]) -> str:
    if taken.size == 0:
        return f"{name} is empty"
    if taken.ndim == 0:
        return f"give a value for each instant, such as numpy.full(N, {taken:g})"
    if taken.size == max(taken.shape):
        return f"use {name}.ravel()"
    return f"a signal is one column, such as {name}[:, 0]"
