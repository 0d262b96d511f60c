"""Arguments of functions that take data: a Dataset, Signals, or an object with `dataset()`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from inspect import Parameter, signature
from threading import Lock
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, TypeVar, cast, overload

import numpy as np
from armrig_core.errors import InputError, InputTypeError
from armrig_core.process.calls import check_call

from armrig.data.columns import MAX_SIZE
from armrig.data.dataset import Dataset, Signals
from armrig.numerics.quantities import digits

P = ParamSpec("P")
R = TypeVar("R")

_ANY_DATA = "Dataset | Signals | Recording"
"""Type of data of any shape in signatures."""
_MIN_SIZE = 1e-30  # powers of much smaller numbers underflow to 0
_MAX_SHOWN_CHARACTERS = 20
"""Largest number of characters of an argument's value that a message quotes."""


class HasDataset(Protocol):
    """An object with a method `dataset`; that of a recording returns the first output."""

    def dataset(self) -> Dataset:
        """Return the input and the output as a Dataset."""


class Treatment(Protocol, Generic[P]):
    """Function that treats the columns of data, and returns data of the same class."""

    # Signals also have `dataset()`, so both overloads accept Signals: the first overload applies.
    @overload
    def __call__(  # type: ignore[overload-overlap]
        self, data: Signals, /, *args: P.args, **options: P.kwargs
    ) -> Signals: ...
    @overload
    def __call__(
        self, data: Dataset | HasDataset, /, *args: P.args, **options: P.kwargs
    ) -> Dataset: ...


def as_dataset(data: Dataset | HasDataset) -> Dataset:
    """Return a Dataset unchanged, or the Dataset that `dataset()` of a recording returns.

    Raises TypeError if the argument is neither a Dataset nor a recording. Raises ValueError if the
    largest magnitude of u or y is below 1e-30 and not 0. Powers of such numbers can underflow in
    floating point.
    """
    if isinstance(data, Dataset):
        _require_visible(data.signals())
        return data
    if not callable(getattr(data, "dataset", None)):
        raise InputTypeError(
            f"data is a {type(data).__name__}: give a Dataset, armrig.Dataset(u=u, y=y, Ts=Ts), "
            'or a recording, armrig.load("F.mcap")'
        )
    return data.dataset()


def as_signals(data: Signals | Dataset | HasDataset) -> Signals:
    """Return Signals unchanged, or the columns of a Dataset or of a recording; see `as_dataset`."""
    if isinstance(data, Signals):
        _require_visible(data)
        return data
    return as_dataset(data).signals()


def takes_recordings(
    f: Callable[Concatenate[Dataset, P], R],
) -> Callable[Concatenate[Dataset | HasDataset, P], R]:
    """Decorate a function of a Dataset so that it also accepts a recording as first argument.

    If orders are given by position, as in MATLAB, the error message shows the call with names.
    """
    return _taking(f, as_dataset, "Dataset | Recording")


def takes_data(
    f: Callable[Concatenate[Dataset | Signals, P], R],
) -> Callable[Concatenate[Dataset | HasDataset | Signals, P], R]:
    """Decorate a function of data of any shape, so that it also accepts a recording."""

    def convert(data: Any) -> Any:
        return data if isinstance(data, Signals) else as_dataset(data)

    return _taking(f, convert, _ANY_DATA)


def takes_signals(
    f: Callable[Concatenate[Signals, P], R],
) -> Callable[Concatenate[Signals | Dataset | HasDataset, P], R]:
    """Decorate a function of Signals so that it also accepts a Dataset or a recording."""
    return _taking(f, as_signals, _ANY_DATA)


def treats_signals(f: Callable[Concatenate[Signals, P], Signals]) -> Treatment[P]:
    """Decorate a treatment of Signals; for a Dataset or a recording it returns a Dataset."""
    treated = takes_signals(f)

    @wraps(f)
    def treating(*args: Any, **options: Any) -> Any:
        signals = treated(*args, **options)
        argument = args[0] if args else options["data"]
        return signals if isinstance(argument, Signals) else signals.dataset()

    treatment_signature = signature(treated).replace(return_annotation="Dataset | Signals")
    treating.__signature__ = treatment_signature  # type: ignore[attr-defined]
    return cast("Treatment[P]", treating)


def _taking(f: Callable[..., R], convert: Callable[[Any], Any], data_type: str) -> Callable[..., R]:
    """Return f with checks of its arguments, and with one thread of linear algebra.

    The first argument is converted. Its type in the signature is `data_type`.
    """
    called = signature(f)
    parameters = list(called.parameters.values())
    positional = sum(p.kind is Parameter.POSITIONAL_OR_KEYWORD for p in parameters)
    by_name = [p for p in parameters if p.kind is Parameter.KEYWORD_ONLY]
    variadic = any(p.kind is Parameter.VAR_POSITIONAL for p in parameters)
    first = parameters[0].name

    @wraps(f)
    def taking(*args: Any, **options: Any) -> R:
        if len(args) > positional and by_name and not variadic:
            convert(args[0])
            raise InputTypeError(_by_name(f.__name__, first, by_name, args[positional:]))
        if not args and first in options:
            args = (options.pop(first),)
        if args:
            _check_order(f.__name__, first, parameters, args)
        check_call(f.__name__, called, args, options)
        with _one_thread():
            return f(*(convert(a) for a in args[:1]), *args[1:], **options)

    parameters = [parameters[0].replace(annotation=data_type), *parameters[1:]]
    taking.__signature__ = called.replace(parameters=parameters)  # type: ignore[attr-defined]
    return taking


_limiting = Lock()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Limit linear algebra to one thread, unless another call limits it already.

    The threads of OpenBLAS wait by spinning: on a busy machine an estimate with small matrices
    takes up to twenty times the processor time that it takes with one thread. The limit belongs to
    the process, so of calls that overlap in several threads, only the first sets and removes it.
    """
    if not _limiting.acquire(blocking=False):
        yield
        return
    try:
        with _linear_algebra().limit(limits=1, user_api="blas"):
            yield
    finally:
        _limiting.release()


@cache
def _linear_algebra() -> Any:
    """Return the controller of the threads of NumPy's and SciPy's linear algebra."""
    import scipy.linalg  # noqa: F401  the controller finds loaded libraries only
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _require_visible(data: Signals) -> None:
    """Refuse a signal so small that powers of its values can underflow; allow a signal of zeros."""
    # Not a check of Signals: a slice of valid data can consist of a decayed response only.
    for names, x, default in ((data.inputs, data.u, "u"), (data.outputs, data.y, "y")):
        largest = np.fmax.reduce(np.abs(x), axis=0, initial=0.0)
        for name, size in zip(names, largest.tolist(), strict=True):
            if 0 < size < _MIN_SIZE:
                raise InputError(
                    f"the largest |{name or default}| is {digits(size, 3)}; use a unit in which it "
                    f"is from {_MIN_SIZE:g} to {MAX_SIZE:g}"
                )


def _check_order(name: str, first: str, parameters: list[Parameter], args: tuple[Any, ...]) -> None:
    """Refuse a call in which another argument, such as a model, precedes the data."""
    if _is_data(args[0]) or not any(_is_data(a) for a in args[1:]):
        return
    second = ", ".join(
        "fit" if p.kind is Parameter.VAR_POSITIONAL else p.name for p in parameters[1:2]
    )
    kind = type(args[0]).__name__
    raise InputTypeError(f"{first} must come first, got a {kind}: {name}({first}, {second})")


def _is_data(value: object) -> bool:
    return isinstance(value, Dataset) or callable(getattr(value, "dataset", None))


def _by_name(name: str, first: str, orders: list[Parameter], args: tuple[Any, ...]) -> str:
    """Return the message for arguments given by position; the message contains the correct call."""
    listed = args[0] if len(args) == 1 and isinstance(args[0], list | tuple) else args
    needed = [p.name for p in orders if p.default is Parameter.empty]
    names = needed + [p.name for p in orders if p.name == "nk" and p.name not in needed]
    names = names or [p.name for p in orders]
    values = [*map(_short, listed), *("…" for _ in needed)]
    call = ", ".join(f"{n}={v}" for n, v in zip(names, values, strict=False))
    return f"{name} takes the arguments after {first} by name: {name}({first}, {call})"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN_CHARACTERS else "…"
