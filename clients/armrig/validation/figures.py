"""Figures of comparisons, of tests of residuals, of a search, and of structure hints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.telemetry.channels import ARM_OUTPUTS

from armrig.data.dataset import Signals
from armrig.data.figures import without_ramp
from armrig.models.spectral_estimate import gain_unit
from armrig.numerics.quantities import NBSP, error, minus, p_relation, plural
from armrig.numerics.whiteness import BAND_99_PERCENT, WHITE_LEVEL, Whiteness
from armrig.plots.captions import axis_label, legend, sign
from armrig.plots.layout import (
    BLUE,
    COLOURS,
    GREY,
    INK,
    MISSING,
    SKY,
    VERMILION,
    axes,
    decibel_ticks,
    decibels,
    drawable,
    finish,
    hertz,
    high_axes,
    logarithmic,
    panels,
    pens,
    rows,
    shade,
    stems,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.data.dataset import Dataset
    from armrig.numerics.polynomial import Array
    from armrig.validation.comparison import Comparison, ComparisonTable
    from armrig.validation.linearity import Linearity
    from armrig.validation.residual_test import ResidualTest
    from armrig.validation.search_result import SearchResult
    from armrig.validation.structure_hints import StructureHints


BAND = "99 % band of each lag"
COLUMN_WIDTH, ROW_HEIGHT = 2.6, 1.9
"""Size in inches of one panel of several outputs or inputs."""
_HEAD_POINTS = 22.0  # height of two lines above a panel
_JOINT = f"joint test, level {100 * WHITE_LEVEL:g}{NBSP}%"
_MARKERS = "osD^vP"
_MOST = 1000.0  # models with a larger multiple of the least error are counted, but not drawn
_MAX_NAMED = 3  # largest number of models in a figure whose legend names the differences
_MIN_DISTANCE_PT = 16.0  # least distance of two tick labels, before the layout lowers the panel


def plot_compare(table: ComparisonTable, *, ax: Axes | None = None) -> Axes:
    """Plot the measured output and the models, and the differences from the best model.

    The lower panel shows the data and the other models, minus the best model. The best model has
    the least rms error. The data are dots, so that a difference smaller than the noise is visible.
    If another model is far worse, the scale is linear up to about three times the least error.
    Dotted lines mark this limit. Beyond the limit the scale is logarithmic. A ramp of the output is
    removed: see `armrig.data.figures.without_ramp`. Several outputs have a panel each, which shows
    the data and the models.
    """
    data, compared = table.data, table.rows
    if len(table.outputs) > 1:
        return _plot_outputs(table, ax)
    if isinstance(data, Signals):
        data = data.dataset(table.outputs[0], data.inputs[0])
    ax, below = panels(ax, 0.5)
    names = [row.name for row in compared]
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
    all_y = np.concatenate([(y - ramp)[data.valid] for y in (data.y, *(r.y for r in compared))])
    measured, all_ = _range(data.y - ramp), _range(all_y[np.isfinite(all_y)])
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
        shade(panel, data.valid, data.Ts, dead_band=data.output in ARM_OUTPUTS)
    finish(ax, below, xlim=(0.0, float(data.t[-1]) or 1.0))
    return sign(ax, data.source, above=legend(ax, *notes))


def _plot_outputs(table: ComparisonTable, ax: Axes | None) -> Axes:
    """Plot each measured output and the outputs of all models against time."""
    data, outputs = table.data, table.outputs
    panel_rows = rows(ax or high_axes(len(outputs)), len(outputs))
    for i, (panel, output) in enumerate(zip(panel_rows, outputs, strict=True)):
        of_output = table.of(output).rows
        y = data.y[:, data.outputs.index(output)] if isinstance(data, Signals) else data.y
        panel.plot(data.t, y, color=MISSING, lw=4.5, label="measured")
        for row, pen in zip(of_output, pens(len(of_output)), strict=True):
            panel.plot(data.t, row.y, label=None if i else row.name, **pen)
        panel.set_ylabel(axis_label(output, of_output[0].unit))
        fits = ", ".join(f"{row.fit_percent:.1f} %" for row in of_output)
        panel.annotate(
            f"fit {fits}",
            (1.0, 1.0),
            xycoords="axes fraction",
            ha="right",
            va="bottom",
            fontsize="small",
        )
    panel_rows[-1].set_xlabel("$t$ [s]")
    finish(*panel_rows, xlim=(float(np.min(data.t)), float(np.max(data.t)) or 1.0))
    return sign(panel_rows[0], data.source, above=legend(panel_rows[0]))


def _limit_errors(ax: Axes, data: Dataset, rows: Sequence[Comparison], best: int) -> float:
    """Make the scale logarithmic beyond 3 times the least error, and return this limit, or 0."""
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


def _range(x: Array) -> tuple[float, float]:
    return (float(np.nanmin(x)), float(np.nanmax(x))) if x.size else (0.0, 1.0)


def plot_residuals(test: ResidualTest, *, ax: Axes | None = None) -> Axes:
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
    band = np.full(test.lags.size - 1, test.autocorrelation_band)
    _draw_in_band(ax, test.lags[1:], test.autocorrelation[1:], band, BLUE)
    ax.set_ylabel("$r_e$(lag)")
    width = BAND_99_PERCENT * test.cross_std
    _draw_in_band(below, test.cross_lags, test.cross_correlation, width, VERMILION)
    below.axvline(-0.5, color=GREY, lw=0.6, ls=":")
    below.set_ylabel("$r_{eu}$(lag)")
    for panel in (ax, below):
        panel.set_xlabel("lag [samples]")
        finish(panel)
    legend(
        below,
        f"no feedback: {_p(test.feedback)}; no dynamics missing: {_p(test.missing_dynamics)} "
        f"({_JOINT})",
    )
    return sign(ax, test.source, above=legend(ax, _verdict(test.white)))


def _verdict(whiteness: Whiteness) -> str:
    """Return whether the residuals are white, with the p value and the level, as text."""
    if np.isnan(whiteness.p_value) or whiteness.unclear:
        return f"residuals {whiteness}"
    verdict = "coloured" if whiteness.coloured else "white"
    return f"residuals {verdict}: {_p(whiteness.p_value)} ({_JOINT})"


def _p(p: float) -> str:
    return f"p {p_relation(p)}".replace(" ", NBSP)


def _plot_rows(test: ResidualTest, ax: Axes | None) -> Axes:
    """Show a row for each output: residual autocorrelation, and correlation with each input."""
    new_figure = ax is None
    ax = axes(ax)
    if new_figure:
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
        _draw_in_band(panel, test.lags[1:], test.autocorrelation[i, i, 1:], width, BLUE)
        _head(panel, f"white: p {p_relation(white)}")
        panel.set_ylabel(f"residuals of\n{output}")
        panels.append(panel)
        for j, input in enumerate(test.inputs):
            panel = ax.figure.add_subplot(grid[i, 1 + j])
            width = BAND_99_PERCENT * test.cross_std[i, j]
            _draw_in_band(panel, test.cross_lags, test.cross_correlation[i, j], width, VERMILION)
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
        drawable(text),
        (0.0, 1.0),
        xycoords="axes fraction",
        xytext=(4.0, 3.0),
        textcoords="offset points",
        va="bottom",
        fontsize="x-small",
    )


def _draw_in_band(panel: Axes, lags: Array, values: Array, width: Array, colour: str) -> None:
    stems(panel, lags, values, colour, band=width, label=BAND)
    reach = 1.15 * max(np.nanmax([*np.abs(values), *width], initial=0.0), 1e-12)
    panel.set_ylim(-reach, reach)


def plot_structure(hints: StructureHints, *, ax: Axes | None = None) -> Axes:
    """Plot the frequency response with resonances and slopes, and the description lengths."""
    from armrig.validation.recommended_structures import BARE

    ax, below = panels(ax, 0.4, sharex=False)
    s = hints.spectrum
    finite = np.isfinite(s.G) & (s.omega > 0)
    w, magnitude = s.omega[finite], s.magnitude[finite]
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
    orders = [*hints.excess]
    below.bar(orders, [*hints.excess.values()], color=SKY, edgecolor=BLUE, lw=0.5)
    below.axhline(BARE, color=VERMILION, ls="--", lw=1.0, label="hardly counts")
    below.set_yscale("symlog", linthresh=BARE)
    below.set_ylim(bottom=0)
    below.set_xticks(orders)
    below.set_xlabel("number of poles")
    below.set_ylabel("MDL, above\nthe least")
    finish(ax, xlim=(float(w[0]), float(w[-1])))
    finish(below)
    legend(below)
    return sign(ax, s.source, above=legend(ax, lift=hertz(ax)))


def plot_search(result: SearchResult, *, ax: Axes | None = None) -> Axes:
    """Show the error on the validation data against the number of parameters, by structure.

    For each structure, a line joins the points of least error at each number of parameters. A ring
    marks the chosen model.
    """
    ax = axes(ax)
    d = np.array([scored.parameters for scored in result.ranked])
    families = [scored.candidate.request.structure for scored in result.ranked]
    visible = result.rms <= _MOST * float(result.rms[0])
    for k, family in enumerate(dict.fromkeys(sorted(families))):
        mine = np.array([f == family for f in families]) & visible
        colour, marker = COLOURS[k % len(COLOURS)], _MARKERS[k % len(_MARKERS)]
        if not mine.any():
            continue
        ax.plot(d[mine], result.rms[mine], marker, color=colour, ms=3.5, alpha=0.6, mew=0)
        counts = np.unique(d[mine])
        least = [float(result.rms[mine & (d == n)].min()) for n in counts]
        ax.plot(counts, least, marker=marker, color=colour, ms=4.5, lw=1.1, label=family.upper())
    i = result.chosen_index
    at = (float(d[i]), float(result.rms[i]))
    chosen = f"chosen: {result.ranked[i].candidate.name}"
    ax.plot(*at, "o", color=INK, ms=12, mfc="none", mew=1.5, ls="none", label=chosen)
    ax.axhline(at[1], color=GREY, lw=0.6, ls=":")
    logarithmic(ax.yaxis, 0.8 * float(result.rms[0]), 1.3 * float(result.rms[visible].max()))
    ax.locator_params(axis="x", integer=True)
    how = "simulated" if result.horizon is None else f"{result.horizon} ahead"
    ax.set_xlabel("number of parameters")
    ax.set_ylabel(f"rms error, {how} [{result.unit or '–'}]")
    finish(ax)
    off = np.count_nonzero(~visible)
    legend(
        ax,
        *(
            [
                f"{plural(off, 'more model has', 'more models have')} over {_MOST:g} times the "
                "least error"
            ]
            if off
            else []
        ),
    )
    return ax


def plot_linearity(test: Linearity, *, ax: Axes | None = None) -> Axes:
    """Show the static gain against the level of the input or the output that determines it."""
    ax = axes(ax)
    if not test.levels.size:
        ax.text(0.5, 0.5, drawable(test.reason), transform=ax.transAxes, ha="center")
        return ax
    ax.plot(test.levels, test.gains, "o-", color=COLOURS[0], ms=3.5)
    u, y = (test.units[name] or "–" for name in (test.input, test.output))
    ax.set_xlabel(f"{test.gain_of} [{test.units[test.gain_of] or '–'}]")
    ax.set_ylabel(f"static gain [{y}/{u}]")
    finish(ax)
    legend(ax, test.reason)
    return ax
