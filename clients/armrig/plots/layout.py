"""Where a figure draws: axes, panels below or beside them, the look of all, and the file."""

from __future__ import annotations

from itertools import cycle
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

from armrig.numerics.stretches import stretches
from armrig.plots.notebook import show_once

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec
    from numpy.typing import NDArray


MISSING = "#BBBBBB"
_LETTER = "_letter"
_WIDE = 2.0  # width over height, from which on two panels stand side by side
# M. Okabe, K. Ito, "Color Universal Design", 2008; without the yellow, too pale on paper.
BLUE, VERMILION, GREEN = "#0072B2", "#D55E00", "#009E73"
PURPLE, ORANGE, SKY = "#CC79A7", "#E69F00", "#56B4E9"
INK, GREY = "#222222", "#777777"
COLOURS = (SKY, VERMILION, BLUE, GREEN, PURPLE, INK)
DASHES: tuple[Any, ...] = (
    "-",
    (0, (4, 2)),
    "-",
    (0, (6, 1.5, 1, 1.5)),
    (0, (1, 1)),
    (0, (8, 3)),
)
WIDTHS = (3.6, 2.0, 0.8, 1.2, 1.2, 0.8)


def axes(ax: Axes | None) -> Axes:
    """Return `ax`, or those of a new figure of pyplot's, laid out so that nothing is cut off."""
    if ax is not None:
        return ax
    from matplotlib import pyplot as plt

    return plt.subplots(layout="constrained")[1]


def figure_of(ax: Axes) -> Figure:
    """Return the whole figure in which axes lie: what a result's `.plot()` gives, to be saved.

    Its panels have letters if they are of this result alone: a figure of several is its maker's.
    """
    figure = ax.figure.figure
    if len({_group(one) for one in figure.axes}) == 1:
        letter(figure)
    show_once(figure)
    return figure


def letter(figure: Figure) -> None:
    """Mark the panels of a figure by (a), (b), …, each result's from top to bottom.

    A figure of one panel has no letter. A second call marks them again.
    """
    # Not findobj, which makes the ticks of every axis first.
    for old in [text for ax in figure.axes for text in ax.texts if text.get_label() == _LETTER]:
        old.remove()
    panels: dict[tuple[int, float, float], Axes] = {}
    for ax in figure.axes:
        panels.setdefault(_reading_order(ax), ax)  # a second scale has the place of the first
    every = [panels[place] for place in sorted(panels)] if len(panels) > 1 else []
    for ax, mark in zip(every, ascii_lowercase, strict=False):
        # Between the axis' label and the names of the curves; above the frequencies in Hz.
        ax.annotate(
            f"({mark})",
            (0.0, 1.0),
            xycoords="axes fraction",
            xytext=(-4.0, 18.0 if ax.child_axes else 3.0),
            textcoords="offset points",
            ha="right",
            va="bottom",
            fontsize="small",
            fontweight="bold",
            label=_LETTER,
        )


def _reading_order(ax: Axes) -> tuple[int, float, float]:
    box = ax.get_position()
    return _group(ax), -round(float(box.y1), 3), round(float(box.x0), 3)


def _group(ax: Axes) -> int:
    """Return the number of the place that axes and their panels have in their figure."""
    place = ax.get_subplotspec()
    return place.get_topmost_subplotspec().num1 if place is not None else 0


def panels(ax: Axes | None, share: float, *, sharex: bool = True) -> tuple[Axes, Axes]:
    """Return `ax`, shortened, and a panel below it that takes `share` of the height of both.

    Panels that share no axis stand side by side where `ax` is much wider than high.
    """
    ax = axes(ax)
    place = _place(ax)
    # A layout engine makes room for labels itself.
    room = 0.02 if ax.figure.get_layout_engine() is not None else 0.08 if sharex else 0.5
    shares = (1 - share, share)
    if not sharex and ax.bbox.width > _WIDE * ax.bbox.height:
        grid = place.subgridspec(1, 2, width_ratios=shares, wspace=room)
    else:
        grid = place.subgridspec(2, 1, height_ratios=shares, hspace=room)
    ax.set_subplotspec(grid[0])
    below = ax.figure.add_subplot(grid[1], sharex=ax if sharex else None)
    if sharex:
        ax.tick_params(labelbottom=False)
    return ax, below


def rows(ax: Axes | None, n: int) -> list[Axes]:
    """Return `ax`, shortened, and more panels below it: n as high as each other, over one axis.

    They begin at one place, however wide their labels are, since they are of one grid.
    """
    ax = axes(ax)
    grid = _place(ax).subgridspec(n, 1, hspace=0.02 if ax.figure.get_layout_engine() else 0.08)
    ax.set_subplotspec(grid[0])
    every = [ax, *(ax.figure.add_subplot(grid[i], sharex=ax) for i in range(1, n))]
    for panel in every[:-1]:
        panel.tick_params(labelbottom=False)
    return every


def _place(ax: Axes) -> SubplotSpec:
    """Return where axes stand in a grid; where they were placed by hand, a grid of one place."""
    place = ax.get_subplotspec()
    if place is not None:
        return place
    (x0, y0), (x1, y1) = ax.get_position().get_points()
    return ax.figure.add_gridspec(1, 1, left=x0, right=x1, bottom=y0, top=y1)[0]


def finish(*panels: Axes, xlim: tuple[float, float] | None = None) -> None:
    """Give panels the look that all have."""
    for ax in panels:
        ax.grid(visible=True, which="major", color="#DDDDDD", lw=0.5)
        ax.set_axisbelow(True)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
        if xlim:
            ax.set_xlim(*xlim)
    panels[0].figure.align_ylabels(panels)


def save(figure: Figure, path: Path, **options: Any) -> None:
    """Write a figure, its panels with letters.

    The same figure gives the same bytes: without date or random ids.
    """
    import matplotlib as mpl

    letter(figure)
    undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    with mpl.rc_context({"svg.hashsalt": "armrig"}):
        figure.savefig(path, metadata=undated.get(path.suffix.lower()), **options)


def shade(ax: Axes, valid: NDArray[np.bool_], Ts: float, *, first: float = 0.0) -> None:
    """Shade the time in which an angle is not valid, and name it for the legend.

    Parameters
    ----------
    valid : ndarray of bool (N,)
        False where the value is missing.
    Ts, first : float
        Sampling time, and time of the first sample, in s.
    """
    # Not grey as the grid; a line of its own keeps three samples of thousands visible.
    look: dict[str, Any] = {"facecolor": ORANGE, "edgecolor": ORANGE, "alpha": 0.35, "lw": 0.5}
    label = "dead band or missing sample"
    for gap in stretches(~valid):
        begin, end = (first + (k - 0.5) * Ts for k in (gap.start, gap.stop))
        ax.axvspan(begin, end, label=label, zorder=0.5, **look)
        label = "_"


def stems(ax: Axes, x: NDArray[Any], y: NDArray[Any], colour: str) -> None:
    """Draw values over lags, each as a stem from zero."""
    ax.vlines(x, 0, y, color=colour, lw=1.0)
    ax.plot(x, y, "o", color=colour, ms=2.6)
    ax.axhline(0, color=INK, lw=0.6)


def pens(curves: int) -> list[dict[str, Any]]:
    """Return what draws each of so many curves: colour, dashes and width.

    The first is the widest: where curves agree, each shows beside the next.
    """
    if curves == 1:
        return [{"color": BLUE, "ls": "-", "lw": 1.4}]
    each = cycle(zip(COLOURS, DASHES, WIDTHS, strict=True))
    return [
        {"color": colour, "ls": dash, "lw": width}
        for (colour, dash, width), _ in zip(each, range(curves), strict=False)
    ]
