"""Figure of the tests of residuals of several outputs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from armrig.numerics.quantities import p_relation
from armrig.plots.captions import sign
from armrig.plots.layout import BLUE, GREY, VERMILION, axes, finish, stems
from armrig.validation.residual_figure import BAND, BAND_99_PERCENT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.numerics.polynomial import Array
    from armrig.validation.multivariable.residual_test import SignalsResidualTest

COLUMN_WIDTH, ROW_HEIGHT = 2.6, 1.9
"""Size of one panel in inches."""
_HEAD_POINTS = 22.0  # height of two lines above a panel


def plot_signals_residuals(test: SignalsResidualTest, *, ax: Axes | None = None) -> Axes:
    """Show a row for each output: residual autocorrelation, and correlation with each input.

    If the model is true, the value at each lag is inside its band with a probability of 99 %. The p
    values above a panel are from the tests of all its lags together.
    """
    own = ax is None
    ax = axes(ax)
    if own:
        size = COLUMN_WIDTH * (1 + len(test.inputs)), ROW_HEIGHT * len(test.outputs) + 0.4
        ax.figure.figure.set_size_inches(*size)
    place: Any = ax.get_subplotspec()
    grid = place.subgridspec(len(test.outputs), 1 + len(test.inputs))
    ax.set_subplotspec(grid[0, 0])
    panels = []
    for i, output in enumerate(test.outputs):
        panel = ax if i == 0 else ax.figure.add_subplot(grid[i, 0])
        count = max(int(np.count_nonzero(np.isfinite(test.e[:, i]))), 1)
        width = np.full(test.lags.size - 1, BAND_99_PERCENT / np.sqrt(count))
        white = test.white_by_output[i].p_value
        _draw(panel, test.lags[1:], test.autocorrelation[i, i, 1:], width, BLUE)
        _head(panel, f"white: p {p_relation(white)}")
        panel.set_ylabel(f"residuals of\n{output}")
        panels.append(panel)
        for j, input in enumerate(test.inputs):
            panel = ax.figure.add_subplot(grid[i, 1 + j])
            width = BAND_99_PERCENT * test.cross_std[i, j]
            _draw(panel, test.cross_lags, test.cross_correlation[i, j], width, VERMILION)
            panel.axvline(-0.5, color=GREY, lw=0.6, ls=":")
            dynamics = p_relation(float(test.missing_dynamics_by_pair[i, j]))
            feedback = p_relation(float(test.feedback_by_pair[i, j]))
            _head(panel, f"dynamics from {input}: p {dynamics}\nfeedback: p {feedback}")
            panels.append(panel)
    for panel in panels[-1 - len(test.inputs) :]:
        panel.set_xlabel("lag [samples]")
    finish(*panels)
    return sign(panels[len(test.inputs)], test.source, above=_HEAD_POINTS)


def _head(panel: Axes, text: str) -> None:
    """Write the p values above a panel, to the right of its letter."""
    panel.annotate(
        text,
        (0.0, 1.0),
        xycoords="axes fraction",
        xytext=(4.0, 3.0),
        textcoords="offset points",
        va="bottom",
        fontsize="x-small",
    )


def _draw(panel: Axes, lags: Array, values: Array, width: Array, colour: str) -> None:
    panel.fill_between(lags, -width, width, step="mid", color=GREY, alpha=0.25, lw=0, label=BAND)
    stems(panel, lags, values, colour)
    reach = 1.15 * max(float(np.nanmax(np.abs(values), initial=0.0)), float(width.max()), 1e-12)
    panel.set_ylim(-reach, reach)
