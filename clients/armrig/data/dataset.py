"""Data of one input and one output: the view of one column of u and of y."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from armrig_core.calls import checked_call
from numpy.typing import ArrayLike, NDArray

from armrig.data.columns import interval, is_pandas, plain, require_finite, validity
from armrig.data.experiments import Experiments
from armrig.data.signals import Signals
from armrig.data.trend import Trend
from armrig.numerics.checks import column
from armrig.numerics.stretches import Mask

Vector = NDArray[np.float64]


class Dataset(Experiments):
    """N equidistant samples of u and y, from one or several experiments.

    A Dataset is a view of `Signals` with one input and one output, in which u and y have one
    dimension. `signals()` returns these Signals, and `Signals.dataset` returns the view.

    Parameters
    ----------
    u, y : array_like, shape (N,)
        Input and output. The input is held from each instant to the next (zero-order hold). If y is
        a masked array, its masked samples are missing; u must not be masked.
    Ts : float
        Sampling time in s.
    valid : array_like of bool, shape (N,), optional
        False where y is missing. At these samples `y` is NaN, and every sample computed from one of
        them is NaN. A missing value of a pandas column is also missing in the Dataset.
    starts : sequence of int, default (0,)
        Index of the first sample of each experiment. Estimators never combine samples of two
        experiments in an equation.
    output, unit, input_unit : str
        Name of y, its unit, and the unit of u.
    source : str
        Hash of the recording or data file; "" for data without a file.
    history : sequence of str
        Steps of the treatment so far, one sentence for each.
    trends : sequence of Trend, default ()
        Means and lines that `detrend` removed from each experiment; `retrend` restores them.

    Raises
    ------
    ValueError
        The lengths differ, u or y is complex, u is masked or not finite, a valid y is not finite,
        or Ts is not > 0.

    Examples
    --------
    >>> import armrig, numpy as np
    >>> data = armrig.Dataset(u=[1, 1, 4, 4], y=[0.1, 0.1, 0.2, np.nan], Ts=0.01,
    ...                       valid=[True, True, True, False], output="alpha", unit="rad")
    >>> data
    <Dataset: 4 samples at 0.01 s; output alpha [rad]; 1 missing (25.0 %)>
    """

    __slots__ = ("_columns",)
    _columns: Signals

    @checked_call
    def __init__(
        self,
        *,
        u: ArrayLike,
        y: ArrayLike,
        Ts: float,
        valid: ArrayLike | None = None,
        starts: Sequence[int] = (0,),
        output: str = "y",
        unit: str = "",
        input_unit: str = "V",
        source: str = "",
        history: Sequence[str] = (),
        trends: Sequence[Trend] = (),
    ) -> None:
        given: Any = y
        there = given.notna() if is_pandas(given) else None
        y = plain("y", y)
        u_, y_ = column("u", plain("u", u)), column("y", y)
        valid_ = validity(valid, y_.shape) & validity(there, y_.shape)
        valid_ &= ~np.ma.getmaskarray(np.ma.asanyarray(y))
        require_finite("y", y_, "mark them missing, valid=numpy.isfinite(y)", where=valid_)
        self._columns = Signals(
            u=u_,
            y=y_,
            Ts=interval(Ts),
            valid=valid_,
            starts=starts,
            outputs=[output],
            units=[unit],
            input_units=[input_unit],
            source=source,
            history=history,
            trends=trends,
        )

    def signals(self) -> Signals:
        """Return the data as Signals with one input, u, and one output; the arrays are shared.

        Examples
        --------
        >>> import armrig
        >>> armrig.example_recording().dataset("alpha").signals()
        <Signals: 3000 samples at 0.01 s; outputs alpha [rad]; inputs u [V]>
        """
        return self._columns

    def _like(self, signals: Signals) -> Dataset:
        return view(signals)

    def _values(self) -> dict[str, Any]:
        names = ("u", "y", "Ts", "valid", "starts", "output", "unit", "input_unit")
        return {name: getattr(self, name) for name in (*names, "source", "history", "trends")}

    @property
    def u(self) -> Vector:
        """Input (N,), in `input_unit`."""
        return self._columns.u[:, 0]

    @property
    def y(self) -> Vector:
        """Output (N,), in `unit`; NaN where it is missing."""
        return self._columns.y[:, 0]

    @property
    def valid(self) -> Mask:
        """Mask (N,), False where y is missing."""
        return self._columns.valid[:, 0]

    @property
    def Ts(self) -> float:
        """Sampling time, in s."""
        return self._columns.equidistant()

    @property
    def starts(self) -> tuple[int, ...]:
        """Index of the first sample of each experiment."""
        return self._columns.starts

    @property
    def output(self) -> str:
        """Name of y."""
        return self._columns.outputs[0]

    @property
    def unit(self) -> str:
        """Unit of y."""
        return self._columns.units[0]

    @property
    def input_unit(self) -> str:
        """Unit of u."""
        return self._columns.input_units[0]

    @property
    def source(self) -> str:
        """Hash of the recording or data file; "" for data without a file."""
        return self._columns.source

    @property
    def history(self) -> tuple[str, ...]:
        """Steps of the treatment, first to last, one sentence for each."""
        return self._columns.history

    @property
    def trends(self) -> tuple[Trend, ...]:
        """Trend removed from each experiment; () if there is no trend that can be restored."""
        number = np.ndarray.item
        return tuple(trend.each(number, number) for trend in self._columns.trends)

    def origin(self) -> dict[str, Any]:
        """Return the facts about the data that a `Fit` stores, such as units and history.

        Examples
        --------
        >>> import armrig
        >>> origin = armrig.example_recording().dataset("alpha").origin()
        >>> origin["output"], origin["unit"], origin["input_unit"]
        ('alpha', 'rad', 'V')
        """
        names = ("output", "unit", "input_unit", "source", "history", "digest")
        return {name: getattr(self, name) for name in names}

    def __repr__(self) -> str:
        """Describe the data in one line."""
        unit = f" [{self.unit}]" if self.unit else ""
        return self._described(f"output {self.output}{unit}", "missing")


def view(signals: Signals) -> Dataset:
    """Return the view of equidistant Signals with one input and one output."""
    data = object.__new__(Dataset)
    object.__setattr__(data, "_columns", signals)
    return data
