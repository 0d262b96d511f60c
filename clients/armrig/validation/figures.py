"""Figures of models against data: outputs, errors, residuals, and the search over structures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.models.fit import Fit
from armrig.models.labels import Labels
from armrig.plots.captions import legend
from armrig.plots.layout import COLOURS, GREY, INK, axes, finish, logarithmic
from armrig.validation.comparison import ComparisonTable, compare
from armrig.validation.comparison_figure import plot_comparison
from armrig.validation.residual_figure import plot_residual_test
from armrig.validation.residuals import residuals

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.data.dataset import Dataset, Signals
    from armrig.models.fit import Fit
    from armrig.validation.search_result import SearchResult

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
