"""What functions of data take: a Dataset, or whatever can give one, such as a Recording."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from inspect import Parameter, signature
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

from armrig_core.calls import check_call
from armrig_core.errors import InputTypeError

from armrig.data.dataset import Dataset, require_visible

P = ParamSpec("P")
R = TypeVar("R")

_WIDEST = 20
"""Characters of a value that a message repeats."""


class HasDataset(Protocol):
    """What gives a Dataset: a recording does, of theta_1."""

    def dataset(self) -> Dataset:
        """Return u and y."""


def as_dataset(data: Dataset | HasDataset) -> Dataset:
    """Return the data, of a recording its `dataset()`.

    Raises
    ------
    TypeError
        It is neither.
    ValueError
        Its numbers are so small that their powers vanish.
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
    """Let a function whose first argument is a Dataset take a recording for it.

    Orders that are given by position, as in MATLAB, are answered with how to name them.
    """
    asked = signature(f)
    parameters = list(asked.parameters.values())
    positional = sum(p.kind is Parameter.POSITIONAL_OR_KEYWORD for p in parameters)
    variadic = any(p.kind is Parameter.VAR_POSITIONAL for p in parameters)
    first = parameters[0].name

    @wraps(f)
    def taking(*args: Any, **options: Any) -> R:
        if len(args) > positional and not variadic:
            as_dataset(args[0])
            raise InputTypeError(_by_name(f.__name__, parameters, args[positional:]))
        if not args and first in options:
            args = (options.pop(first),)
        if args:
            _check_order(f.__name__, first, parameters, args)
        check_call(f.__name__, asked, args, options)
        call: Callable[..., R] = f
        return call(*(as_dataset(a) for a in args[:1]), *args[1:], **options)

    return taking


def _check_order(name: str, first: str, parameters: list[Parameter], args: tuple[Any, ...]) -> None:
    """Refuse data that stand behind something else, such as a model."""
    if _is_data(args[0]) or not any(_is_data(a) for a in args[1:]):
        return
    rest = ", ".join(
        "fit" if p.kind is Parameter.VAR_POSITIONAL else p.name for p in parameters[1:2]
    )
    kind = type(args[0]).__name__
    raise InputTypeError(f"{first} stand first, and a {kind} came: {name}({first}, {rest})")


def _is_data(value: object) -> bool:
    return isinstance(value, Dataset) or callable(getattr(value, "dataset", None))


def _by_name(name: str, parameters: list[Parameter], given: tuple[Any, ...]) -> str:
    """Return how a call with positional orders is to be written."""
    listed = given[0] if len(given) == 1 and isinstance(given[0], list | tuple) else given
    orders = [p for p in parameters if p.kind is Parameter.KEYWORD_ONLY]
    needed = [p.name for p in orders if p.default is Parameter.empty]
    names = needed + [p.name for p in orders if p.name == "nk" and p.name not in needed]
    names = names or [p.name for p in orders]
    values = [*map(_short, listed), *("…" for _ in needed)]
    call = ", ".join(f"{n}={v}" for n, v in zip(names or ["…"], values, strict=False))
    first = parameters[0].name
    return f"{name} takes what stands after {first} by name: {name}({first}, {call})"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _WIDEST else "…"
