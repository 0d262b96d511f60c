"""Figure of a calibration: the potentiometer over its turns, and the motor's speeds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.numerics.quantities import scaled, with_std
from armrig.plots.captions import legend
from armrig.plots.layout import BLUE, GREY, INK, VERMILION, finish, panels
from armrig.recordings.calibration.motor import IDEAL_DRIVER, Speeds, TerminalVoltage
from armrig.recordings.calibration.readings import Readings, readings_of
from armrig.recordings.calibration.rotation import Turning

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.recordings.calibration.estimate import Estimate
    from armrig.recordings.recording import Recording

Vector = NDArray[np.float64]


def plot_calibration(
    estimate: Estimate, turns: Recording | Readings, *, ax: Axes | None = None
) -> Axes:
    """Plot theta_1's readings and the edges of its track; below, plot speed against voltage.

    Parameters
    ----------
    turns : Recording or Readings
        Run at constant voltages from which `estimate` was made.

    Raises
    ------
    InputError
        The estimate was made from a recording at rest only.
    """
    turned, size = estimate.turned, estimate.rad_per_count
    if turned is None or size is None:
        raise InputError("no figure of a calibration without turns: record turns with --volts")
    ax, below = panels(ax, 0.45, sharex=False)
    readings = readings_of(turns)
    ax.plot(readings.t, readings.theta_1, ".", color=BLUE, ms=1.5)
    for edge, name, dash in ((turned.low, "low", "--"), (turned.high, "high", "-.")):
        text = f"{name} edge {with_std(edge.value, edge.std)}"
        ax.axhline(edge.value, color=VERMILION, ls=dash, lw=1.0, label=text)
    ax.set_xlim(0.0, float(readings.t[-1]) or 1.0)
    ax.set_xlabel("$t$ [s]")
    ax.set_ylabel(r"$\theta_1$ [counts]")
    _plot_speeds(below, turned, estimate.speeds, estimate.terminal)
    finish(ax)
    finish(below)
    legend(ax, f"one count is {scaled(size.value, size.std, 'rad')}")
    legend(below)
    return ax


def _plot_speeds(
    ax: Axes, turned: Turning, speeds: Speeds | None, terminal: TerminalVoltage | None
) -> None:
    """Plot the speed at each voltage with ±2 σ, and the line through the speeds."""
    offset, gain = (terminal or IDEAL_DRIVER).line
    v = offset + gain * turned.volts
    scale = 2 * np.pi * turned.direction / turned.per_turn.value
    omega = scale * turned.slopes
    std = abs(scale) * np.sqrt(np.diag(turned.covariance)[:-1])
    ax.errorbar(v, omega, 2 * std, fmt="o", color=BLUE, ms=4, lw=1.0, capsize=3, label="measured")
    if speeds is not None:
        stop = speeds.zero_torque.value
        ends = np.array([stop, 1.05 * float(v.max())])
        rate = f"{with_std(speeds.rate.value, speeds.rate.std)} rad/s/V"
        ax.plot(ends, speeds.rate.value * (ends - stop), color=INK, lw=0.9, label=rate)
        at = f"stops at {with_std(stop, speeds.zero_torque.std)} V"
        ax.plot(stop, 0.0, "s", color=VERMILION, ms=5, mfc="none", ls="none", label=at)
    ax.axhline(0, color=GREY, lw=0.6)
    ax.set_xlabel("$u$ at the terminals [V]" if terminal is not None else "$u$ of the code [V]")
    ax.set_ylabel(r"$\dot\theta_1$ [rad/s]")
