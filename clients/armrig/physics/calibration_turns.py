"""Turns at constant voltages: counts of a turn, edges of the track, dead band and speeds.

After a transient, the shaft turns at a constant speed at each constant voltage. Then::

    counts = a_j + b_j t - s d n

a_j and b_j are the intercept and the slope at voltage j, and n is the number of turns. d is the
number of counts of a whole turn, as if the track continued in the dead band. s = ±1 is the sign of
all b_j. The equation is a linear regression in the a_j, b_j and d. One count is 2 pi / d rad at
every speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, pi, sqrt

import numpy as np
from armrig_core.errors import InputError
from armrig_core.rig.calibration import CALIBRATED, MeasuredValue
from armrig_core.rig.volts import U_MAX_V
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from armrig.data.columns import Matrix, Vector
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.stretches import Mask, constant
from armrig.physics.calibration_readings import FULL_COUNTS, RAIL_COUNTS, Readings

SETTLE_S = 2.0
"""Time after each voltage change that the fit does not use, in s; 16 time constants of the arm."""
LEAST_S = 1.0
"""Least time in s for which each voltage is held after the first `SETTLE_S`."""
LEAST_TURNS = 3
"""Least number of passes of the shaft through its dead band, at all voltages together."""
MAX_MISREAD_SHARE = 0.02  # largest share of rail readings on the track (worn spots)
_TURNING = CALIBRATED[0]
_REMEDY = "turn it slowly in one direction, three turns or more: see --volts and --level-seconds"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Turning:
    """Results for the potentiometer of a shaft that turned at constant speeds."""

    direction: int
    """1 if the counts increase as the shaft turns, -1 if they decrease."""
    per_turn: MeasuredValue
    """Counts of a whole turn, as if the track continued in the dead band."""
    low: MeasuredValue
    """Reading at the beginning of the track, in counts."""
    high: MeasuredValue
    """Reading at the end of the track, in counts."""
    turns: int
    """Number of passes through the dead band."""
    volts: Vector
    """Voltages of the codes, in V, (m,)."""
    slopes: Vector
    """Slopes b_j, in counts/s, (m,)."""
    covariance: Matrix
    """Covariance matrix of the m slopes and, last, the counts of a turn, (m + 1, m + 1)."""
    residual_variance: float
    """Variance of the readings about the straight lines, in counts²."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Settled:
    """Samples at constant speeds."""

    level: NDArray[np.intp]
    t: Vector
    counts: Vector
    live: Mask
    volts: Vector


def turning(readings: Readings, step: float) -> Turning:
    """Estimate counts per turn and edges of a track from turns at constant voltages.

    An edge of the track is between the last sample with an angle and the first sample without an
    angle. The fitted straight lines give the counts of these two samples. In each turn, the edge is
    between these two counts. Over all turns, the edge is in the intersection of these intervals. If
    the track begins near 0 counts, a reading of 0 may be on the track or in the dead band. The
    track begins at 0 counts or above, and ends at full scale or below.

    In the run, each voltage must be held for longer than `SETTLE_S` + `LEAST_S`. `step` is the step
    of the converter, in counts.

    Raises InputError if no voltage was held long enough, or the shaft did not turn in one direction
    throughout.
    """
    settled = _select_settled(readings)
    live = settled.live
    if np.count_nonzero(live) < 10 * (settled.volts.size + 1):
        raise InputError(f"{_TURNING} shows no angle: check its wires, then {_REMEDY}")
    turns, direction = _turns(settled)
    counts = settled.counts
    low, high = float(counts[live].min()), float(counts[live].max())
    margin = 0.05 * (high - low)
    inside = live & (counts > low + margin) & (counts < high - margin)
    n = np.zeros(counts.size)
    n[live] = turns
    # Fit twice. The first fit leaves out readings near an edge by their values. The second fit
    # leaves out readings by their places on the fitted lines, which noise does not bias.
    for _ in range(2):
        x, covariance, variance = _fit_lines(settled, n, inside, direction)
        place, n = _places(settled, x, direction, (low + high) / 2)
        margin = 6 * (sqrt(variance) + step)
        inside = (place > low + margin) & (place < high - margin)
        misread = float(np.mean(~live[inside])) if inside.any() else 1.0
        if misread > MAX_MISREAD_SHARE:
            raise InputError(
                f"{_TURNING} was at a rail at {100 * misread:.0f} % of its track: {_REMEDY}"
            )
        inside &= live
    x, covariance, variance = _fit_lines(settled, n, inside, direction)
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
        per_turn=MeasuredValue(value=float(x[-1]), std=sqrt(var_d)),
        low=_interval_middle(low_edge, var_d),
        high=_interval_middle(high_edge, var_d),
        turns=_turn_count(settled, turns),
        volts=settled.volts,
        slopes=x[m : 2 * m],
        covariance=covariance[m:, m:],
        residual_variance=variance,
    )


def _select_settled(readings: Readings) -> _Settled:
    """Return the samples at voltages above 0 that were held long enough."""
    u, t = readings.u, readings.t
    held = [
        part
        for part in constant(u)
        if u[part.start] > 0 and t[part.stop - 1] - t[part.start] > SETTLE_S + LEAST_S
    ]
    if not held:
        raise InputError(f"no voltage was held for more than {SETTLE_S + LEAST_S:g} s: {_REMEDY}")
    rows = [np.arange(part.start, part.stop)[t[part] - t[part.start] > SETTLE_S] for part in held]
    level = np.repeat(np.arange(len(rows)), [r.size for r in rows])
    chosen = np.concatenate(rows)
    counts = readings.first[chosen]
    return _Settled(
        level=level,
        t=t[chosen],
        counts=counts,
        live=counts >= RAIL_COUNTS,
        volts=u[[part.start for part in held]],
    )


def _turns(settled: _Settled) -> tuple[Vector, int]:
    """Return the number of turns at each sample with an angle, and the direction, 1 or -1."""
    counts = settled.counts[settled.live]
    change = np.diff(counts)
    change[np.diff(settled.level[settled.live]) != 0] = 0.0
    far = np.abs(change) > np.ptp(counts) / 2
    direction = 1 if change[~far].sum() >= 0 else -1
    if np.count_nonzero(far) < LEAST_TURNS:
        raise InputError(
            f"{_TURNING} passed its dead band {np.count_nonzero(far)} times: {_REMEDY}"
        )
    if (change[far] * direction > 0).any():
        raise InputError(
            f"{_TURNING} did not turn in one direction at a constant voltage: {_REMEDY}"
        )
    return np.r_[0.0, np.cumsum(far)], direction


def _turn_count(settled: _Settled, turns: Vector) -> int:
    level = settled.level[settled.live]
    return int(sum(np.ptp(turns[level == j]) for j in range(settled.volts.size)))


def _fit_lines(
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
        raise InputError(f"{_TURNING} shows too few angles at one of the voltages: {_REMEDY}")
    residuals = basis.without(settled.counts[rows])
    variance = float(residuals @ residuals) / (t.size - basis.rank)
    return basis.coefficients(settled.counts[rows]), variance * basis.W @ basis.W.T, variance


def _places(settled: _Settled, x: Vector, direction: int, centre: float) -> tuple[Vector, Vector]:
    """Return fitted counts, reduced to within half a turn of `centre`, and the numbers of turns."""
    m, d = settled.volts.size, x[-1]
    line = x[settled.level] + x[m + settled.level] * settled.t
    n = direction * np.floor((line - centre) / d + 0.5)
    return line - direction * n * d, n


def _edges(
    place: Vector, counts: Vector, live: Mask, *, centre: float, d: float, clear: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the intervals that contain the beginning and the end of the track, in counts."""
    # When the wiper returns to the track, its first reading may have any value and is left out.
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


def _interval_middle(bracket: tuple[float, float], variance: float) -> MeasuredValue:
    """Return the middle of an interval that contains a value, and its standard deviation."""
    low, high = bracket  # the value is uniformly distributed, with a further `variance`
    return MeasuredValue(value=(low + high) / 2, std=sqrt((high - low) ** 2 / 12 + variance))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TerminalVoltage:
    """Line of the terminal voltage, offset + gain · u, estimated from readings of a meter."""

    line: Vector
    """Offset in V, and gain."""
    covariance: Matrix
    """Covariance matrix of offset and gain; entries of the offset are 0 for a single reading."""

    @property
    def offset(self) -> MeasuredValue:
        """Terminal voltage of the line at u = 0, in V."""
        return MeasuredValue(value=float(self.line[0]), std=sqrt(float(self.covariance[0, 0])))

    @property
    def gain(self) -> MeasuredValue:
        """Gain of the line: volts at the terminals per volt of u."""
        return MeasuredValue(value=float(self.line[1]), std=sqrt(float(self.covariance[1, 1])))


STANDSTILL_RAD_S = 0.1
"""Least measured speed that is used, in rad/s; at a lower speed, friction holds the rig."""
IDEAL_DRIVER = TerminalVoltage(line=np.array([0.0, 1.0]), covariance=np.zeros((2, 2)))
"""Line of an ideal driver, used without a measurement: the terminal voltage is u."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Speeds:
    """Line fitted to the measured speeds: speed = rate · (terminal voltage - zero_torque)."""

    rate: MeasuredValue
    """Speed per volt at the terminals, in rad/s/V."""
    zero_torque: MeasuredValue
    """Terminal voltage at which the line has speed 0, in V.

    Friction and the driver's offset shift this voltage from 0.
    """


def terminal_voltage(
    meter: Sequence[tuple[float, float]], meter_std_v: float
) -> TerminalVoltage | None:
    """Return the line through the readings of a meter; None without readings.

    One reading determines the gain of a line through 0. Two or more readings also determine the
    offset. A reading is a pair: the voltage of a code, and the voltage at the motor's terminals,
    both in V. `meter_std_v` is the standard deviation of a reading, in V.

    Raises InputError if a voltage is out of range, or two or more readings are all at the same
    code.
    """
    if not meter:
        return None
    if not 0 < meter_std_v < U_MAX_V:
        raise InputError(f"a meter's standard deviation of {meter_std_v:g} V: it must be above 0 V")
    u, y = np.array(meter, dtype=np.float64).T
    for volts, actual in meter:
        if not (0 < volts <= U_MAX_V and isfinite(actual) and 0 < actual < 2 * U_MAX_V):
            raise InputError(
                f"the meter reads {actual:g} V at a code of {volts:g} V: the reading must be above "
                f"0 V and below {2 * U_MAX_V:g} V, at a code above 0 V, at most {U_MAX_V:g} V"
            )
    if u.size == 1:
        gain, std = y[0] / u[0], meter_std_v / u[0]
        return TerminalVoltage(line=np.array([0.0, gain]), covariance=np.diag([0.0, std**2]))
    if np.ptp(u) == 0:
        raise InputError(
            f"all readings of the meter are at {u[0]:g} V: read the meter at another code, too"
        )
    basis = orthonormal(np.column_stack([np.ones(u.size), u]))
    return TerminalVoltage(
        line=basis.coefficients(y), covariance=meter_std_v**2 * basis.W @ basis.W.T
    )


def speeds(turned: Turning, terminal: TerminalVoltage) -> Speeds | None:
    """Return the line fitted to the speeds at the voltages; None for fewer than two voltages.

    The speeds are 2 pi b_j / d, with the slopes b_j and the number d of counts of a turn. Their
    covariance follows from the covariance of b_j and d. The line is fitted with the inverse of
    this covariance as weight. The errors of the meter are independent of the b_j and d.
    """
    d = turned.per_turn.value
    omega = 2 * pi * turned.direction * turned.slopes / d
    moved = omega > STANDSTILL_RAD_S
    v = turned.volts[moved]
    if np.unique(v).size < 2:
        return None
    J = np.column_stack([np.eye(omega.size) * turned.direction * 2 * pi / d, -omega / d])[moved]
    # L L^T is the covariance of the speeds. Multiplied by L^-1, their errors are white.
    L = np.linalg.cholesky(J @ turned.covariance @ J.T)
    X = np.column_stack([v, np.ones(v.size)])
    basis = orthonormal(solve_triangular(L, X, lower=True))
    slope, intercept = basis.coefficients(solve_triangular(L, omega[moved], lower=True))
    P = basis.W @ basis.W.T
    stop = -intercept / slope  # in volts of the code
    gradient = np.array([-stop / slope, -1 / slope])
    offset, gain = terminal.line
    at = np.array([1.0, stop])
    rate, var_gain = slope / gain, terminal.covariance[1, 1]
    return Speeds(
        rate=MeasuredValue(
            value=float(rate),
            std=sqrt(float(P[0, 0] / gain**2 + rate**2 * var_gain / gain**2)),
        ),
        zero_torque=MeasuredValue(
            value=float(offset + gain * stop),
            std=sqrt(float(gain**2 * gradient @ P @ gradient + at @ terminal.covariance @ at)),
        ),
    )
