"""What all figures share: colours, line styles, panels, and the signature of a recording."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any, Protocol

from armrig.numerics.stretches import stretches

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

# M. Okabe, K. Ito, "Color Universal Design", 2008; without the yellow, too pale on paper.
BLUE, VERMILION, GREEN = "#0072B2", "#D55E00", "#009E73"
PURPLE, ORANGE, SKY = "#CC79A7", "#E69F00", "#56B4E9"
INK, GREY = "#222222", "#777777"
COLOURS = (VERMILION, BLUE, GREEN, PURPLE, ORANGE, SKY)
DASHES: tuple[Any, ...] = ("--", "-", "-.", ":", (0, (6, 1.5, 1.5, 1.5)), (0, (3, 1)))
NAMES = {"theta_1": r"$\theta_1$", "alpha": r"$\alpha$", "velocity": r"$\dot\theta_1$"}
MISSING = "#BBBBBB"


class Sampled(Protocol):
    """What has a value at each sample, some of them missing: a `Dataset`, for example."""

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(N,), False where the value is missing."""

    @property
    def Ts(self) -> float:
        """Sampling time, in s."""


def axes(ax: Axes | None) -> Axes:
    """Return `ax`, or those of a new figure of pyplot's."""
    if ax is not None:
        return ax
    from matplotlib import pyplot as plt

    return plt.subplots()[1]


def panels(ax: Axes | None, share: float, *, sharex: bool = True) -> tuple[Axes, Axes]:
    """Return `ax`, shortened, and a panel below it that takes `share` of the height of both."""
    from mpl_toolkits.axes_grid1 import (  # type: ignore[import-untyped]
        make_axes_locatable,
    )

    ax = axes(ax)
    size = f"{100 * share / (1 - share):.0f}%"
    pad = 0.08 if sharex else 0.28
    below = make_axes_locatable(ax).append_axes(
        "bottom", size=size, pad=pad, sharex=ax if sharex else None
    )
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


def sign(ax: Axes, *sources: str) -> Axes:
    """Write what the numbers are from above the axes, small."""
    if text := signature(*sources):
        ax.set_title(text, loc="right", fontsize="x-small", color=GREY, pad=3)
    return ax


def finish_over_time(ax: Axes, below: Axes, *, output: str, unit: str, end: float) -> None:
    """Label an output over time and the error below it, and give them the look that all have."""
    ax.set_ylabel(named(output, unit))
    below.set_ylabel(named("error", unit))
    below.set_xlabel("$t$ [s]")
    ax.legend(loc="best")
    finish(ax, below, xlim=(0.0, end or 1.0))


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


def pens() -> Any:
    """Iterate over colours and line styles, in pairs, for ever."""
    return cycle(zip(COLOURS, DASHES, strict=True))


def named(output: str, unit: str) -> str:
    """Return an output's label for an axis."""
    return f"{NAMES.get(output, output)} [{unit or '–'}]"


def short(x: float) -> str:
    """Return a number with three digits, or all before the point."""
    return f"{x:.3g}" if x < 1000 else f"{x:.0f}"
