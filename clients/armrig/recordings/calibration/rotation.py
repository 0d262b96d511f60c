"""A shaft that turns on at constant speeds: counts per turn, edges, dead band and speeds.

Each constant voltage turns the shaft at a constant speed once the transient is over, and then::

    counts = a_j + b_j t - s d n

with a_j and b_j of voltage j, n the turns so far, d the counts of a whole turn (dead band
included, as if the track went on) and s = ±1 the sign of all b_j: linear regression in the a_j,
b_j and d. One count is 2 pi / d rad, whatever the speeds.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from armrig_core.calibration import Figure
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.numerics.least_squares import orthonormal
from armrig.numerics.stretches import Mask, constant
from armrig.recordings.calibration.readings import FULL_COUNTS, RAIL_COUNTS, Readings

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

SETTLE_S = 2.0
"""Beginning of each voltage that is left out: sixteen time constants of the handout's arm."""
LEAST_S = 1.0
"""Shortest rest of a voltage that counts, in s."""
LEAST_TURNS = 3
"""Times that the shaft has to pass its dead band, at all voltages together."""
_MOST_MISREAD = 0.02  # share of samples on the track that may show a rail: a worn spot
_WAY_OUT = "turn it slowly and one way, for three turns or more: see --volts and --level-seconds"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Turning:
    """What a shaft at constant speeds shows."""

    direction: int
    """1 where the counts grow, else -1."""
    per_turn: Figure
    """Counts of a whole turn, as if the track went on through the dead band."""
    low: Figure
    """Reading at the track's beginning, in counts."""
    high: Figure
    """Reading at the track's end, in counts."""
    turns: int
    """Times that the dead band was passed."""
    volts: Vector
    """Voltages of the codes, in V, (m,)."""
    slopes: Vector
    """b_j, in counts/s, (m,)."""
    covariance: Matrix
    """Of the slopes and, last, the counts of a turn, (m + 1, m + 1)."""
    residual_variance: float
    """Of the readings about the straight lines, in counts²."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Settled:
    """The samples at constant speeds."""

    level: NDArray[np.intp]
    t: Vector
    counts: Vector
    live: Mask
    volts: Vector


def turning(readings: Readings, step: float) -> Turning:
    """Return what a run of constant voltages shows of theta_1's potentiometer.

    The edges of the track lie between the last sample that shows an angle and the first that does
    not, where the straight lines put these two: the narrowest such bracket of all turns. A reading
    of 0 near 0 may be either; the track cannot begin below it, nor end above full scale.

    Parameters
    ----------
    readings : Readings
        One run, N samples; one voltage or more, each held for more than `SETTLE_S` + `LEAST_S`.
    step : float
        The converter's step, in counts.

    Raises
    ------
    InputError
        No voltage was held for long enough, or the shaft did not turn on, one way.
    """
    settled = _settled(readings)
    live = settled.live
    if np.count_nonzero(live) < 10 * (settled.volts.size + 1):
        raise InputError(f"theta_1 shows no angle: see to its wires, then {_WAY_OUT}")
    turns, direction = _turns(settled)
    counts = settled.counts
    low, high = float(counts[live].min()), float(counts[live].max())
    margin = 0.05 * (high - low)
    inside = live & (counts > low + margin) & (counts < high - margin)
    n = np.zeros(counts.size)
    n[live] = turns
    # Twice: the first fit leaves out readings near an edge by what they show, the second by where
    # the first fit puts them, which noise does not bias.
    for _ in range(2):
        x, covariance, variance = _fitted(settled, n, inside, direction)
        place, n = _places(settled, x, direction, (low + high) / 2)
        margin = 6 * (sqrt(variance) + step)
        inside = (place > low + margin) & (place < high - margin)
        misread = float(np.mean(~live[inside])) if inside.any() else 1.0
        if misread > _MOST_MISREAD:
            raise InputError(
                f"theta_1 showed a rail at {100 * misread:.0f} % of its track: {_WAY_OUT}"
            )
        inside &= live
    x, covariance, variance = _fitted(settled, n, inside, direction)
    place, _ = _places(settled, x, direction, (low + high) / 2)
    m = settled.volts.size
    var_d = float(covariance[-1, -1])
    low_edge, high_edge = _edges(
        place,
        counts,
        live,
        centre=(low + high) / 2,
        d=float(x[-1]),
        clear=6 * sqrt(variance) + step,
    )
    return Turning(
        direction=direction,
        per_turn=Figure(value=float(x[-1]), std=sqrt(var_d)),
        low=_bracketed(low_edge, var_d),
        high=_bracketed(high_edge, var_d),
        turns=_passed(settled, turns),
        volts=settled.volts,
        slopes=x[m : 2 * m],
        covariance=covariance[m:, m:],
        residual_variance=variance,
    )


def _settled(readings: Readings) -> _Settled:
    """Return the samples at voltages above 0 that were held for long enough."""
    u, t = readings.u, readings.t
    held = [
        part
        for part in constant(u)
        if u[part.start] > 0 and t[part.stop - 1] - t[part.start] > SETTLE_S + LEAST_S
    ]
    if not held:
        raise InputError(f"no voltage was held for more than {SETTLE_S + LEAST_S:g} s: {_WAY_OUT}")
    rows = [np.arange(part.start, part.stop)[t[part] - t[part.start] > SETTLE_S] for part in held]
    level = np.repeat(np.arange(len(rows)), [r.size for r in rows])
    chosen = np.concatenate(rows)
    counts = readings.theta_1[chosen]
    return _Settled(
        level=level,
        t=t[chosen],
        counts=counts,
        live=counts >= RAIL_COUNTS,
        volts=u[[part.start for part in held]],
    )


def _turns(settled: _Settled) -> tuple[Vector, int]:
    """Return the turns so far at each sample that shows an angle, and the direction."""
    counts = settled.counts[settled.live]
    change = np.diff(counts)
    change[np.diff(settled.level[settled.live]) != 0] = 0.0
    far = np.abs(change) > np.ptp(counts) / 2
    direction = 1 if change[~far].sum() >= 0 else -1
    if np.count_nonzero(far) < LEAST_TURNS:
        raise InputError(f"theta_1 passed its dead band {np.count_nonzero(far)} times: {_WAY_OUT}")
    if (change[far] * direction > 0).any():
        raise InputError(f"theta_1 did not turn one way at a constant voltage: {_WAY_OUT}")
    return np.r_[0.0, np.cumsum(far)], direction


def _passed(settled: _Settled, turns: Vector) -> int:
    level = settled.level[settled.live]
    return int(sum(np.ptp(turns[level == j]) for j in range(settled.volts.size)))


def _fitted(
    settled: _Settled, n: Vector, rows: Mask, direction: int
) -> tuple[Vector, Matrix, float]:
    """Return (a_j, b_j, d), their covariance and the variance of the residuals."""
    m = settled.volts.size
    level, t = settled.level[rows], settled.t[rows]
    X = np.zeros((t.size, 2 * m + 1))
    X[np.arange(t.size), level] = 1.0
    X[np.arange(t.size), m + level] = t
    X[:, -1] = -direction * n[rows]
    basis = orthonormal(X)
    if basis.rank < X.shape[1] or t.size <= X.shape[1]:
        raise InputError(f"theta_1 shows too few angles at one of the voltages: {_WAY_OUT}")
    residuals = basis.without(settled.counts[rows])
    variance = float(residuals @ residuals) / (t.size - basis.rank)
    return basis.coefficients(settled.counts[rows]), variance * basis.W @ basis.W.T, variance


def _places(settled: _Settled, x: Vector, direction: int, centre: float) -> tuple[Vector, Vector]:
    """Return where the lines put each sample, within half a turn of `centre`, and its turns."""
    m, d = settled.volts.size, x[-1]
    line = x[settled.level] + x[m + settled.level] * settled.t
    n = direction * np.floor((line - centre) / d + 0.5)
    return line - direction * n * d, n


def _edges(
    place: Vector, counts: Vector, live: Mask, *, centre: float, d: float, clear: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return between which places the track begins, and between which it ends."""
    # Where the wiper comes back to the track, its first reading may have any value: leave it out.
    expected = np.clip(place, 0.0, FULL_COUNTS - RAIL_COUNTS)
    on = live & (np.abs(counts - expected) < clear + RAIL_COUNTS)
    above = place >= centre
    off_low = ~live & ~above & (place > clear + RAIL_COUNTS)
    off_high = ~live & above
    low = (max(_most(place[off_low], centre - d / 2), 0.0), _least(place[on & ~above], centre))
    high = (
        _most(place[on & above], centre),
        min(_least(place[off_high], centre + d / 2), float(FULL_COUNTS)),
    )
    return low, high


def _most(values: Vector, otherwise: float) -> float:
    return float(values.max()) if values.size else otherwise


def _least(values: Vector, otherwise: float) -> float:
    return float(values.min()) if values.size else otherwise


def _bracketed(bracket: tuple[float, float], variance: float) -> Figure:
    """Return the middle of a bracket, with the deviation of anywhere in it."""
    low, high = bracket
    return Figure(value=(low + high) / 2, std=sqrt((high - low) ** 2 / 12 + variance))
