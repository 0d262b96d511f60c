"""Figures of models against data: outputs, errors and residuals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from armrig.canvas import (
    BLUE,
    GREY,
    INK,
    VERMILION,
    finish,
    finish_over_time,
    panels,
    pens,
    shade,
    short,
    sign,
    stems,
)
from armrig.models.labels import Labels
from armrig.models.model import Model
from armrig.numerics.quantities import p_relation
from armrig.validation.comparison import ComparisonTable, compare
from armrig.validation.residuals import BAND_99_PERCENT, residuals

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.data.dataset import Dataset
    from armrig.models.fit import Fit


def plot_compare(
    data: Dataset,
    *models: Model,
    horizon: int | None = None,
    labels: Labels = None,
    table: ComparisonTable | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Show measured output and models (simulated unless a horizon is given), and below the errors.

    The errors' scale is linear up to three times the best model's rms error and logarithmic beyond.
    """
    table = compare(data, *models, horizon=horizon, labels=labels) if table is None else table
    ax, below = panels(ax, 0.38)
    for panel in (ax, below):
        shade(panel, data)
    ax.plot(data.t, data.y, color=INK, lw=1.8, alpha=0.55, label="measured")
    names = labels or [row.name for row in table.rows]
    for row, name, (colour, dash) in zip(table.rows, names, pens(), strict=False):
        rms = f"{short(row.rms_error)} {data.unit}"
        text = f"{name}, rms error {rms}"
        ax.plot(data.t, row.y, color=colour, ls=dash, lw=1.0, label=text)
        below.plot(data.t, data.y - row.y, color=colour, ls=dash, lw=0.8)
    finite = [
        row.rms_error for row in table.rows if np.isfinite(row.rms_error) and row.rms_error > 0
    ]
    if finite and max(finite) > 8 * min(finite):
        linear = 3 * min(finite)
        below.set_yscale("symlog", linthresh=linear, linscale=1.0)
        largest = max(float(np.nanmax(np.abs(data.y - row.y))) for row in table.rows)
        decades = {np.ceil(np.log10(linear)), np.floor(np.log10(max(largest, linear)))}
        ticks = [sign * 10.0**d for d in sorted(decades) for sign in (-1, 1)]
        below.set_yticks([0, *ticks], [f"{v:g}" for v in (0, *ticks)])
        below.minorticks_off()
    below.axhline(0, color=GREY, lw=0.6)
    # Not autoscaled: where nothing was measured a model's initial transient may be anywhere.
    shown = np.concatenate([y[data.valid] for y in (data.y, *(row.y for row in table.rows))])
    measured, all_ = _range(data.y), _range(shown[np.isfinite(shown)])
    span = measured[1] - measured[0] or 1.0
    ax.set_ylim(
        max(all_[0], measured[0] - span) - 0.05 * span,
        min(all_[1], measured[1] + span) + 0.05 * span,
    )
    end = float(data.t[-1])
    finish_over_time(ax, below, output=data.output, unit=data.unit, end=end)
    return sign(ax, data.source)


def plot_residuals(
    fit: Fit, data: Dataset, *, lags: int | None = None, ax: Axes | None = None
) -> Axes:
    """Show the residuals' autocorrelation and, below, their correlation with the input.

    Grey bands hold 99 % of each lag's values: if the residuals are white, and if the input has
    nothing to do with them. Negative lags point to feedback, positive ones to missing dynamics.
    """
    test = residuals(fit, data, lags)
    ax, below = panels(ax, 0.5, sharex=False)
    ax.axhspan(-test.autocorrelation_band, test.autocorrelation_band, color=GREY, alpha=0.25, lw=0)
    stems(ax, test.lags[1:], test.autocorrelation[1:], BLUE)
    ax.set_ylabel("$r_e$(lag)")
    band = BAND_99_PERCENT * test.cross_std
    below.fill_between(
        test.cross_lags, -band, band, step="mid", color=GREY, alpha=0.25, lw=0, label="99 %"
    )
    stems(below, test.cross_lags, test.cross_correlation, VERMILION)
    below.axvline(-0.5, color=GREY, lw=0.6, ls=":")
    below.set_ylabel("$r_{eu}$(lag)")
    below.set_xlabel("lag [samples]")
    for panel, values, width in (
        (ax, test.autocorrelation[1:], test.autocorrelation_band),
        (below, test.cross_correlation, float(np.nanmax(band, initial=0.0))),
    ):
        reach = 1.25 * max(float(np.nanmax(np.abs(values), initial=0.0)), width, 1e-12)
        panel.set_ylim(-reach, 1.4 * reach)  # room for the p values
    ax.text(0.99, 0.93, f"residuals {test.white}", **_corner(ax))
    below.text(0.99, 0.93, _p_value("no dynamics missing", test.missing_dynamics), **_corner(below))
    below.text(
        0.01, 0.93, _p_value("no feedback", test.feedback), **(_corner(below) | {"ha": "left"})
    )
    finish(ax)
    finish(below)
    return sign(ax, data.source)


def _range(x: NDArray[np.float64]) -> tuple[float, float]:
    return (float(np.nanmin(x)), float(np.nanmax(x))) if x.size else (0.0, 1.0)


def _p_value(hypothesis: str, p: float) -> str:
    return f"{hypothesis}: p {p_relation(p)}"


def _corner(ax: Axes) -> dict[str, Any]:
    box = {"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 1.5}
    return {"transform": ax.transAxes, "ha": "right", "va": "top", "fontsize": "small", "bbox": box}
