"""Figure of poles and zeros with their 95 % regions and their cancellations."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from armrig.models.characteristics import overlapping
from armrig.models.equation import Labels, labels_of, left_out, sources_of
from armrig.models.uncertainty import Draws, drawn, pole_regions, zero_regions
from armrig.numerics.confidence_regions import HighestDensityRegion, Region
from armrig.plots.captions import legend, sign
from armrig.plots.layout import GREY, INK, axes, finish, pens

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.models.fit import Fit

# The sizes decrease, so that coinciding markers of several models are all visible.
_MARKER_SIZES = (9.0, 6.5, 4.0, 4.0)
_MAX_SHOWN_MODULUS = 2.0  # roots with a larger modulus are not shown
_MAX_REGION_MODULUS = 1.3  # the figure is widened for regions up to this modulus
_RASTER_POINTS = 120
_MAX_WIDENINGS = 6  # largest number of widenings of a raster until it contains the whole region


def plot_poles_zeros(*models: Fit, labels: Labels = None, ax: Axes | None = None) -> Axes:
    """Plot poles (×) and zeros (○) in the z plane with their 95 % regions and the unit circle.

    The region of a real root is an interval, drawn as a bar. The region of a complex root is an
    ellipse. If the linearisation is poor, the region contains the densest 95 % of draws of the
    parameters. Such a region is dotted and shaded, and the legend contains "by draws". A square
    marks a pole and a zero that cannot be distinguished at the level 1 %.
    """
    ax = axes(ax)
    angle = np.linspace(0, 2 * np.pi, 721)
    ax.plot(np.cos(angle), np.sin(angle), color=GREY, lw=0.8)
    ax.axhline(0, color=GREY, lw=0.5)
    ax.axvline(0, color=GREY, lw=0.5)
    shown: list[Region] = []
    by_draws: dict[str, Draws | None] = {}
    for model, name, pen, size in zip(
        models, labels_of(models, labels), pens(len(models)), cycle(_MARKER_SIZES), strict=False
    ):
        colour = pen["color"]
        draws = drawn(model)
        poles, zeros = pole_regions(model, draws), zero_regions(model, draws)
        if any(r.method == "sampled" for r in (*poles, *zeros)):
            by_draws[name] = draws
        shown += [*poles, *zeros]
        for found, marker in ((poles, "x"), (zeros, "o")):
            z = np.array([r.centre for r in found], dtype=np.complex128)
            style = {"color": colour, "mfc": "none", "ms": size, "mew": 1.2, "ls": "none"}
            label = (name if draws is None else f"{name}, 95 %") if marker == "x" else None
            ax.plot(z.real, z.imag, marker, label=label, zorder=3, **style)
            for region in found:
                _draw(ax, region, colour)
        if draws is not None:
            _mark_cancelling(ax, model)
    if by_draws:
        ax.plot([], [], color=INK, lw=1.0, ls=":", label="95 % by draws")
    _frame(ax, shown)
    ax.set(xlabel="Re $z$", ylabel="Im $z$")
    ax.set_aspect("equal")
    ax.locator_params(nbins=6)
    finish(ax)
    above = legend(ax, "× poles, ○ zeros", *left_out(by_draws, models=len(models)))
    return sign(ax, *sources_of(models), above=above)


def _draw(ax: Axes, region: Region, colour: str) -> None:
    dotted: dict[str, Any] = {
        "color": colour,
        "lw": 1.0,
        "ls": ":" if region.method == "sampled" else "-",
    }
    border = region.border()
    if region.interval is not None:
        low, high = np.clip(region.interval, -_MAX_SHOWN_MODULUS - 1, _MAX_SHOWN_MODULUS + 1)
        if high > low:
            ends = {"marker": "|", "ms": 6.0, "mew": 1.0, "solid_capstyle": "butt", "zorder": 2.5}
            ax.plot([low, high], [0.0, 0.0], **(dotted | {"lw": 1.8} | ends))
    if region.densest is not None and region.centre.imag >= 0:
        _draw_densest(ax, region.densest, colour)
    if border is not None and np.isfinite(border).all() and np.ptp(border) > 0:
        ax.plot(*border, **dotted)


def _draw_densest(ax: Axes, densest: HighestDensityRegion, colour: str) -> None:
    """Draw the region of the densest draws, and its mirror image below the real axis."""
    inside = densest.inside()
    inside = inside[np.abs(inside) < _MAX_SHOWN_MODULUS + 1]
    if inside.size == 0:
        return
    room = 0.1 * max(np.ptp(inside.real), np.ptp(inside.imag)) + 1e-4
    for _ in range(_MAX_WIDENINGS):
        x = np.linspace(inside.real.min() - room, inside.real.max() + room, _RASTER_POINTS)
        top = inside.imag.max() + room
        y = np.linspace(-top, top, 2 * _RASTER_POINTS)
        z = x[None, :] + 1j * y[:, None]
        excess = densest.excess(z.ravel()).reshape(z.shape)
        edge = np.concatenate([excess[0], excess[:, 0], excess[:, -1]])
        if (edge > 1).all() or room > _MAX_SHOWN_MODULUS:
            break
        room *= 2
    ax.contourf(x, y, excess, levels=[0.0, 1.0], colors=[colour], alpha=0.15)
    ax.contour(x, y, excess, levels=[1.0], colors=[colour], linestyles=":", linewidths=1.0)


def _mark_cancelling(ax: Axes, model: Fit) -> None:
    """Mark each pair of a pole and a zero that cannot be distinguished, and its conjugate pair."""
    for pole, zero, _ in overlapping(model):
        middle = (pole + zero) / 2
        said = "cannot be distinguished"
        known = said in ax.get_legend_handles_labels()[1]
        heights = {middle.imag, -middle.imag}
        style: dict[str, Any] = {"color": INK, "mfc": "none", "ms": 15, "mew": 0.9, "ls": "none"}
        style |= {"zorder": 2.8, "alpha": 0.6, "label": None if known else said}
        ax.plot([middle.real] * len(heights), list(heights), "s", **style)


def _frame(ax: Axes, shown: list[Region]) -> None:
    """Limit the axes to the roots near the unit circle and to their regions."""
    points: list[complex] = [1.0 + 0.0j]
    near = [r for r in shown if abs(r.centre) < _MAX_SHOWN_MODULUS]
    if len(near) < len(shown):
        text = f"{len(shown) - len(near)} beyond |z| = {_MAX_SHOWN_MODULUS:g}"
        ax.text(0.03, 0.03, text, transform=ax.transAxes, fontsize="x-small", color=INK)
    if not near:
        ax.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2))
        return
    for r in near:
        points += [r.centre, r.centre.conjugate()]
        points += [z for z in _extent(r) if abs(z) < _MAX_REGION_MODULUS]
    z = np.array(points)
    low, high = float(z.real.min()), float(z.real.max())
    half = max(0.5 * (high - low), float(np.abs(z.imag).max()), 0.3) * 1.12
    middle = 0.5 * (low + high)
    ax.set(xlim=(middle - half, middle + half), ylim=(-half, half))


def _extent(region: Region) -> list[complex]:
    """Return points on the border or at the ends of a region."""
    points: list[complex] = []
    if region.interval is not None:
        points += [
            complex(np.clip(x, -_MAX_REGION_MODULUS, _MAX_REGION_MODULUS) * 0.999)
            for x in region.interval
        ]
    if region.densest is not None:
        points += region.densest.inside().tolist()
    border = region.border()
    return points if border is None else [*points, *(border[0] + 1j * border[1]).tolist()]
