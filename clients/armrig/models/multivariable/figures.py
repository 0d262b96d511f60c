"""Figures of models with several inputs and outputs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from armrig.plots.captions import legend, named, sign
from armrig.plots.layout import MISSING, finish, high_axes, pens, rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.models.multivariable.comparison import SignalsComparisonTable


def plot_signals_comparison(table: SignalsComparisonTable, *, ax: Axes | None = None) -> Axes:
    """Plot each measured output and the outputs of all models against time."""
    data = table.data
    panels = rows(ax or high_axes(data.ny), data.ny)
    for i, panel in enumerate(panels):
        panel.plot(data.t, data.y[:, i], color=MISSING, lw=4.5, label="measured")
        for row, pen in zip(table.rows, pens(len(table.rows)), strict=True):
            panel.plot(data.t, row.y[:, i], label=row.name if i == 0 else None, **pen)
        panel.set_ylabel(named(data.outputs[i], data.units[i]))
        fits = ", ".join(f"{row.fit_percent[i]:.1f} %" for row in table.rows)
        panel.annotate(
            f"fit {fits}",
            (1.0, 1.0),
            xycoords="axes fraction",
            ha="right",
            va="bottom",
            fontsize="small",
        )
    panels[-1].set_xlabel("$t$ [s]")
    finish(*panels, xlim=(float(np.min(data.t)), float(np.max(data.t)) or 1.0))
    return sign(panels[0], data.source, above=legend(panels[0]))
