"""Orders of a model with several inputs and outputs: one order for each channel or output.

An order is given as an integer for all channels, as an array with a row for each output, or as a
mapping by names.
"""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Integral
from typing import Any

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.signals import Signals

Integers = NDArray[np.int_]


def by_channel(name: str, value: Any, data: Signals, *, least: int) -> Integers:
    """Return the orders (ny, nu) of an argument such as nb.

    Raises
    ------
    ValueError
        The shape is wrong, a channel is not named, or an order is below `least`.
    """
    keys = [[(y, u) for u in data.inputs] for y in data.outputs]
    return _matrix(name, value, keys, least, "a row for each output and a column for each input")


def by_pair(name: str, value: Any, data: Signals, *, least: int) -> Integers:
    """Return the orders (ny, ny) of an argument such as na."""
    keys = [[(y, z) for z in data.outputs] for y in data.outputs]
    return _matrix(name, value, keys, least, "a row and a column for each output")


def by_output(name: str, value: Any, data: Signals, *, least: int) -> Integers:
    """Return the orders (ny,) of an argument such as nc."""
    if isinstance(value, Mapping):
        return _named(name, value, list(data.outputs), least)
    given = np.asarray(value, dtype=object)
    if given.shape not in ((), (data.ny,)):
        raise InputError(f"{name} needs {data.ny} orders, one for each output, got {value!r}")
    return _checked(name, np.broadcast_to(given, (data.ny,)), least)


def _matrix(name: str, value: Any, keys: list[list[Any]], least: int, what: str) -> Integers:
    shape = len(keys), len(keys[0])
    if isinstance(value, Mapping):
        flat = [key for row in keys for key in row]
        return _named(name, value, flat, least).reshape(shape)
    try:
        given = np.array(value.tolist() if isinstance(value, np.ndarray) else value, dtype=object)
    except ValueError:
        given = np.zeros(0, dtype=object)
    if given.shape not in ((), shape):
        got = " × ".join(map(str, given.shape)) or repr(value)
        raise InputError(f"{name} is {shape[0]} × {shape[1]}, got {got}: {what}")
    return _checked(name, np.broadcast_to(given, shape), least)


def _named(name: str, value: Mapping[Any, Any], keys: list[Any], least: int) -> Integers:
    """Return the orders of all keys; in nk, a channel without a key has the delay 1."""
    unknown = [key for key in value if key not in keys]
    missing = [key for key in keys if key not in value] if name != "nk" else []
    if unknown or missing:
        said = f"there is no {unknown[0]!r}" if unknown else f"{missing[0]!r} is not named"
        raise InputError(f"{name}: {said}; name each of {', '.join(map(repr, keys))}")
    return _checked(name, np.array([value.get(key, 1) for key in keys], dtype=object), least)


def _checked(name: str, values: Any, least: int) -> Integers:
    for value in values.ravel().tolist():
        if isinstance(value, bool) or not isinstance(value, Integral) or int(value) < least:
            raise InputError(f"{name}: {value!r} must be an integer >= {least}")
    return np.asarray(values, dtype=np.int_)


def as_text(**orders: Integers) -> str:
    """Return orders as text; if all channels have the same order, the text has one number."""
    return ", ".join(f"{name}={_short(value)}" for name, value in orders.items())


def _short(value: Integers) -> str:
    flat = value.ravel()
    if flat.size and (flat == flat[0]).all():
        return str(int(flat[0]))
    return str(value.tolist()).replace(" ", "")
