"""Figures of a recording: its timing and its overview."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from armrig_core.errors import InputError

from armrig.data.columns import Vector
from armrig.numerics.quantities import digits, plural
from armrig.numerics.stretches import Mask
from armrig.plots.captions import legend, sign, symbol_of
from armrig.plots.layout import (
    BLUE,
    INK,
    SKY,
    VERMILION,
    axes,
    finish,
    logarithmic,
    rows,
    shade,
)
from armrig.recordings.jitter import jitter_us, lateness_us

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.recordings.recording import Recording


_RESOLUTION_US = 1.0  # of the device's clock
Quantity = Literal["jitter", "lateness"]
_TIMES: dict[Quantity, tuple[Callable[[Recording], Vector], str]] = {
    "jitter": (jitter_us, r"$|\Delta t - T_s|$ on the device's clock [µs]"),
    "lateness": (lateness_us, "lateness at the host [µs]"),
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
    if not _varies(x):  # a histogram would be a single bar
        text = "no samples"
        if x.size:
            text = (
                f"{plural(x.size, 'sample')}, all\n{digits(float(np.median(x)), 3)} µs, to "
                "the microsecond"
            )
        ax.text(0.5, 0.5, text, ha="center", va="center", transform=ax.transAxes)
        ax.set(xticks=[], yticks=[], xlabel=label, ylabel="samples")
        finish(ax)
        return sign(ax, recording.sha256)
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
        text = f"{name} {digits(value, 3)} µs"
        ax.axvline(max(value, floor), color=VERMILION, ls=dash, lw=1.1, label=text)
    ax.set_xlabel(label)
    ax.set_ylabel("samples")
    finish(ax)
    return sign(ax, recording.sha256, above=legend(ax))


def plot_overview(
    rec: Recording, outliers: Mapping[str, Vector], *, ax: Axes | None = None
) -> Axes:
    """Plot u, the channels and their rates against time.

    In the panels of the channels and rates, times without a valid value are shaded. In the panel of
    u, times are shaded where any channel has no valid value. Rings mark outliers.
    """
    if not rec.N:
        raise InputError(
            f"{rec.path}: contains no samples, so there is nothing to draw; record again"
        )
    signals: list[tuple[str, str, Vector, Mask]] = []
    for channel in rec.description.channels:
        y, valid = rec.channel(channel.name)
        signals.append((channel.name, channel.unit, y, valid))
        if channel.rate:
            rate = np.diff(y, prepend=np.nan) / rec.Ts
            signals.append((channel.rate, f"{channel.unit}/s", rate, valid))
    every = rows(ax, 1 + len(signals))
    ax, first, last = every[0], float(rec.t[0]), float(rec.t[-1])
    u_signal = rec.description.input
    ax.step(rec.t, u_signal.value(rec.u), where="post", color=INK, lw=0.7)
    turns = any(channel.turns for channel in rec.description.channels)
    how: dict[str, Any] = {"first": first, "dead_band": turns}
    shade(ax, np.logical_and.reduce([valid for *_, valid in signals]), rec.Ts, **how)
    ax.set_ylabel(
        f"{'$u$' if u_signal.name == 'u' else symbol_of(u_signal.name)} [{u_signal.unit}]"
    )
    for panel, (name, unit, y, valid) in zip(every[1:], signals, strict=True):
        panel.plot(rec.t, y, color=BLUE, lw=0.7)
        panel.set_ylabel(f"{symbol_of(name)} [{unit}]")
        shade(panel, valid, rec.Ts, **how)
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
