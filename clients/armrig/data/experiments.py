"""Samples of one or several experiments, the common base of Signals and Dataset, and trends."""

from __future__ import annotations

import hashlib
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from numbers import Integral
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar

import numpy as np
from armrig_core.errors import InputError, InputTypeError

from armrig.data.columns import Vector
from armrig.data.step import took
from armrig.numerics.checks import require_integers
from armrig.numerics.quantities import plural
from armrig.plots.layout import figure_of, html

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from armrig.data.dataset import Signals

Levels = float | Vector
"""One number, or an array with a number for each column."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trend:
    """Level and slope of u and of y; a slope is 0 if only the mean was removed.

    In the trends of a Dataset the fields are numbers. In the trends of Signals they are arrays with
    a number for each column of u and of y.
    """

    u_level: Levels = 0.0
    """Value of u's line at the experiment's first sample, in u's unit."""
    u_slope: Levels = 0.0
    """Slope of u, in u's unit per s."""
    y_level: Levels = 0.0
    """Value of y's line at the experiment's first sample, in y's unit."""
    y_slope: Levels = 0.0
    """Slope of y, in y's unit per s."""

    def u(self, t: Vector) -> Vector:
        """Return the lines of u at times t (n,), in s from the experiment's first sample."""
        return np.asarray(self.u_level + np.multiply.outer(t, self.u_slope))

    def y(self, t: Vector) -> Vector:
        """Return the lines of y at times t (n,), in s from the experiment's first sample."""
        return np.asarray(self.y_level + np.multiply.outer(t, self.y_slope))

    def later(self, seconds: float) -> Trend:
        """Return the same lines for data that begin `seconds` later; only the levels change."""
        return replace(
            self,
            u_level=self.u_level + self.u_slope * seconds,
            y_level=self.y_level + self.y_slope * seconds,
        )

    def each(self, of_u: Callable[[Any], Any], of_y: Callable[[Any], Any]) -> Trend:
        """Return the results of `of_u` for the fields of u, and of `of_y` for the fields of y."""
        functions = {"u": of_u, "y": of_y}
        return Trend(**{f.name: functions[f.name[0]](getattr(self, f.name)) for f in _FIELDS})

    def __add__(self, other: Trend) -> Trend:
        """Return the sum of two trends that were removed one after the other."""
        return Trend(**{f.name: getattr(self, f.name) + getattr(other, f.name) for f in _FIELDS})

    def __eq__(self, other: object) -> bool:
        """Return whether all levels and slopes are equal."""
        return isinstance(other, Trend) and all(
            np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in _FIELDS
        )


_FIELDS = fields(Trend)


T = TypeVar("T", bound="Experiments")


class Experiments:
    """Samples of inputs and outputs from one or several experiments."""

    __slots__: tuple[str, ...] = ()

    def signals(self) -> Signals:
        """Return the data with a column for each channel."""
        raise NotImplementedError

    def _like(self, signals: Signals) -> Self:
        """Return Signals as an object of this class."""
        raise NotImplementedError

    def _values(self) -> dict[str, Any]:
        """Return the arguments with which the constructor makes the same data."""
        raise NotImplementedError

    @property
    def N(self) -> int:
        """Number of instants, including instants with missing samples."""
        return int(self.signals().u.shape[0])

    @property
    def missing(self) -> int:
        """Number of missing values of y."""
        valid = self.signals().valid
        return int(valid.size - np.count_nonzero(valid))

    @property
    def t(self) -> Vector:
        """Time (N,) in s from 0 on, as if the experiments were consecutive."""
        return self.signals().Ts * np.arange(self.N, dtype=np.float64)

    @property
    def digest(self) -> str:
        """Hash of u, y, valid, the times and the starts.

        It distinguishes estimation and validation data.
        """
        data = self.signals()
        # Saved models contain the hash. Data of one channel hash Ts, all others the times.
        of_one = data.u.shape[1] == data.y.shape[1] == 1
        times = np.array([data.Ts]) if of_one else data.t
        arrays = (data.u, data.y, data.valid, times, np.array(data.starts))
        return hashlib.blake2b(b"".join(x.tobytes() for x in arrays), digest_size=8).hexdigest()

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
            raise InputError(
                f"data[{part.start}:{part.stop}] is empty: the data have {plural(self.N, 'sample')}"
            )
        if (a, b) == (0, self.N):
            return self  # the data are immutable
        data = self.signals()
        which = range(bisect_right(data.starts, a) - 1, bisect_left(data.starts, b))
        firsts = [max(a, data.starts[k]) for k in which]
        starts = tuple(first - a for first in firsts)
        step = took(f"took samples {a} to {b - 1} of {self.N}", data.Ts * a, data.Ts * b)
        return self._like(
            replace_unchecked(
                data,
                u=data.u[a:b],
                y=data.y[a:b],
                valid=data.valid[a:b],
                r=None if data.r is None else data.r[a:b],
                starts=starts,
                trends=tuple(
                    data.trends[k].later(data.Ts * (first - data.starts[k]))
                    for k, first in zip(which, firsts, strict=True)
                    if data.trends
                ),
                history=(*data.history, step),
            )
        )

    def split(self, k: int) -> tuple[Self, ...]:
        """Return k consecutive parts, whose lengths differ by at most one sample.

        Raises
        ------
        ValueError
            There are fewer samples than parts, or `k` is less than 1.

        Examples
        --------
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
                f"{plural(self.N, 'sample')} cannot be split into {plural(k, 'part')}: 1 to "
                f"{self.N} are possible"
            )
        edges = [round(i * self.N / k) for i in range(k + 1)]
        return tuple(self[a:b] for a, b in pairwise(edges))

    def experiments(self) -> Iterator[Self]:
        """Iterate over the experiments.

        Examples
        --------
        >>> data = armrig.example_recording().dataset("alpha")
        >>> both = armrig.merge(data.split(2))
        >>> [experiment.N for experiment in both.experiments()]
        [1500, 1500]
        """
        for a, b in pairwise((*self.signals().starts, self.N)):
            yield self[a:b]

    def select(self, *which: int) -> Self:
        """Return the experiments with the given numbers, counted from 0, in the given order.

        Raises
        ------
        ValueError
            An experiment does not exist, or no number is given.

        Examples
        --------
        >>> thirds = armrig.merge(armrig.example_recording().dataset("alpha").split(3))
        >>> thirds.select(0, 2)  # without the second third
        <Dataset: 2000 samples at 0.01 s; output alpha [rad]; 2 experiments; ...>
        """
        data = self.signals()
        count = len(data.starts)
        if not which or not all(0 <= i < count for i in which):
            raise InputError(
                f"select{which} needs numbers from 0 to {count - 1}: the data have "
                f"{plural(count, 'experiment')}"
            )
        edges = (*data.starts, self.N)
        parts = [np.arange(edges[i], edges[i + 1]) for i in which]
        rows = np.concatenate(parts)
        step = f"selected experiments {', '.join(map(str, which))} of {count}"
        return self._like(
            data.replaced(
                step=step,
                u=data.u[rows],
                y=data.y[rows],
                valid=data.valid[rows],
                r=None if data.r is None else data.r[rows],
                starts=np.cumsum([0, *(part.size for part in parts[:-1])]).tolist(),
                trends=[data.trends[i] for i in which if data.trends],
            )
        )

    def replaced(self, *, step: str | None, **fields: Any) -> Self:
        """Return a copy with the given fields replaced, and with `step` added to its history.

        Examples
        --------
        >>> import numpy as np
        >>> data = armrig.example_recording().dataset("alpha")
        >>> degrees = data.replaced(step="converted y to degrees", y=np.rad2deg(data.y), unit="deg")
        >>> degrees
        <Dataset: 3000 samples at 0.01 s; output alpha [deg]; history: converted y to degrees>
        """
        values = self._values() | fields
        if step is not None:
            values["history"] = (*values["history"], step)
        return type(self)(**values)

    def plot(
        self, kind: Literal["time", "spectrum", "values"] = "time", *, ax: Axes | None = None
    ) -> Figure:
        """Return a figure of outputs and inputs.

        Parameters
        ----------
        kind : {"time", "spectrum", "values"}
            Plot the signals against time, their power spectra, or histograms of their values: see
            `plot_data`, `plot_spectrum` and `plot_values` of `armrig.plots`.

        Examples
        --------
        >>> data = armrig.example_recording().dataset("alpha")
        >>> data.plot()
        <Figure size ... with 2 Axes>
        >>> data.plot("spectrum").savefig("spectrum.png")
        """
        from armrig.data.figures import plot_data, plot_spectrum, plot_values

        kinds = {"time": plot_data, "spectrum": plot_spectrum, "values": plot_values}
        if kind not in kinds:
            raise InputError(f"kind={kind!r} must be one of {', '.join(kinds)}")
        return figure_of(kinds[kind](self.signals(), ax=ax))

    _repr_html_ = html

    def _description(self, channels: str, missing: str) -> str:
        """Return one line with the names of the channels, and with the word for missing values."""
        data = self.signals()
        parts = [f"{plural(self.N, 'sample')} at {data.Ts:g} s", channels]
        if self.missing:
            share = 100 * self.missing / data.y.size
            parts.append(f"{self.missing} {missing} ({share:.1f} %)")
        if len(data.starts) > 1:
            parts.append(f"{plural(len(data.starts), 'experiment')}")
        if data.history:
            parts.append(f"history: {'; '.join(data.history)}")
        return f"<{type(self).__name__}: {'; '.join(parts)}>"


def replace_unchecked(value: T, **fields: Any) -> T:
    """Return a copy with the given fields replaced; the fields are valid and not checked again."""
    copy = object.__new__(type(value))
    for name in value.__slots__:
        object.__setattr__(copy, name, fields.get(name, getattr(value, name)))
    return copy
