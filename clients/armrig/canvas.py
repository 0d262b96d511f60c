"""What all figures share: colours, line styles, panels, and the signature of a recording."""

from __future__ import annotations

import re
from itertools import cycle
from math import tau
from textwrap import fill
from typing import TYPE_CHECKING, Any, Protocol

from armrig.numerics.stretches import stretches

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis, XAxis, YAxis
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

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
NAMES = {"theta_1": r"$\theta_1$", "alpha": r"$\alpha$", "velocity": r"$\dot\theta_1$"}
MISSING = "#BBBBBB"
_FROM_RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
_WIDE = 2.0  # width over height, from which on two panels stand side by side


class Sampled(Protocol):
    """What has a value at each sample, some of them missing: a `Dataset`, for example."""

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(N,), False where the value is missing."""

    @property
    def Ts(self) -> float:
        """Sampling time, in s."""


def axes(ax: Axes | None) -> Axes:
    """Return `ax`, or those of a new figure of pyplot's, laid out so that nothing is cut off."""
    if ax is not None:
        return ax
    from matplotlib import pyplot as plt

    return plt.subplots(layout="constrained")[1]


def figure_of(ax: Axes) -> Figure:
    """Return the whole figure in which axes lie: what a result's `.plot()` gives, to be saved."""
    return ax.figure.figure


def panels(ax: Axes | None, share: float, *, sharex: bool = True) -> tuple[Axes, Axes]:
    """Return `ax`, shortened, and a panel below it that takes `share` of the height of both.

    Panels that share no axis stand side by side where `ax` is much wider than high.
    """
    ax = axes(ax)
    place = ax.get_subplotspec()
    if place is None:
        # Placed by hand: a grid of one place, just there.
        (x0, y0), (x1, y1) = ax.get_position().get_points()
        place = ax.figure.add_gridspec(1, 1, left=x0, right=x1, bottom=y0, top=y1)[0]
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


def signature(*sources: str) -> str:
    """Return the kind of files and their hashes, shortened: `recordings 0123…, 4567…`."""
    hashes: dict[str, list[str]] = {}
    for one in dict.fromkeys(h for source in sources for h in source.split("+") if h):
        kind, _, digest = one.rpartition(":")
        hashes.setdefault(kind or "recording", []).append(digest[:12])
    return "; ".join(
        f"{kind}{'s' if kind == 'recording' and len(of) > 1 else ''} {', '.join(of)}"
        for kind, of in hashes.items()
    )


def sign(ax: Axes, *sources: str, above: float = 0.0) -> Axes:
    """Write what the numbers are from above the axes, small.

    Parameters
    ----------
    above : float
        Height, in points, of what stands above the axes already: see `legend`.
    """
    if text := signature(*sources):
        ax.set_title(text, loc="right", fontsize="x-small", color=GREY, pad=3 + above)
    return ax


def legend(ax: Axes, *notes: str, lift: float = 0.0) -> float:
    """Name the curves above the axes, where they cover nothing, and return the height in points.

    Parameters
    ----------
    notes : str
        Lines to stand above the names, such as a p value.
    lift : float
        Height, in points, of what stands above the axes already: see `hertz`.
    """
    import matplotlib as mpl
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path
    from matplotlib.transforms import ScaledTranslation

    handles, names = ax.get_legend_handles_labels()
    if not (handles or notes):
        return lift
    font = FontProperties(size="small")
    size = font.get_size_in_points()
    room = 0.92 * 72 * ax.bbox.width / ax.figure.dpi  # labels may yet take some of it

    def width(text: str) -> float:
        return max(
            text_to_path.get_text_width_height_descent(line, font, "$" in line)[0]
            for line in text.split("\n")
        )

    def folded(text: str, room: float) -> str:
        return fill(text, max(12, int(len(text) * room / max(width(text), 1.0))))

    names = [in_mathtext(n) for n in names]
    names = [folded(n, room - 3 * size) if width(n) > room - 3 * size else n for n in names]
    widths = [width(n) + 3 * size for n in names]
    columns = next((k for k in range(len(names), 1, -1) if _fits(widths, k, room, size)), 1)
    title = "\n".join(folded(n, room) if width(n) > room else n for n in notes)
    lines = [n.count("\n") + 1 for n in names]
    rows = -(-len(names) // columns)
    height = size * (1.45 * (max(sum(lines), rows) if columns == 1 else rows))
    height += 1.5 * size * (title.count("\n") + 1) if title else 0.0
    ax.legend(
        handles,
        names,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        bbox_transform=ax.transAxes + ScaledTranslation(0.0, lift / 72, ax.figure.dpi_scale_trans),
        ncols=columns,
        frameon=False,
        fontsize=size,
        title=title or None,
        title_fontsize=size,
        alignment="left",
        borderpad=0.0,
        borderaxespad=0.3,
        labelspacing=0.3,
        handlelength=2.2,
        handletextpad=0.5,
        columnspacing=1.2,
    )
    return float(lift + height + 0.3 * mpl.rcParams["font.size"])


def in_mathtext(text: str) -> str:
    """Return powers of ten in raised digits, 10⁻³, as mathematics, which every font has."""

    def power(found: re.Match[str]) -> str:
        return f"$10^{{{found[1].translate(_FROM_RAISED)}}}$"

    return re.sub("10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", power, text)


def _fits(widths: list[float], columns: int, room: float, size: float) -> bool:
    """Return whether names of these widths fit side by side; columns are filled one by one."""
    rest, total = list(widths), 1.2 * size * (columns - 1)
    for k in range(columns):
        n = len(widths) // columns + (k < len(widths) % columns)
        total += max(rest[:n])
        rest = rest[n:]
    return total <= room


def hertz(ax: Axes) -> float:
    """Write the frequencies of an axis in rad/s in Hz, too, above; return the height in points."""
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
    """Return 20 log10 |x|; of 0 the lowest that a figure can want."""
    import numpy as np

    return np.asarray(20 * np.log10(np.maximum(np.abs(x), 1e-15)), dtype=np.float64)


def decibel_ticks(ax: Axes) -> None:
    """Put the ticks of an axis in dB at multiples of 20, 40 … dB."""
    from matplotlib.ticker import MaxNLocator

    ax.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 4, 10]))


def save(figure: Figure, path: Path, **options: Any) -> None:
    """Write a figure so that the same figure gives the same bytes: without date or random ids."""
    import matplotlib as mpl

    undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    with mpl.rc_context({"svg.hashsalt": "armrig"}):
        figure.savefig(path, metadata=undated.get(path.suffix.lower()), **options)


def shade(ax: Axes, data: Sampled) -> None:
    """Shade the time in which y is missing."""
    for gap in stretches(~data.valid):
        begin, end = (gap.start - 0.5) * data.Ts, (gap.stop - 0.5) * data.Ts
        ax.axvspan(begin, end, color=MISSING, alpha=0.5, lw=0)


def logarithmic(axis: XAxis | YAxis, low: float, high: float) -> None:
    """Make an axis logarithmic, with 1, 2, 5, 10 … or the decades for ticks, as plain numbers."""
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


def bare_minor(*shown: Axis) -> None:
    """Write no number between the decades of logarithmic axes."""
    from matplotlib.ticker import NullFormatter

    for axis in shown:
        axis.set_minor_formatter(NullFormatter())


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


def symbol(parameter: str) -> str:
    """Return a parameter's name as mathematics: J_1 as $J_1$, K_lin as $K_{lin}$."""
    letter, _, index = parameter.partition("_")
    index = f"{{{index}}}" if len(index) > 1 else index
    return f"${letter}_{index}$" if index else f"${letter}$"


def named(output: str, unit: str) -> str:
    """Return an output's label for an axis."""
    return f"{NAMES.get(output, output)} [{unit or '–'}]"


def short(x: float) -> str:
    """Return a number with three digits, or all before the point."""
    return f"{x:.3g}" if x < 1000 else f"{x:.0f}"
