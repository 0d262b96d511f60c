"""Choice between a function for one input and output, and its variant for several signals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from importlib import import_module
from inspect import signature
from typing import Any, ParamSpec, TypeVar, cast

from armrig_core.errors import InputTypeError

from armrig.data.dataset import Signals

P = ParamSpec("P")
R = TypeVar("R")

_NOTE = """\
    `Signals` with several inputs or outputs are accepted, too. For these Signals, the parameters
    and the result are described in `{home}.{name}`."""


def accepts_signals(home: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a function of a Dataset so that it also accepts `Signals`.

    The decorated function itself handles Signals of one input and one output. For Signals of
    several channels, the function of the same name in the module `home` is called. The first call
    with such Signals loads the module.
    """

    def decorate(f: Callable[P, R]) -> Callable[P, R]:
        @wraps(f)
        def choosing(*args: Any, **options: Any) -> Any:
            data = args[0] if args else options.get("data")
            if isinstance(data, Signals) and (data.nu, data.ny) != (1, 1):
                of_several = getattr(import_module(home), f.__name__)
                _require_options(of_several, options)
                return of_several(*args, **options)
            return f(*args, **options)

        summary, _, rest = (f.__doc__ or "").partition("\n\n")
        choosing.__doc__ = f"{summary}\n\n{_NOTE.format(home=home, name=f.__name__)}\n\n{rest}"
        return cast("Callable[P, R]", choosing)

    return decorate


def _require_options(f: Callable[..., Any], options: Mapping[str, Any]) -> None:
    """Refuse an option that the function of several signals, `f`, does not have."""
    known = signature(f).parameters
    if any(p.kind is p.VAR_KEYWORD for p in known.values()):
        return
    for name in options:
        if name not in known:
            takes = ", ".join(p.name for p in known.values() if p.kind is p.KEYWORD_ONLY)
            raise InputTypeError(
                f"{name}= is for one output and one input; for several signals {f.__name__} takes "
                f"{takes}"
            )
