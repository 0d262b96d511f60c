"""Figures that commands write: one axes below the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armrig.cli.files import check_output
from armrig.cli.options import tell

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Plot = Annotated[Path | None, typer.Option("--plot", metavar="PNG", help="Figure to write.")]


def check_plot(path: Path | None, inputs: Sequence[Path] = ()) -> None:
    """Refuse, before any work, a figure that cannot or must not be written."""
    if path is None:
        return
    from armrig.rig.bench.results import check_figure

    check_output(path, inputs)
    check_figure(path)


def write_plot(path: Path | None, *draw: Callable[[Axes], Any], height: float = 3.6) -> None:
    """Write a figure with one axes for each that draws, and say where it is."""
    if path is None:
        return
    from matplotlib.figure import Figure

    from armrig.canvas import save
    from armrig.cli.spinner import spinner

    # No constrained layout: it overlooks the panels that a figure appends below its axes.
    figure = Figure(figsize=(8.0, height * len(draw)))
    below = figure.subplots(len(draw), squeeze=False, gridspec_kw={"hspace": 0.32})[:, 0]
    with spinner("drawing"):
        for ax, one in zip(below, draw, strict=True):
            one(ax)
        save(figure, path, dpi=150, bbox_inches="tight")
    tell(f"figure: {path}")
