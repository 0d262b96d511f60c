"""Tests of data with several inputs and outputs, channel by channel.

A joint test of all channels would have to try exponentially many combinations of delays or orders.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import wraps
from typing import Any, Generic, ParamSpec, TypeVar, cast

import numpy as np
from armrig_core.errors import InputError

from armrig.data.dataset import Dataset, Signals
from armrig.numerics.criteria import mdl
from armrig.numerics.regressors import arx_errors, best_arx

Name = tuple[str, str]
P = ParamSpec("P")

_ORDERS = (1, 2, 3, 4, 6, 8, 12, 16)  # of the ARX model of all inputs
_ROWS_PER_PARAMETER = 5


R = TypeVar("R")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ByChannel(Generic[R]):
    """Results of a test for each channel: `found["y", "u"]`."""

    results: Mapping[Name, Any]
    """Result for each output and input."""
    refused: Mapping[Name, str]
    """Reason why there is no result, for each channel without a result."""
    together: str = ""
    """Result for all channels as text."""

    def __getitem__(self, channel: Name) -> R:
        """Return the result of one output and input.

        Raises
        ------
        ValueError
            There is no such channel, or the channel is in `refused`.
        """
        if channel in self.refused:
            raise InputError(f"{_arrow(channel)}: {self.refused[channel]}")
        if channel not in self.results:
            names = ", ".join(str(name) for name in (*self.results, *self.refused))
            raise InputError(f"{channel!r}: there is no such channel; there are {names}")
        result: R = self.results[channel]
        return result

    def __iter__(self) -> Iterator[Name]:
        """Iterate over the channels with a result."""
        return iter(self.results)

    def __len__(self) -> int:
        """Return the number of channels with a result."""
        return len(self.results)

    def explain(self) -> str:
        """Return the explanation of each result."""
        return self._join({name: f"\n{result.explain()}" for name, result in self.results.items()})

    def __repr__(self) -> str:
        """Return the result of each channel."""
        return self._join({name: f" {result!r}" for name, result in self.results.items()})

    def _join(self, texts: Mapping[Name, str]) -> str:
        refused = {name: f" {text}" for name, text in self.refused.items()}
        lines = [f"{_arrow(name)}:{text}" for name, text in {**texts, **refused}.items()]
        return "\n".join([*lines, *filter(None, [self.together])])


def _arrow(channel: Name) -> str:
    return f"{channel[1]} to {channel[0]}"


def each_channel(
    separated: Callable[[Signals, str, str], tuple[Any, dict[str, Any]]] | None = None,
    together: Callable[[Mapping[Name, Any]], str] | None = None,
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a test of a Dataset so that it also tests each channel of `Signals`.

    For Signals with several channels, the result is `ByChannel`. `separated` returns the data of a
    channel, and options of the test; by default the other inputs are part of the noise. If each
    channel has a result, `together` returns the result for all channels as text. If all channels
    are refused for one reason, the error is raised.
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
                        alone = data.dataset(output, input), dict[str, Any]()
                        part, extra = separated(data, output, input) if separated else alone
                        results[output, input] = call(part, *args[1:], **options | extra)
                    except InputError as err:
                        refused[output, input] = str(err)
            if not results and len(reasons := {*refused.values()}) == 1:
                raise InputError(reasons.pop())  # such as an argument that is out of range
            text = together(results) if together and not refused else ""
            return ByChannel(results=results, refused=refused, together=text)

        return cast("Callable[P, R]", testing)

    return decorate


def without_other_inputs(data: Signals, output: str, input: str) -> tuple[Dataset, dict[str, Any]]:
    """Return one channel without the effects of the other inputs, and options of `delay`.

    With several inputs, A and all B_k of an ARX model of the output are estimated; MDL chooses the
    order of the model. The signal w contains no effects of the other inputs ::

        w = A y - sum of B_k u_k over k other than j = B_j u_j + e

    The first lag of B_j is the lag at which input j acts first. A contains the integrator of an
    output that integrates, so that w does not integrate.
    """
    channel = data.dataset(output, input)
    if data.nu == 1:
        return channel, {}
    j = data.inputs.index(input)
    y = data.y[:, data.output(output)]
    each = [(part.u, part.y[:, 0]) for part in data.channels([output]).experiments()]
    arx = best_arx(each, _ORDERS, mdl, _ROWS_PER_PARAMETER)
    if arx is None:
        raise InputError(f"too few samples of {output} for an ARX model of all inputs; record more")
    A, B = arx.polynomials(y)
    B[j] = 0.0
    w = np.concatenate([arx_errors(A, B, *part) for part in each])
    # Not the output's own name, which can imply an integrator or a smooth onset.
    alone = channel.replaced(
        step=None, y=np.nan_to_num(w), valid=np.isfinite(w), output=f"filtered {output}"
    )
    return alone, {"integrator": False}
