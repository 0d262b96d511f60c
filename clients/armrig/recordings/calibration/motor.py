"""Motor: terminal voltage at a code, speed at a voltage, and voltage at which the motor stops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, pi, sqrt

import numpy as np
from armrig_core.calibration import Figure
from armrig_core.errors import InputError
from armrig_core.volts import U_MAX_V
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from armrig.numerics.least_squares import orthonormal
from armrig.recordings.calibration.rotation import Turning

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TerminalVoltage:
    """Line of the terminal voltage, offset + gain · u, estimated from readings of a meter."""

    line: Vector
    """Offset in V, and gain."""
    covariance: Matrix
    """Covariance matrix of offset and gain; entries of the offset are 0 for a single reading."""

    @property
    def offset(self) -> Figure:
        """Terminal voltage of the line at u = 0, in V."""
        return Figure(value=float(self.line[0]), std=sqrt(float(self.covariance[0, 0])))

    @property
    def gain(self) -> Figure:
        """Gain of the line: volts at the terminals per volt of u."""
        return Figure(value=float(self.line[1]), std=sqrt(float(self.covariance[1, 1])))


STANDSTILL_RAD_S = 0.1
"""Least measured speed that is used, in rad/s; at a lower speed, friction holds the chassis."""
IDEAL_DRIVER = TerminalVoltage(line=np.array([0.0, 1.0]), covariance=np.zeros((2, 2)))
"""Line of an ideal driver, used without a measurement: the terminal voltage is u."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Speeds:
    """Line fitted to the measured speeds: speed = rate · (terminal voltage - zero_torque)."""

    rate: Figure
    """Speed of the chassis per volt at the terminals, in rad/s/V."""
    zero_torque: Figure
    """Terminal voltage at which the line has speed 0, in V.

    Friction and the driver's offset shift this voltage from 0.
    """


def terminal_voltage(
    meter: Sequence[tuple[float, float]], meter_std_v: float
) -> TerminalVoltage | None:
    """Return the line through the readings of a meter; None without readings.

    One reading determines the gain of a line through 0. Two or more readings also determine the
    offset.

    Parameters
    ----------
    meter : sequence of (float, float)
        Pairs of a code's voltage and the meter's reading at the motor's terminals, both in V.
    meter_std_v : float
        Standard deviation of a reading, in V.

    Raises
    ------
    InputError
        A voltage is out of range, or two or more readings are all at the same code.
    """
    if not meter:
        return None
    if not 0 < meter_std_v < U_MAX_V:
        raise InputError(f"a meter's standard deviation of {meter_std_v:g} V: it must be above 0 V")
    u, y = np.array(meter, dtype=np.float64).T
    for volts, shown in meter:
        if not (0 < volts <= U_MAX_V and isfinite(shown) and 0 < shown < 2 * U_MAX_V):
            raise InputError(
                f"the meter reads {shown:g} V at a code of {volts:g} V: the reading must be above "
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
        rate=Figure(
            value=float(rate),
            std=sqrt(float(P[0, 0] / gain**2 + rate**2 * var_gain / gain**2)),
        ),
        zero_torque=Figure(
            value=float(offset + gain * stop),
            std=sqrt(float(gain**2 * gradient @ P @ gradient + at @ terminal.covariance @ at)),
        ),
    )
