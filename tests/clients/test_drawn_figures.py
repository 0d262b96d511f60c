"""Every figure draws what drawn_figures.txt lists: its axes, and each artist with its numbers.

After a wanted change of a figure, `make stored` writes the list again: read its difference.

A line is the artists of one look on one axes, or the bars or texts of one look in the figure. It
has their look, the number of points (and of gaps), and of x and y the first, last, least, greatest
and mean. A contour has the last three. A single number means that all are the same.
The words of titles, labels and legends are omitted, as are limits that matplotlib chooses.
"""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Iterator
from itertools import zip_longest
from math import isclose
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from armrig import plots
from armrig.report import identification_sections, study_sections
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.colors import to_hex, to_rgba
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Annotation, Text
from matplotlib.ticker import FixedLocator
from numpy.typing import ArrayLike, NDArray

from tests.clients import figure_examples
from tests.clients.figure_examples import FIGURES, Examples, examples
from tests.sampling import without_slow

__all__ = ["examples"]
WRITES = bool(os.environ.get("WRITE_STORED"))
LIST = Path(__file__).with_name("drawn_figures.txt")
NEAR = 1e-3
"""Share of a number, and of a linear axis, by which versions of libraries may differ."""
Listed = tuple[str, dict[str, float]]
"""A line, and how far its numbers may be from 0 by x and y."""


def listed(figure: Figure) -> Iterator[Listed]:
    """Yield a line for each axes and for its artists of each look, then for all bars and texts."""
    everywhere: dict[str, list[NDArray[np.float64]]] = {}
    widest = dict.fromkeys("xy", 0.0)
    for ax in figure.axes:
        near_0 = {
            name: (NEAR if axis.get_scale() == "linear" else 1e-9)
            * np.ptp(axis.get_view_interval())
            for name, axis in (("x", ax.xaxis), ("y", ax.yaxis))
        }
        widest = {name: max(widest[name], near) for name, near in near_0.items()}
        yield _axes(ax), near_0
        of_axes: dict[str, list[NDArray[np.float64]]] = {}
        for artist in (*ax.collections, *ax.lines):
            of_axes.setdefault(_look(artist), []).append(_points(artist))
        for artist in (*ax.patches, *ax.texts):
            everywhere.setdefault(_look(artist), []).append(_points(artist))
        yield from ((_line(look, points), near_0) for look, points in of_axes.items())
    yield from ((_line(look, points), widest) for look, points in everywhere.items())


def _line(look: str, points: list[NDArray[np.float64]]) -> str:
    """Describe the artists of one look."""
    every = np.concatenate(points)
    seen = every[np.isfinite(every).all(axis=1)]
    gaps = f"+{len(every) - len(seen)}" if len(seen) < len(every) else ""
    # The number of points of a contour and its first point are a matter of rounding.
    ends = not look.startswith("contour")
    count = f"{len(points)} × " if len(points) > 1 else ""
    n = f"n={len(seen)}{gaps} " if ends else ""
    x, y = (_numbers(name, seen[:, k], ends=ends) for k, name in enumerate("xy"))
    return f"{count}{look} {n}{x} {y}"


def _axes(ax: Axes) -> str:
    """Describe axes: place in inches, labels, legend, look, scales, limits and number of ticks."""
    legend = ax.get_legend()
    lift = (legend.get_bbox_to_anchor().y0 - ax.bbox.y1) / ax.figure.dpi if legend else 0.0
    titles = [ax.get_title(loc=at) for at in ("left", "center", "right")]  # type: ignore[arg-type]
    place = ax.get_position().transformed(ax.figure.transSubfigure).bounds
    words = [
        f"axes at {' '.join(f'{inch / ax.figure.dpi:.4g}' for inch in place)}",
        f"labels={sum(map(bool, [*titles, ax.get_xlabel(), ax.get_ylabel()]))}",
        f"spines={sum(side.get_visible() for side in ax.spines.values()) * ax.axison}",
        f"grid={ax.xaxis.get_tick_params().get('gridOn', False):d}",
        f"aspect={ax.get_aspect()}",
        *(_numbers("above", _limits(other)) for other in ax.child_axes),
    ]
    if legend:
        words.append(
            f"legend={len(legend.get_texts())} title={bool(legend.get_title().get_text())}"
        )
        words.append(f"lift {lift:.2f}")
    free = {"x": ax.get_autoscalex_on(), "y": ax.get_autoscaley_on()}
    for name, axis, margin in zip("xy", (ax.xaxis, ax.yaxis), ax.margins(), strict=True):
        low, high = axis.get_view_interval()
        words.append(f"{name} {axis.get_scale()}")
        words.append(f"margin {margin:g}" if free[name] else f"{low:.4g} {high:.4g}")
        locator = axis.get_major_locator()
        if axis.get_scale() == "log":
            low, high = 1.0, 9.0  # elsewhere versions differ
        elif free[name] and not isinstance(locator, FixedLocator):
            continue
        ticks = {t for t in locator.tick_values(low, high) if low <= t <= high}
        words.append(f"ticks={len(ticks)}")
    return " ".join(words)


def _limits(above: Any) -> NDArray[np.float64]:
    """Return the limits of a secondary axis, which are set when it is drawn."""
    above.apply_aspect()
    return np.array(above.get_xlim())


def _look(artist: Any) -> str:
    match artist:
        case Line2D():
            dashes, marker = artist.get_linestyle(), artist.get_marker()
            steps = artist.get_drawstyle().removeprefix("default")
            pen = "" if dashes == "None" else f" {dashes}{steps},{artist.get_linewidth():.3g}"
            hollow = ",hollow" if artist.get_markerfacecolor() == "none" else ""
            mark = "" if marker == "None" else f" {marker},{artist.get_markersize():.3g}{hollow}"
            return f"line {_colour(artist.get_color(), artist)}{pen}{mark}"
        case Text():
            kind = "annotation" if isinstance(artist, Annotation) else "text"
            box, sides = artist.get_bbox_patch(), (artist.get_ha(), artist.get_va())
            edge = f" in {_colour(box.get_edgecolor(), artist)}" if box else ""
            size = f"{artist.get_fontsize():.3g}"
            return f"{kind} {_colour(artist.get_color(), artist)} {size},{','.join(sides)}{edge}"
    colours = (_colour(c, artist) for c in (artist.get_facecolor(), artist.get_edgecolor()))
    kinds = {Patch: "patches", ContourSet: "contour", Collection: "area"}
    return " ".join([next(kinds[k] for k in kinds if isinstance(artist, k)), *colours])


def _colour(colour: Any, artist: Any) -> str:
    if np.size(colour) == 0:
        return "none"
    rgba = to_rgba(colour[0] if np.ndim(colour) == 2 else colour, artist.get_alpha())
    return to_hex(rgba, keep_alpha=rgba[3] < 1)


def _points(artist: Any) -> NDArray[np.float64]:
    """Return the points of an artist, (n, 2)."""
    match artist:
        case Line2D():
            points: Any = artist.get_xydata()
        case Collection():
            points = np.concatenate([np.zeros((0, 2)), *(p.vertices for p in artist.get_paths())])
        case Patch():
            points = artist.get_patch_transform().transform(artist.get_path().vertices)
        case Annotation():
            points = [artist.xy, artist.xyann]
        case _:
            points = [artist.get_position()]
    return np.ma.filled(np.ma.asarray(points, np.float64), np.nan)


def _numbers(name: str, values: NDArray[np.float64], *, ends: bool = True) -> str:
    shown: ArrayLike = values[:1]
    if values.size and np.ptp(values) > 1e-9 * np.abs(values).max():
        shown = [*values[[0, -1]][: 2 * ends], values.min(), values.max(), values.mean()]
    return " ".join([name, *(f"{v:.4g}" for v in shown)])


def _same(was: str, now: Listed) -> bool:
    """Return whether two lines have the same words, and the same numbers except for rounding."""
    near_0 = 0.0
    for a, b in zip_longest(was.split(), now[0].split(), fillvalue=""):
        near_0 = now[1].get(a, near_0)
        try:
            if not isclose(float(a), float(b), rel_tol=NEAR, abs_tol=near_0):
                return False
        except ValueError:
            if a != b:
                return False
    return True


def test_every_figure_has_an_example() -> None:
    sources = map(inspect.getsource, (figure_examples, identification_sections, study_sections))
    drawn = set(re.findall(r"\bplot_\w+", "".join(sources)))

    assert {name for name in plots.__all__ if name.startswith("plot_")} <= drawn


@pytest.fixture(scope="module")
def lists() -> Iterator[dict[str, list[str]]]:
    """Give the lines of each figure, and write them at the end on request."""
    parts = LIST.read_text().removeprefix("[").split("\n[")
    lines = {name: body.splitlines() for name, _, body in (p.partition("]\n") for p in parts)}
    yield lines
    if WRITES:
        texts = ("\n".join([f"[{name}]", *lines[name]]) for name in FIGURES if name in lines)
        LIST.write_text("\n".join(texts) + "\n")


@pytest.mark.parametrize(
    "name", without_slow(FIGURES, lambda name: name in ("handout", "plot_structure"))
)
def test_a_figure_has_the_stored_artists(
    name: str, examples: Examples, lists: dict[str, list[str]]
) -> None:
    with mpl.rc_context({"backend": "agg"}):
        drawn = FIGURES[name](examples)
        each = [drawn.figure] if isinstance(drawn, (Figure, Axes)) else drawn
        now = [line for figure in each for line in listed(figure)]

    if WRITES:
        lists[name] = [line for line, _ in now]
    was = lists.get(name, [])
    for k, (a, b) in enumerate(zip_longest(was, now), 1):
        if a is None or b is None or not _same(a, b):
            text = f"{name}, line {k} of {len(was)}, now of {len(now)}"
            pytest.fail(f"{text}\nwas {a}\nis  {b and b[0]}", pytrace=False)
