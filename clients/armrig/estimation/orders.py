"""Orders of a model: one order for each channel or output.

An order is given as an integer for all channels, as an array with a row for each output, or as a
mapping by names.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray

from armrig.data.dataset import Dataset, Signals
from armrig.models.structure import Structure
from armrig.models.structure_table import STRUCTURES
from armrig.numerics.checks import MAX_ORDER, require_integers
from armrig.numerics.quantities import plural

Integers = NDArray[np.int_]
Orders = int | ArrayLike | Mapping[str, int] | Mapping[tuple[str, str], int]
"""Order of each channel: one number, an array with a row for each output, or a mapping by names."""
Integrator = bool | str | Sequence[str]
"""True if all outputs integrate their input, or the names of the outputs that do."""
Shared = Literal["", "denominator"]

_OF_OUTPUTS = ("na", "nc", "nd")
"""Orders that each output has once; the other orders are those of a channel."""


def require_samples(orders: str, *, needed: int, got: int) -> None:
    """Refuse orders that need more samples than the data have."""
    if got < needed:
        raise InputError(f"{orders} needs at least {plural(needed, 'sample')}, got {got}")


def by_channel(name: str, value: Orders, data: Signals | Dataset, *, least: int) -> Integers:
    """Return the orders (ny, nu) of an argument such as nb; refuse an order below `least`."""
    signals = data.signals()
    keys = [[(y, u) for u in signals.inputs] for y in signals.outputs]
    return _matrix(name, value, keys, least, "a row for each output and a column for each input")


def by_pair(name: str, value: Orders, data: Signals | Dataset, *, least: int) -> Integers:
    """Return the orders (ny, ny) of an argument such as na."""
    outputs = data.signals().outputs
    keys = [[(y, z) for z in outputs] for y in outputs]
    return _matrix(name, value, keys, least, "a row and a column for each output")


def by_output(name: str, value: Orders, data: Signals | Dataset, *, least: int) -> Integers:
    """Return the orders (ny,) of an argument such as nc."""
    outputs = data.signals().outputs
    if isinstance(value, Mapping):
        return _orders_of_keys(name, value, list(outputs), least)
    orders, ny = np.asarray(value, dtype=object), len(outputs)
    if orders.shape not in ((), (ny,)):
        raise InputError(f"{name} needs {plural(ny, 'order')}, one for each output, got {value!r}")
    return _as_orders(name, np.broadcast_to(orders, (ny,)), least)


def _matrix(name: str, value: Any, keys: list[list[Any]], least: int, layout: str) -> Integers:
    shape = len(keys), len(keys[0])
    if isinstance(value, Mapping):
        flat = [key for row in keys for key in row]
        return _orders_of_keys(name, value, flat, least).reshape(shape)
    try:
        orders = np.array(value.tolist() if isinstance(value, np.ndarray) else value, dtype=object)
    except ValueError:
        orders = np.zeros(0, dtype=object)
    if orders.shape not in ((), shape):
        got = " × ".join(map(str, orders.shape)) or repr(value)
        raise InputError(f"{name} is {shape[0]} × {shape[1]}, got {got}: {layout}")
    return _as_orders(name, np.broadcast_to(orders, shape), least)


def _orders_of_keys(name: str, value: Mapping[Any, Any], keys: list[Any], least: int) -> Integers:
    """Return the orders of all keys; in nk, a channel without a key has the delay 1."""
    unknown = [key for key in value if key not in keys]
    missing = [key for key in keys if key not in value] if name != "nk" else []
    if unknown or missing:
        fault = f"there is no {unknown[0]!r}" if unknown else f"{missing[0]!r} is not named"
        raise InputError(f"{name}: {fault}; name each of {', '.join(map(repr, keys))}")
    return _as_orders(name, np.array([value.get(key, 1) for key in keys], dtype=object), least)


def _as_orders(name: str, values: Any, least: int) -> Integers:
    for value in values.ravel().tolist():
        require_integers(MAX_ORDER, **{name: (value, least)})
    return np.asarray(values, dtype=np.int_)


def integrating_outputs(integrator: Integrator, data: Signals | Dataset) -> tuple[bool, ...]:
    """Return whether each output integrates; refuse the name of an unknown output."""
    outputs = data.signals().outputs
    if isinstance(integrator, bool | np.bool_):
        return (bool(integrator),) * len(outputs)
    names = [integrator] if isinstance(integrator, str) else integrator
    unknown = [name for name in names if name not in outputs] if isinstance(names, Iterable) else []
    if unknown or not isinstance(names, Iterable):
        hint = f"; there is no output {unknown[0]!r}" if unknown else ""
        raise InputError(
            f"integrator={integrator!r} must be True or False, or names of outputs{hint}; there "
            f"are {', '.join(outputs)}"
        )
    return tuple(name in names for name in outputs)


def as_text(**orders: ArrayLike) -> str:
    """Return orders as text; if all channels have the same order, the text has one number."""
    return ", ".join(f"{name}={_short(np.asarray(value))}" for name, value in orders.items())


def _short(value: Integers) -> str:
    same = (value == value.flat[0]).all()
    return str(value.flat[0]) if same else str(value.tolist()).replace(" ", "")


def order_arrays(
    data: Dataset | Signals,
    name: str,
    orders: Mapping[str, Any],
    integrators: tuple[bool, ...],
    shared: Shared,
) -> dict[str, Integers]:
    """Return the orders as arrays, in the order in which the caller gave them."""
    signals, arrays = data.signals(), {}
    for order, value in orders.items():
        least = int(order == "nb" and signals.nu == 1)
        by = by_output if order in _OF_OUTPUTS else by_channel
        arrays[order] = by(order, value, data, least=least)
    for output, nb in zip(signals.outputs, arrays["nb"], strict=True):
        if not nb.any():
            raise InputError(f"nb is 0 for all inputs of {output}; leave this output out")
    counted = "nf" if "nf" in STRUCTURES[name].orders else "na"
    if shared:
        if not (arrays[counted] == arrays[counted].flat[0]).all():
            raise InputError(
                f"{counted}={arrays[counted].tolist()}: outputs that share a denominator need one "
                f"order {counted}"
            )
    elif any(
        (n < 1).any() and inside for n, inside in zip(arrays[counted], integrators, strict=True)
    ):
        raise InputError(
            f"{counted} must be at least 1 with an integrator, because it also counts the root at 1"
        )
    return arrays


def structures(
    arrays: dict[str, Integers],
    name: str,
    integrators: tuple[bool, ...],
    *,
    offset: bool,
    shared: bool,
) -> list[Structure]:
    """Return the structure of each output."""
    ny, nu = arrays["nb"].shape
    none = np.zeros(ny, dtype=np.int_)
    na, nc, nd = (arrays.get(order, none) for order in _OF_OUTPUTS)
    nf = arrays.get("nf", np.zeros((ny, nu), dtype=np.int_))
    letter: Literal["a", "f"] = "f" if "nf" in STRUCTURES[name].orders else "a"
    rows = []
    for i, integrates in enumerate(integrators):
        inside = {"a": 0, "f": 0} | ({letter: int(not shared)} if integrates else {})
        rows.append(
            Structure(
                na=int(na[i]) - inside["a"],
                nb=tuple(arrays["nb"][i].tolist()),
                nc=int(nc[i]),
                nd=int(nd[i]),
                nf=tuple(
                    n - inside["f"] if b else 0
                    for n, b in zip(nf[i].tolist(), arrays["nb"][i].tolist(), strict=True)
                ),
                nk=tuple(arrays["nk"][i].tolist()),
                integrator=letter if integrates else "",
                shared=shared,
                offset=offset,
            )
        )
    return rows
