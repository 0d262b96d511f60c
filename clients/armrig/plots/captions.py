"""Texts of a figure: names of curves above the axes, symbols, and the sources of the data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from textwrap import fill
from types import MappingProxyType
from typing import TYPE_CHECKING

from armrig_core.telemetry.channels import SYMBOLS

from armrig.plots.layout import GREY, any_characters, drawable

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_RUN_OF_HASH: ContextVar[Mapping[str, str]] = ContextVar(
    "_RUN_OF_HASH", default=MappingProxyType({})
)


def symbol_of(output: str) -> str:
    """Return the symbol of an output, or its name."""
    return SYMBOLS.get(output, output)


@contextmanager
def name_by_run(runs: Mapping[str, str]) -> Iterator[None]:
    """Name recordings in figures by the run's id, such as `@0000000b`, instead of the hash.

    `runs` contains the id of each run by the hash of its recording; "" if the run has no id.
    """
    token = _RUN_OF_HASH.set(runs)
    try:
        yield
    finally:
        _RUN_OF_HASH.reset(token)


def signature(*sources: str, runs: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return the kinds of files and their shortened hashes, such as `recordings 0123…, 4567…`.

    For a recording whose hash is in `runs`, the id of the run replaces the hash.
    """
    hashes: dict[str, list[str]] = {}
    for source_id in dict.fromkeys(h for source in sources for h in source.split("+") if h):
        kind, _, digest = source_id.rpartition(":")
        run = runs.get(digest)
        hashes.setdefault(kind or "recording", []).append(f"@{run}" if run else digest[:12])
    return "; ".join(
        f"{kind}{'s' if kind == 'recording' and len(ids) > 1 else ''} {', '.join(ids)}"
        for kind, ids in hashes.items()
    )


def sign(ax: Axes, *sources: str, above: float = 0.0) -> Axes:
    """Write the sources of the data above the axes, in small type, and return `ax`.

    `above` is the height, in points, of the legend above the axes, as `legend` returns it.
    """
    if text := signature(*sources, runs=_RUN_OF_HASH.get()):
        ax.set_title(drawable(text), loc="right", fontsize="x-small", color=GREY, pad=3 + above)
    return ax


def legend(ax: Axes, *notes: str, lift: float = 0.0) -> float:
    """Draw the legend above the axes, and return the height of all texts there, in points.

    The notes are lines above the names, such as a p value. `lift` is the height, in points, of the
    ticks above the axes, as `hertz` returns it.
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
    room = 0.92 * 72 * ax.bbox.width / ax.figure.dpi  # 8 % is left for the labels of the axis

    def width(text: str) -> float:
        with any_characters():
            return max(
                text_to_path.get_text_width_height_descent(line, font, "$" in line)[0]
                for line in text.split("\n")
            )

    def fold(text: str, room: float) -> str:
        return fill(text, max(12, int(len(text) * room / max(width(text), 1.0))))

    names = list(map(drawable, names))
    notes = tuple(map(drawable, notes))
    names = [fold(n, room - 3 * size) if width(n) > room - 3 * size else n for n in names]
    widths = [width(n) + 3 * size for n in names]
    columns = next((k for k in range(len(names), 1, -1) if _fits(widths, k, room, size)), 1)
    title = "\n".join(fold(n, room) if width(n) > room else n for n in notes)
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
    """Return whether names of these widths, in `columns` columns, fit into the width `room`."""
    remaining, total = list(widths), 1.2 * size * (columns - 1)
    for k in range(columns):
        n = len(widths) // columns + (k < len(widths) % columns)
        total += max(remaining[:n])
        remaining = remaining[n:]
    return total <= room


def symbol(parameter: str) -> str:
    """Return a parameter's name in mathtext: R_m as $R_m$, K_spring as $K_{spring}$."""
    letter, _, index = parameter.partition("_")
    index = f"{{{index}}}" if len(index) > 1 else index
    return f"${letter}_{index}$" if index else f"${letter}$"


def axis_label(output: str, unit: str) -> str:
    """Return the label of an output's axis."""
    return f"{symbol_of(output)} [{unit or '–'}]"
