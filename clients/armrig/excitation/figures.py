"""Figure of an input before a run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.plots.layout import BLUE, INK, SKY, finish, hertz

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from armrig.excitation.input_description import InputDescription

Vector = NDArray[np.float64]

_MAX_SHOWN_SAMPLES = 1000  # more samples would look like a solid bar


def plot_input(description: InputDescription) -> Figure:
    """Return a figure of an input: its first samples, its spectrum, and the time at each level."""
    from matplotlib import pyplot as plt

    d = description
    figure, (time, spectrum, levels) = plt.subplots(
        3, 1, figsize=(6.5, 7.0), height_ratios=(1, 1.2, 0.8), layout="constrained"
    )
    shown = min(_MAX_SHOWN_SAMPLES, d.u.size)
    whole = "" if shown == d.u.size else f", the first {shown} of {d.u.size} samples"
    time.step(d.Ts * np.arange(shown), d.u[:shown], where="post", color=INK, lw=0.8)
    time.set_xlabel(f"$t$ [s]{whole}")
    time.set_ylabel("$u$ [V]")
    if d.omega.size and d.std > 0:
        # Omit both ends: a logarithmic axis has no 0, and the density at Nyquist is not doubled.
        omega, density = d.omega[1:-1], d.spectrum[1:-1]
        spectrum.plot(omega, np.maximum(density, 1e-300), color=BLUE, lw=1.0)
        spectrum.set_xscale("log")
        spectrum.set_yscale("log")
        top = float(density.max())
        bottom = max(float(density.min()), 1e-8 * top)
        spectrum.set_ylim(bottom / 2, 2 * top)
        spectrum.set_xlim(float(omega[0]), np.pi / d.Ts)
        hertz(spectrum)
    else:
        spectrum.text(
            0.5, 0.5, "no power except the mean's", ha="center", transform=spectrum.transAxes
        )
    spectrum.set_xlabel(r"$\omega$ [rad/s], up to the Nyquist frequency")
    spectrum.set_ylabel("power [V² s/rad]")
    span = float(np.ptp(d.levels)) or 1.0
    width = span / 10 if d.binned else span / 40
    levels.bar(d.levels, 100 * d.shares, width=width, color=SKY, edgecolor=BLUE, lw=0.5)
    levels.set_xlabel("$u$ [V]")
    levels.set_ylabel("time [%]")
    at_least = "at least " if d.order == d.highest_order else ""
    time.set_title(
        f"crest factor {d.crest_factor:.2f}, persistently exciting of order {at_least}{d.order}",
        loc="left",
        fontsize="medium",
    )
    for panel in (time, spectrum, levels):
        finish(panel)
    return figure
