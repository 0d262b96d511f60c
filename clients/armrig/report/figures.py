"""Figures of a report."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import matplotlib as mpl
import numpy as np
from armrig_core.arm import arm_matrices
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from armrig import plots
from armrig.data.dataset import Vector
from armrig.estimation.nonparametric.spectral import spectral_reference
from armrig.physics.integrators.accuracy import convergence
from armrig.physics.systems import ArmParameters
from armrig.plots import layout
from armrig.plots.captions import legend, named, named_by_run
from armrig.recordings.figures import varying_times
from armrig.report.handout_study import METHODS, HandoutStudy
from armrig.report.study import STEP, Study, each_output, kind_of

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
DETAIL_S = 4.0
_RESIDUALS_ROW_HEIGHT = 3.4
_LOW_HEIGHT, _HEIGHT = 1.6, 1.75
_TWO_PANELS_HEIGHT, _LEGENDS_HEIGHT, _HIGH_LEGENDS_HEIGHT = 2.1, 1.85, 2.6
"""Heights, in inches, of a figure with two stacked panels, and of panels with long legends."""
_STEP_HEIGHT = 2.6
"""Height, in inches, at which the slope at t = 0 (assignment 2.2) is visible below the legend."""
Draw = Callable[[Axes], object]


def write_figures(study: Study, directory: Path) -> tuple[Path, ...]:
    """Write the figures of a study as SVG into `directory` and return their paths."""
    paths = []
    runs = {r.sha256: r.manifest.run_id for r in study.recordings}
    with mpl.rc_context(STYLE), named_by_run(runs):
        for one in each_output(study):
            for name, draw in _FIGURES.items():
                figure = draw(one) if one is study or name not in _OF_RECORDINGS else None
                if figure is not None:
                    paths.append(directory / f"{name}{suffix(one, study)}.svg")
                    save(figure, paths[-1])
    return tuple(paths)


def save(figure: Figure, path: Path) -> None:
    """Write a figure as SVG; texts smaller than `MIN_SIZE`, such as an index, get this size."""
    layout.save(figure, path)
    svg = re.sub(
        r"(?<=font-size:\s)[\d.]+(?=px)",
        lambda size: f"{max(float(size[0]), MIN_SIZE):g}",
        path.read_text(encoding="utf-8"),
    )
    path.write_text(svg, encoding="utf-8")


def suffix(one: Study, study: Study) -> str:
    """Return the suffix in the file names of an output's figures; "" for the first output."""
    return "" if one is study else f"-{one.output}"


def _canvas(height: float, columns: int = 1, rows: int = 1) -> tuple[Figure, list[Any]]:
    """Return a figure as wide as the text and `height` inches high, and its axes."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False).ravel().tolist()


def _timing_figure(study: Study) -> Figure | None:
    """Draw a panel for each quantity that has more than one value; None if there is none."""
    recording = study.recording_of(study.estimation.source)
    if not (varying := varying_times(recording)):
        return None
    figure, axes = _canvas(2.2, len(varying))
    for ax, quantity in zip(axes, varying, strict=True):
        plots.plot_timing(recording, quantity=quantity, ax=ax)
    return figure


def _data_figure(study: Study) -> Figure:
    figure, axes = _canvas(2.4, 2)
    for ax, data in zip(axes, (study.estimation, study.validation), strict=True):
        plots.plot_data(data, ax=ax)
    return figure


def _step_figure(study: Study) -> Figure | None:
    steps = [r for r in study.recordings if kind_of(r) == STEP]
    if not steps:
        return None
    figure, (ax,) = _canvas(2.0)
    plots.plot_data(steps[0], ax=ax)
    return figure


def _compare_figure(study: Study) -> Figure:
    figure, (ax,) = _canvas(3.0)
    fits = [m.model for m in study.estimated]
    names = [m.name for m in study.estimated]
    plots.plot_compare(study.validation, *fits, labels=names, ax=ax)
    return figure


def _velocity_figure(study: Study) -> Figure:
    figure, (ax,) = _canvas(2.0)
    data = study.validation

    def of(y: Vector) -> Vector:
        return np.diff(y) / data.Ts if study.integrates else y[1:]

    t = data.t[1:]
    begin = min(data.N // 3 * data.Ts, max(data.t[-1] - DETAIL_S, 0.0))
    shown = (t >= begin) & (t <= begin + DETAIL_S)
    measured = of(data.y)[shown]
    ax.plot(t[shown], measured, ".", color=plots.INK, ms=2.5, alpha=0.6, label="measured")
    for model, pen in zip(study.estimated, layout.pens(len(study.estimated)), strict=True):
        modelled = of(model.comparison.y)
        ax.plot(t[shown], modelled[shown], label=f"{model.name}, simulated", **pen)
    lowest, highest = np.nanmin(measured), np.nanmax(measured)
    room = 0.15 * (highest - lowest)
    ax.set_ylim(lowest - room, highest + room)
    ax.set_xlim(begin, begin + DETAIL_S)
    ax.set_xlabel("$t$ [s]")
    label = rf"$\Delta\theta_1/T_s$ [{data.unit}/s]"
    ax.set_ylabel(label if study.integrates else named(data.output, data.unit))
    plots.finish(ax)
    plots.sign(ax, data.source, above=legend(ax))
    return figure


def _bode_figure(study: Study) -> Figure:
    figure, (ax,) = _canvas(3.4)
    names = [*(m.name for m in study.models), "spectral analysis, 95 %"]
    data = spectral_reference(study.estimation)
    plots.plot_bode(*(m.model for m in study.models), data, labels=names, ax=ax)
    return figure


def _step_poles_figure(study: Study) -> Figure:
    figure, axes = _canvas(2.7, 2)
    fits, names = [m.model for m in study.models], [m.name for m in study.models]
    plots.plot_step(*fits, labels=names, ax=axes[0])
    plots.plot_poles_zeros(*fits, labels=names, ax=axes[1])
    return figure


def _residuals_figure(study: Study) -> Figure:
    """Draw the residual tests of all estimated models, two panels in a row."""
    rows = (len(study.estimated) + 1) // 2
    figure, axes = _canvas(_RESIDUALS_ROW_HEIGHT * rows, min(2, len(study.estimated)), rows)
    for ax in axes[len(study.estimated) :]:
        ax.remove()
    for ax, model in zip(axes, study.estimated, strict=False):
        plots.plot_residuals(model.fit, study.validation, ax=ax)
        ax.set_ylabel(f"{model.name}: {ax.get_ylabel()}")
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
_OF_RECORDINGS = ("timing", "step")
"""Figures that all outputs have in common."""


class Shown(Protocol):
    """A result with a method that draws it."""

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Draw into `ax`, or into a new figure."""


def write_handout_figures(study: HandoutStudy, directory: Path) -> frozenset[str]:
    """Write the figures for which the study has data as SVG files, and return their names."""
    drawn = _drawn(study)
    runs = {r.sha256: r.manifest.run_id for r in study.recordings}
    with mpl.rc_context(STYLE), named_by_run(runs):
        for name, (height, draws) in drawn.items():
            figure = Figure(figsize=(WIDTH, height), layout="constrained")
            columns = figure.subplots(1, len(draws), squeeze=False)[0]
            for ax, draw in zip(columns, draws, strict=True):
                draw(ax)
            save(figure, directory / f"{name}.svg")
    return frozenset(drawn)


def _drawn(study: HandoutStudy) -> dict[str, tuple[float, list[Draw]]]:
    """Return the height, in inches, and the panels of each figure."""
    A, _, _ = arm_matrices(ArmParameters())
    studies = [convergence(study.problem, m) for m in METHODS.values()]
    found: dict[str, tuple[float, list[Draw]]] = {
        "rig": (_LEGENDS_HEIGHT, [lambda ax: plots.plot_rig(ax=ax)]),
        "step": (
            _STEP_HEIGHT,
            [lambda ax: plots.plot_physical_step(study.cases, seconds=0.5, ax=ax)],
        ),
        "integrators": (
            2.4,
            [
                lambda ax: plots.plot_stability_regions(A, methods=tuple(METHODS.values()), ax=ax),
                lambda ax: plots.plot_convergence(studies, ax=ax),
            ],
        ),
        "solution": (
            _TWO_PANELS_HEIGHT,
            [
                lambda ax: plots.plot_solution(
                    study.problem,
                    0.02,
                    methods=tuple(METHODS.values()),
                    state=2,
                    label=r"$\dot\theta_1$ [rad/s]",
                    ax=ax,
                )
            ],
        ),
    }
    return found | _of_data(study)


def _drawing(value: Shown) -> Draw:
    return lambda ax: value.plot(ax=ax)


def _of_data(study: HandoutStudy) -> dict[str, tuple[float, list[Draw]]]:
    values: dict[str, Shown | None] = {
        "sampling": study.sampling,
        "structure": study.hints,
        "split": study.split,
        "loop": study.loop,
        "delay": study.delay,
    }
    heights = {
        "sampling": _HIGH_LEGENDS_HEIGHT,
        "structure": _HIGH_LEGENDS_HEIGHT,
        "loop": _LOW_HEIGHT,
    }
    found = {
        name: (heights.get(name, _HEIGHT), [_drawing(value)])
        for name, value in values.items()
        if value is not None
    }
    black, grey, chassis = study.black, study.grey, study.chassis
    if black is not None:
        names = [m.name for m in black.models]
        models = [m.model for m in black.models]
        fit, data = black.best.fit, black.validation
        found["residuals"] = (_LEGENDS_HEIGHT, [lambda ax: plots.plot_residuals(fit, data, ax=ax)])
        found["compare"] = (
            2.95,
            [lambda ax: plots.plot_compare(data, *models, labels=names, ax=ax)],
        )
    if grey is not None and chassis is not None:
        found["greybox"] = (
            _TWO_PANELS_HEIGHT,
            [lambda ax: plots.plot_greybox(grey, chassis, ax=ax)],
        )
    return found
