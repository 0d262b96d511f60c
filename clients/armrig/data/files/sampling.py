"""The sampling time that a column of times gives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.table import Column, Vector

_UNEVEN = 0.05
"""Share of Ts by which an interval may differ from it."""
_SECONDS = {"": 1.0, "s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6}
_SECONDS |= {"min": 60.0, "h": 3600.0}
_DIGITS = 12


def sampling_time(t: Vector, column: Column, place: Callable[[int], str]) -> float:
    """Return Ts in s of times that must be evenly apart.

    It is the mean interval, or the roundest number that the times agree with as well: those of a
    file often have few digits.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times in the column's unit; in s where it has none.
    place : callable
        Where in the file instant k stands.

    Raises
    ------
    FileError
        A time is missing, or an interval differs from the mean by more than a twentieth.
    """
    name = f"the times in column {column.name}" if column.name else "the times"
    if column.unit.casefold() not in _SECONDS:
        known = ", ".join(unit for unit in _SECONDS if unit)
        raise FileError(f"{name} are in {column.unit}, known are {known}; give Ts in s (--Ts)")
    missing = ~np.isfinite(t)
    if missing.any():
        msg = f"{place(int(np.argmax(missing)))}: {name} have none here; fill it in, or give Ts in "
        raise FileError(msg + "s (--Ts)")
    if t.size < 2:
        raise FileError(f"{name} are {t.size}, which tells no interval; give Ts in s (--Ts)")
    t = t * _SECONDS[column.unit.casefold()]
    intervals = np.diff(t)
    usual = float(np.median(intervals))
    wrong = ~(np.abs(intervals - usual) <= _UNEVEN * usual)
    if wrong.any() or usual <= 0:
        k = int(np.argmax(wrong)) + 1
        raise FileError(
            f"{place(k)}: {name} go from {t[k - 1]:.9g} to {t[k]:.9g} s, usual is {usual:.6g} s; "
            "sample evenly, cut the file, or give Ts in s (--Ts) if the times are wrong"
        )
    return _roundest(t)


def _roundest(t: Vector) -> float:
    k = np.arange(t.size)
    mean = float(t[-1] - t[0]) / (t.size - 1)
    apart = 1.1 * float(np.ptp(t - mean * k)) + 1e-9 * mean
    for digits in range(1, _DIGITS):
        rounded = float(f"{mean:.{digits}g}")
        if float(np.ptp(t - rounded * k)) <= apart:
            return rounded
    return mean
