"""Figure of a test of residuals: autocorrelation, and correlation with the input, with bands."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from armrig.numerics.quantities import NBSP, p_relation
from armrig.numerics.whiteness import WHITE_LEVEL, Whiteness
from armrig.plots.captions import legend, sign
from armrig.plots.layout import BLUE, GREY, VERMILION, axes, finish, panels, stems

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.numerics.polynomial import Array
    from armrig.validation.residual_test import ResidualTest

BAND_99_PERCENT = 2.58
"""Two-sided 99 % quantile of the normal distribution."""
BAND = "99 % band of each lag"
COLUMN_WIDTH, ROW_HEIGHT = 2.6, 1.9
"""Size in inches of one panel of several outputs or inputs."""
_HEAD_POINTS = 22.0  # height of two lines above a panel
_JOINT = f"joint test, level {100 * WHITE_LEVEL:g}{NBSP}%"


def plot_residual_test(test: ResidualTest, *, ax: Axes | None = None) -> Axes:
    """Show the autocorrelation of the residuals, and their correlation with the inputs.

    If the residuals are white, the value at each lag is inside the upper band with a probability of
    99 %. If the residuals are independent of the input, the value at each lag is inside the lower
    band with a probability of 99 %. On average one of 100 values is outside its band by chance, so
    a test of all lags together decides. A correlation at negative lags indicates feedback. A
    correlation at positive lags indicates missing dynamics. Several outputs have a row each, with a
    panel for each input; the p values above a panel are from the tests of all its lags together.
    """
    if test.missing_dynamics_by_pair.size > 1:
        return _plot_rows(test, ax)
    ax, below = panels(ax, 0.5, sharex=False)
    own_band = float(test.autocorrelation_band)
    shade: dict[str, Any] = {"color": GREY, "alpha": 0.25, "lw": 0, "label": BAND}
    ax.axhspan(-own_band, own_band, **shade)
    stems(ax, test.lags[1:], test.autocorrelation[1:], BLUE)
    ax.set_ylabel("$r_e$(lag)")
    band = BAND_99_PERCENT * test.cross_std
    below.fill_between(test.cross_lags, -band, band, step="mid", **shade)
    stems(below, test.cross_lags, test.cross_correlation, VERMILION)
    below.axvline(-0.5, color=GREY, lw=0.6, ls=":")
    below.set_ylabel("$r_{eu}$(lag)")
    for panel in (ax, below):
        panel.set_xlabel("lag [samples]")
    for panel, values, width in (
        (ax, test.autocorrelation[1:], own_band),
        (below, test.cross_correlation, float(np.nanmax(band, initial=0.0))),
    ):
        reach = 1.15 * max(float(np.nanmax(np.abs(values), initial=0.0)), width, 1e-12)
        panel.set_ylim(-reach, reach)
    finish(ax)
    finish(below)
    legend(
        below,
        f"no feedback: {_p(test.feedback)}; no dynamics missing: {_p(test.missing_dynamics)} "
        f"({_JOINT})",
    )
    return sign(ax, test.source, above=legend(ax, _verdict(test.white)))


def _verdict(found: Whiteness) -> str:
    """Return whether the residuals are white, with the p value and the level, as text."""
    if np.isnan(found.p_value):
        return f"residuals {found}"
    verdict = "coloured" if found.coloured else "white"
    return f"residuals {verdict}: {_p(found.p_value)} ({_JOINT})"


def _p(p: float) -> str:
    return f"p {p_relation(p)}".replace(" ", NBSP)


def _plot_rows(test: ResidualTest, ax: Axes | None) -> Axes:
    """Show a row for each output: residual autocorrelation, and correlation with each input."""
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
        width = np.full(test.lags.size - 1, np.atleast_1d(test.autocorrelation_band)[i])
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
