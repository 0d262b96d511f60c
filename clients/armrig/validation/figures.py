"""Figures of models against data, of the search over structures, and of structure hints."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.estimation.figures import gain_unit
from armrig.models.fit import Fit
from armrig.models.labels import Labels
from armrig.numerics.quantities import minus
from armrig.plots.captions import legend, sign
from armrig.plots.layout import (
    BLUE,
    COLOURS,
    GREY,
    INK,
    SKY,
    VERMILION,
    axes,
    decibel_ticks,
    decibels,
    finish,
    hertz,
    logarithmic,
    panels,
)
from armrig.validation.comparison import ComparisonTable, compare
from armrig.validation.comparison_figure import plot_comparison
from armrig.validation.residual_figure import plot_residual_test
from armrig.validation.residuals import residuals

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.data.dataset import Dataset, Signals
    from armrig.models.fit import Fit
    from armrig.validation.search_result import SearchResult
    from armrig.validation.structure_hints import StructureHints

Vector = NDArray[np.float64]

_MARKERS = "osD^vP"
_MOST = 1000.0  # models with a larger multiple of the least error are counted, but not drawn


def plot_compare(
    data: Dataset | Signals,
    *models: Fit,
    horizon: int | None = None,
    labels: Labels = None,
    table: ComparisonTable | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Show the measured outputs and the models' outputs, simulated unless a horizon is given.

    See `armrig.validation.comparison_figure.plot_comparison`. If `table` is given, the comparison
    is not computed again.
    """
    table = compare(data, *models, horizon=horizon, labels=labels) if table is None else table
    return plot_comparison(data, table.rows, labels=labels, ax=ax)


def plot_residuals(
    fit: Fit,
    data: Dataset | Signals,
    *,
    lags: int | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Show how a model's residuals correlate with each other and with the inputs.

    See `armrig.validation.residual_figure.plot_residual_test`.
    """
    return plot_residual_test(residuals(fit, data, lags), ax=ax)


def plot_structure(hints: StructureHints, *, ax: Axes | None = None) -> Axes:
    """Plot the frequency response with resonances and slopes, and Hankel singular values."""
    ax, below = panels(ax, 0.4, sharex=False)
    s = hints.spectrum
    known = np.isfinite(s.G) & (s.omega > 0)
    w, magnitude = s.omega[known], s.magnitude[known]
    trusted = max(hints.trusted, float(w[0]))
    ax.plot(w, decibels(magnitude), color=BLUE, lw=1.1, label="$|G|$, spectral analysis")
    for slope, at, name, dash in (
        (hints.low_slope, float(w[0]), "low", "--"),
        (hints.high_slope, trusted / 2, "high", "-."),
    ):
        if slope is None:
            continue
        reach = at * np.array([1.0, 4.0]) if name == "low" else at * np.array([0.6, 2.0])
        level = float(np.interp(at, w, magnitude)) * (1.6 if name == "low" else 1.9)
        line = level * (reach / at) ** (slope / 20)
        text = f"slope {minus(f'{slope:.0f}')} dB/decade"
        ax.plot(reach, decibels(line), color=INK, ls=dash, lw=1.0, label=text)
    for marks, marker, name in (
        (hints.resonances, "^", "resonance"),
        (hints.antiresonances, "v", "antiresonance"),
    ):
        x = np.asarray(marks, dtype=np.float64)
        if x.size:
            at_marks = decibels(np.interp(x, w, magnitude))
            ax.plot(x, at_marks, marker, color=VERMILION, ms=6, ls="none", label=name)
    unexplained = (trusted, max(float(w[-1]), trusted))
    ax.axvspan(*unexplained, color=GREY, alpha=0.2, lw=0, label="not explained by the input")
    ax.set_xscale("log")
    seen = decibels(magnitude[w <= trusted])
    ax.set_ylim(float(seen.min()) - 12, float(decibels(magnitude).max()) + 12)
    decibel_ticks(ax)
    ax.set_xlabel(r"$\omega$ [rad/s]")
    ax.set_ylabel(f"$|G|$ [dB re 1 {gain_unit(s)}]")
    values = hints.singular_values[:12]
    index = np.arange(1, values.size + 1)
    below.bar(index, values, color=SKY, edgecolor=BLUE, lw=0.5)
    name = "from noise alone, 95 %"
    below.axhline(hints.threshold, color=VERMILION, ls="--", lw=1.0, label=name)
    below.set_yscale("log")
    below.set_xticks(index)
    below.set_xlabel("state, strongest first")
    below.set_ylabel("Hankel singular\nvalue, relative")
    finish(ax, xlim=(float(w[0]), float(w[-1])))
    finish(below)
    legend(below)
    return sign(ax, s.source, above=legend(ax, lift=hertz(ax)))


def plot_search(found: SearchResult, *, ax: Axes | None = None) -> Axes:
    """Show the error on the validation data against the number of parameters, by structure.

    For each structure, a line joins the points of least error at each number of parameters. A ring
    marks the chosen model.
    """
    ax = axes(ax)
    d = np.array([scored.parameters for scored in found.ranked])
    families = [scored.candidate.family for scored in found.ranked]
    shown = found.rms <= _MOST * float(found.rms[0])
    for k, family in enumerate(dict.fromkeys(sorted(families))):
        mine = np.array([f == family for f in families]) & shown
        colour, marker = COLOURS[k % len(COLOURS)], _MARKERS[k % len(_MARKERS)]
        if not mine.any():
            continue
        ax.plot(d[mine], found.rms[mine], marker, color=colour, ms=3.5, alpha=0.6, mew=0)
        counts = np.unique(d[mine])
        least = [float(found.rms[mine & (d == n)].min()) for n in counts]
        ax.plot(counts, least, marker=marker, color=colour, ms=4.5, lw=1.1, label=family.upper())
    i = found.chosen_index
    at = (float(d[i]), float(found.rms[i]))
    chosen = f"chosen: {found.ranked[i].candidate.name}"
    ax.plot(*at, "o", color=INK, ms=12, mfc="none", mew=1.5, ls="none", label=chosen)
    ax.axhline(at[1], color=GREY, lw=0.6, ls=":")
    logarithmic(ax.yaxis, 0.8 * float(found.rms[0]), 1.3 * float(found.rms[shown].max()))
    ax.locator_params(axis="x", integer=True)
    how = "simulated" if found.horizon is None else f"{found.horizon} ahead"
    ax.set_xlabel("number of parameters")
    ax.set_ylabel(f"rms error, {how} [{found.unit or '–'}]")
    finish(ax)
    off = np.count_nonzero(~shown)
    legend(ax, *([f"{off} more models have over {_MOST:g} times the least error"] if off else []))
    return ax
