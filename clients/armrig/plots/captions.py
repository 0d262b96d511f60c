"""What a figure writes: names of curves above the axes, symbols, and whence the numbers are."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from textwrap import fill
from types import MappingProxyType
from typing import TYPE_CHECKING

from armrig_core.telemetry import ALPHA, THETA_1, VELOCITY

from armrig.numerics.quantities import three_digits
from armrig.plots.layout import GREY

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NAMES = {THETA_1: r"$\theta_1$", ALPHA: r"$\alpha$", VELOCITY: r"$\dot\theta_1$"}
_FROM_RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


_RUNS: ContextVar[Mapping[str, str]] = ContextVar("_RUNS", default=MappingProxyType({}))


@contextmanager
def named_by_run(runs: Mapping[str, str]) -> Iterator[None]:
    """Sign figures in this context with the run's id, as in `@0000000b`, in place of the hash.

    Parameters
    ----------
    runs : mapping of str to str
        Hash of a recording -> id of its run, or "" for none.
    """
    token = _RUNS.set(runs)
    try:
        yield
    finally:
        _RUNS.reset(token)


def signature(*sources: str, runs: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return the kind of files and their hashes, shortened: `recordings 0123…, 4567…`.

    A recording whose hash is in `runs` has the id of its run in place of the hash.
    """
    hashes: dict[str, list[str]] = {}
    for one in dict.fromkeys(h for source in sources for h in source.split("+") if h):
        kind, _, digest = one.rpartition(":")
        run = runs.get(digest)
        hashes.setdefault(kind or "recording", []).append(f"@{run}" if run else digest[:12])
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
    if text := signature(*sources, runs=_RUNS.get()):
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


def _fits(widths: list[float], columns: int, room: float, size: float) -> bool:
    """Return whether names of these widths fit side by side; columns are filled one by one."""
    rest, total = list(widths), 1.2 * size * (columns - 1)
    for k in range(columns):
        n = len(widths) // columns + (k < len(widths) % columns)
        total += max(rest[:n])
        rest = rest[n:]
    return total <= room


def in_mathtext(text: str) -> str:
    """Return powers of ten in raised digits, 10⁻³, as mathematics, which every font has."""

    def power(found: re.Match[str]) -> str:
        return f"$10^{{{found[1].translate(_FROM_RAISED)}}}$"

    return re.sub("10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", power, text)


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
    return three_digits(x)
