"""Decorator that applies a treatment of one Dataset to each channel of Signals."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, cast, overload

from armrig.data.argument import HasDataset
from armrig.data.dataset import Dataset
from armrig.data.signals import Signals

P = ParamSpec("P")


class Treatment(Protocol, Generic[P]):
    """Function that treats a Dataset, or each channel of Signals."""

    # Signals also have `dataset()`, so both overloads accept Signals: the first overload applies.
    @overload
    def __call__(  # type: ignore[overload-overlap]
        self, data: Signals, /, *args: P.args, **options: P.kwargs
    ) -> Signals: ...
    @overload
    def __call__(
        self, data: Dataset | HasDataset, /, *args: P.args, **options: P.kwargs
    ) -> Dataset: ...


def channelwise(f: Callable[Concatenate[Dataset | HasDataset, P], Dataset]) -> Treatment[P]:
    """Decorate a treatment of u and y so that it also accepts Signals, channel by channel.

    `signals.treated(treatment, channels)` treats the named channels only.
    """

    @wraps(f)
    def treating(*args: Any, **options: Any) -> Any:
        if args and isinstance(args[0], Signals):
            return args[0].treated(lambda data: f(data, *args[1:], **options))
        return f(*args, **options)

    return cast("Treatment[P]", treating)
