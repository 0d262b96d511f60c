"""Tests of feedback and of the delay, channel by channel.

A channel is one output with one input. Each channel is tested alone. A joint test would have to try
all combinations of delays. The number of combinations grows exponentially with the number of
channels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Generic, TypeVar

import numpy as np
from armrig_core.errors import InputError

from armrig.data.dataset import Dataset
from armrig.data.signals import Signals
from armrig.numerics.criteria import mdl
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array
from armrig.numerics.regressors import complete, past
from armrig.validation.feedback_and_delay.delay import delay as delay_of_one
from armrig.validation.feedback_and_delay.delay_result import Delay
from armrig.validation.feedback_and_delay.open_loop import OpenLoop
from armrig.validation.feedback_and_delay.open_loop import open_loop as open_loop_of_one

Result = TypeVar("Result")
Name = tuple[str, str]

_ORDERS = (1, 2, 3, 4, 6, 8, 12, 16)
_ROWS_PER_PARAMETER = 5


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

    def __repr__(self) -> str:
        """Return the result of each channel."""
        texts = {name: repr(result) for name, result in self.results.items()} | dict(self.refused)
        return "\n".join(f"{_arrow(name)}: {text}" for name, text in texts.items())


def _arrow(channel: Name) -> str:
    return f"{channel[1]} to {channel[0]}"


def delay(data: Signals, *, integrator: bool | None = None) -> ByChannel[Delay]:
    """Find the delay of each channel, one channel at a time.

    With several inputs, A and all B_k of an ARX model of the output are estimated; MDL chooses the
    order of the model. The test is then applied to the signal w, which contains no effects of the
    other inputs ::

        w = A y - sum of B_k u_k over k other than j = B_j u_j + e

    The first lag of B_j is the lag at which input j acts first.

    Parameters
    ----------
    data : Signals
        N samples of nu inputs and ny outputs.
    integrator : bool, optional
        True if the outputs integrate. With several inputs this argument has no effect, because A
        contains the integrator.

    Returns
    -------
    ByChannel
        `Delay` of each output and input. For a channel without a visible response, `refused`
        contains the reason.
    """

    def of(channel: Dataset) -> Delay:
        return delay_of_one(channel, integrator=integrator if data.nu == 1 else False)

    return _each(data, lambda output, input: of(_alone(data, output, input)))


def open_loop(data: Signals, level: float = 0.05) -> ByChannel[OpenLoop]:
    """Test for feedback from each output to each input, one channel at a time.

    Each channel is tested like data of one output and one input. In open loop, some tests find
    feedback by chance: one of twenty tests at the level 0.05.

    Parameters
    ----------
    data : Signals
        N samples of nu inputs and ny outputs.
    level : float, default 0.05
        Level of each test, between 0 and 1.

    Returns
    -------
    ByChannel
        `OpenLoop` of each output and input.
    """
    return _each(data, lambda output, input: open_loop_of_one(data.dataset(output, input), level))


def _each(data: Signals, test: Callable[[str, str], Result]) -> ByChannel[Result]:
    results: dict[Name, Result] = {}
    refused: dict[Name, str] = {}
    for output in data.outputs:
        for input in data.inputs:
            try:
                results[output, input] = test(output, input)
            except InputError as err:
                refused[output, input] = str(err)
    return ByChannel(results=results, refused=refused)


def _alone(data: Signals, output: str, input: str) -> Dataset:
    """Return one channel without the effects of the other inputs."""
    own = data.dataset(output, input)
    if data.nu == 1:
        return own
    j = data.inputs.index(input)
    parts = list(data.channels([output]).experiments())
    blocks = _best_blocks(parts, output)
    rows = [complete(block) for block in blocks]
    n = (blocks[0].shape[1] - 1 - data.nu) // (1 + data.nu)
    whole = np.vstack([block[known] for block, known in zip(blocks, rows, strict=True)])
    theta = orthonormal(whole[:, :-1]).coefficients(whole[:, -1])
    kept = slice(n + j * (n + 1), n + (j + 1) * (n + 1))
    theta[kept] = 0.0
    w = np.concatenate([block[:, -1] - block[:, :-1] @ theta for block in blocks])
    return own.replaced(step=None, y=np.nan_to_num(w), valid=np.isfinite(w), output="", unit="")


def _best_blocks(parts: list[Signals], output: str) -> list[Array]:
    """Return the rows [-y lags, u_1 lags, …, y] of each experiment, for the order n with least MDL.

    The rows of an experiment have the shape (N, n + nu (n + 1) + 1).
    """
    best: tuple[float, list[Array]] | None = None
    for n in _ORDERS:
        blocks = [_block(part, n) for part in parts]
        whole = np.vstack([block[complete(block)] for block in blocks])
        d = whole.shape[1] - 1
        if whole.shape[0] < _ROWS_PER_PARAMETER * d:
            break
        e = orthonormal(whole[:, :-1]).without(whole[:, -1])
        score = float(mdl(float(np.mean(e**2)), d, whole.shape[0]))
        if best is None or score < best[0]:
            best = (score, blocks)
    if best is None:
        raise InputError(f"too few samples of {output} for an ARX model of all inputs; record more")
    return best[1]


def _block(part: Signals, n: int) -> Array:
    y = np.where(part.valid[:, 0], part.y[:, 0], np.nan)
    inputs = [past(u, range(n + 1)) for u in part.u.T]
    return np.hstack([-past(y, range(1, n + 1)), *inputs, y[:, None]])
