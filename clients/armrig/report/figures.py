"""The figures of a report."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from armrig import plots
from armrig.canvas import pens, save
from armrig.nonparametric.spectral_reference import spectral_reference
from armrig.report.study import STEP, Study, kind_of

_STYLE: Any = {
    "svg.fonttype": "none",
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 8.5,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.1,
    "legend.fontsize": 7.5,
    "legend.framealpha": 0.9,
    "legend.edgecolor": "#cccccc",
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "axes.unicode_minus": True,
}
_WIDTH = 6.4
_RESIDUALS = 3.2  # height of one row of residual tests
DETAIL_S = 4.0


def write_figures(study: Study, directory: Path) -> tuple[Path, ...]:
    """Write the figures of a study as SVG into `directory` and return their paths."""
    paths = []
    with mpl.rc_context(_STYLE):
        for name, draw in _FIGURES.items():
            figure = draw(study)
            if figure is not None:
                paths.append(directory / f"{name}.svg")
                save(figure, paths[-1])
    return tuple(paths)


def _canvas(height: float, *places: tuple[float, float, float, float]) -> tuple[Figure, list[Any]]:
    """Return a figure `height` inches high with axes at (left, bottom, right, top) inches."""
    figure = Figure(figsize=(_WIDTH, height))
    return figure, [
        figure.add_axes((a / _WIDTH, b / height, (c - a) / _WIDTH, (d - b) / height))
        for a, b, c, d in places
    ]


def _timing_figure(study: Study) -> Figure:
    figure, axes = _canvas(2.25, (0.5, 0.45, 3.05, 2.05), (3.8, 0.45, 6.35, 2.05))
    recording = study.recording_of(study.estimation.source)
    plots.plot_timing(recording, quantity="jitter", ax=axes[0])
    plots.plot_timing(recording, quantity="lateness", ax=axes[1])
    return figure


def _data_figure(study: Study) -> Figure:
    figure, axes = _canvas(2.5, (0.5, 0.42, 3.05, 2.3), (3.8, 0.42, 6.35, 2.3))
    for ax, data in zip(axes, (study.estimation, study.validation), strict=True):
        plots.plot_data(data, ax=ax)
    return figure


def _step_figure(study: Study) -> Figure | None:
    steps = [r for r in study.recordings if kind_of(r) == STEP]
    if not steps:
        return None
    figure, (ax,) = _canvas(2.1, (0.5, 0.42, 6.35, 1.9))
    plots.plot_data(steps[0], ax=ax)
    return figure


def _compare_figure(study: Study) -> Figure:
    figure, (ax,) = _canvas(3.0, (0.5, 0.42, 6.35, 2.8))
    fits = [m.model for m in study.estimated]
    names = [m.name for m in study.estimated]
    plots.plot_compare(study.validation, *fits, labels=names, ax=ax)
    return figure


def _velocity_figure(study: Study) -> Figure:
    figure, (ax,) = _canvas(2.1, (0.5, 0.42, 6.25, 1.9))
    data = study.validation
    t = data.t[1:]
    begin = min(data.N // 3 * data.Ts, max(data.t[-1] - DETAIL_S, 0.0))
    shown = (t >= begin) & (t <= begin + DETAIL_S)
    rate = np.diff(data.y) / data.Ts
    ax.plot(t[shown], rate[shown], ".", color=plots.INK, ms=2.5, alpha=0.6, label="measured")
    for model, (colour, dash) in zip(study.estimated, pens(), strict=False):  # pens never end
        modelled = np.diff(model.comparison.y) / data.Ts
        ax.plot(t[shown], modelled[shown], color=colour, ls=dash, label=f"{model.name}, simulated")
    lowest, highest = np.nanmin(rate[shown]), np.nanmax(rate[shown])
    room = 0.15 * (highest - lowest)
    ax.set_ylim(lowest - room, highest + room)
    ax.set_xlim(begin, begin + DETAIL_S)
    ax.set_xlabel("$t$ [s]")
    ax.set_ylabel(rf"$\Delta\theta_1/T_s$ [{data.unit}/s]")
    ax.legend(loc="upper right", ncols=3)
    plots.finish(ax)
    plots.sign(ax, data.source)
    return figure


def _bode_figure(study: Study) -> Figure:
    figure, (ax,) = _canvas(3.6, (0.55, 0.45, 6.35, 3.4))
    names = [*(m.name for m in study.models), "spectral analysis, 95 %"]
    data = spectral_reference(study.estimation)
    plots.plot_bode(*(m.model for m in study.models), data, labels=names, ax=ax)
    return figure


def _step_poles_figure(study: Study) -> Figure:
    figure, axes = _canvas(3.25, (0.5, 1.15, 3.3, 3.05), (4.1, 1.15, 6.3, 3.05))
    fits, names = [m.model for m in study.models], [m.name for m in study.models]
    plots.plot_step(*fits, labels=names, ax=axes[0])
    plots.plot_poles_zeros(*fits, labels=names, ax=axes[1])
    return figure


def _residuals_figure(study: Study) -> Figure:
    """Draw the tests of all estimated models, two in a row."""
    rows = (len(study.estimated) + 1) // 2
    places = []
    for i in range(len(study.estimated)):
        left, right = ((0.55, 3.1), (3.85, 6.35))[i % 2]
        floor = _RESIDUALS * (rows - 1 - i // 2)
        places.append((left, floor + 0.42, right, floor + 2.95))
    figure, axes = _canvas(_RESIDUALS * rows, *places)
    for ax, model in zip(axes, study.estimated, strict=True):
        plots.plot_residuals(model.fit, study.validation, ax=ax)
        ax.set_title(model.name, loc="left", fontsize=8.5)
    return figure


_FIGURES: dict[str, Callable[[Study], Figure | None]] = {
    "timing": _timing_figure,
    "data": _data_figure,
    "step": _step_figure,
    "compare": _compare_figure,
    "velocity": _velocity_figure,
    "bode": _bode_figure,
    "step_poles": _step_poles_figure,
    "residuals": _residuals_figure,
}
