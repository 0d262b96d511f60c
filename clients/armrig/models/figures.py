"""Figures of models: frequency and step response, poles and zeros."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.telemetry.channels import RATES
from numpy.typing import ArrayLike, NDArray

from armrig.models.characteristics import integrates, overlapping
from armrig.models.equation import Labels, gain_unit, labels_of, left_out, sources_of, with_method
from armrig.models.spectral_estimate import COHERENT, SpectralEstimate
from armrig.models.uncertainty import (
    Draws,
    frequency_bands,
    parameter_draws,
    pole_regions,
    step_band,
    zero_regions,
)
from armrig.numerics.confidence_regions import HALF_WIDTH, Band, HighestDensityRegion, Region
from armrig.plots.captions import legend, sign, symbol_of
from armrig.plots.layout import (
    GREY,
    INK,
    axes,
    decibel_ticks,
    decibels,
    finish,
    hertz,
    letter,
    panels,
    pens,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from armrig.models.fit import Fit

_AMBIGUOUS_TURN_DEG = 150.0  # a sudden phase change by more than this may have either sign
_TURN_STEPS = 4  # number of frequencies over which a phase change is sudden
_CHANNEL_WIDTH = 4.5  # inches, of the frequency response of one channel
_CHANNEL_HEIGHT = 3.6  # inches, likewise
_MAX_DOTS = 40  # largest number of dots of a spectral estimate
# The sizes decrease, so that coinciding markers of several models are all visible.
_MARKER_SIZES = (9.0, 6.5, 4.0, 4.0)
_MAX_SHOWN_MODULUS = 2.0  # roots with a larger modulus are not shown
_MAX_REGION_MODULUS = 1.3  # the figure is widened for regions up to this modulus
_RASTER_POINTS = 120
_MAX_WIDENINGS = 6  # largest number of widenings of a raster until it contains the whole region


def in_discrete_time(models: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the models, those in continuous time sampled as their estimation data."""
    return tuple(m.to_discrete() if getattr(m, "Ts", None) == 0 else m for m in models)


def plot_bode(
    *models: Any, omega: ArrayLike | None = None, labels: Labels = None, ax: Axes | None = None
) -> Axes:
    """Plot magnitude and phase, with 95 % bands for estimated models.

    A band is linearised, or computed by draws of the parameters if the linearisation is poor. The
    legend names the method. The bands are pointwise: the probability that a band contains the true
    response at all frequencies is below 95 %.

    Parameters
    ----------
    *models
        A `Fit`, an estimate of `spa`, `etfe` or `bla`, or a python-control system with one input
        and one output. An estimate of `spa`, `etfe` or `bla` is drawn as dots with 95 % bars, which
        do not include the smoothing bias. A dot is hollow if u explains less than half of y's
        power.
    omega : array_like, optional
        Frequencies in rad/s. The default range ends at the highest Nyquist frequency of the models,
        and begins at 1/600 of this frequency.
    """
    names, models = labels_of(models, labels), in_discrete_time(models)
    highest = max((np.pi / m.Ts for m in models if hasattr(m, "Ts")), default=1e3)
    w = (
        np.geomspace(highest / 600, highest, 500)
        if omega is None
        else np.asarray(omega, np.float64)
    )
    ax, below = panels(ax, 0.42)
    levels: list[NDArray[np.float64]] = []
    named_models = list(zip(models, names, strict=True))
    curves = [pair for pair in named_models if not isinstance(pair[0], SpectralEstimate)]
    sampled: dict[str, Draws | None] = {}
    for (model, name), pen in zip(curves, pens(len(curves)), strict=True):
        level, sampled[name] = _curve(ax, below, model, name, w, pen)
        levels.append(level)
    for model, name in named_models:
        if isinstance(model, SpectralEstimate):
            name = name if labels else f"{model.method.split(',')[0]}, 95 %"
            levels.append(_dots(ax, below, model, name, w))
    ax.set_xscale("log")
    all_levels = np.concatenate(levels)
    all_levels = all_levels[np.isfinite(all_levels)]
    if all_levels.size:
        ax.set_ylim(float(all_levels.min()) - 6.0, float(all_levels.max()) + 6.0)
    decibel_ticks(ax)
    _limit_phase(below)
    ax.set_ylabel(f"$|G|$ [dB re 1 {gain_unit(models)}]")
    below.set_ylabel("arg $G$ [°]")
    below.set_xlabel(r"$\omega$ [rad/s]")
    finish(ax, below, xlim=(float(w[0]), float(w[-1])))
    above = legend(ax, *left_out(sampled, models=len(models)), lift=hertz(ax))
    return sign(ax, *sources_of(models), above=above)


def plot_step(
    *models: Fit, n: int | None = None, labels: Labels = None, ax: Axes | None = None
) -> Axes:
    """Plot the response to a unit step with 95 % bands.

    A band is linearised, or computed by draws if the linearisation is poor. Each curve begins at 0
    at the time of the step. If all models integrate, the figure shows the rate, because the output
    is a ramp.

    Parameters
    ----------
    n : int, optional
        Number of samples; the default is 1 s or 50 samples, whichever is longer.
    """
    ax = axes(ax)
    curves: list[NDArray[np.float64]] = []
    sampled: dict[str, Draws | None] = {}
    names, models = labels_of(models, labels), in_discrete_time(models)
    rate = all(integrates(model) for model in models)
    for model, name, pen in zip(models, names, pens(len(models)), strict=True):
        answer = model.step_response(n or max(50, round(1 / model.Ts)), rate=rate)
        # The response is from rest. The first value of a rate is half a sample after the step.
        t, y = np.append(0.0, answer.t), np.append(0.0, answer.y)
        curves.append(y)
        if np.nan_to_num(answer.std).any():
            draws = parameter_draws(model)
            band = step_band(model, answer, draws)
            sampled |= {name: draws} if band.method == "sampled" else {}
            name = with_method(name, band)
            edges = np.append(0.0, band.low), np.append(0.0, band.high)
            ax.fill_between(t, *edges, color=pen["color"], alpha=0.25, lw=0)
        ax.plot(t, y, label=name, **pen)
    ax.set_xlabel("$t$ [s]")
    name = symbol_of(models[0].output)
    if rate:
        rate_name = RATES.get(models[0].output)
        name = symbol_of(rate_name) if rate_name else f"rate of {name}"
    ax.set_ylabel(f"{name} [{gain_unit(models, rate=rate)}]")
    ax.margins(x=0)
    _limit_to_curves(ax, np.concatenate(curves))
    finish(ax)
    above = legend(ax, *left_out(sampled, models=len(models)))
    return sign(ax, *sources_of(models), above=above)


def plot_fit(model: Fit) -> Figure:
    """Return a figure of one model with frequency response, step response, poles and zeros.

    The figure of a model of several signals has the frequency response of each channel, a row for
    each output and a column for each input.
    """
    from matplotlib import pyplot as plt

    if (model.ny, model.nu) != (1, 1):
        size = _CHANNEL_WIDTH * model.nu, _CHANNEL_HEIGHT * model.ny
        figure = plt.figure(figsize=size, layout="constrained")
        cells = figure.add_gridspec(nrows=model.ny, ncols=model.nu)
        for i, j, channel in model.channels():
            name = f"{model.inputs[j]} to {model.outputs[i]}"
            plot_bode(channel, labels=[name], ax=figure.add_subplot(cells[i, j]))
        return figure
    figure = plt.figure(figsize=(9.0, 5.6), layout="constrained")
    grid = figure.add_gridspec(nrows=2, ncols=2, width_ratios=(1.2, 1), height_ratios=(1, 1.5))
    plot_bode(model, ax=figure.add_subplot(grid[:, 0]))
    plot_step(model, ax=figure.add_subplot(grid[0, 1]))
    plot_poles_zeros(model, ax=figure.add_subplot(grid[1, 1]))
    letter(figure)
    return figure


def _curve(
    ax: Axes, below: Axes, model: Any, name: str, omega: NDArray[np.float64], pen: dict[str, Any]
) -> tuple[NDArray[np.float64], Draws | None]:
    """Draw one model; return its magnitude in dB, and the parameter draws for its bands."""
    x, G, bands, draws = response_and_bands(model, omega)
    level, phase = decibels(G), continuous_phase(G)
    shade: dict[str, Any] = {"color": pen["color"], "alpha": 0.25, "lw": 0}
    if bands is not None:
        low = np.maximum(bands[0].low, np.abs(G) * 1e-3)  # 0 has no decibels
        ax.fill_between(x, decibels(low), decibels(bands[0].high), **shade)
        reach = [np.clip(np.degrees(edge), -180, 180) for edge in (bands[1].low, bands[1].high)]
        below.fill_between(x, phase + reach[0], phase + reach[1], **shade)
        name = with_method(name, bands[0])
    ax.plot(x, level, label=name, **pen)
    below.plot(x, phase, **pen)
    by_draws = bands is not None and "sampled" in (bands[0].method, bands[1].method)
    return level, draws if by_draws else None


def _dots(
    ax: Axes, below: Axes, estimate: SpectralEstimate, name: str, omega: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Draw a spectral estimate as dots with bars; return its magnitude in dB."""
    w = estimate.omega
    usable = np.isfinite(estimate.G) & (w >= omega[0]) & (w <= omega[-1]) & (np.abs(estimate.G) > 0)
    at = _spread(w, np.flatnonzero(usable))
    w, G = w[at], estimate.G[at]
    magnitude, level, phase = np.abs(G), decibels(G), continuous_phase(G)
    if below.lines and w.size:
        # Noise could unwrap the phase of the dots wrongly. Therefore each dot is moved by full
        # turns to the phase of the last model.
        curve = np.asarray(below.lines[-1].get_xydata(), np.float64)
        near = np.interp(w, *curve[np.isfinite(curve).all(axis=1)].T)
        phase = phase + 360 * np.round((near - phase) / 360)
    std = np.nan_to_num(estimate.std_magnitude[at]), np.nan_to_num(estimate.std_phase[at])
    down = level - decibels(np.maximum(magnitude - HALF_WIDTH * std[0], magnitude * 1e-3))
    up = decibels(magnitude + HALF_WIDTH * std[0]) - level
    across = np.degrees(np.minimum(HALF_WIDTH * std[1], np.pi))
    style: dict[str, Any] = {"color": INK, "ecolor": GREY, "elinewidth": 0.7, "zorder": 1.5}
    style |= {"fmt": "o", "ms": 2.5}
    ax.errorbar(w, level, yerr=[down, up], label=name, **style)
    below.errorbar(w, phase, yerr=across, **style)
    if estimate.coherence is not None and (weak := estimate.coherence[at] < COHERENT).any():
        hollow: dict[str, Any] = {"color": INK, "mfc": "white", "ms": 3, "mew": 0.7, "zorder": 1.6}
        ax.plot(w[weak], level[weak], "o", label="not explained by the input", **hollow)
        below.plot(w[weak], phase[weak], "o", **hollow)
    return level


def _spread(w: NDArray[np.float64], indices: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the indices of the frequencies to show, evenly spaced on the logarithmic axis."""
    if indices.size <= _MAX_DOTS:
        return indices
    wanted = np.geomspace(max(w[indices[0]], w[-1] * 1e-6), w[indices[-1]], _MAX_DOTS)
    return np.unique(indices[np.argmin(np.abs(wanted[:, None] - w[indices][None, :]), axis=1)])


def response_and_bands(
    model: Any, omega: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[Any], tuple[Band, Band] | None, Draws | None]:
    """Return G, its frequencies (at most pi/Ts), its bands, and the draws for the bands."""
    if hasattr(model, "dt"):  # a python-control system
        w = omega[omega <= np.pi / model.dt * (1 + 1e-9)] if model.dt else omega
        return w, np.asarray(model(np.exp(1j * w * model.dt) if model.dt else 1j * w)), None, None
    w = omega[omega <= np.pi / model.Ts * (1 + 1e-9)]
    answer = model.frequency_response(w)
    if not np.nan_to_num(answer.std_magnitude).any():
        return w, answer.G, None, None
    draws = parameter_draws(model)
    return w, answer.G, frequency_bands(model, answer, draws), draws


def continuous_phase(G: NDArray[Any]) -> NDArray[np.float64]:
    """Return the phase without jumps by 360°, beginning between -360° and 0°."""
    # At a weakly damped zero the sign of a jump by 180° is arbitrary.
    phase = np.degrees(np.angle(G)) % 360 - 360
    for k in range(1, phase.size):
        step = (phase[k] - phase[k - 1] + 180) % 360 - 180
        if np.abs(step) < _AMBIGUOUS_TURN_DEG:
            phase[k] = phase[k - 1] + step
    for k in range(phase.size - _TURN_STEPS):
        begin, end = phase[k], phase[k + _TURN_STEPS]
        turns = np.ceil(end / 360)
        if turns and -360 <= begin <= 0 and np.abs(end - begin) > _AMBIGUOUS_TURN_DEG:
            phase[k + 1 : k + _TURN_STEPS] = np.nan
            phase[k + _TURN_STEPS :] -= 360 * turns
    return np.asarray(phase)


def _limit_phase(ax: Axes) -> None:
    """Limit a phase axis to the multiples of 90° around its curves and dots."""
    phases = np.concatenate([np.asarray(line.get_ydata(), np.float64) for line in ax.lines])
    phases = phases[np.isfinite(phases)]
    if phases.size:
        first, last = np.floor(phases.min() / 90), np.ceil(phases.max() / 90)
        last = max(last, first + 1)
        ticks = 90 * np.arange(first, last + 1)
        ax.set_yticks(ticks[:: -(-ticks.size // 6)])
        ax.set_ylim(90 * first - 5, 90 * last + 5)


def _limit_to_curves(ax: Axes, y: NDArray[np.float64]) -> None:
    """Limit an axis so that a very wide band does not flatten the curves."""
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    span = high - low or 1.0
    bottom, top = ax.get_ylim()
    ax.set_ylim(max(bottom, low - span), min(top, high + span))


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
    all_regions: list[Region] = []
    by_draws: dict[str, Draws | None] = {}
    names, models = labels_of(models, labels), in_discrete_time(models)
    for model, name, pen, size in zip(
        models, names, pens(len(models)), cycle(_MARKER_SIZES), strict=False
    ):
        colour = pen["color"]
        draws = parameter_draws(model)
        poles, zeros = pole_regions(model, draws), zero_regions(model, draws)
        if any(r.method == "sampled" for r in (*poles, *zeros)):
            by_draws[name] = draws
        all_regions += [*poles, *zeros]
        for regions, marker in ((poles, "x"), (zeros, "o")):
            z = np.array([r.centre for r in regions], dtype=np.complex128)
            style = {"color": colour, "mfc": "none", "ms": size, "mew": 1.2, "ls": "none"}
            label = (name if draws is None else f"{name}, 95 %") if marker == "x" else None
            ax.plot(z.real, z.imag, marker, label=label, zorder=3, **style)
            for region in regions:
                _draw(ax, region, colour)
        if draws is not None:
            _mark_cancelling(ax, model)
    if by_draws:
        ax.plot([], [], color=INK, lw=1.0, ls=":", label="95 % by draws")
    _frame(ax, all_regions)
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
        label = "cannot be distinguished"
        in_legend = label in ax.get_legend_handles_labels()[1]
        heights = {middle.imag, -middle.imag}
        style: dict[str, Any] = {"color": INK, "mfc": "none", "ms": 15, "mew": 0.9, "ls": "none"}
        style |= {"zorder": 2.8, "alpha": 0.6, "label": None if in_legend else label}
        ax.plot([middle.real] * len(heights), list(heights), "s", **style)


def _frame(ax: Axes, regions: list[Region]) -> None:
    """Limit the axes to the roots near the unit circle and to their regions."""
    points: list[complex] = [1.0 + 0.0j]
    near = [r for r in regions if abs(r.centre) < _MAX_SHOWN_MODULUS]
    if len(near) < len(regions):
        text = f"{len(regions) - len(near)} beyond |z| = {_MAX_SHOWN_MODULUS:g}"
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
