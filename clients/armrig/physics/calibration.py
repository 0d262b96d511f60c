"""Estimation of a calibration from recordings at rest and in slow turns, and from a voltmeter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, hypot, sqrt, tau
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.errors import InputError
from armrig_core.rig.calibration import (
    ALPHA,
    THETA_1,
    Calibration,
    Driver,
    Made,
    MeasuredValue,
    Potentiometer,
)
from armrig_core.rig.volts import U_MAX_V
from msgspec.structs import replace

from armrig.numerics.quantities import plural
from armrig.physics.calibration_readings import (
    Readings,
    at_rail,
    mean_reading,
    noise_before_rounding,
    readings_of,
    resolution,
    rounding_variance,
    spread,
)
from armrig.physics.calibration_turns import (
    IDEAL_DRIVER,
    Speeds,
    TerminalVoltage,
    Turning,
    speeds,
    terminal_voltage,
    turning,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

    from armrig.recordings.recording import Recording


MAX_STEADY_RATIO = 1.5  # ratio of the residuals at constant speed to noise and rounding
_METER_TOLERANCE = 1.005  # relative uncertainty of a common meter's reading
_MAX_REST_STEPS = 10.0  # spread of readings at rest, in steps of the converter
CLEAR = 8.0
"""Threshold of the arm's deflection: this multiple of the noise, plus one converter step."""
HAND_RAD = 0.02
"""Smallest deflection by hand that determines alpha's sign, in rad; a light touch causes less."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibrationEstimate:
    """Estimated calibration; None for values that the recordings do not determine."""

    theta_1_zero: MeasuredValue
    """Reading of the chassis at rest, which defines theta_1 = 0, in counts."""
    theta_1_noise: MeasuredValue
    """Standard deviation of theta_1's readings at rest, in counts."""
    alpha_zero: MeasuredValue
    """Reading of the arm at rest, which defines alpha = 0, in counts."""
    alpha_noise: MeasuredValue
    """Standard deviation of alpha's readings at rest, in counts."""
    alpha_sign: int
    """Sign of alpha's rad per count; 0 if no deflection was seen."""
    resolution: int
    """Step of the converter, in counts."""
    turned: Turning | None
    """Results for theta_1's potentiometer; None without a recording of turns."""
    speeds: Speeds | None
    """Line fitted to the motor's speeds at its voltages; None for fewer than two voltages."""
    terminal: TerminalVoltage | None
    """Line fitted to the driver's terminal voltage over u; None without readings of a meter."""
    warnings: tuple[str, ...]
    """Warnings about the calibration, one sentence each."""

    @property
    def rad_per_count(self) -> MeasuredValue | None:
        """Angle of one count of theta_1, in rad."""
        if self.turned is None:
            return None
        d = self.turned.per_turn
        size = tau / d.value
        return MeasuredValue(value=self.turned.direction * size, std=size * d.std / d.value)

    @property
    def dead_band(self) -> MeasuredValue | None:
        """Angle of the dead band of theta_1, in rad."""
        if self.turned is None:
            return None
        low, high, d = self.turned.low, self.turned.high, self.turned.per_turn
        share = (high.value - low.value) / d.value
        std = hypot(low.std, high.std, share * d.std) / d.value
        return MeasuredValue(value=tau * (1 - share), std=tau * std)

    def plot(self, turns: Recording | Readings, *, ax: Axes | None = None) -> Drawing:
        """Return a figure of the turns: see `armrig.plots.plot_calibration`."""
        from armrig.plots import plot_calibration
        from armrig.plots.layout import figure_of

        return figure_of(plot_calibration(self, turns, ax=ax))

    def figures(self) -> dict[str, MeasuredValue]:
        """Return the measured values, with standard deviations, by names that contain the unit."""
        found: dict[str, MeasuredValue | None] = {
            "theta_1_zero_counts": self.theta_1_zero,
            "theta_1_noise_counts": self.theta_1_noise,
            "theta_1_rad_per_count": self.rad_per_count,
            "theta_1_dead_band_rad": self.dead_band,
            "alpha_zero_counts": self.alpha_zero,
            "alpha_noise_counts": self.alpha_noise,
            "resolution_counts": MeasuredValue(value=float(self.resolution), std=0.0),
        }
        if self.turned is not None:
            found["theta_1_low_counts"] = self.turned.low
            found["theta_1_high_counts"] = self.turned.high
        if self.terminal is not None:
            found["driver_gain"] = self.terminal.gain
            found["driver_offset_v"] = self.terminal.offset
        if self.speeds is not None:
            found["motor_zero_torque_v"] = self.speeds.zero_torque
            found["motor_rad_per_s_v"] = self.speeds.rate
        return {name: figure for name, figure in found.items() if figure is not None}

    def calibration(self, base: Calibration, made: Made) -> Calibration:
        """Return the calibration; the measured values are added to its origin, `made`.

        The values that were not measured come from `base`, such as the current calibration. The
        angle of one count of alpha always comes from `base`, except its sign.
        """
        size, alpha = self.rad_per_count, base.alpha
        scale = base.theta_1.rad_per_count if size is None else size.value
        sign = self.alpha_sign or (1 if alpha.rad_per_count > 0 else -1)
        driver = base.driver
        if self.terminal is not None:
            offset, gain = (float(x) for x in self.terminal.line)
            driver = Driver(gain=gain, offset_v=offset)
        return Calibration(
            theta_1=Potentiometer(
                zero_counts=self.theta_1_zero.value, rad_per_count=scale, wraps=base.theta_1.wraps
            ),
            alpha=Potentiometer(
                zero_counts=self.alpha_zero.value,
                rad_per_count=sign * abs(alpha.rad_per_count),
                wraps=alpha.wraps,
            ),
            driver=driver,
            made=replace(made, figures=self.figures()),
        )


def estimate(
    rest: Recording | Readings,
    turns: Recording | Readings | None = None,
    *,
    deflected: Recording | Readings | None = None,
    meter: Sequence[tuple[float, float]] = (),
    meter_std_v: float = 0.01,
    base: Calibration | None = None,
) -> CalibrationEstimate:
    """Estimate a calibration from recordings of a rig, with standard deviations.

    Parameters
    ----------
    rest : Recording or Readings
        Recording at 0 V. The chassis rests at the position of theta_1 = 0, and the arm hangs still.
    turns : Recording or Readings, optional
        Recording at 0 V, then at one or more voltages, each held for a few turns. The voltage at
        which the motor stops is estimated from two or more voltages.
    deflected : Recording or Readings, optional
        Recording at 0 V, during which a hand deflects the arm towards positive alpha. The sign of
        alpha is estimated from `deflected`, or from `turns` if `deflected` shows no deflection.
    meter : sequence of (float, float), optional
        Pairs of a code's voltage and the voltage measured at the motor's terminals, both in V.
    meter_std_v : float, default 0.01
        Standard deviation of a reading of the meter, in V.
    base : Calibration, optional
        Calibration with the approximate rad per count of alpha, which converts the deflection in
        `deflected` to rad.

    Raises
    ------
    InputError
        The recordings do not determine a calibration: for example, the shaft did not turn in one
        direction, or rested in the dead band.
    """
    still = _at_rest(rest)
    run = None if turns is None else readings_of(turns)
    runs = [still] if run is None else [still, run]
    step = resolution(*(r.first for r in runs), *(r.second for r in runs))
    turned = None if run is None else turning(run, step)
    theta_1, alpha = spread(still.first, step), spread(still.second, step)
    if turned is None:
        noise_1, noise_2 = (noise_before_rounding(s.value**2, step) for s in (theta_1, alpha))
    else:
        # The spread at rest depends on the position of the readings in a step of the converter. The
        # spread over whole turns does not depend on this position. One converter reads both angles,
        # so the noise of theta_1 over turns is also the noise of alpha.
        noise_1 = noise_2 = noise_before_rounding(turned.residual_variance, step)
    alpha_zero = mean_reading(still.second, step, noise_2)
    sign = 0
    if deflected is not None:
        scale = (base or Calibration()).alpha.rad_per_count
        sign = sign_by_hand(readings_of(deflected), alpha_zero, scale)
    if not sign and run is not None:
        sign = sign_of_lag(run, alpha.value, step)
    terminal = terminal_voltage(meter, meter_std_v)
    return CalibrationEstimate(
        theta_1_zero=mean_reading(still.first, step, noise_1),
        theta_1_noise=theta_1,
        alpha_zero=alpha_zero,
        alpha_noise=alpha,
        alpha_sign=sign,
        resolution=step,
        turned=turned,
        speeds=None if turned is None else speeds(turned, terminal or IDEAL_DRIVER),
        terminal=terminal,
        warnings=(*_warnings(theta_1, alpha, step, turned, sign), *_overvoltage(terminal)),
    )


def _at_rest(source: Recording | Readings) -> Readings:
    """Return the readings at rest; refuse readings of a driven motor and readings at a rail."""
    still = readings_of(source)
    if (still.u != 0).any():
        raise InputError("the motor was driven in the recording at rest: all voltages must be 0 V")
    if still.N < 2:
        raise InputError(
            f"the recording at rest has {plural(still.N, 'sample')}: record a second or more"
        )
    for name, counts, way_out in (
        (THETA_1, still.first, "turn the chassis out of the dead band"),
        (ALPHA, still.second, "check its wires and that the arm hangs free"),
    ):
        if at_rail(counts).any():
            raise InputError(
                f"{name} reads {counts.mean():.0f} of 65535 at rest, at an end of its range: "
                f"{way_out}, then record at rest again"
            )
    return still


def _overvoltage(terminal: TerminalVoltage | None) -> list[str]:
    """Return a warning, with its remedy, if the driver's voltage exceeds the rig's limit."""
    offset, gain = (terminal or IDEAL_DRIVER).line
    most = offset + gain * U_MAX_V
    if most <= U_MAX_V * _METER_TOLERANCE:
        return []
    return [
        f"a code of {U_MAX_V:g} V applies {most:.2f} V to the motor, and more than {U_MAX_V:g} V "
        f"destroys the rig: set limits.u_max_v = {(U_MAX_V - offset) / gain:.2f} or less"
    ]


def _warnings(
    theta_1: MeasuredValue, alpha: MeasuredValue, step: int, turned: Turning | None, sign: int
) -> list[str]:
    warnings = [
        f"{name} moved in the recording at rest: the standard deviation of its readings is "
        f"{s.value:.0f} counts, {degrees(s.value * tau / 65536):.1f}°"
        for name, s in ((THETA_1, theta_1), (ALPHA, alpha))
        if s.value > _MAX_REST_STEPS * step
    ]
    if not sign:
        warnings.append("no deflection of the arm was seen: alpha keeps the configured sign")
    if turned is not None:
        expected = sqrt(theta_1.value**2 + rounding_variance(step, 0.0))
        off = sqrt(turned.residual_variance)
        if off > MAX_STEADY_RATIO * expected:
            warnings.append(
                f"theta_1 deviates from a constant speed by {off:.0f} counts rms, and its "
                f"noise explains {expected:.0f} counts: the angle of a count is less accurate than "
                "its standard deviation indicates"
            )
    return warnings


def sign_of_lag(readings: Readings, noise: float, step: float) -> int:
    """Return the sign of alpha's rad per count; 0 if no deflection of the arm was seen.

    When the motor accelerates the chassis from rest towards positive angles, the arm lags. alpha is
    therefore negative at first. The run must begin at 0 V and at rest. `noise` is the standard
    deviation of alpha's readings at rest, and `step` the step of the converter, both in counts.
    """
    driven = np.flatnonzero(readings.u > 0)
    if not driven.size or driven[0] == 0:
        return 0
    deflection = readings.second - readings.second[: driven[0]].mean()
    seen = np.flatnonzero(np.abs(deflection) > CLEAR * noise + step)
    seen = seen[seen > driven[0]]
    return 0 if not seen.size else int(-np.sign(deflection[seen[0]]))


def sign_by_hand(readings: Readings, rest_reading: MeasuredValue, rad_per_count: float) -> int:
    """Return the sign of alpha's rad per count; 0 if the arm was deflected by less than `HAND_RAD`.

    In the run, a hand deflects the arm towards positive alpha, then holds or releases it.
    `rest_reading` is
    the reading of the arm at rest, in counts. The sign of the approximate `rad_per_count` is
    ignored.
    """
    deflection = (readings.second - rest_reading.value) * abs(rad_per_count)
    # If a hand holds the arm, one quartile is far from 0. A released arm swings to both sides.
    low, high = np.quantile(deflection, [0.25, 0.75])
    farthest = max(low, high, key=abs)
    return 0 if abs(farthest) < HAND_RAD else int(np.sign(farthest))
