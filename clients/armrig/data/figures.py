"""Figures of what was recorded: data and timing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from armrig.canvas import (
    BLUE,
    INK,
    NAMES,
    SKY,
    VERMILION,
    axes,
    finish,
    named,
    panels,
    shade,
    short,
    sign,
)
from armrig.recordings.jitter import jitter_us, lateness_us

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.data.dataset import Dataset
    from armrig.recordings.recording import Recording


def plot_data(source: Recording | Dataset, *, ax: Axes | None = None) -> Axes:
    """Show output and, below it, input against time; where the output is missing is shaded.

    A recording shows theta_1.
    """
    data = _dataset(source)
    ax, below = panels(ax, 0.28)
    for panel in (ax, below):
        shade(panel, data)
    ax.plot(data.t, data.y, color=BLUE, lw=0.9)
    ax.set_ylabel(named(data.output, data.unit))
    below.step(data.t, data.u, where="post", color=INK, lw=0.7)
    below.set_ylabel(f"$u$ [{data.input_unit}]")
    below.set_xlabel("$t$ [s]")
    below.margins(y=0.15)
    finish(ax, below, xlim=(0.0, float(data.t[-1]) or 1.0))
    return sign(ax, data.source)


def plot_spectrum(source: Recording | Dataset, *, ax: Axes | None = None) -> Axes:
    """Show the power density of the output and, below it, of the input, both axes logarithmic.

    Averaged over the stretches without a gap, see `armrig.numerics.power_spectrum`. What
    rises towards the right edge, the Nyquist frequency, was sampled too slowly, or is noise.
    """
    from armrig.numerics.power_spectrum import power_spectrum

    data = _dataset(source)
    ax, below = panels(ax, 0.5)
    for panel, signals, colour, label, unit in (
        (ax, [d.y for d in data.experiments()], BLUE, data.output, data.unit),
        (below, [d.u for d in data.experiments()], INK, "$u$", data.input_unit),
    ):
        omega, density = power_spectrum(signals, data.Ts)
        # Without 0, and without Nyquist's, whose density is one-sided already.
        omega, density = omega[1:-1], density[1:-1]
        panel.plot(omega, np.maximum(density, 1e-300), color=colour, lw=0.9)
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_ylabel(f"{NAMES.get(label, label)} [{squared(unit)}s/rad]")
        shown = density[density > 0]
        if shown.size:
            # A periodic input has nothing between its lines: twelve decades down is nothing.
            panel.set_ylim(max(float(shown.min()), 1e-12 * float(shown.max())) / 2, None)
    below.set_xlabel(r"$\omega$ [rad/s]")
    finish(ax, below, xlim=(float(omega[0]), np.pi / data.Ts))
    return sign(ax, data.source)


def plot_values(source: Recording | Dataset, *, ax: Axes | None = None) -> Axes:
    """Show how often each value of the output and, below it, of the input was taken.

    The counts are logarithmic: a single sample far from all others, an outlier, shows.
    """
    data = _dataset(source)
    ax, below = panels(ax, 0.5, sharex=False)
    for panel, values, colour, label in (
        (ax, data.y[data.valid], BLUE, named(data.output, data.unit)),
        (below, data.u, INK, f"$u$ [{data.input_unit}]"),
    ):
        panel.hist(values, bins=60, color=colour, alpha=0.75)
        panel.set_yscale("log")
        panel.set_ylim(0.6, 6 * panel.get_ylim()[1])  # room for the name
        panel.text(0.5, 0.95, label, ha="center", va="top", transform=panel.transAxes)
        panel.set_ylabel("samples")
        finish(panel)
    return sign(ax, data.source)


def plot_timing(
    recording: Recording,
    *,
    quantity: Literal["jitter", "lateness"] = "jitter",
    ax: Axes | None = None,
) -> Axes:
    """Show the histogram of a time, both axes logarithmic, with its p50, p99 and maximum.

    Parameters
    ----------
    quantity : {"jitter", "lateness"}
        |interval - Ts| on the device's clock, or how late the host asked for each sample.
    """
    ax = axes(ax)
    if quantity == "jitter":
        x, label = jitter_us(recording), r"$|\Delta t - T_s|$ on the device's clock [µs]"
    else:
        x, label = lateness_us(recording), "host's lateness [µs]"
    # What is less than the clock resolves is shown at the left edge.
    floor = 0.5 if quantity == "jitter" else 0.1
    marks = np.percentile(x, (50, 99, 100)) if x.size else ()
    x = np.maximum(x, floor)
    top = max(float(x.max(initial=floor)) * 1.3, floor * 20)
    edges = np.geomspace(floor, top, 41)
    # The device's clock ticks in µs: no bin between two ticks, or the histogram shows its own comb.
    bins = np.unique(np.round(edges)) + 0.5 if quantity == "jitter" else edges
    bins = np.insert(bins, 0, floor) if bins[0] > floor else bins
    ax.hist(x, bins=bins.tolist(), color=SKY, edgecolor=BLUE, lw=0.5)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(floor, top)
    ax.set_ylim(0.6, max(ax.get_ylim()[1] * 6, 20.0))
    for name, value, dash in zip(("p50", "p99", "max"), marks, (":", "--", "-"), strict=False):
        text = f"{name} {short(value)} µs"
        ax.axvline(max(value, floor), color=VERMILION, ls=dash, lw=1.1, label=text)
    ax.set_xlabel(label)
    ax.set_ylabel("samples")
    ax.legend(loc="upper center", ncols=3, handlelength=1.2, columnspacing=0.9, borderpad=0.3)
    finish(ax)
    return sign(ax, recording.sha256)


def squared(unit: str) -> str:
    """Return a unit's square and a space, for an axis; nothing where there is no unit."""
    return f"({unit})² " if "/" in unit else f"{unit}² " if unit else ""


def _dataset(source: Recording | Dataset) -> Dataset:
    from armrig.data.dataset import Dataset

    return source if isinstance(source, Dataset) else source.dataset()
