"""Faults of a column that its own values show: rails, and a counter that wraps."""

from __future__ import annotations

from math import tau

import numpy as np
from armrig_core.errors import FileError
from numpy.typing import NDArray

from armrig.data.files.table import Vector
from armrig.numerics.quantities import plural

_MODULI = (*(2.0**n for n in range(8, 17)), 2.0**24, 2.0**32, 360.0, tau)
_MIN_RAIL_RUN = 3  # samples
_MIN_RAIL_SAMPLES = 5
_MIN_ENTRY = 3.0  # smallest step onto a rail, in steps of the last digit: a level is reached slowly
_MIN_STEPS = 20
_MIN_JUMP = 0.5  # of the modulus
_MAX_JUMP_SHARE = 0.25  # of the steps
_MIN_RANGE = 0.7  # of the modulus
_MAX_REST = 0.25  # largest usual step of a counter that wraps, as a share of its modulus


def rails(y: Vector) -> tuple[NDArray[np.bool_], list[float]]:
    """Return the samples on a rail, and the values of the rails.

    A rail is the largest or smallest value, if y reaches it by jumps and keeps it for several
    samples. If y settles at a level instead, its last steps before the level are small.
    """
    found, values = np.zeros(y.size, np.bool_), []
    known = y[np.isfinite(y)]
    steps = np.abs(np.diff(known))
    if not np.any(steps > 0):
        return found, []
    digit = float(steps[steps > 0].min())
    for value in (float(known.min()), float(known.max())):
        there = known == value
        begins = np.flatnonzero(there & ~np.append(False, there[:-1]))
        runs = np.diff(np.append(begins, known.size)) if begins.size else np.array([])
        lengths = [int(np.argmin(np.append(there[a:], False))) for a in begins]
        entries = [steps[a - 1] for a, n in zip(begins, lengths, strict=True) if a and n > 1]
        several = runs.size and max(lengths, default=0) >= _MIN_RAIL_RUN
        alike = np.mean(steps[~(there[1:] & there[:-1])] == 0)
        if (
            several
            and there.sum() >= _MIN_RAIL_SAMPLES
            and entries
            and np.median(entries) >= _MIN_ENTRY * digit
            and alike < 0.5
        ):
            found |= y == value
            values.append(value)
    return found, values


def modulus_of(y: Vector) -> float | None:
    """Return the range of a counter or an angle that wraps, such as 65536 or 360; else None."""
    known = y[np.isfinite(y)]
    d = np.diff(known)
    if d.size < _MIN_STEPS:
        return None
    for modulus in _MODULI:
        jumps = np.abs(d) > _MIN_JUMP * modulus
        rest = np.abs(d - modulus * np.rint(d / modulus))
        if (
            0 < np.count_nonzero(jumps) <= _MAX_JUMP_SHARE * d.size
            and _MIN_RANGE * modulus <= np.ptp(known) <= modulus * (1 + 1e-9)
            and rest.max() < _MAX_REST * modulus
            and rest[jumps].max() <= 2 * max(float(rest[~jumps].max()), modulus / 1000)
        ):
            return modulus
    return None


def unwrapped(y: Vector, modulus: float) -> Vector:
    """Return y without its jumps of `modulus`; the steps of the result are at most half of it.

    Raises
    ------
    FileError
        The modulus is not a positive number.
    """
    if not (np.isfinite(modulus) and modulus > 0):
        raise FileError(f"--unwrap {modulus:g}: must be the positive range of the counter")
    known = np.isfinite(y)
    d = np.diff(y[known])
    result = y.copy()
    result[known] -= modulus * np.append(0.0, np.cumsum(np.rint(d / modulus)))
    return result


def treated(
    y: Vector, name: str, *, mask_rails: bool, unwrap: float | None
) -> tuple[Vector, list[str]]:
    """Return a column without the faults that the options name, and notes on all its faults."""
    notes = []
    if unwrap is not None:
        before, y = y, unwrapped(y, unwrap)
        jumps = int(np.count_nonzero(np.diff(np.rint((before - y) / unwrap)[np.isfinite(y)])))
        notes.append(f"unwrapped {name} at {plural(jumps, 'jump')} of {unwrap:.6g}")
    elif modulus := modulus_of(y):
        known = y[np.isfinite(y)]
        jumps = int(np.count_nonzero(np.abs(np.diff(known)) > _MIN_JUMP * modulus))
        notes.append(
            f"{name} jumps by {modulus:.6g} at {plural(jumps, 'place')}, as a counter that wraps: "
            f"give --unwrap {modulus:.6g}"
        )
        return y, notes
    at, values = rails(y)
    if values:
        where = " or ".join(f"{value:g}" for value in values)
        share = f"{np.count_nonzero(at)} of {y.size} samples"
        if mask_rails:
            y = np.where(at, np.nan, y)
            notes.append(f"masked {share} of {name} at the rail {where}")
        else:
            notes.append(
                f"{share} of {name} are exactly {where}, as at the rail of a converter: give "
                "--mask-rails to mark them as missing"
            )
    elif mask_rails:
        notes.append(f"{name} has no samples at a rail")
    return y, notes
