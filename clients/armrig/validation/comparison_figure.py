"""Figure of a comparison: data, models, and the differences from the best model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.data.dataset import Signals
from armrig.data.figures import without_ramp
from armrig.models.labels import Labels
from armrig.numerics.quantities import error, minus
from armrig.plots.captions import legend, named, sign
from armrig.plots.layout import GREY, INK, MISSING, finish, high_axes, panels, pens, rows, shade

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.data.dataset import Dataset
    from armrig.validation.comparison import Comparison


_MAX_NAMED = 3  # largest number of models in a figure whose legend names the differences
_MIN_DISTANCE_PT = 16.0  # least distance of two tick labels, before the layout lowers the panel


def plot_comparison(
    data: Dataset | Signals,
    compared: Sequence[Comparison],
    *,
    labels: Labels = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot the measured output and the models, and the differences from the best model.

    The lower panel shows the data and the other models, minus the best model. The best model has
    the least rms error. The data are dots, so that a difference smaller than the noise is visible.
    If another model is far worse, the scale is linear up to about three times the least error.
    Dotted lines mark this limit. Beyond the limit the scale is logarithmic. A ramp of the output is
    removed: see `armrig.data.figures.without_ramp`. Several outputs have a panel each, which shows
    the data and the models.
    """
    outputs = list(dict.fromkeys(row.output for row in compared))
    if len(outputs) > 1:
        return _plot_outputs(data, compared, outputs, labels, ax)
    if isinstance(data, Signals):
        data = data.dataset(outputs[0], data.inputs[0])
    ax, below = panels(ax, 0.5)
    names = labels or [row.name for row in compared]
    best = min(range(len(compared)), key=lambda i: _size(compared[i].rms_error))
    reference = compared[best].y
    ramp, label, notes = without_ramp(data)
    ax.plot(data.t, data.y - ramp, color=MISSING, lw=6.0, label="measured")
    for i, (row, name, pen) in enumerate(zip(compared, names, pens(len(names)), strict=True)):
        text = f"{name}, rms error {error(row.rms_error, data.unit)}"
        ax.plot(data.t, row.y - ramp, label=text, **pen)
        if i != best:
            thin = pen | {"lw": 0.6 * pen["lw"]}
            difference = f"{name} − {names[best]}" if len(names) <= _MAX_NAMED else None
            below.plot(data.t, row.y - reference, label=difference, **thin)
    below.plot(data.t, data.y - reference, ".", color=GREY, ms=1.2, zorder=3)
    below.plot([], [], ".", color=GREY, ms=5, label=f"measured − {names[best]}")
    below.axhline(0, color=INK, lw=0.6)
    linear = _limit_errors(below, data, compared, best)
    # Not autoscaled: at missing samples the initial transient of a model may be far off.
    shown = np.concatenate([(y - ramp)[data.valid] for y in (data.y, *(r.y for r in compared))])
    measured, all_ = _range(data.y - ramp), _range(shown[np.isfinite(shown)])
    span = measured[1] - measured[0] or 1.0
    ax.set_ylim(
        max(all_[0], measured[0] - span) - 0.05 * span,
        min(all_[1], measured[1] + span) + 0.05 * span,
    )
    ax.set_ylabel(label)
    below.set_ylabel(f"difference\n[{data.unit or '–'}]")
    below.set_xlabel("$t$ [s]")
    unit = f" {data.unit}" if data.unit else ""
    legend(below, *([f"scale logarithmic beyond ±{linear:g}{unit}, dotted"] if linear else []))
    for panel in (ax, below):  # the upper legend names the shading
        shade(panel, data.valid, data.Ts)
    finish(ax, below, xlim=(0.0, float(data.t[-1]) or 1.0))
    return sign(ax, data.source, above=legend(ax, *notes))


def _plot_outputs(
    data: Dataset | Signals,
    compared: Sequence[Comparison],
    outputs: Sequence[str],
    labels: Labels,
    ax: Axes | None,
) -> Axes:
    """Plot each measured output and the outputs of all models against time."""
    shown = rows(ax or high_axes(len(outputs)), len(outputs))
    for i, (panel, output) in enumerate(zip(shown, outputs, strict=True)):
        of_output = [row for row in compared if row.output == output]
        names = labels or [row.name for row in of_output]
        y = data.y[:, data.outputs.index(output)] if isinstance(data, Signals) else data.y
        panel.plot(data.t, y, color=MISSING, lw=4.5, label="measured")
        for row, name, pen in zip(of_output, names, pens(len(of_output)), strict=True):
            panel.plot(data.t, row.y, label=None if i else name, **pen)
        panel.set_ylabel(named(output, of_output[0].unit))
        fits = ", ".join(f"{row.fit_percent:.1f} %" for row in of_output)
        panel.annotate(
            f"fit {fits}",
            (1.0, 1.0),
            xycoords="axes fraction",
            ha="right",
            va="bottom",
            fontsize="small",
        )
    shown[-1].set_xlabel("$t$ [s]")
    finish(*shown, xlim=(float(np.min(data.t)), float(np.max(data.t)) or 1.0))
    return sign(shown[0], data.source, above=legend(shown[0]))


def _limit_errors(ax: Axes, data: Dataset, rows: Sequence[Comparison], best: int) -> float:
    """Make the scale logarithmic beyond three times the least error, if errors differ widely.

    Return the limit of the linear part; 0 if the whole scale is linear.
    """
    sizes = [r.rms_error for r in rows if np.isfinite(r.rms_error) and r.rms_error > 0]
    if not sizes or max(sizes) <= 8 * min(sizes):
        return 0.0
    linear = float(f"{3 * min(sizes):.1g}")
    others = [np.abs(row.y - rows[best].y)[data.valid] for row in rows]
    largest = max(float(np.nanmax(e, initial=linear)) for e in others if np.isfinite(e).any())
    ax.set_yscale("symlog", linthresh=linear, linscale=1.0)
    ax.set_ylim(-2 * largest, 2 * largest)
    for edge in (-linear, linear):
        ax.axhline(edge, color=INK, lw=0.9, ls=":", zorder=4)
    # The panel may be as low as three lines of text. The limit is labelled only if it is far enough
    # from 0 and from the end of the scale.
    steps = np.array([1.0, 2.0, 5.0]) * 10.0 ** np.floor(np.log10(largest))
    highest = max(float(steps[steps <= largest].max(initial=0.0)), linear)
    places = ax.transData.transform([(0.0, 0.0), (0.0, linear), (0.0, highest)])[:, 1]
    apart = np.diff(places).min() * 72 / ax.figure.dpi > _MIN_DISTANCE_PT
    ticks = (-highest, -linear, 0, linear, highest) if apart else (-highest, 0, highest)
    ax.set_yticks(ticks, [minus(f"{v:g}") for v in ticks])
    decades = 10.0 ** np.arange(np.ceil(np.log10(linear)), np.log10(highest))
    ax.set_yticks([*-decades, -linear, linear, *decades], minor=True)
    return linear


def _size(x: float) -> float:
    """Return x as a sort key: infinity if x is not finite."""
    return x if np.isfinite(x) else np.inf


def _range(x: NDArray[np.float64]) -> tuple[float, float]:
    return (float(np.nanmin(x)), float(np.nanmax(x))) if x.size else (0.0, 1.0)
