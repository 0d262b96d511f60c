"""Figures that commands write: one axes below the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from armrig.cli.options import tell
from armrig.cli.output_file import check_output

Plot = Annotated[
    Path | None, typer.Option("-o", "--plot", metavar="FIGURE", help="Figure to write.")
]


def check_plot(path: Path | None, inputs: Sequence[Path] = ()) -> None:
    """Refuse, before any work, a figure that cannot or must not be written."""
    if path is None:
        return
    from armrig.rig.bench.results import check_figure

    check_output(path, inputs)
    check_figure(path)


def write_plot(path: Path | None, *draw: Callable[..., Any], height: float = 3.6) -> None:
    """Write a figure with axes for each that draws into `ax`, and say where it is."""
    if path is None:
        return
    from matplotlib.figure import Figure

    from armrig.canvas import save
    from armrig.cli.spinner import spinner

    # As wide as the text of an A4 page.
    figure = Figure(figsize=(6.3, height * len(draw)), layout="constrained")
    below = figure.subplots(len(draw), squeeze=False)[:, 0]
    with spinner("drawing"):
        for ax, one in zip(below, draw, strict=True):
            one(ax=ax)
        save(figure, path, dpi=200)
    tell(f"figure: {path}")
