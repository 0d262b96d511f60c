"""Figures of grey-box estimates: against data, and of the split study."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.telemetry.channels import ARM_OUTPUTS

from armrig.data.figures import without_ramp
from armrig.numerics.quantities import join_names, plural, superscript, with_unit
from armrig.physics.grey_box.physical_models import UNITS
from armrig.plots.captions import legend, sign, symbol
from armrig.plots.layout import (
    BLUE,
    GREY,
    MISSING,
    VERMILION,
    axes,
    finish,
    logarithmic,
    panels,
    shade,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.data.dataset import Dataset
    from armrig.physics.grey_box.fit import GreyFit
    from armrig.physics.grey_box.split_study import SplitStudy


def plot_greybox(fit: GreyFit, data: Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the measured and the simulated output; below, plot the error of the simulation.

    Initial state and offset of the simulation are fitted to the data. The simulation contains no
    Coulomb friction, so that the error contains the effect of Coulomb friction.
    """
    ax, below = panels(ax, 0.38)
    e = fit.errors(data)[:, 0]
    estimates = ", ".join(
        f"{symbol(n)} = {with_unit(fit.values[n], fit.std[n], fit.physics.parameters[n].unit)}"
        for n in fit.names
    )
    ramp, label, notes = without_ramp(data)
    ax.plot(data.t, data.y - ramp, color=MISSING, lw=3.0, label="measured")
    ax.plot(data.t, data.y - e - ramp, color=BLUE, lw=1.0, label=f"grey box, {estimates}")
    below.plot(data.t, e, color=BLUE, lw=0.6)
    below.axhline(0, color=GREY, lw=0.6)
    ax.set_ylabel(label)
    below.set_ylabel(f"error [{data.unit or '–'}]")
    below.set_xlabel("$t$ [s]")
    for panel in (ax, below):
        shade(panel, data.valid, data.Ts, dead_band=data.output in ARM_OUTPUTS)
    finish(ax, below, xlim=(0.0, float(data.t[-1]) or 1.0))
    return sign(ax, data.source, above=legend(ax, *notes))


def plot_split(study: SplitStudy, *, ax: Axes | None = None) -> Axes:
    """Plot the estimates ±2 standard deviations; below, plot the standard deviations against N.

    A cross marks the scatter of the parts. The scatter of four parts has three degrees of freedom,
    and its 95 % interval is wide. For two parts no cross is drawn, because the interval would
    exceed the figure.
    """
    ax, below = panels(axes(ax), 0.5, sharex=False)
    unit = UNITS.get(study.parameter, "")
    size, of_std = (
        10.0 ** (3 * np.floor(np.log10(np.abs(np.concatenate(v)).max()) / 3))
        for v in ([s.values for s in study.splits], [s.std for s in study.splits])
    )
    x = 0.0
    ticks: list[tuple[float, str]] = []
    for s in study.splits:
        place = x + np.arange(s.k)
        value, std = (part / size for part in s.pooled)
        bars: dict[str, Any] = {"fmt": "o", "color": BLUE, "ms": 4, "lw": 1.0, "capsize": 3}
        each, all_ = (
            ("each part ±2 σ", "weighted mean of the parts ±2 σ") if not ticks else (None, None)
        )
        ax.errorbar(place, s.values / size, 2 * s.std / size, label=each, **bars)
        edge = (place[0] - 0.4, place[-1] + 0.4)
        band: dict[str, Any] = {"color": VERMILION, "alpha": 0.2, "lw": 0, "label": all_}
        ax.fill_between(edge, value - 2 * std, value + 2 * std, **band)
        ax.plot(edge, [value, value], color=VERMILION, ls="--", lw=1.0)
        ticks.append((float(place.mean()), plural(s.k, "part")))
        x += s.k + 1
    ax.set_xticks([t for t, _ in ticks], [name for _, name in ticks])
    ax.set_ylabel(f"{symbol(study.parameter)} [{_of(size, unit)}]")
    N = np.concatenate([s.N for s in study.splits])
    reported = np.concatenate([s.std for s in study.splits]) / of_std
    line = np.geomspace(N.min() / 1.2, N.max() * 1.2, 20)
    law = float(np.mean(reported * np.sqrt(N)))
    below.plot(line, law / np.sqrt(line), color=GREY, ls="--", lw=1.0, label=r"law $1/\sqrt{N}$")
    below.plot(N, reported, "o", color=BLUE, ms=4, label="σ of each estimate")
    if several := [s for s in study.splits if s.k > 2]:
        scatter = np.array([s.scatter for s in several]) / of_std
        interval = np.array([s.scatter_interval for s in several]).T / of_std
        below.errorbar(
            [float(s.N.mean()) for s in several],
            scatter,
            np.abs(interval - scatter),
            fmt="x",
            color=VERMILION,
            ms=7,
            mew=1.5,
            lw=1.0,
            capsize=3,
            label=f"scatter of {join_names([str(s.k) for s in several])} parts, 95 % interval",
        )
    below.set_xscale("log")
    below.set_yscale("log")
    places = sorted({float(n) for s in study.splits for n in [s.N.mean()]})
    below.set_xticks(places, [f"{n:.0f}" for n in places])
    below.minorticks_off()
    low, high = below.get_ylim()
    margin = max(1.0, float(np.sqrt(5 * low / high)))  # a factor of 5 has two of 1, 2, 5, 10
    logarithmic(below.yaxis, low / margin, high * margin)
    below.set_xlabel("samples $N$")
    below.set_ylabel(f"σ [{_of(of_std, unit)}]")
    finish(ax)
    finish(below)
    legend(below)
    return sign(ax, study.source, above=legend(ax))


def _of(size: float, unit: str) -> str:
    """Return a power of ten and a unit as text, such as 10⁻³ kg m², or "–" if both are empty."""
    exponent = round(float(np.log10(size)))
    power = f"10{superscript(exponent)}" if exponent else ""
    return f"{power} {unit}".strip() or "–"
