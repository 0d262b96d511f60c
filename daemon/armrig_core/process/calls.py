"""Checks of a call's arguments, with messages that show the correct call."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Any, ParamSpec, TypeVar

from armrig_core.errors import InputTypeError

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


def with_argument_checks(f: Callable[P, R]) -> Callable[P, R]:
    """Return the function with checks for missing, unknown or too many arguments.

    For too many arguments, Python's own message contains only their number. The message of the
    returned function names the arguments and shows the correct call.
    """
    asked = signature(f)
    name = f.__qualname__.removesuffix(".__init__").rpartition(".")[2]

    @wraps(f)
    def call(*args: P.args, **options: P.kwargs) -> R:
        check_call(name, asked, args, options)
        return f(*args, **options)

    return call


def with_constructor_checks(cls: type[T]) -> type[T]:
    """Return the class with checks of its constructor's arguments, as in `with_argument_checks`."""
    cls.__init__ = with_argument_checks(cls.__init__)  # type: ignore[method-assign]
    return cls


def check_call(
    name: str, asked: Signature, args: Sequence[Any], options: Mapping[str, Any]
) -> None:
    """Refuse arguments that do not fit the signature `asked`.

    Raises TypeError if arguments are missing, unknown or too many. The message names these
    arguments and shows the correct call.
    """
    try:
        asked.bind(*args, **options)
    except TypeError:
        raise InputTypeError(_explain(name, asked, args, options)) from None


def _explain(name: str, asked: Signature, args: Sequence[Any], options: Mapping[str, Any]) -> str:
    parameters = [p for p in asked.parameters.values() if p.name != "self"]
    names = [p.name for p in parameters]
    positional = [p.name for p in parameters if p.kind is Parameter.POSITIONAL_OR_KEYWORD]
    count = len(args) - ("self" in asked.parameters)
    for option in options:
        if option not in names:
            near = get_close_matches(option, names, n=1) or [
                n for n in names if n.casefold() == option.casefold()
            ]
            meant = f"did you mean {near[0]}? " if near else ""
            return f"{name} has no {option}; {meant}it takes {', '.join(names)}"
    needed = [p for p in parameters if p.default is Parameter.empty]
    needed = [p for p in needed if p.kind is not Parameter.VAR_POSITIONAL]
    call = f"{name}({', '.join(_argument_text(p) for p in needed)})"
    if count > len(positional):
        by_name = [n for n in names if n not in positional]
        if by_name:
            return f"{name} takes {', '.join(by_name[:3])} by name: {call}"
        return f"{name} takes {', '.join(positional)}, but was given {count}: {call}"
    taken = {*options, *positional[:count]}
    missing = [p.name for p in needed if p.name not in taken]
    if not missing:
        twice = [n for n in positional[:count] if n in options]
        return f"{name} was given {' and '.join(twice)} twice: {call}"
    return f"{name} needs {' and '.join(missing)}: {call}"


def _argument_text(p: Parameter) -> str:
    """Return the text of an argument in a call, such as `[u, …]` or `Ts=…`."""
    if str(p.annotation).startswith("Sequence"):
        return f"[{p.name}, …]"
    return p.name if p.kind is Parameter.POSITIONAL_OR_KEYWORD else f"{p.name}=…"
