"""The figures of the handout's report: half as high as the others, for ten pages."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import matplotlib as mpl
from armrig_core.arm import arm_matrices
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from armrig import plots
from armrig.physics.integrators.accuracy import convergence
from armrig.physics.systems import ArmParameters
from armrig.plots.captions import named_by_run
from armrig.plots.layout import save
from armrig.report.figures import STYLE, WIDTH
from armrig.report.handout_study import METHODS, HandoutStudy

_LOWER, _HEIGHT = 1.35, 1.55
_HIGHER, _LEGENDS = 1.95, 1.75
"""Where two panels stand one below the other, or a panel has many names."""
_SLOPE = 2.6
"""High enough for the slope at t = 0, which assignment 2.2 is about, below four lines of names."""
Draw = Callable[[Axes], object]


class Shown(Protocol):
    """What shows itself."""

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Draw into `ax`."""


def write_handout_figures(study: HandoutStudy, directory: Path) -> frozenset[str]:
    """Write the figures that the study has data for as SVG, and return their names."""
    drawn = _drawn(study)
    look = STYLE | {"font.size": 7.5, "xtick.labelsize": 7, "ytick.labelsize": 7}
    runs = {r.sha256: r.manifest.run_id for r in study.recordings}
    with mpl.rc_context(look), named_by_run(runs):
        for name, (height, draws) in drawn.items():
            figure = Figure(figsize=(WIDTH, height), layout="constrained")
            columns = figure.subplots(1, len(draws), squeeze=False)[0]
            for ax, draw in zip(columns, draws, strict=True):
                draw(ax)
            save(figure, directory / f"{name}.svg")
    return frozenset(drawn)


def _drawn(study: HandoutStudy) -> dict[str, tuple[float, list[Draw]]]:
    """Return height and panels of each figure."""
    A, _, _ = arm_matrices(ArmParameters())
    studies = [convergence(study.problem, m) for m in METHODS.values()]
    found: dict[str, tuple[float, list[Draw]]] = {
        "rig": (_LOWER, [lambda ax: plots.plot_rig(ax=ax)]),
        "step": (_SLOPE, [lambda ax: plots.plot_physical_step(study.cases, seconds=0.5, ax=ax)]),
        "integrators": (
            2.4,
            [
                lambda ax: plots.plot_stability_regions(A, methods=tuple(METHODS.values()), ax=ax),
                lambda ax: plots.plot_convergence(studies, ax=ax),
            ],
        ),
        "solution": (
            _HIGHER,
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
    heights = {"sampling": _HIGHER, "structure": _HIGHER, "loop": _LOWER}
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
        found["residuals"] = (_LEGENDS, [lambda ax: plots.plot_residuals(fit, data, ax=ax)])
        found["compare"] = (
            2.75,
            [lambda ax: plots.plot_compare(data, *models, labels=names, ax=ax)],
        )
    if grey is not None and chassis is not None:
        found["greybox"] = (_HIGHER, [lambda ax: plots.plot_greybox(grey, chassis, ax=ax)])
    return found
