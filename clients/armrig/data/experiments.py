"""Samples of one or several experiments, the common base of Dataset and Signals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from numbers import Integral
from typing import Any, Self, TypeVar

import numpy as np
from armrig_core.errors import InputError, InputTypeError

from armrig.data.step import Step, codes_of, in_merged, took
from armrig.numerics.checks import require_integers

Data = TypeVar("Data", bound="Experiments")

_MAX_LISTED_LENGTHS = 8  # of merged parts, in a history
_OWN = frozenset({"u", "y", "valid", "starts", "source", "history", "trends", "times"})
"""Fields that differ between the parts of merged data."""


class Experiments:
    """Samples of u and y from one or several experiments."""

    __slots__: tuple[str, ...] = ()

    Ts: Any
    u: Any
    y: Any
    valid: Any
    t: Any
    starts: tuple[int, ...]
    source: str
    history: tuple[str, ...]

    @property
    def N(self) -> int:
        """Number of instants, including instants with missing samples."""
        return int(self.u.shape[0])

    @property
    def missing(self) -> int:
        """Number of missing values of y."""
        return int(self.valid.size - np.count_nonzero(self.valid))

    def __len__(self) -> int:
        """Return the number of instants."""
        return self.N

    def __getitem__(self, part: slice) -> Self:
        """Return the samples of a slice; the starts of experiments inside the slice are kept."""
        if not isinstance(part, slice) or part.step not in (None, 1):
            raise InputTypeError(
                f"data are cut with data[a:b], got {part!r}; for a lower rate, resample; choose "
                "channels of Signals with signals.channels(outputs, inputs)"
            )
        if not all(x is None or isinstance(x, Integral) for x in (part.start, part.stop)):
            raise InputTypeError(
                f"data[{part.start}:{part.stop}] must have integers: sample numbers. The sample "
                "at t s has the number round(t / data.Ts)"
            )
        a, b, _ = part.indices(self.N)
        if b <= a:
            raise InputError(f"data[{part.start}:{part.stop}] is empty: there are {self.N} samples")
        if (a, b) == (0, self.N):
            return self  # the data are immutable
        begin, end = (
            self.t[[a, b - 1]] - self.t[0] if self.Ts is None else self.Ts * np.array([a, b])
        )
        return self.replaced(
            u=self.u[a:b],
            y=self.y[a:b],
            valid=self.valid[a:b],
            starts=(0, *(s - a for s in self.starts if a < s < b)),
            step=took(f"took samples {a} to {b - 1} of {self.N}", begin, end),
            **self._rest_between(a, b),
        )

    def _rest_between(self, a: int, b: int) -> dict[str, Any]:
        """Return the further fields of the samples a to b - 1."""
        raise NotImplementedError

    def split(self, k: int) -> tuple[Self, ...]:
        """Return k consecutive parts, whose lengths differ by at most one sample.

        Raises
        ------
        ValueError
            There are fewer samples than parts, or `k` is less than 1.

        Examples
        --------
        >>> import armrig
        >>> first, second = armrig.example_recording().dataset("alpha").split(2)
        >>> first.N, second.N
        (1500, 1500)
        >>> fit = armrig.oe(first, nb=3, nf=3)  # estimate from one half, validate with the other
        >>> print(armrig.compare(second, fit))
        simulation; initial state estimated from these data by least squares
          OE[3 3 1]  fit   97.5... %  rms 0.0035... rad
        """
        require_integers(k=(k, 1))
        if k > self.N:
            raise InputError(
                f"{self.N} samples cannot be split into {k} parts: 1 to {self.N} are possible"
            )
        edges = [round(i * self.N / k) for i in range(k + 1)]
        return tuple(self[a:b] for a, b in pairwise(edges))

    def experiments(self) -> Iterator[Self]:
        """Iterate over the experiments.

        Examples
        --------
        >>> import armrig
        >>> data = armrig.example_recording().dataset("alpha")
        >>> both = armrig.merge(data.split(2))
        >>> [experiment.N for experiment in both.experiments()]
        [1500, 1500]
        """
        for a, b in pairwise((*self.starts, self.N)):
            yield self[a:b]

    def replaced(self, *, step: str | None, **fields: Any) -> Self:
        """Return a copy with the given fields replaced, and with `step` added to its history.

        Examples
        --------
        >>> import armrig, numpy as np
        >>> data = armrig.example_recording().dataset("alpha")
        >>> degrees = data.replaced(step="converted y to degrees", y=np.rad2deg(data.y), unit="deg")
        >>> degrees
        <Dataset: 3000 samples at 0.01 s; output alpha [deg]; history: converted y to degrees>
        """
        values = {name: getattr(self, name) for name in self.__slots__} | fields
        t = values.pop("times", None)
        if step is not None:
            values["history"] = (*values["history"], step)
        return type(self)(**values | ({} if t is None else {"t": t, "Ts": None}))

    def _repr_html_(self) -> str:
        """Return text and figure as HTML for a notebook."""
        from armrig.plots.notebook import html

        shown: Any = self
        return html(shown)


def merged(parts: Sequence[Data], **fields: Any) -> Data:
    """Return several experiments as one object, with further fields; see `armrig.merge`."""
    first = parts[0]
    for name in first.__slots__:
        values = set() if name in _OWN else {getattr(d, name) for d in parts}
        if len(values) > 1:
            raise InputError(
                f"merge needs the same {name} in all data, got {sorted(values, key=str)}; apply "
                "the same treatment to all before merging"
            )
    offsets = np.cumsum([0, *(d.N for d in parts[:-1])])
    return first.replaced(
        step=None,
        u=np.concatenate([d.u for d in parts]),
        y=np.concatenate([d.y for d in parts]),
        valid=np.concatenate([d.valid for d in parts]),
        starts=tuple(int(o) + s for o, d in zip(offsets, parts, strict=True) for s in d.starts),
        source="+".join(dict.fromkeys(d.source for d in parts if d.source)),
        history=_joined_history(parts),
        **fields,
    )


def _joined_history(parts: Sequence[Experiments]) -> tuple[str, ...]:
    """Return the history of merged data: common steps, then steps of each part, then the merge."""
    if len(parts) == 1:
        return parts[0].history
    common: list[str] = []
    for steps in zip(*(d.history for d in parts), strict=False):
        if len(set(steps)) > 1:
            break
        common.append(steps[0])
    own = [
        Step(f"part {i}: {step}", in_merged(code))
        for i, d in enumerate(parts, 1)
        for step, code in list(zip(d.history, codes_of(d.history), strict=True))[len(common) :]
    ]
    lengths = ", ".join(str(d.N) for d in parts[:_MAX_LISTED_LENGTHS])
    lengths += ", …" if len(parts) > _MAX_LISTED_LENGTHS else ""
    return (*common, *own, f"merged {len(parts)} parts of {lengths} samples")
