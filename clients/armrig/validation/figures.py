"""Figures of models against data: outputs, errors and residuals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.canvas import (
    BLUE,
    GREY,
    INK,
    MISSING,
    VERMILION,
    finish,
    legend,
    panels,
    pens,
    shade,
    sign,
    stems,
)
from armrig.data.figures import without_ramp
from armrig.models.labels import Labels
from armrig.models.model import Model
from armrig.numerics.quantities import NBSP, error, minus, p_relation
from armrig.validation.comparison import Comparison, ComparisonTable, compare
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
    """Show measured output and models (simulated unless a horizon is given), and what tells them.

    Below are data and other models less the best model, which has the least rms error: the data as
    dots, so that what hides in their noise shows. The scale is linear up to three times that error
    and logarithmic beyond. What is a ramp and little else is shown without it: see
    `armrig.data.figures.without_ramp`.
    """
    table = compare(data, *models, horizon=horizon, labels=labels) if table is None else table
    ax, below = panels(ax, 0.38)
    for panel in (ax, below):
        shade(panel, data)
    names = labels or [row.name for row in table.rows]
    best = min(range(len(table.rows)), key=lambda i: _size(table.rows[i].rms_error))
    reference = table.rows[best].y
    ramp, label = without_ramp(data)
    ax.plot(data.t, data.y - ramp, color=MISSING, lw=4.5, label="measured")
    for i, (row, name, pen) in enumerate(zip(table.rows, names, pens(len(names)), strict=True)):
        text = f"{name}, rms error {error(row.rms_error, data.unit)}"
        ax.plot(data.t, row.y - ramp, label=text, **pen)
        if i != best:
            below.plot(data.t, row.y - reference, **(pen | {"lw": 0.6 * pen["lw"]}))
    below.plot(data.t, data.y - reference, ".", color=GREY, ms=1.2, zorder=3)
    below.axhline(0, color=INK, lw=0.6)
    _limit_errors(below, data, table.rows, best)
    # Not autoscaled: where nothing was measured a model's initial transient may be anywhere.
    shown = np.concatenate([(y - ramp)[data.valid] for y in (data.y, *(r.y for r in table.rows))])
    measured, all_ = _range(data.y - ramp), _range(shown[np.isfinite(shown)])
    span = measured[1] - measured[0] or 1.0
    ax.set_ylim(
        max(all_[0], measured[0] - span) - 0.05 * span,
        min(all_[1], measured[1] + span) + 0.05 * span,
    )
    ax.set_ylabel(label)
    below.set_ylabel(f"minus {names[best]}\n[{data.unit or '–'}]")
    below.set_xlabel("$t$ [s]")
    finish(ax, below, xlim=(0.0, float(data.t[-1]) or 1.0))
    return sign(ax, data.source, above=legend(ax))


def _limit_errors(ax: Axes, data: Dataset, rows: Sequence[Comparison], best: int) -> None:
    """Make the scale logarithmic beyond the best model's errors where another's are far larger."""
    sizes = [r.rms_error for r in rows if np.isfinite(r.rms_error) and r.rms_error > 0]
    if not sizes or max(sizes) <= 8 * min(sizes):
        return
    linear = 3 * min(sizes)
    others = [np.abs(row.y - rows[best].y)[data.valid] for row in rows]
    largest = max(float(np.nanmax(e, initial=linear)) for e in others if np.isfinite(e).any())
    ax.set_yscale("symlog", linthresh=linear, linscale=1.0)
    ax.set_ylim(-2 * largest, 2 * largest)
    decades = {np.ceil(np.log10(linear)), np.floor(np.log10(largest))}
    ticks = [sign * 10.0**d for d in sorted(decades) for sign in (-1, 1)]
    ax.set_yticks([0, *ticks], [minus(f"{v:g}") for v in (0, *ticks)])
    ax.minorticks_off()


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
    below.fill_between(test.cross_lags, -band, band, step="mid", color=GREY, alpha=0.25, lw=0)
    stems(below, test.cross_lags, test.cross_correlation, VERMILION)
    below.axvline(-0.5, color=GREY, lw=0.6, ls=":")
    below.set_ylabel("$r_{eu}$(lag)")
    for panel in (ax, below):
        panel.set_xlabel("lag [samples]")
    for panel, values, width in (
        (ax, test.autocorrelation[1:], test.autocorrelation_band),
        (below, test.cross_correlation, float(np.nanmax(band, initial=0.0))),
    ):
        reach = 1.15 * max(float(np.nanmax(np.abs(values), initial=0.0)), width, 1e-12)
        panel.set_ylim(-reach, reach)
    finish(ax)
    finish(below)
    legend(
        below,
        f"no feedback: {_p(test.feedback)}; no dynamics missing: {_p(test.missing_dynamics)}",
    )
    return sign(ax, data.source, above=legend(ax, f"residuals {test.white}"))


def _size(x: float) -> float:
    """Return a number to be compared by: what is not finite is the largest."""
    return x if np.isfinite(x) else np.inf


def _range(x: NDArray[np.float64]) -> tuple[float, float]:
    return (float(np.nanmin(x)), float(np.nanmax(x))) if x.size else (0.0, 1.0)


def _p(p: float) -> str:
    return f"p {p_relation(p)}".replace(" ", NBSP)
