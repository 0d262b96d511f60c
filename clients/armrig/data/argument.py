"""Arguments of functions that take data: a Dataset, or an object with a method `dataset`."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from inspect import Parameter, signature
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

from armrig_core.calls import check_call
from armrig_core.errors import InputTypeError

from armrig.data.dataset import Dataset, require_visible
from armrig.data.signals import Signals

P = ParamSpec("P")
R = TypeVar("R")

_MAX_SHOWN_CHARACTERS = 20
"""Largest number of characters of an argument's value that a message quotes."""


class HasDataset(Protocol):
    """An object with a method `dataset`; for a recording, the output of the Dataset is theta_1."""

    def dataset(self) -> Dataset:
        """Return the input and the output as a Dataset."""


def as_dataset(data: Dataset | HasDataset) -> Dataset:
    """Return a Dataset unchanged, or the Dataset that `dataset()` of a recording returns.

    Raises
    ------
    TypeError
        The argument is neither a Dataset nor a recording.
    ValueError
        The largest magnitude of u or y is below 1e-30 and not 0. Powers of such numbers can
        underflow in floating point.
    """
    if isinstance(data, Dataset):
        require_visible(data)
        return data
    if not callable(getattr(data, "dataset", None)):
        raise InputTypeError(
            f"data is a {type(data).__name__}: give a Dataset, armrig.Dataset(u=u, y=y, Ts=Ts), "
            'or a recording, armrig.load("F.mcap")'
        )
    return data.dataset()


def takes_recordings(
    f: Callable[Concatenate[Dataset, P], R],
) -> Callable[Concatenate[Dataset | HasDataset, P], R]:
    """Decorate a function of a Dataset so that it also accepts a recording as first argument.

    If orders are given by position, as in MATLAB, the error message shows the call with names.
    """
    return _taking(f, as_dataset)


def takes_signals(
    f: Callable[Concatenate[Dataset | Signals, P], R],
) -> Callable[Concatenate[Dataset | Signals | HasDataset, P], R]:
    """Decorate a function of data of any shape so that it also accepts a recording.

    Signals of one input and one output are passed as a Dataset.
    """
    return _taking(f, _of_any_shape)


def _of_any_shape(data: Dataset | Signals | HasDataset) -> Dataset | Signals:
    if isinstance(data, Signals) and (data.nu, data.ny) != (1, 1):
        return data
    return as_dataset(data)


def _taking(f: Callable[..., R], accepted: Callable[[Any], Any]) -> Callable[..., R]:
    called = signature(f)
    parameters = list(called.parameters.values())
    positional = sum(p.kind is Parameter.POSITIONAL_OR_KEYWORD for p in parameters)
    by_name = [p for p in parameters if p.kind is Parameter.KEYWORD_ONLY]
    variadic = any(p.kind is Parameter.VAR_POSITIONAL for p in parameters)
    first = parameters[0].name

    @wraps(f)
    def taking(*args: Any, **options: Any) -> R:
        if len(args) > positional and by_name and not variadic:
            accepted(args[0])
            raise InputTypeError(_by_name(f.__name__, first, by_name, args[positional:]))
        if not args and first in options:
            args = (options.pop(first),)
        if args:
            _check_order(f.__name__, first, parameters, args)
        check_call(f.__name__, called, args, options)
        call: Callable[..., R] = f
        return call(*(accepted(a) for a in args[:1]), *args[1:], **options)

    return taking


def _check_order(name: str, first: str, parameters: list[Parameter], args: tuple[Any, ...]) -> None:
    """Refuse a call in which another argument, such as a model, precedes the data."""
    if _is_data(args[0]) or not any(_is_data(a) for a in args[1:]):
        return
    rest = ", ".join(
        "fit" if p.kind is Parameter.VAR_POSITIONAL else p.name for p in parameters[1:2]
    )
    kind = type(args[0]).__name__
    raise InputTypeError(f"{first} must come first, got a {kind}: {name}({first}, {rest})")


def _is_data(value: object) -> bool:
    return isinstance(value, Dataset) or callable(getattr(value, "dataset", None))


def _by_name(name: str, first: str, orders: list[Parameter], given: tuple[Any, ...]) -> str:
    """Return the message for arguments given by position; the message contains the correct call."""
    listed = given[0] if len(given) == 1 and isinstance(given[0], list | tuple) else given
    needed = [p.name for p in orders if p.default is Parameter.empty]
    names = needed + [p.name for p in orders if p.name == "nk" and p.name not in needed]
    names = names or [p.name for p in orders]
    values = [*map(_short, listed), *("…" for _ in needed)]
    call = ", ".join(f"{n}={v}" for n, v in zip(names, values, strict=False))
    return f"{name} takes the arguments after {first} by name: {name}({first}, {call})"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN_CHARACTERS else "…"
