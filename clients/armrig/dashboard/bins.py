"""Bins of samples in time; each bin contains the least and the largest value of each signal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from armrig_core.telemetry.telemetry import Sample
from numpy.typing import NDArray

Rows = NDArray[np.float64]
"""(n, 9): t in s, then the least and the largest value of each of four signals.

The signals are u in V, theta_1 in °, the rate of theta_1 in °/s, and alpha in °.
"""

COLUMNS = 9
WIDTH_S = 0.01
"""Width of a bin in s: one pixel if 1000 pixels show 10 s. If the sampling time is longer, each
sample has its own bin.
"""
RATE_S = 0.1
"""Time in s between the two angles of a rate; a converter step changes the rate by 3.5 °/s."""
_TURN = 360.0
_CLOCK_S = 1e-6  # resolution of the times, in s
_MAX_ROWS_BEFORE = 1000  # most earlier rows for a rate; a rig at 1 kHz needs 200


def signals(samples: Sequence[Sample]) -> NDArray[np.float64]:
    """Return an array (n, 5): k, t in s, u in V, theta_1 and alpha in °; NaN if unknown."""
    found = np.array(
        [(s.k, s.t_sched_ns / 1e9, s.u_applied_v, s.value_0, s.value_1) for s in samples],
        np.float64,
    ).reshape(-1, 5)
    found[:, 3:] = np.degrees(found[:, 3:])
    return found


def rate(before: NDArray[np.float64], now: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rate of theta_1 at each row of `now`, (N,) in °/s.

    The rate in a row is the difference between the row's angle and an older angle, divided by the
    time between the two angles. The older angle is the newest known angle at least `RATE_S` before
    the row. The rate is therefore also known after a missing sample or the dead band. The two
    angles are assumed to differ by less than half a turn.

    `before` (m, 5) contains the samples before `now` (N, 5), both from `signals`: see
    `needed_before`. The rate is NaN for a sample without an angle. The rate is also NaN if the
    older angle is more than 2 `RATE_S` before the sample, unless the older angle is in the previous
    sample.
    """
    every = np.concatenate([before, now])
    known = every[np.isfinite(every[:, 3])]
    slope = np.full(now.shape[0], np.nan)
    if known.shape[0]:
        place = np.searchsorted(known[:, 1], now[:, 1] - RATE_S + _CLOCK_S, "right") - 1
        older = known[np.maximum(place, 0)]
        elapsed = now[:, 1] - older[:, 1]
        near = (elapsed <= 2 * RATE_S + _CLOCK_S) | (now[:, 0] - older[:, 0] == 1)
        turned = now[:, 3] - older[:, 3]
        turned -= _TURN * np.round(turned / _TURN)
        use = near & (place >= 0)
        slope[use] = turned[use] / elapsed[use]
    return slope


def needed_before(found: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the newest rows, at most `_MAX_ROWS_BEFORE`, that the rates of later samples need."""
    found = found[-_MAX_ROWS_BEFORE:]
    first = int(np.searchsorted(found[:, 1], found[-1, 1] - 2 * RATE_S))
    return found[min(first, found.shape[0] - 1) :]


def binned(found: NDArray[np.float64], slope: NDArray[np.float64]) -> Rows:
    """Return a row for each bin of samples; a wrap of theta_1 divides its bin into two rows."""
    if not found.shape[0]:
        return np.zeros((0, COLUMNS))
    values = np.column_stack([found[:, 2], found[:, 3], slope, found[:, 4]])
    each = np.column_stack([found[:, 1], np.repeat(values, 2, axis=1)])
    return coarser(each, WIDTH_S)


def coarser(rows: Rows, width_s: float) -> Rows:
    """Return rows in wider bins; a new bin begins where theta_1 jumps by more than half a turn."""
    if not rows.shape[0]:
        return rows
    bins = np.floor(rows[:, 0] / width_s + 1e-6)
    # The potentiometer wraps inside its dead band, whose unknown angles are skipped.
    first_y, n = rows[:, 3], np.arange(rows.shape[0])
    known = np.maximum.accumulate(np.where(np.isnan(first_y), 0, n))
    wraps = np.abs(np.diff(first_y[known], prepend=first_y[:1])) > _TURN / 2  # False for NaN
    first = np.flatnonzero((np.diff(bins, prepend=np.nan) != 0) | wraps)
    made = np.empty((first.size, COLUMNS))
    made[:, 0] = rows[first, 0]
    # fmin and fmax ignore NaN, unless all values are NaN.
    made[:, 1::2] = np.fmin.reduceat(rows[:, 1::2], first)
    made[:, 2::2] = np.fmax.reduceat(rows[:, 2::2], first)
    return made


def as_lists(rows: Rows) -> list[list[float]]:
    """Return rows for JSON; t and u are rounded to 0.001, angles and rates to 0.01.

    Unknown values are NaN, which the encoder writes as null.
    """
    places = np.full(COLUMNS, 100.0)
    places[:3] = 1000.0
    lists: list[list[float]] = (np.rint(rows * places) / places).tolist()
    return lists
