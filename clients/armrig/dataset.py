"""Data to identify from: input, output, sampling time, and what is missing."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armrig.checks import column

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True, init=False, eq=False, repr=False)
class Dataset:
    """N equidistant samples of u and y, from one experiment or several.

    Parameters
    ----------
    u, y : array_like, shape (N,)
        Input, held from each instant to the next (zero-order hold), and output.
    Ts : float
        Sampling time in s.
    valid : array_like of bool, shape (N,), optional
        False where y is missing; there `y` reads NaN, so that no formula can use it unseen.
    starts : sequence of int, default (0,)
        Index of the first sample of each experiment; nothing is known across a boundary.
    output, unit, input_unit : str
        Name of y, its unit, and the unit of u.
    source : str
        Hash of the recording, "" where there is none.
    history : sequence of str
        The treatment so far, one step an entry.

    Raises
    ------
    ValueError
        The lengths differ, u is not finite, y is not finite where it is valid, or Ts is not > 0.
    """

    u: Vector
    """Input (N,), in `input_unit`."""
    y: Vector
    """Output (N,), in `unit`; NaN where it is missing."""
    Ts: float
    """Sampling time, in s."""
    valid: Mask
    """(N,), False where y is missing."""
    starts: tuple[int, ...]
    """First sample of each experiment."""
    output: str
    """Name of y."""
    unit: str
    """Unit of y."""
    input_unit: str
    """Unit of u."""
    source: str
    """Hash of the recording, or ""."""
    history: tuple[str, ...]
    """Steps of treatment, first to last."""

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
    ) -> None:
        u_, y_ = column("u", u), column("y", y)
        N = u_.size
        if y_.size != N:
            msg = f"u has {N} samples and y has {y_.size}; both need one value for each instant"
            raise ValueError(msg)
        valid_ = np.ones(N, dtype=np.bool_) if valid is None else np.array(valid, dtype=np.bool_)
        if valid_.shape != (N,):
            msg = f"valid has shape {valid_.shape}, u and y have ({N},); give one bool a sample"
            raise ValueError(msg)
        _require_finite("u", u_, "an input that was not applied cannot be identified from: cut it")
        _require_finite("y", y_, "mark them missing with valid=False", where=valid_)
        if not (isfinite(Ts) and Ts > 0):
            msg = f"Ts={Ts!r} must be finite and > 0, in s"
            raise ValueError(msg)
        starts_ = tuple(int(s) for s in starts)
        ordered = all(a < b for a, b in zip(starts_, (*starts_[1:], N), strict=True))
        if not starts_ or starts_[0] != 0 or not ordered:
            msg = f"starts={starts_} must begin with 0 and rise strictly, below N={N}"
            raise ValueError(msg)
        y_[~valid_] = np.nan
        for array in (u_, y_, valid_):
            array.flags.writeable = False
        values = (u_, y_, float(Ts), valid_, starts_, output, unit, input_unit, source)
        for name, value in zip(self.__slots__, (*values, tuple(history)), strict=True):
            object.__setattr__(self, name, value)

    @property
    def N(self) -> int:
        """Number of instants, missing ones included."""
        return int(self.u.size)

    @property
    def t(self) -> Vector:
        """Time (N,) in s from the first sample, as if experiments followed each other."""
        return self.Ts * np.arange(self.N, dtype=np.float64)

    @property
    def missing(self) -> int:
        """Number of samples without y."""
        return int(self.N - np.count_nonzero(self.valid))

    @property
    def digest(self) -> str:
        """Fingerprint of the numbers, to tell estimation data from validation data."""
        parts = (self.u, self.y, self.valid, np.array([self.Ts]), np.array(self.starts))
        return hashlib.blake2b(b"".join(p.tobytes() for p in parts), digest_size=8).hexdigest()

    def origin(self) -> dict[str, Any]:
        """Return what a model from these data says of them, as the fields of a `Fit`."""
        names = ("output", "unit", "input_unit", "source", "history", "digest")
        return {name: getattr(self, name) for name in names}

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Show output and input against time: see `armrig.plots.plot_data`."""
        from armrig.plots.data import plot_data

        return plot_data(self, ax=ax)

    def __len__(self) -> int:
        """Return the number of instants."""
        return self.N

    def __getitem__(self, part: slice) -> Dataset:
        """Return the samples of a slice; boundaries inside it stay boundaries."""
        if not isinstance(part, slice) or part.step not in (None, 1):
            msg = f"a Dataset is cut with data[a:b], got {part!r}; to thin it out, resample first"
            raise TypeError(msg)
        a, b, _ = part.indices(self.N)
        if b <= a:
            msg = f"data[{part.start}:{part.stop}] is empty: there are {self.N} samples"
            raise ValueError(msg)
        whole = (a, b) == (0, self.N)
        return self.replaced(
            u=self.u[a:b],
            y=self.y[a:b],
            valid=self.valid[a:b],
            starts=(0, *(s - a for s in self.starts if a < s < b)),
            step=None if whole else f"samples {a}:{b}",
        )

    def split(self, k: int) -> tuple[Dataset, ...]:
        """Return k parts that follow each other, whose lengths differ by one sample at most."""
        if not 1 <= k <= self.N:
            msg = f"split({k}) needs 1 <= k <= N={self.N}"
            raise ValueError(msg)
        edges = [round(i * self.N / k) for i in range(k + 1)]
        return tuple(self[a:b] for a, b in pairwise(edges))

    def experiments(self) -> Iterator[Dataset]:
        """Iterate over the experiments, each a Dataset of its own."""
        for a, b in zip(self.starts, (*self.starts[1:], self.N), strict=True):
            yield self[a:b]

    def replaced(
        self,
        *,
        step: str | None,
        u: Vector | None = None,
        y: Vector | None = None,
        valid: Mask | None = None,
        starts: tuple[int, ...] | None = None,
        output: str | None = None,
        unit: str | None = None,
    ) -> Dataset:
        """Return a copy with other numbers and `step` written down in its history."""
        return Dataset(
            u=self.u if u is None else u,
            y=self.y if y is None else y,
            valid=self.valid if valid is None else valid,
            starts=self.starts if starts is None else starts,
            output=self.output if output is None else output,
            unit=self.unit if unit is None else unit,
            Ts=self.Ts,
            input_unit=self.input_unit,
            source=self.source,
            history=self.history if step is None else (*self.history, step),
        )

    def __repr__(self) -> str:
        """Say it in one line."""
        parts = [f"{self.N} samples at {self.Ts:g} s", f"output {self.output}"]
        parts[1] += f" [{self.unit}]" if self.unit else ""
        if self.missing:
            parts.append(f"{self.missing} missing ({100 * self.missing / self.N:.1f} %)")
        if len(self.starts) > 1:
            parts.append(f"{len(self.starts)} experiments")
        parts += [f"history: {', '.join(self.history)}"] if self.history else []
        return f"<Dataset: {'; '.join(parts)}>"


def merge(parts: Sequence[Dataset]) -> Dataset:
    """Return several experiments as one Dataset with a boundary between each two.

    Parameters
    ----------
    parts : sequence of Dataset
        At least one; Ts, output and units are the same in all.

    Returns
    -------
    Dataset
        All samples in the order given; nothing is known across a boundary.

    Raises
    ------
    ValueError
        There is none, or they differ in Ts, output or unit.
    """
    if not parts:
        msg = "merge needs at least one Dataset, got none"
        raise ValueError(msg)
    for name in ("Ts", "output", "unit", "input_unit"):
        values = sorted({getattr(d, name) for d in parts})
        if len(values) > 1:
            msg = f"merge needs one {name}, got {values}; treat the data alike before merging"
            raise ValueError(msg)
    offsets = np.cumsum([0, *(d.N for d in parts[:-1])])
    histories = {d.history for d in parts}
    return Dataset(
        u=np.concatenate([d.u for d in parts]),
        y=np.concatenate([d.y for d in parts]),
        valid=np.concatenate([d.valid for d in parts]),
        starts=tuple(int(o) + s for o, d in zip(offsets, parts, strict=True) for s in d.starts),
        Ts=parts[0].Ts,
        output=parts[0].output,
        unit=parts[0].unit,
        input_unit=parts[0].input_unit,
        source="+".join(dict.fromkeys(d.source for d in parts if d.source)),
        history=parts[0].history
        if len(histories) == 1
        else tuple(f"{i + 1}: {step}" for i, d in enumerate(parts) for step in d.history),
    )


def _require_finite(name: str, x: Vector, way_out: str, where: Mask | None = None) -> None:
    bad = ~np.isfinite(x) if where is None else ~np.isfinite(x) & where
    if bad.any():
        first = int(np.argmax(bad))
        msg = f"{name} is not finite at {bad.sum()} samples, first {x[first]} at {first}; {way_out}"
        raise ValueError(msg)
