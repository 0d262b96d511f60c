"""Choice between the functions of one input and output and those of several."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import Any, ParamSpec, TypeVar, cast

from armrig.data.signals import Signals

P = ParamSpec("P")
R = TypeVar("R")


def accepts_signals(home: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a function of a Dataset so that it also accepts `Signals`.

    Signals of one input and one output are treated as their Dataset. For Signals of several
    channels, the function of the same name in the module `home` is called. The module is loaded at
    the first such call.
    """

    def decorate(f: Callable[P, R]) -> Callable[P, R]:
        @wraps(f)
        def choosing(*args: Any, **options: Any) -> Any:
            data = args[0] if args else options.get("data")
            if isinstance(data, Signals) and (data.nu, data.ny) != (1, 1):
                return getattr(import_module(home), f.__name__)(*args, **options)
            return f(*args, **options)

        return cast("Callable[P, R]", choosing)

    return decorate
