"""Tests of data with several inputs and outputs, channel by channel.

A channel is one output with one input. Each channel is tested alone. A joint test would have to try
all combinations of delays or orders. The number of combinations grows exponentially with the number
of channels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import wraps
from types import MappingProxyType
from typing import Any, Generic, ParamSpec, Protocol, TypeVar, cast

from armrig_core.errors import InputError

from armrig.data.dataset import Dataset, Signals

Name = tuple[str, str]
P = ParamSpec("P")


class Explained(Protocol):
    """Result with an explanation."""

    def explain(self) -> str:
        """Return the result and its reasons as text."""


R = TypeVar("R")
Result = TypeVar("Result", bound=Explained)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ByChannel(Generic[Result]):
    """Results of a test for each channel: `found["alpha", "u"]`."""

    results: Mapping[Name, Result]
    """Result for each output and input."""
    refused: Mapping[Name, str]
    """Reason why there is no result, for each channel without a result."""

    def __post_init__(self) -> None:
        """Make the mappings read-only."""
        for name in ("results", "refused"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def __getitem__(self, channel: Name) -> Result:
        """Return the result of one output and input.

        Raises
        ------
        ValueError
            There is no such channel, or the channel is in `refused`.
        """
        if channel in self.refused:
            raise InputError(f"{_arrow(channel)}: {self.refused[channel]}")
        if channel not in self.results:
            known = ", ".join(str(name) for name in (*self.results, *self.refused))
            raise InputError(f"{channel!r}: there is no such channel; there are {known}")
        return self.results[channel]

    def __iter__(self) -> Iterator[Name]:
        """Iterate over the channels with a result."""
        return iter(self.results)

    def __len__(self) -> int:
        """Return the number of channels with a result."""
        return len(self.results)

    def explain(self) -> str:
        """Return the explanation of each result."""
        texts = {name: f"\n{result.explain()}" for name, result in self.results.items()}
        return self._joined(texts)

    def __repr__(self) -> str:
        """Return the result of each channel."""
        return self._joined({name: f" {result!r}" for name, result in self.results.items()})

    def _joined(self, texts: Mapping[Name, str]) -> str:
        refused = {name: f" {text}" for name, text in self.refused.items()}
        return "\n".join(f"{_arrow(name)}:{text}" for name, text in {**texts, **refused}.items())


def _arrow(channel: Name) -> str:
    return f"{channel[1]} to {channel[0]}"


def channel_of(data: Signals, output: str, input: str) -> tuple[Dataset, dict[str, Any]]:
    """Return the data of a channel, in which the other inputs are part of the noise."""
    return data.dataset(output, input), {}


def each_channel(
    separated: Callable[[Signals, str, str], tuple[Dataset, dict[str, Any]]] = channel_of,
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a test of a Dataset so that it also tests each channel of `Signals`.

    For Signals with several channels, the result is `ByChannel`.

    Parameters
    ----------
    separated : callable, optional
        Function that returns the data of one channel, and options of the test for these data.
    """

    def decorate(f: Callable[P, R]) -> Callable[P, R]:
        @wraps(f)
        def testing(*args: Any, **options: Any) -> Any:
            call: Callable[..., Any] = f
            data = args[0] if args else options.get("data")
            if not isinstance(data, Signals) or (data.nu, data.ny) == (1, 1):
                return call(*args, **options)
            options.pop("data", None)
            results, refused = {}, {}
            for output in data.outputs:
                for input in data.inputs:
                    try:
                        channel, own = separated(data, output, input)
                        results[output, input] = call(channel, *args[1:], **options | own)
                    except InputError as err:
                        refused[output, input] = str(err)
            return ByChannel(results=results, refused=refused)

        return cast("Callable[P, R]", testing)

    return decorate
