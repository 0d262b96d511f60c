"""Columns of numbers with names and units, from the arguments of a caller."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal, get_args

import numpy as np
from armrig_core.errors import InputError, InputTypeError
from numpy.typing import ArrayLike, NDArray

from armrig.numerics.checks import column, real_copy
from armrig.numerics.quantities import digits, plural
from armrig.numerics.rounding import is_constant
from armrig.numerics.stretches import Mask

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Intersample = Literal["zoh", "foh"]
Names = str | Sequence[str]

MAX_SIZE = 1e30
"""Largest magnitude of a value: products of fourth powers of data must be finite."""
_MAX_SHOWN = 12  # names in a message
_MAX_INTERVAL_DEVIATION = 1e-3
_MIN_TS, _MAX_TS = 1e-12, 1e12  # s
"""Largest deviation of an interval of equidistant times, as a share of the mean interval."""


def columns(name: str, values: Any) -> Matrix:
    """Return a column-major copy (N, n) of the values, with NaN for masked values."""
    if getattr(values, "ndim", 1) == 2 and is_pandas(values):
        values = np.column_stack([plain(name, values.iloc[:, j]) for j in range(values.shape[1])])
    array = np.asanyarray(plain(name, values))
    if array.dtype.kind not in "buif":
        raise InputError(
            f"{name} is an array of {array.dtype}; give real numbers, a column for each channel"
        )
    taken = real_copy(array)
    if taken.ndim == 1:
        taken = taken[:, None]
    if taken.ndim != 2 or 0 in taken.shape:
        raise InputError(
            f"{name} has shape {taken.shape}; give (N, n), a row for each instant and a column for "
            "each channel"
        )
    if taken.shape[1] > taken.shape[0]:
        raise InputError(
            f"{name} has {plural(taken.shape[0], 'row')} and {plural(taken.shape[1], 'column')}, "
            f"fewer samples than channels; give {name}.T if the channels are the rows"
        )
    return taken


def constancy(name: str, values: Vector) -> str:
    """Return a text with the way out if all known values of a signal are equal, "" otherwise."""
    finite = values[np.isfinite(values)]
    if not finite.size or not is_constant(finite):
        return ""
    return f"{name} is always {finite[0]:.4g}: give the column that varies, or record again"


def plain(name: str, values: Any) -> Any:
    """Return a pandas column as an array, NaN for missing values; return other values unchanged.

    Raises ValueError if a value is not a number, or `values` is a table instead of a column.
    """
    if not is_pandas(values):
        return values
    if getattr(values, "ndim", 1) != 1:
        raise InputError(
            f"{name} is a table of pandas with shape {values.shape}; give one column, df[{name!r}]"
        )
    if getattr(values.dtype, "kind", "") == "c":
        return values.to_numpy()
    try:
        return values.to_numpy(dtype=np.float64, na_value=np.nan)
    except (TypeError, ValueError) as err:
        raise InputError(
            f"{name} is a column of {values.dtype}: {err}; give numbers, see pandas.to_numeric"
        ) from err


def is_pandas(values: Any) -> bool:
    """Return whether `values` is a pandas object, recognised by its methods."""
    return hasattr(values, "to_numpy") and hasattr(values, "isna")


def validity(valid: Any, shape: tuple[int, ...]) -> Mask:
    """Return a copy of a mask for values of a shape; masked and missing entries become False."""
    if valid is None:
        return np.ones(shape, dtype=np.bool_)
    if is_pandas(valid):
        valid = valid.to_numpy(dtype=np.bool_, na_value=False)
    mask = np.array(np.ma.filled(valid, False), dtype=np.bool_)
    if mask.ndim == 1 < len(shape):
        mask = mask[:, None]
    if mask.shape != shape:
        raise InputError(f"valid has shape {mask.shape}, y has {shape}; give one bool per value")
    return mask


def reference_of(r: ArrayLike, N: int) -> Vector:
    """Return a copy of a reference (N,); refuse another size, and values that are not finite."""
    reference = column("r", r)
    if reference.size != N:
        raise InputError(
            f"r has {plural(reference.size, 'sample')} and the data have {N}; give each sample"
        )
    if (at := np.flatnonzero(~np.isfinite(reference))).size:
        raise InputError(f"r[{at[0]}] is {reference[at[0]]}: r must be known at each sample")
    return reference


def names_of(option: str, names: Names | None, values: Any, letter: str, n: int) -> tuple[str, ...]:
    """Return n names; the default is the names of a DataFrame's columns, or `letter` and a number.

    The empty name is only for a single channel.
    """
    if names is None and is_pandas(values) and hasattr(values, "columns"):
        names = [str(name) for name in values.columns]
    if names is None:
        return (letter,) if n == 1 else tuple(f"{letter}{k + 1}" for k in range(n))
    chosen = as_tuple(names)
    if len(chosen) != n or not all(isinstance(name, str) and (name or n == 1) for name in chosen):
        raise InputError(
            f"{option}={list(chosen)!r}: {plural(n, 'name is', 'names are')} needed, one for each "
            f"column of {letter}"
        )
    if repeated := sorted({name for name in chosen if chosen.count(name) > 1}):
        raise InputError(
            f"{option}: {', '.join(repeated)} repeats; each channel needs its own name"
        )
    return chosen


def units_of(option: str, units: Names | None, n: int) -> tuple[str, ...]:
    """Return n units; the default is "", no unit."""
    chosen = ("",) * n if units is None else as_tuple(units)
    if len(chosen) != n:
        raise InputError(
            f'{option}={list(chosen)!r}: {n} units are needed, one for each channel; "" is none'
        )
    return chosen


def courses_of(intersample: Names, n: int) -> tuple[Intersample, ...]:
    """Return the course of each of n inputs between samples; one course is for all inputs."""
    courses = (intersample,) * n if isinstance(intersample, str) else tuple(intersample)
    allowed = get_args(Intersample)
    if len(courses) != n or not set(courses) <= set(allowed):
        raise InputError(
            f'intersample={intersample!r} must be "zoh" or "foh", or one of these for each of the '
            f"{plural(n, 'input')}"
        )
    return tuple(allowed[allowed.index(course)] for course in courses)


def as_tuple(names: Names) -> tuple[str, ...]:
    """Return one name or several names as a tuple."""
    return (names,) if isinstance(names, str) else tuple(names)


def channel_list(names: Sequence[str], units: Sequence[str] = ()) -> str:
    """Return names with their units as text; a long list is cut off."""
    pairs = zip(names, units or [""] * len(names), strict=True)
    texts = [f"{name} [{unit}]" if unit else name for name, unit in pairs]
    return ", ".join(texts[:_MAX_SHOWN]) + (", …" if len(texts) > _MAX_SHOWN else "")


def index_of(kind: str, name: str | None, names: tuple[str, ...]) -> int:
    """Return the index of a channel; the name may be left out if there is one channel."""
    if name is None and len(names) == 1:
        return 0
    if name not in names:
        problem = f"{kind}={name!r}: there is no such {kind}" if name else f"which {kind}?"
        raise InputError(f"{problem}; there are {channel_list(names)}")
    return names.index(name)


def starts_of(starts: Sequence[int], N: int) -> tuple[int, ...]:
    """Return the indices of the first samples of the experiments; refuse indices out of order."""
    starts_ = tuple(int(s) for s in starts)
    if starts_[:1] != (0,) or not all(a < b for a, b in pairwise((*starts_, N))):
        raise InputError(f"starts={starts_} must begin with 0 and rise strictly, below N={N}")
    return starts_


def sampling(Ts: Any, t: ArrayLike | None, starts: tuple[int, ...], N: int) -> float:
    """Return the given sampling time in s, or that of equidistant times t; refuse other times."""
    if (Ts is None) == (t is None):
        raise InputError("give either Ts, the sampling time in s, or t, the time of each sample")
    if t is None:
        return interval(Ts)
    times = np.array(plain("t", t), dtype=np.float64)
    if times.shape != (N,) or not np.isfinite(times).all():
        raise InputError(f"t has shape {times.shape}; give {N} finite times, one for each sample")
    intervals = np.concatenate([np.diff(times[a:b]) for a, b in pairwise((*starts, N))])
    if not intervals.size or not (intervals > 0).all():
        raise InputError("t must rise from each sample of an experiment to the next")
    mean = float(np.mean(intervals))
    if np.max(np.abs(intervals - mean)) > _MAX_INTERVAL_DEVIATION * mean:
        raise InputError(
            "the sample times are not equidistant, which a model in discrete time needs; "
            "interpolate the signals to equidistant times first"
        )
    return interval(mean)


def interval(Ts: Any) -> float:
    """Return a sampling time in s; refuse a value that is not one number of a possible size."""
    if Ts is None or isinstance(Ts, str) or np.ndim(Ts):
        raise InputTypeError(
            f"Ts is a {type(Ts).__name__}; give one number, in seconds, such as Ts=0.01"
        )
    if not _MIN_TS <= Ts <= _MAX_TS:
        raise InputError(f"Ts={Ts!r} must be from {_MIN_TS:g} to {_MAX_TS:g} s")
    return float(Ts)


def require_size(name: str, x: Vector) -> None:
    """Refuse numbers so large that their powers overflow in floating point."""
    largest = float(np.max(np.abs(x), initial=0.0))
    if largest > MAX_SIZE:
        raise InputError(
            f"the largest |{name}| is {digits(largest, 3)}; use a unit in which it is below "
            f"{MAX_SIZE:g}"
        )


def require_finite(name: str, x: Vector, way_out: str, where: Mask | None = None) -> None:
    """Refuse values that are not finite, among those marked True in `where`."""
    bad = ~np.isfinite(x) if where is None else ~np.isfinite(x) & where
    if bad.any():
        first = int(np.argmax(bad))
        raise InputError(
            f"{name} is not finite at {plural(bad.sum(), 'sample')}, first {x[first]} at "
            f"{first}; {way_out}"
        )
