"""Figures of a report."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from armrig_core.telemetry.channels import CHANNELS
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from armrig import plots
from armrig.data.dataset import Dataset, Vector
from armrig.estimation.nonparametric.spectral import spectral_reference
from armrig.physics.integrators.accuracy import convergence
from armrig.plots import layout
from armrig.plots.captions import labelled, legend, named, named_by_run
from armrig.recordings.figures import varying_times
from armrig.report.handout_study import METHODS, HandoutStudy
from armrig.report.study import STEP, AssessedFit, Study, each_output, kind_of

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
_LOW_HEIGHT, _HEIGHT = 1.6, 1.75
_TWO_PANELS_HEIGHT, _LEGENDS_HEIGHT, _HIGH_LEGENDS_HEIGHT = 2.1, 1.85, 2.6
"""Heights, in inches, of a figure with two stacked panels, and of panels with long legends."""
_STEP_HEIGHT = 2.6
"""Height, in inches, at which the slope at t = 0 (assignment 2.2) is visible below the legend."""
Draw = Callable[..., object]
"""Function that draws into the axes `ax`."""
Drawing = tuple[float, Sequence[Draw]]
"""Height of a figure in inches, and a function for each panel; a row has at most two panels."""


def write_figures(study: Study | HandoutStudy, directory: Path) -> tuple[Path, ...]:
    """Write the figures for which a study has data as SVG into `directory`; return their paths."""
    found = _of_handout(study) if isinstance(study, HandoutStudy) else of_study(study)
    runs, paths = {r.sha256: r.manifest.run_id for r in study.recordings}, []
    with mpl.rc_context(STYLE), named_by_run(runs):
        for name, (height, draws) in found.items():
            paths.append(directory / f"{name}.svg")
            save(drawn(height, draws), paths[-1])
    return tuple(paths)


def drawn(height: float, draws: Sequence[Draw]) -> Figure:
    """Return a figure as wide as the text, without empty panels."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    panels = figure.subplots(-(-len(draws) // 2), min(2, len(draws)), squeeze=False).ravel()
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


def suffix(one: Study, study: Study) -> str:
    """Return the suffix in the file names of an output's figures; "" for the first output."""
    return "" if one is study else f"-{one.output}"


def of_study(study: Study) -> dict[str, Drawing]:
    """Return the figures of the recordings, then the figures of each output, by name."""
    recording = study.recording_of(study.estimation.source)
    found: dict[str, Drawing] = {}
    if varying := varying_times(recording):
        found["timing"] = (
            2.2,
            [partial(plots.plot_timing, recording, quantity=quantity) for quantity in varying],
        )
    if steps := [r for r in study.recordings if kind_of(r) == STEP]:
        found["step"] = 2.0, [partial(plots.plot_data, steps[0])]
    for one in each_output(study):
        found |= {f"{name}{suffix(one, study)}": of for name, of in _of_output(one).items()}
    return found


def _of_output(study: Study) -> dict[str, Drawing]:
    """Return the figures of one output by name."""
    fits, names = [m.model for m in study.models], [m.name for m in study.models]
    own = len(study.estimated)
    compared = partial(plots.plot_compare, study.validation, *fits[:own], labels=names[:own])
    spectrum = spectral_reference(study.estimation)
    with_spectrum = [*names, "spectral analysis, 95 %"]
    return {
        "data": (2.4, [partial(plots.plot_data, d) for d in (study.estimation, study.validation)]),
        "compare": (3.0, [compared]),
        "velocity": (2.0, [partial(plot_velocity, study)]),
        "bode": (3.4, [partial(plots.plot_bode, *fits, spectrum, labels=with_spectrum)]),
        "step_poles": (
            2.7,
            [
                partial(plot, *fits, labels=names)
                for plot in (plots.plot_step, plots.plot_poles_zeros)
            ],
        ),
        "residuals": (
            3.4 * -(-own // 2),
            [partial(_plot_residuals, m, study.validation) for m in study.estimated],
        ),
    }


def detail_s(data: Dataset) -> float:
    """Return the length of the detail of a simulation, in s."""
    return max(_DETAIL_S, _DETAIL_SHARE * data.N * data.Ts)


def plot_velocity(study: Study, *, ax: Axes) -> None:
    """Plot a detail of the simulation; of an output that integrates, plot the rate."""
    data, seconds = study.validation, detail_s(study.validation)

    def of(y: Vector) -> Vector:
        return np.diff(y) / data.Ts if study.integrates else y[1:]

    t = data.t[1:]
    begin = min(data.N // 3 * data.Ts, max(data.t[-1] - seconds, 0.0))
    shown = (t >= begin) & (t <= begin + seconds)
    measured = of(data.y)[shown]
    ax.plot(t[shown], measured, ".", color=plots.INK, ms=2.5, alpha=0.6, label="measured")
    for model, pen in zip(study.estimated, layout.pens(len(study.estimated)), strict=True):
        modelled = of(model.comparison.y)
        ax.plot(t[shown], modelled[shown], label=f"{model.name}, simulated", **pen)
    lowest, highest = np.nanmin(measured), np.nanmax(measured)
    room = 0.15 * (highest - lowest)
    ax.set_ylim(lowest - room, highest + room)
    ax.set_xlim(begin, begin + seconds)
    ax.set_xlabel("$t$ [s]")
    symbol = labelled(data.output)
    change = rf"$\Delta{symbol[1:-1]}/T_s$" if symbol.startswith("$") else f"Δ{symbol}/Ts"
    label = f"{change} [{data.unit}/s]"
    ax.set_ylabel(label if study.integrates else named(data.output, data.unit))
    plots.finish(ax)
    plots.sign(ax, data.source, above=legend(ax))


def _plot_residuals(model: AssessedFit, data: Dataset, *, ax: Axes) -> None:
    plots.plot_residuals(model.model, data, ax=ax)
    ax.set_ylabel(f"{model.name}: {ax.get_ylabel()}")


def _of_handout(study: HandoutStudy) -> dict[str, Drawing]:
    """Return the figures of the handout's report by name."""
    problem, methods = study.problem, tuple(METHODS.values())
    regions = partial(plots.plot_stability_regions, problem.A, methods=methods)
    errors = partial(plots.plot_convergence, [convergence(problem, m) for m in methods])
    speed: dict[str, Any] = {"state": 2, "label": f"{labelled(CHANNELS[0].rate)} [rad/s]"}
    solution = partial(plots.plot_solution, problem, 0.02, methods=methods, **speed)
    found: dict[str, Drawing] = {
        "rig": (_LEGENDS_HEIGHT, [plots.plot_rig]),
        "step": (_STEP_HEIGHT, [partial(plots.plot_physical_step, study.cases, seconds=0.5)]),
        "integrators": (2.4, [regions, errors]),
        "solution": (_TWO_PANELS_HEIGHT, [solution]),
    }
    results: dict[str, tuple[float, Any]] = {
        "sampling": (_HIGH_LEGENDS_HEIGHT, study.sampling),
        "structure": (_HIGH_LEGENDS_HEIGHT, study.hints),
        "split": (_HEIGHT, study.split),
        "loop": (_LOW_HEIGHT, study.loop if study.loop and study.loop.sims else None),
        "delay": (_HEIGHT, study.delay),
    }
    found |= {name: (height, [x.plot]) for name, (height, x) in results.items() if x is not None}
    if black := study.black:
        data, labels = black.validation, [m.name for m in black.models]
        of_best = partial(plots.plot_residuals, black.best.model, data)
        of_all = partial(plots.plot_compare, data, *(m.model for m in black.models), labels=labels)
        found |= {"residuals": (_LEGENDS_HEIGHT, [of_best]), "compare": (2.95, [of_all])}
    if study.grey is not None and study.alone is not None:
        fitted = partial(plots.plot_greybox, study.grey, study.alone)
        found["greybox"] = _TWO_PANELS_HEIGHT, [fitted]
    return found
