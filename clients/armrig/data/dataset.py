"""Data for identification: input, output, sampling time, and missing samples."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from armrig_core.calls import checked_call
from armrig_core.errors import InputError, InputTypeError
from numpy.typing import ArrayLike, NDArray

from armrig.data.experiments import Experiments, merged
from armrig.data.pandas_columns import plain, present
from armrig.data.trend import Trend
from armrig.numerics.checks import column
from armrig.numerics.stretches import Mask

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]

_MAX_SIZE = 1e30  # products of fourth powers of data must be finite
_MIN_SIZE = 1e-30  # powers of much smaller numbers underflow to 0


@dataclass(frozen=True, slots=True, kw_only=True, init=False, eq=False, repr=False)
class Dataset(Experiments):
    """N equidistant samples of u and y, from one or several experiments.

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

    u: Vector
    """Input (N,), in `input_unit`."""
    y: Vector
    """Output (N,), in `unit`; NaN where it is missing."""
    Ts: float
    """Sampling time, in s."""
    valid: Mask
    """Mask (N,), False where y is missing."""
    starts: tuple[int, ...]
    """Index of the first sample of each experiment."""
    output: str
    """Name of y."""
    unit: str
    """Unit of y."""
    input_unit: str
    """Unit of u."""
    source: str
    """Hash of the recording or data file; "" for data without a file."""
    history: tuple[str, ...]
    """Steps of the treatment, first to last, one sentence for each."""
    trends: tuple[Trend, ...]
    """Trend removed from each experiment; () without a trend, or if no trend can be restored."""

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
        u, y, valid = plain("u", u), plain("y", y), present(y, valid)
        u_, y_ = column("u", u), column("y", y)
        N = u_.size
        if y_.size != N:
            raise InputError(
                f"u has {N} samples and y has {y_.size}; both need one value for each instant"
            )
        valid_ = np.ones(N, dtype=np.bool_) if valid is None else _mask(valid)
        if valid_.shape != (N,):
            raise InputError(
                f"valid has shape {valid_.shape}, u and y have ({N},); give one bool per sample"
            )
        valid_ &= ~np.ma.getmaskarray(np.ma.asanyarray(y))
        require_finite("u", u_, "a model needs the input at each instant: cut these samples out")
        require_finite("y", y_, "mark them missing, valid=numpy.isfinite(y)", where=valid_)
        for name, x in (("u", u_), ("y", y_[valid_])):
            require_size(name, x)
        _require_one_number(Ts)
        if not (isfinite(Ts) and Ts > 0):
            raise InputError(f"Ts={Ts!r} must be finite and > 0, in s")
        starts_ = starts_of(starts, N)
        if len(trends) not in (0, len(starts_)):
            raise InputError(
                f"{len(trends)} trends for {len(starts_)} experiments; give one for each, or none"
            )
        y_[~valid_] = np.nan
        for array in (u_, y_, valid_):
            array.flags.writeable = False
        values = {
            "u": u_,
            "y": y_,
            "Ts": float(Ts),
            "valid": valid_,
            "starts": starts_,
            "output": output,
            "unit": unit,
            "input_unit": input_unit,
            "source": source,
            "history": tuple(history),
            "trends": tuple(trends),
        }
        for name, value in values.items():
            object.__setattr__(
                self, name, value
            )  # the only way to set a field of a frozen dataclass

    @property
    def t(self) -> Vector:
        """Time (N,) in s from the first sample, as if the experiments were consecutive."""
        return self.Ts * np.arange(self.N, dtype=np.float64)

    @property
    def digest(self) -> str:
        """Hash of u, y, valid, Ts and starts, to distinguish estimation and validation data."""
        arrays = (self.u, self.y, self.valid, np.array([self.Ts]), np.array(self.starts))
        return hashlib.blake2b(b"".join(x.tobytes() for x in arrays), digest_size=8).hexdigest()

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

    def plot(
        self, kind: Literal["time", "spectrum", "values"] = "time", *, ax: Axes | None = None
    ) -> Figure:
        """Return a figure of output and input.

        Parameters
        ----------
        kind : {"time", "spectrum", "values"}
            Plot the signals against time, their power spectra, or histograms of their values: see
            `plot_data`, `plot_spectrum` and `plot_values` of `armrig.plots`.

        Examples
        --------
        >>> import armrig
        >>> data = armrig.example_recording().dataset("alpha")
        >>> data.plot()
        <Figure size ... with 2 Axes>
        >>> data.plot("spectrum").savefig("spectrum.png")
        """
        from armrig.data.figures import plot_data, plot_spectrum, plot_values
        from armrig.plots.layout import figure_of

        kinds = {"time": plot_data, "spectrum": plot_spectrum, "values": plot_values}
        if kind not in kinds:
            raise InputError(f"kind={kind!r} must be one of {', '.join(kinds)}")
        return figure_of(kinds[kind](self, ax=ax))

    def _rest_between(self, a: int, b: int) -> dict[str, Any]:
        ends = (*self.starts[1:], self.N)
        trends = (
            trend.later(max(a - start, 0) * self.Ts)
            for trend, start, end in zip(self.trends, self.starts, ends, strict=False)
            if end > a and start < b
        )
        return {"trends": tuple(trends)}

    def select(self, *which: int) -> Dataset:
        """Return the experiments with the given numbers, counted from 0, in the given order.

        Raises
        ------
        ValueError
            An experiment does not exist, or no number is given.

        Examples
        --------
        >>> import armrig
        >>> thirds = armrig.merge(armrig.example_recording().dataset("alpha").split(3))
        >>> thirds.select(0, 2)  # without the second third
        <Dataset: 2000 samples at 0.01 s; output alpha [rad]; 2 experiments; ...>
        """
        parts = list(self.experiments())
        if not which or not all(0 <= i < len(parts) for i in which):
            raise InputError(
                f"select{which} needs numbers from 0 to {len(parts) - 1}: there are "
                f"{len(parts)} experiments"
            )
        chosen = [parts[i].replaced(step=None, history=self.history) for i in which]
        step = f"selected experiments {', '.join(map(str, which))} of {len(parts)}"
        return merged_datasets(chosen).replaced(step=step, history=self.history)

    def __repr__(self) -> str:
        """Describe the data in one line."""
        unit = f" [{self.unit}]" if self.unit else ""
        parts = [f"{self.N} samples at {self.Ts:g} s", f"output {self.output}{unit}"]
        if self.missing:
            parts.append(f"{self.missing} missing ({100 * self.missing / self.N:.1f} %)")
        if len(self.starts) > 1:
            parts.append(f"{len(self.starts)} experiments")
        if self.history:
            parts.append(f"history: {'; '.join(self.history)}")
        return f"<Dataset: {'; '.join(parts)}>"


def merged_datasets(parts: Sequence[Dataset]) -> Dataset:
    """Return several experiments as one Dataset; `armrig.merge` documents it."""
    trends: list[Trend] = []
    if any(d.trends for d in parts):
        for d in parts:
            trends += d.trends or [Trend() for _ in d.starts]
    return merged(parts, trends=tuple(trends))


def starts_of(starts: Sequence[int], N: int) -> tuple[int, ...]:
    """Return the indices of the first samples of the experiments; refuse indices out of order."""
    starts_ = tuple(int(s) for s in starts)
    if starts_[:1] != (0,) or not all(a < b for a, b in pairwise((*starts_, N))):
        raise InputError(f"starts={starts_} must begin with 0 and rise strictly, below N={N}")
    return starts_


def _require_one_number(Ts: Any) -> None:
    if Ts is None or isinstance(Ts, str) or np.ndim(Ts):
        raise InputTypeError(
            f"Ts is a {type(Ts).__name__}; give one number, in seconds, such as Ts=0.01"
        )


def _mask(valid: ArrayLike) -> Mask:
    """Return a copy of a validity mask; a masked entry becomes False."""
    return np.array(np.ma.filled(np.ma.asanyarray(valid), False), dtype=np.bool_)


def require_size(name: str, x: Vector) -> None:
    """Refuse numbers so large that their powers overflow in floating point."""
    largest = float(np.max(np.abs(x), initial=0.0))
    if largest > _MAX_SIZE:
        raise InputError(
            f"the largest |{name}| is {largest:.3g}; use a unit in which it is below {_MAX_SIZE:g}"
        )


def require_visible(data: Dataset) -> None:
    """Refuse a signal so small that powers of its values can underflow; allow a signal of zeros.

    The constructor of Dataset does not make this check, because a slice of valid data can consist
    of a decayed response only.
    """
    for name, x in (("u", data.u), ("y", data.y[data.valid])):
        largest = float(np.max(np.abs(x), initial=0.0))
        if 0 < largest < _MIN_SIZE:
            raise InputError(
                f"the largest |{name}| is {largest:.3g}; use a unit in which it is from "
                f"{_MIN_SIZE:g} to {_MAX_SIZE:g}"
            )


def require_finite(name: str, x: Vector, way_out: str, where: Mask | None = None) -> None:
    """Refuse values that are not finite, among those marked True in `where`."""
    bad = ~np.isfinite(x) if where is None else ~np.isfinite(x) & where
    if bad.any():
        first = int(np.argmax(bad))
        raise InputError(
            f"{name} is not finite at {bad.sum()} samples, first {x[first]} at {first}; {way_out}"
        )
