"""Figures of a recording: its timing and its overview; figure of a calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Literal

import numpy as np
from armrig_core.errors import InputError
from armrig_core.telemetry.channels import ALPHA, THETA_1, VELOCITY

from armrig.data.columns import Vector
from armrig.numerics.quantities import scaled, three_digits, with_std
from armrig.plots.captions import NAMES, legend, sign
from armrig.plots.layout import (
    BLUE,
    GREY,
    INK,
    SKY,
    VERMILION,
    axes,
    finish,
    logarithmic,
    panels,
    rows,
    shade,
)
from armrig.recordings.calibration_readings import Readings, readings_of
from armrig.recordings.calibration_turns import IDEAL_DRIVER, Speeds, TerminalVoltage, Turning
from armrig.recordings.jitter import jitter_us, lateness_us

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.recordings.calibration import Estimate
    from armrig.recordings.recording import Recording


_RESOLUTION_US = 1.0  # of the device's clock
Quantity = Literal["jitter", "lateness"]
_TIMES: dict[Quantity, tuple[Callable[[Recording], Vector], str]] = {
    "jitter": (jitter_us, r"$|\Delta t - T_s|$ on the device's clock [µs]"),
    "lateness": (lateness_us, "host's lateness [µs]"),
}


def varying_times(recording: Recording) -> list[Quantity]:
    """Return the quantities of `plot_timing` whose values differ by the clock's resolution."""
    return [quantity for quantity, (times, _) in _TIMES.items() if _varies(times(recording))]


def _varies(x: Vector) -> bool:
    return bool(x.size) and float(np.ptp(x)) >= _RESOLUTION_US


def plot_timing(
    recording: Recording,
    *,
    quantity: Quantity = "jitter",
    ax: Axes | None = None,
) -> Axes:
    """Plot the histogram of jitter or lateness, and mark its p50, p99 and maximum.

    Both axes are logarithmic. If all values agree within the clock's resolution, the figure
    contains the value as text.

    Parameters
    ----------
    quantity : {"jitter", "lateness"}
        "jitter": |interval - Ts| on the device's clock. "lateness": lateness of
        the host's request, or of the sample's arrival if the device paces the samples.
    """
    ax = axes(ax)
    times, label = _TIMES[quantity]
    x = times(recording)
    if not _varies(x):
        return _write_the_same(ax, recording, x, label)
    marks = np.percentile(x, (50, 99, 100))
    # Times below the clock's resolution are drawn at the left edge.
    least = 0.5 if quantity == "jitter" else 0.1
    floor = max(least, 0.5 * float(x.min()))
    x = np.maximum(x, floor)
    top = max(float(x.max()) * 1.3, floor * 20)
    edges = np.geomspace(floor, top, 41)
    # The device's clock ticks in µs: bins between two ticks would be empty.
    bins = np.unique(np.round(edges)) + 0.5 if quantity == "jitter" else edges
    bins = np.insert(bins, 0, floor) if bins[0] > floor else bins
    ax.hist(x, bins=bins.tolist(), color=SKY, edgecolor=BLUE, lw=0.5)
    logarithmic(ax.xaxis, floor, top)
    ax.set_yscale("log")
    ax.set_xlim(floor, top)
    ax.set_ylim(bottom=0.6)
    for name, value, dash in zip(("p50", "p99", "max"), marks, (":", "--", "-"), strict=False):
        text = f"{name} {three_digits(value)} µs"
        ax.axvline(max(value, floor), color=VERMILION, ls=dash, lw=1.1, label=text)
    ax.set_xlabel(label)
    ax.set_ylabel("samples")
    finish(ax)
    return sign(ax, recording.sha256, above=legend(ax))


def _write_the_same(ax: Axes, recording: Recording, x: Vector, label: str) -> Axes:
    """Write the common value of all times instead of a histogram, which would be a single bar."""
    text = "no samples"
    if x.size:
        median = three_digits(float(np.median(x)))
        text = f"{x.size} samples, all\n{median} µs, to the microsecond"
    ax.text(0.5, 0.5, text, ha="center", va="center", transform=ax.transAxes)
    ax.set(xticks=[], yticks=[], xlabel=label, ylabel="samples")
    finish(ax)
    return sign(ax, recording.sha256)


def plot_overview(
    rec: Recording, outliers: Mapping[str, Vector], *, ax: Axes | None = None
) -> Axes:
    """Plot u, theta_1, the rate of theta_1 and alpha against time.

    In the panels of the angles and of the rate, times without a valid value are shaded. In the
    panel of u, times are shaded where theta_1 or alpha has no valid value. Rings mark outliers.
    """
    if not rec.N:
        raise InputError(
            f"{rec.path}: contains no samples, so there is nothing to draw; record again"
        )
    every = rows(ax, 4)
    ax, first, last = every[0], float(rec.t[0]), float(rec.t[-1])
    rate = np.diff(rec.theta_1, prepend=np.nan) / rec.Ts
    ax.step(rec.t, rec.u, where="post", color=INK, lw=0.7)
    shade(ax, rec.valid & rec.valid_alpha, rec.Ts, first=first)
    signals = (
        (THETA_1, rec.theta_1, rec.valid, f"{NAMES[THETA_1]} [rad]"),
        (VELOCITY, rate, rec.valid, f"{NAMES[VELOCITY]} [rad/s]"),
        (ALPHA, rec.alpha, rec.valid_alpha, f"{NAMES[ALPHA]} [rad]"),
    )
    ax.set_ylabel("$u$ [V]")
    for panel, (name, y, valid, label) in zip(every[1:], signals, strict=True):
        panel.plot(rec.t, y, color=BLUE, lw=0.7)
        panel.set_ylabel(label)
        shade(panel, valid, rec.Ts, first=first)
        _ring(panel, rec.t, y, outliers.get(name, np.zeros(0)))
    every[-1].set_xlabel("$t$ [s]")
    finish(*every, xlim=(first, last if last > first else first + 1.0))
    return sign(ax, rec.sha256, above=legend(ax))


def _ring(panel: Axes, t: Vector, y: Vector, times: Vector) -> None:
    """Draw a ring around the sample of a signal at each of the times."""
    at = np.searchsorted(t, times)
    if at.size:
        label = f"{at.size} outliers" if at.size > 1 else "an outlier"
        panel.plot(times, y[at], "o", mfc="none", mec=VERMILION, ms=7, label=label)
        panel.legend(loc="upper right", fontsize="small")


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
