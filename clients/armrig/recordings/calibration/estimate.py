"""A calibration from recordings: a rest, a few slow turns, and readings of a meter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, hypot, sqrt, tau
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.calibration import Calibration, Driver, Figure, Made, Potentiometer
from armrig_core.errors import InputError
from armrig_core.telemetry import ALPHA, THETA_1
from armrig_core.volts import U_MAX_V
from msgspec.structs import replace

from armrig.numerics.quantities import plural
from armrig.recordings.calibration.motor import (
    IDEAL_DRIVER,
    Speeds,
    TerminalVoltage,
    speeds,
    terminal_voltage,
)
from armrig.recordings.calibration.readings import (
    Readings,
    at_rail,
    mean_reading,
    noise_before_rounding,
    readings_of,
    resolution,
    rounding_variance,
    spread,
)
from armrig.recordings.calibration.rotation import Turning, turning

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

    from armrig.recordings.recording import Recording


_UNSTEADY = 1.5  # residuals at constant speed over what noise and rounding explain
_METER_MAY_ERR = 1.005  # what a common meter's reading is uncertain by
_MOVED = 10.0  # spread of readings at rest, in steps of the converter
CLEAR = 8.0
"""Deflections are told from noise of so many standard deviations, and a step beside."""
HAND_RAD = 0.02
"""Shortest deflection by hand that counts, in rad: a touch says nothing."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimate:
    """What the recordings say; None for what they cannot say."""

    theta_1_zero: Figure
    """Reading where the chassis stood at rest, which is theta_1 = 0, in counts."""
    theta_1_noise: Figure
    """Standard deviation of theta_1's readings at rest, in counts."""
    alpha_zero: Figure
    """Reading of the arm at rest, which is alpha = 0, in counts."""
    alpha_noise: Figure
    """Standard deviation of alpha's readings at rest, in counts."""
    alpha_sign: int
    """Sign of alpha for growing counts; 0 where it was not seen."""
    resolution: int
    """The converter's step, in counts."""
    turned: Turning | None
    """theta_1's potentiometer over whole turns."""
    speeds: Speeds | None
    """Of the motor; None for fewer than two voltages."""
    terminal: TerminalVoltage | None
    """Of the driver; None without a meter."""
    warnings: tuple[str, ...]
    """What speaks against it, one sentence each."""

    @property
    def rad_per_count(self) -> Figure | None:
        """Angle of one count of theta_1, in rad."""
        if self.turned is None:
            return None
        d = self.turned.per_turn
        size = tau / d.value
        return Figure(value=self.turned.direction * size, std=size * d.std / d.value)

    @property
    def dead_band(self) -> Figure | None:
        """Angle over which theta_1 shows nothing, in rad."""
        if self.turned is None:
            return None
        low, high, d = self.turned.low, self.turned.high, self.turned.per_turn
        share = (high.value - low.value) / d.value
        std = hypot(low.std, high.std, share * d.std) / d.value
        return Figure(value=tau * (1 - share), std=tau * std)

    def plot(self, turns: Recording | Readings, *, ax: Axes | None = None) -> Drawing:
        """Return a figure of what the turns say: see `armrig.plots.plot_calibration`."""
        from armrig.plots.layout import figure_of
        from armrig.recordings.calibration.figures import plot_calibration

        return figure_of(plot_calibration(self, turns, ax=ax))

    def figures(self) -> dict[str, Figure]:
        """Return all that was measured, by names that end in their units."""
        found: dict[str, Figure | None] = {
            "theta_1_zero_counts": self.theta_1_zero,
            "theta_1_noise_counts": self.theta_1_noise,
            "theta_1_rad_per_count": self.rad_per_count,
            "theta_1_dead_band_rad": self.dead_band,
            "alpha_zero_counts": self.alpha_zero,
            "alpha_noise_counts": self.alpha_noise,
            "resolution_counts": Figure(value=float(self.resolution), std=0.0),
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
        """Return the calibration; what was not measured is that of `base`.

        Parameters
        ----------
        base : Calibration
            Such as the one in force until now: alpha's rad per count is always its.
        made : Made
            How the recordings came about; gets the figures.
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
) -> Estimate:
    """Estimate a calibration from recordings of a rig, with standard deviations.

    Parameters
    ----------
    rest : Recording or Readings
        0 V, the chassis standing where theta_1 is to be 0, the arm hanging still.
    turns : Recording or Readings, optional
        0 V, then one voltage or more, each held for a few turns: two or more tell the voltage at
        which the motor stands.
    deflected : Recording or Readings, optional
        0 V, the arm held by hand towards positive alpha: its sign where the turns do not show it.
    meter : sequence of (float, float), optional
        Voltage of a code and that of the motor's terminals, both in V.
    meter_std_v : float, default 0.01
        Standard deviation of a reading of the meter, in V.
    base : Calibration, optional
        About how much a count of alpha is, for its deflection by hand.

    Raises
    ------
    InputError
        The recordings cannot say it: the shaft did not turn on, or stood in the dead band.
    """
    still = _at_rest(rest)
    run = None if turns is None else readings_of(turns)
    runs = [still] if run is None else [still, run]
    step = resolution(*(r.theta_1 for r in runs), *(r.alpha for r in runs))
    turned = None if run is None else turning(run, step)
    theta_1, alpha = spread(still.theta_1, step), spread(still.alpha, step)
    if turned is None:
        noise_1, noise_2 = (noise_before_rounding(s.value**2, step) for s in (theta_1, alpha))
    else:
        # The spread at rest depends on where in a step the readings are; over whole turns it does
        # not. One converter reads both angles, so that both have this noise.
        noise_1 = noise_2 = noise_before_rounding(turned.residual_variance, step)
    alpha_zero = mean_reading(still.alpha, step, noise_2)
    sign = 0
    if deflected is not None:
        scale = (base or Calibration()).alpha.rad_per_count
        sign = sign_by_hand(readings_of(deflected), alpha_zero, scale)
    if not sign and run is not None:
        sign = sign_of_lag(run, alpha.value, step)
    terminal = terminal_voltage(meter, meter_std_v)
    return Estimate(
        theta_1_zero=mean_reading(still.theta_1, step, noise_1),
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


def _at_rest(rest: Recording | Readings) -> Readings:
    """Return the readings at rest; refuse a rest that was driven, or shows no angle."""
    still = readings_of(rest)
    if (still.u != 0).any():
        raise InputError("the recording at rest was driven: it must be at 0 V throughout")
    if still.N < 2:
        raise InputError(f"the rest has {plural(still.N, 'sample')}: record a second or more")
    for name, counts, way_out in (
        (THETA_1, still.theta_1, "turn the chassis out of the dead band"),
        (ALPHA, still.alpha, "see to its wires, and that the arm hangs free"),
    ):
        if at_rail(counts).any():
            raise InputError(
                f"{name} reads {counts.mean():.0f} of 65535 at rest, an end of its range: "
                f"{way_out}, then record the rest again"
            )
    return still


def _overvoltage(terminal: TerminalVoltage | None) -> list[str]:
    """Return what to do about a driver that gives more than the rig stands."""
    offset, gain = (terminal or IDEAL_DRIVER).line
    most = offset + gain * U_MAX_V
    if most <= U_MAX_V * _METER_MAY_ERR:
        return []
    return [
        f"at the code of {U_MAX_V:g} V the motor gets {most:.2f} V, and beyond {U_MAX_V:g} V the "
        f"rig is destroyed: set limits.u_max_v = {(U_MAX_V - offset) / gain:.2f} or less"
    ]


def _warnings(
    theta_1: Figure, alpha: Figure, step: int, turned: Turning | None, sign: int
) -> list[str]:
    found = [
        f"{name} moved while it was to rest: its readings spread by {s.value:.0f} counts, "
        f"{degrees(s.value * tau / 65536):.1f}°"
        for name, s in ((THETA_1, theta_1), (ALPHA, alpha))
        if s.value > _MOVED * step
    ]
    if not sign:
        found.append("the arm was not seen to deflect: alpha's sign is the one configured")
    if turned is not None:
        expected = sqrt(theta_1.value**2 + rounding_variance(step, 0.0))
        off = sqrt(turned.residual_variance)
        if off > _UNSTEADY * expected:
            found.append(
                f"theta_1 is {off:.0f} counts rms off a constant speed, where its noise explains "
                f"{expected:.0f}: the angle of a count is less certain than its standard deviation "
                "says"
            )
    return found


def sign_of_lag(readings: Readings, noise: float, step: float) -> int:
    """Return the sign of alpha for growing counts, 0 where the arm was not seen to deflect.

    When the motor sets the chassis in motion from rest, towards positive angles, the arm stays
    behind: alpha is negative first.

    Parameters
    ----------
    readings : Readings
        A run that begins at 0 V and at rest.
    noise : float
        Standard deviation of alpha's readings at rest, in counts.
    step : float
        The converter's step, in counts.
    """
    driven = np.flatnonzero(readings.u > 0)
    if not driven.size or driven[0] == 0:
        return 0
    deflection = readings.alpha - readings.alpha[: driven[0]].mean()
    seen = np.flatnonzero(np.abs(deflection) > CLEAR * noise + step)
    seen = seen[seen > driven[0]]
    return 0 if not seen.size else int(-np.sign(deflection[seen[0]]))


def sign_by_hand(readings: Readings, rest: Figure, rad_per_count: float) -> int:
    """Return the sign of alpha for growing counts; 0 where the arm was deflected either way or not.

    Parameters
    ----------
    readings : Readings
        The arm deflected by hand towards positive alpha, and let go or held.
    rest : Figure
        Reading at rest, in counts.
    rad_per_count : float
        About how much a count is, in rad; the sign does not matter.
    """
    deflection = (readings.alpha - rest.value) * abs(rad_per_count)
    # Quantiles count the time in which the arm is held; once let go it swings either way.
    low, high = np.quantile(deflection, [0.25, 0.75])
    farthest = max(low, high, key=abs)
    return 0 if abs(farthest) < HAND_RAD else int(np.sign(farthest))
