"""Faults of a column that its own values show: rails, and a counter that wraps."""

from __future__ import annotations

from math import tau

import numpy as np
from armrig_core.errors import FileError
from numpy.typing import NDArray

from armrig.data.files.table import Vector
from armrig.data.step import DOUBT, Step
from armrig.numerics.quantities import plural
from armrig.numerics.stretches import Mask, stretches

_LINES = (1.0, 2.0, 2.4, 2.5, 3.6, 4.0, 5.0)  # of encoders, with a power of ten
_MODULI = (
    *(2.0**n for n in range(8, 17)),
    *(2.0**24, 2.0**32, 360.0, tau),
    *(x * 10.0**n for x in _LINES for n in range(2, 5)),
)
_SAME = 0.005  # relative difference of a modulus from the jumps
_MIN_RAIL_RUN = 3  # samples
_MIN_RAIL_SAMPLES = 5
_NEAR = 2.5  # steps of the last digit; y passes these values quickly, but settles at a level slowly
_MAX_RESTS = 0.5  # share of steps without a change elsewhere
_MAX_HELD = 10  # rows with each value, of a column that is read less often than the others
_MIN_HELD_VALUES = 10
_MIN_STUCK = 20  # rows
_MIN_STUCK_RATIO = 4  # of the longest to the second longest sequence of one value
_MIN_STEPS = 20
_MIN_COUNTER_VALUES = 8  # a signal of few levels is no counter
_MIN_JUMP = 0.5  # of the modulus
_MAX_JUMP_SHARE = 0.25  # of the steps
_MIN_RANGE = 0.7  # of the modulus
_MAX_REST = 0.25  # largest step of a counter that wraps, as a share of its modulus
_MAX_USUAL_STEP = 0.125  # of the modulus, for nine of ten steps: noise has larger ones


def treat_faults(
    y: Vector, name: str, *, mask_rails: bool, unwrap: float | None
) -> tuple[Vector, list[str]]:
    """Return a column without the faults that the options name, and notes on all its faults."""
    finite = y[np.isfinite(y)]
    wrap = _modulus_of(finite) if unwrap is None else None
    if wrap is not None:
        modulus, is_usual = wrap
        jumps = int(np.count_nonzero(np.abs(np.diff(finite)) > _MIN_JUMP * modulus))
        way = f"{modulus:.6g}" if is_usual else "with the range of the counter"
        text = (
            f"{name} jumps by {'' if is_usual else 'about '}{modulus:.6g} at "
            f"{plural(jumps, 'place')}, as a counter that wraps: give --unwrap {way}"
        )
        return y, [Step(text, DOUBT)]
    notes = []
    if unwrap is not None:
        turns = _turns(finite, unwrap)
        y = y.copy()
        y[np.isfinite(y)] -= unwrap * turns
        jumps = int(np.count_nonzero(np.diff(turns)))
        notes.append(f"unwrapped {name} at {plural(jumps, 'jump')} of {unwrap:.6g}")
    at, rails = rails_of(y)
    where = " or ".join(f"{value:g}" for value in rails)
    share = f"{np.count_nonzero(at)} of {y.size} samples"
    if where and mask_rails:
        notes.append(f"masked {share} of {name} at the rail {where}")
        return np.where(at, np.nan, y), notes
    if where:
        text = f"{share} of {name} are exactly {where}, as at the rail of a converter: "
        notes.append(Step(f"{text}give --mask-rails to mark them as missing", DOUBT))
    elif mask_rails:
        notes.append(f"{name} has no samples at a rail")
    return y, notes


def rows_of_each_value(x: Vector) -> int:
    """Return the number of rows for which every value stays, or 1."""
    at, lengths = _runs(x)
    rows = int(np.gcd.reduce(lengths[1:-1], initial=0))
    return rows if 1 < rows <= _MAX_HELD and np.unique(x[at]).size > _MIN_HELD_VALUES else 1


def repetition_notes(x: Vector, name: str) -> list[str]:
    """Return a note if every value stays for the same number of rows, or a multiple of it."""
    rows = rows_of_each_value(x)
    if rows == 1:
        return []
    text = (
        f"each value of {name} is in {plural(rows, 'row')}: if {name} was read less often "
        "than the rows "
    )
    return [Step(f"{text}were written, keep one row of {rows}", DOUBT)]


def stuck_notes(y: Vector, name: str, u: NDArray[np.float64]) -> list[str]:
    """Return a note if y is the same in many rows in which the inputs u (N, nu) change."""
    at, lengths = _runs(y)
    k = int(np.argmax(lengths))
    rows, other = int(lengths[k]), int(np.delete(lengths, k).max(initial=0))
    moved = np.ptp(u[at[k] : at[k] + rows // 2], axis=0) if rows > _MIN_STUCK else np.zeros(1)
    if not (moved > 0).any() or rows == y.size or rows < _MIN_STUCK_RATIO * other:
        return []
    text = f"{name} is {y[at[k]]:g} in {plural(rows, 'row')} in sequence while the input changes"
    return [Step(f"{text}, as of a sensor that is stuck: cut these rows out", DOUBT)]


def _runs(x: Vector) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first row of each sequence of one value, and its number of rows."""
    edges = np.flatnonzero(np.diff(x, prepend=np.nan, append=np.nan) != 0)
    return edges[:-1], np.diff(edges)


def rails_of(y: Vector) -> tuple[Mask, list[float]]:
    """Return the samples on a rail, which y keeps but does not settle at, and the rails."""
    at_rail, values = np.zeros(y.size, np.bool_), []
    finite = y[np.isfinite(y)]
    steps = np.abs(np.diff(finite))
    digit = float(steps[steps > 0].min(initial=np.inf))
    for value in (finite.min(), finite.max()) if np.isfinite(digit) else ():
        there = finite == value
        stays = stretches(there)
        lengths = [s.stop - s.start for s in stays]
        entries = [s for s in stays if s.start and s.stop - s.start > 1]
        # A sensor at rest with single wrong samples leaves no rail.
        leaves = any(s.stop - s.start > 1 for s in stretches(~there))
        beside = (finite != value) & (np.abs(finite - value) < _NEAR * digit)
        if (
            max(lengths) >= _MIN_RAIL_RUN
            and sum(lengths) >= _MIN_RAIL_SAMPLES
            and entries
            and leaves
            and np.count_nonzero(beside) <= 2 * len(entries)
            and np.mean(steps[~(there[1:] & there[:-1])] == 0) < _MAX_RESTS
        ):
            at_rail |= y == value
            values.append(float(value))
    return at_rail, values


def _modulus_of(values: Vector) -> tuple[float, bool] | None:
    """Return the range of a counter that wraps, or None, and whether the range is a usual one."""
    d = np.diff(values)
    if d.size < _MIN_STEPS or np.unique(values).size < _MIN_COUNTER_VALUES:
        return None
    span = float(np.ptp(values))
    at = np.flatnonzero(np.abs(d) > _MIN_JUMP * span)
    inside = at[(at > 0) & (at < d.size - 1)]
    inside = inside[~np.isin(inside - 1, at) & ~np.isin(inside + 1, at)]
    if not inside.size or at.size > _MAX_JUMP_SHARE * d.size:
        return None
    other_steps = np.abs(np.delete(d, at))
    sizes = np.abs(d[inside] - (d[inside - 1] + d[inside + 1]) / 2)
    modulus, scatter = float(np.median(sizes)), float(np.ptp(sizes)) / np.sqrt(inside.size)
    if (
        not span * (1 - 1e-9) <= modulus <= span / _MIN_RANGE
        or other_steps.max() >= _MAX_REST * modulus
        or np.quantile(other_steps, 0.9) >= _MAX_USUAL_STEP * modulus
        or np.ptp(sizes) > 2 * other_steps.max() + _SAME * modulus
    ):
        return None
    nearest = min(_MODULI, key=lambda m: abs(m - modulus))
    is_usual = span * (1 - 1e-9) <= nearest and abs(nearest - modulus) <= scatter + _SAME * modulus
    return (float(nearest), True) if is_usual else (float(f"{modulus:.3g}"), False)


def _turns(values: Vector, modulus: float) -> Vector:
    """Return how often a counter has wrapped; a step is at most half of its range."""
    if not (np.isfinite(modulus) and modulus > 0):
        raise FileError(f"--unwrap {modulus:g}: must be the positive range of the counter")
    d = np.diff(values)
    if np.mean(np.abs(d) > _MIN_JUMP * modulus) > _MAX_REST:
        raise FileError(
            f"--unwrap {modulus:g}: more than a quarter of the steps are longer than half of it; "
            "give the range of the counter"
        )
    return np.append(0.0, np.cumsum(np.rint(d / modulus)))
