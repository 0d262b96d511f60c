"""Layout of a figure: axes, panels, the style, the file, and the display in a notebook."""

from __future__ import annotations

import re
import sys
import warnings
from base64 import b64encode
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from html import escape
from io import BytesIO
from itertools import cycle
from logging import ERROR, getLogger
from math import tau
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

from armrig_core.process.printable import SPACES, printable, with_degrees

from armrig.numerics.stretches import stretches

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis, XAxis, YAxis
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec
    from numpy.typing import NDArray


MISSING = "#BBBBBB"
_LETTER_LABEL = "_letter"
MIN_WIDE_RATIO = 2.0
"""Ratio of the width to the height of axes; above this ratio, two panels are side by side."""
# M. Okabe, K. Ito, "Color Universal Design", 2008; the yellow is left out, because it is too pale
# on paper.
BLUE, VERMILION, GREEN = "#0072B2", "#D55E00", "#009E73"
PURPLE, ORANGE, SKY = "#CC79A7", "#E69F00", "#56B4E9"
INK, GREY = "#222222", "#777777"
COLOURS = (SKY, VERMILION, BLUE, GREEN, PURPLE, INK)
DASHES: tuple[Any, ...] = ("-", (0, (4, 2)), "-", (0, (6, 1.5, 1, 1.5)), (0, (1, 1)), (0, (8, 3)))
WIDTHS = (3.6, 2.0, 0.8, 1.2, 1.2, 0.8)
_RAISED_DIGITS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
_PANEL_HEIGHT = 1.15  # inches
_WIDTH = 6.4  # inches
_LEAST_HEIGHT = 3.6  # inches


def axes(ax: Axes | None) -> Axes:
    """Return `ax`, or the axes of a new pyplot figure with constrained layout."""
    if ax is not None:
        return ax
    from matplotlib import pyplot as plt

    return plt.subplots(layout="constrained")[1]


def high_axes(n: int) -> Axes:
    """Return the axes of a new figure that is high enough for n panels."""
    ax = axes(None)
    ax.figure.figure.set_size_inches(_WIDTH, max(_LEAST_HEIGHT, _PANEL_HEIGHT * n))
    return ax


def stack_panels(size: tuple[float, float], heights: Sequence[float]) -> tuple[Figure, list[Axes]]:
    """Return a new pyplot figure of `size` in inches, and its panels from top to bottom."""
    from matplotlib import pyplot as plt

    figure = plt.figure(figsize=size, layout="constrained")
    return figure, figure.subplots(len(heights), 1, height_ratios=heights).tolist()


def figure_of(ax: Axes) -> Figure:
    """Return the figure that contains the axes, for the method `.plot()` of a result.

    If all panels belong to one result, they are marked by letters. In a figure of several results
    the caller must call `letter`.
    """
    figure = ax.figure.figure
    if len({_group(panel) for panel in figure.axes}) == 1:
        letter(figure)
    _write_degrees(figure)
    show_once(figure)
    return figure


def _write_degrees(figure: Figure) -> None:
    """Write °C for degC in all texts of a figure."""
    from matplotlib.text import Text

    for artist in figure.findobj(Text):
        text = artist.get_text() if isinstance(artist, Text) else ""
        if isinstance(artist, Text) and (new_text := with_degrees(text)) != text:
            artist.set_text(new_text)


def plot_method(name: str, subject: str) -> Callable[..., Figure]:
    """Return the method `.plot()` of a result that the function `name` of `armrig.plots` draws."""

    def plot(self: Any, *, ax: Axes | None = None) -> Figure:
        from armrig import plots

        return figure_of(getattr(plots, name)(self, ax=ax))

    plot.__doc__ = f"Return a figure of {subject}: see `armrig.plots.{name}`."
    return plot


def letter(figure: Figure) -> None:
    """Mark the panels with the letters (a), (b), … in the order of the results.

    The panels of each result are marked from top to bottom. A figure of one panel has no letter. A
    second call replaces the letters of the first call.
    """
    # Not findobj, which creates the ticks of every axis.
    texts = [text for ax in figure.axes for text in ax.texts]
    for old in [text for text in texts if text.get_label() == _LETTER_LABEL]:
        old.remove()
    panels: dict[tuple[int, float, float], Axes] = {}
    for ax in figure.axes:
        panels.setdefault(_reading_order(ax), ax)  # axes of a second scale are the same panel
    every = [panels[place] for place in sorted(panels)] if len(panels) > 1 else []
    for ax, mark in zip(every, ascii_lowercase, strict=False):
        # Between the axis label and the names of the curves; above the frequencies in Hz.
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
            label=_LETTER_LABEL,
        )


def _reading_order(ax: Axes) -> tuple[int, float, float]:
    box = ax.get_position()
    return _group(ax), -round(float(box.y1), 3), round(float(box.x0), 3)


def _group(ax: Axes) -> int:
    """Return the index of the outermost grid cell that contains the axes; 0 without a grid."""
    place = ax.get_subplotspec()
    return place.get_topmost_subplotspec().num1 if place is not None else 0


def panels(ax: Axes | None, share: float, *, sharex: bool = True) -> tuple[Axes, Axes]:
    """Shorten `ax`, add a panel below with the fraction `share` of the height, and return both.

    If `ax` is much wider than high, panels without a common axis are drawn side by side.
    """
    ax = axes(ax)
    place = _place(ax)
    # A layout engine adds the room for labels itself.
    room = 0.02 if ax.figure.get_layout_engine() is not None else 0.08 if sharex else 0.5
    shares = (1 - share, share)
    if not sharex and ax.bbox.width > MIN_WIDE_RATIO * ax.bbox.height:
        grid = place.subgridspec(1, 2, width_ratios=shares, wspace=room)
    else:
        grid = place.subgridspec(2, 1, height_ratios=shares, hspace=room)
    ax.set_subplotspec(grid[0])
    below = ax.figure.add_subplot(grid[1], sharex=ax if sharex else None)
    if sharex:
        ax.tick_params(labelbottom=False)
    return ax, below


def rows(ax: Axes | None, n: int) -> list[Axes]:
    """Divide `ax` into n panels of equal height with a common x axis; `ax` becomes the first panel.

    The panels share a grid, so their left edges are aligned for labels of any width.
    """
    ax = axes(ax)
    grid = _place(ax).subgridspec(n, 1, hspace=0.02 if ax.figure.get_layout_engine() else 0.08)
    ax.set_subplotspec(grid[0])
    every = [ax, *(ax.figure.add_subplot(grid[i], sharex=ax) for i in range(1, n))]
    for panel in every[:-1]:
        panel.tick_params(labelbottom=False)
    return every


def _place(ax: Axes) -> SubplotSpec:
    """Return the grid cell of axes; for axes without a grid, make a grid with one cell."""
    place = ax.get_subplotspec()
    if place is not None:
        return place
    (x0, y0), (x1, y1) = ax.get_position().get_points()
    return ax.figure.add_gridspec(1, 1, left=x0, right=x1, bottom=y0, top=y1)[0]


def finish(*panels: Axes, xlim: tuple[float, float] | None = None) -> None:
    """Apply the common style and `xlim` to panels whose axes have labels, and align the labels."""
    for ax in panels:
        for label in (ax.xaxis.label, ax.yaxis.label):
            label.set_text(drawable(label.get_text()))
        ax.grid(visible=True, which="major", color="#DDDDDD", lw=0.5)
        ax.set_axisbelow(True)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
        if xlim:
            ax.set_xlim(*xlim)
    panels[0].figure.align_ylabels(panels)


def drawable(text: str) -> str:
    """Return a text that can be drawn, with its exponents in mathtext.

    A formula that cannot be drawn, as in a name or a unit of a file, becomes text. Control
    characters, which an SVG must not contain, are escaped.
    """
    lines, text = [], printable(text, keep="\n" + SPACES)
    for line in text.split("\n"):
        drawn = in_mathtext(line)
        is_right = _has_right_formulas(drawn)
        lines.append(drawn if is_right else in_mathtext(line.replace("$", r"\$")))
    return "\n".join(lines)


def in_mathtext(text: str) -> str:
    """Return a text with the exponents of 10⁻³ and s⁻¹ in mathtext; few fonts have their digits."""

    def exponent(match: re.Match[str]) -> str:
        return f"${match[1] or ''}^{{{match[2].translate(_RAISED_DIGITS)}}}$"

    return re.sub("(?:(10)(?=[⁻⁰¹²³⁴⁵⁶⁷⁸⁹])|(?=⁻))([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", exponent, text)


@contextmanager
def any_characters() -> Iterator[None]:
    """Draw a box or ¤, without a warning, for a character that no font of this machine has."""
    formulas = getLogger("matplotlib.mathtext")
    level = formulas.level
    formulas.setLevel(ERROR)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph .* missing")
            yield
    finally:
        formulas.setLevel(level)


def _has_right_formulas(line: str) -> bool:
    from matplotlib.mathtext import MathTextParser

    try:
        if "$" in line:
            with any_characters():
                MathTextParser("path").parse(line)
    except ValueError:
        return False
    return line.replace(r"\$", "").count("$") % 2 == 0


def save(figure: Figure, path: Path, **options: Any) -> None:
    """Mark the panels of a figure with letters, and write the figure to a file.

    The file contains no date and no random ids, so that equal figures give identical files.
    """
    import matplotlib as mpl

    letter(figure)
    _write_degrees(figure)
    undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    with mpl.rc_context({"svg.hashsalt": "armrig"}), any_characters():
        figure.savefig(path, metadata=undated.get(path.suffix.lower()), **options)


def shade(
    ax: Axes, valid: NDArray[np.bool_], Ts: float, *, dead_band: bool, first: float = 0.0
) -> None:
    """Shade the times without a valid value, and label the shade for the legend.

    `valid` (N,) is False where the value is missing; `dead_band` is True if a dead band of the rig
    may be the reason. `first` is the time of the first sample in s.
    """
    # Orange, since the grid is grey. With the edge, a gap of a few samples in thousands is visible.
    look: dict[str, Any] = {"facecolor": ORANGE, "edgecolor": ORANGE, "alpha": 0.35, "lw": 0.5}
    label = f"{'dead band or ' * dead_band}missing sample"
    for gap in stretches(~valid):
        begin, end = (first + (k - 0.5) * Ts for k in (gap.start, gap.stop))
        ax.axvspan(begin, end, label=label, zorder=0.5, **look)
        label = "_"


def stems(
    ax: Axes,
    x: NDArray[Any],
    y: NDArray[Any],
    colour: str,
    *,
    band: NDArray[Any] | None = None,
    label: str = "",
) -> None:
    """Draw a vertical line from 0 to y at each x, and a band about 0 of this half width."""
    if band is not None:
        ax.fill_between(x, -band, band, step="mid", color=GREY, alpha=0.25, lw=0, label=label)
    ax.vlines(x, 0, y, color=colour, lw=1.0)
    ax.plot(x, y, "o", color=colour, ms=2.6)
    ax.axhline(0, color=INK, lw=0.6)


def pens(curves: int) -> list[dict[str, Any]]:
    """Return the colour, dashes and width of each curve.

    The first curve is the widest, so that all curves are visible where they coincide.
    """
    if curves == 1:
        return [{"color": BLUE, "ls": "-", "lw": 1.4}]
    each = cycle(zip(COLOURS, DASHES, WIDTHS, strict=True))
    return [
        {"color": colour, "ls": dash, "lw": width}
        for (colour, dash, width), _ in zip(each, range(curves), strict=False)
    ]


def hertz(ax: Axes) -> float:
    """Add ticks in Hz above an axis in rad/s, and return their height in points."""
    import matplotlib as mpl
    from matplotlib.font_manager import FontProperties
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    def to_hertz(omega: Any) -> Any:
        return omega / tau

    def to_radians(f: Any) -> Any:
        return f * tau

    above = ax.secondary_xaxis("top", functions=(to_hertz, to_radians))
    above.set_xscale("log")
    above.xaxis.set_major_locator(LogLocator())
    above.xaxis.set_major_formatter(FuncFormatter(lambda f, _: f"{f:g} Hz"))
    above.xaxis.set_minor_formatter(NullFormatter())
    above.tick_params(axis="x", which="both", labelsize="small", pad=1, colors=GREY)
    above.spines["top"].set_visible(False)
    size = FontProperties(size="small").get_size_in_points()
    return float(1.4 * size + mpl.rcParams["xtick.major.size"])


def decibels(x: NDArray[Any]) -> NDArray[np.float64]:
    """Return 20 log10 |x|, at least -300."""
    import numpy as np

    return np.asarray(20 * np.log10(np.maximum(np.abs(x), 1e-15)), dtype=np.float64)


def decibel_ticks(ax: Axes) -> None:
    """Set ticks in dB: at most six intervals, each 1, 2 or 4 times a power of ten."""
    from matplotlib.ticker import MaxNLocator

    ax.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 4, 10]))


def logarithmic(axis: XAxis | YAxis, low: float, high: float) -> None:
    """Make an axis logarithmic, with plain numbers at 1, 2, 5, 10 … or at decades only."""
    from matplotlib.ticker import FuncFormatter, LogLocator

    ax = axis.axes
    if axis.axis_name == "x":
        ax.set_xscale("log")
        ax.set_xlim(low, high)
    else:
        ax.set_yscale("log")
        ax.set_ylim(low, high)
    subs = (1.0, 2.0, 5.0) if high < 200 * low else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs, numticks=20))
    axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    bare_minor(axis)


def bare_minor(*log_axes: Axis) -> None:
    """Remove the numbers between the decades of logarithmic axes."""
    from matplotlib.ticker import NullFormatter

    for axis in log_axes:
        axis.set_minor_formatter(NullFormatter())


def html(result: Any) -> str:
    """Return a result's text and figure as HTML, for a notebook's `_repr_html_`."""
    from matplotlib import pyplot as plt

    figure = result.plot()
    data = b64encode(png(figure)).decode()
    plt.close(figure)
    words = escape(repr(result))
    return f'<pre>{words}</pre><img alt="{words}" src="data:image/png;base64,{data}">'


def png(figure: Figure) -> bytes:
    """Return a figure as PNG with 100 dpi, for a screen."""
    out = BytesIO()
    figure.savefig(out, format="png", dpi=100)
    return out.getvalue()


def show_once(figure: Figure) -> None:
    """Make a notebook show a pyplot figure only once.

    A notebook shows a cell's result and, at the cell's end, all open pyplot figures. IPython calls
    the method `_ipython_display_` of a cell's result. This function gives the figure such a method,
    which shows the figure and then closes the figure in pyplot.
    """
    pyplot = sys.modules.get("matplotlib.pyplot")
    if pyplot is None or "inline" not in pyplot.get_backend():
        return

    def display() -> None:
        from IPython.display import Image  # type: ignore[import-not-found]
        from IPython.display import display as show

        show(Image(png(figure)))
        pyplot.close(figure)

    figure._ipython_display_ = display  # type: ignore[attr-defined]
