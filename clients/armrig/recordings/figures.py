"""Figures of a recording's timing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from armrig.canvas import BLUE, SKY, VERMILION, axes, finish, short, sign
from armrig.recordings.jitter import jitter_us, lateness_us

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.recordings.recording import Recording


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
    # Times below the clock's resolution stand at the left edge.
    floor = 0.5 if quantity == "jitter" else 0.1
    marks = np.percentile(x, (50, 99, 100)) if x.size else ()
    x = np.maximum(x, floor)
    top = max(float(x.max(initial=floor)) * 1.3, floor * 20)
    edges = np.geomspace(floor, top, 41)
    # The device's clock ticks in µs. Bins between two ticks would be empty and show a comb.
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
