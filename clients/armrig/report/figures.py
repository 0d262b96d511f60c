"""Figures of a report."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from armrig import plots
from armrig.data.dataset import Dataset, Vector
from armrig.plots import layout
from armrig.plots.captions import axis_label, legend, name_by_run, symbol_of
from armrig.recordings.recording import Recording
from armrig.report.sections import Contents, Draw
from armrig.report.study import Study

STYLE: Any = {
    "svg.fonttype": "none",
    "font.family": ["STIXGeneral", "DejaVu Sans"],  # the second if the first lacks a glyph
    "mathtext.fontset": "stix",
    "font.size": 9,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.1,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "axes.unicode_minus": True,
}
WIDTH = 6.4
"""Width of a figure in inches, as wide as the text of report.typ, so that sizes are as printed."""
MIN_SIZE = 7.0
"""Smallest size of a text in a figure, in points."""
_DETAIL_S, _DETAIL_SHARE = 4.0, 0.1  # least length of a detail, and its share of the data


def write_figures(
    contents: Contents, recordings: Iterable[Recording], directory: Path
) -> tuple[Path, ...]:
    """Write the figures of a report of recordings as SVG into `directory`; return their paths."""
    runs, paths = {r.sha256: r.manifest.run_id for r in recordings}, []
    with mpl.rc_context(STYLE), name_by_run(runs):
        for figure in (figure for section in contents.sections for figure in section.figures):
            paths.append(directory / f"{figure.name}.svg")
            save(draw_figure(figure.height, figure.draws), paths[-1])
    return tuple(paths)


def draw_figure(height: float, draws: Sequence[Draw]) -> Figure:
    """Return a figure as wide as the text, without empty panels."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    columns = min(len(draws), 3 if len(draws) % 2 else 2)
    panels = figure.subplots(-(-len(draws) // columns), columns, squeeze=False).ravel()
    for ax in panels[len(draws) :]:
        ax.remove()
    for ax, draw in zip(panels, draws, strict=False):
        draw(ax=ax)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure as SVG; texts smaller than `MIN_SIZE`, such as an index, get this size."""
    layout.save(figure, path)
    svg = re.sub(
        r"(?<=font-size:\s)[\d.]+(?=px)",
        lambda size: f"{max(float(size[0]), MIN_SIZE):g}",
        path.read_text(encoding="utf-8"),
    )
    path.write_text(svg, encoding="utf-8")


def detail_s(data: Dataset) -> float:
    """Return the length of the detail of a simulation, in s."""
    return max(_DETAIL_S, _DETAIL_SHARE * data.N * data.Ts)


def plot_velocity(study: Study, *, ax: Axes) -> None:
    """Plot a detail of the simulation; of an output that integrates, plot the rate."""
    data, seconds = study.validation, detail_s(study.validation)

    def velocity(y: Vector) -> Vector:
        return np.diff(y) / data.Ts if study.integrates else y[1:]

    t = data.t[1:]
    begin = min(data.N // 3 * data.Ts, max(data.t[-1] - seconds, 0.0))
    window = (t >= begin) & (t <= begin + seconds)
    measured = velocity(data.y)[window]
    ax.plot(t[window], measured, ".", color=plots.INK, ms=2.5, alpha=0.6, label="measured")
    for model, pen in zip(study.estimated, layout.pens(len(study.estimated)), strict=True):
        modelled = velocity(model.comparison.y)
        ax.plot(t[window], modelled[window], label=f"{model.name}, simulated", **pen)
    lowest, highest = np.nanmin(measured), np.nanmax(measured)
    room = 0.15 * (highest - lowest)
    ax.set_ylim(lowest - room, highest + room)
    ax.set_xlim(begin, begin + seconds)
    ax.set_xlabel("$t$ [s]")
    rate = rf"$\Delta{symbol_of(data.output)[1:-1]}/T_s$ [{data.unit}/s]"
    ax.set_ylabel(rate if study.integrates else axis_label(data.output, data.unit))
    plots.finish(ax)
    plots.sign(ax, data.source, above=legend(ax))
