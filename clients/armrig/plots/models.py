"""Figures of models: against data, and what they answer."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armrig.plots.canvas import (
    BLUE,
    GREY,
    INK,
    NAMES,
    VERMILION,
    axes,
    finish,
    named,
    panels,
    pens,
    shade,
    short,
    sign,
)
from armrig.validation import BAND_99_PERCENT, ComparisonTable, compare, residuals

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from armrig.dataset import Dataset
    from armrig.fit import Fit

Labels = Sequence[str] | None


def plot_compare(
    data: Dataset,
    *fits: Fit,
    horizon: int | None = None,
    labels: Labels = None,
    table: ComparisonTable | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Show measured output and models (simulated unless a horizon is given), and below the errors.

    The errors' scale is linear up to three times the best model's rms error and logarithmic beyond.
    """
    table = compare(data, *fits, horizon=horizon, labels=labels) if table is None else table
    ax, below = panels(ax, 0.38)
    for panel in (ax, below):
        shade(panel, data)
    ax.plot(data.t, data.y, color=INK, lw=1.8, alpha=0.55, label="measured")
    names = labels or [row.name for row in table.rows]
    for row, name, (colour, dash) in zip(table.rows, names, pens(), strict=False):
        rms = f"{short(row.rms_error)} {data.unit}"
        text = f"{name}, rms error {rms}"
        ax.plot(data.t, row.y, color=colour, ls=dash, lw=1.0, label=text)
        below.plot(data.t, data.y - row.y, color=colour, ls=dash, lw=0.8)
    finite = [
        row.rms_error for row in table.rows if np.isfinite(row.rms_error) and row.rms_error > 0
    ]
    if finite and max(finite) > 8 * min(finite):
        linear = 3 * min(finite)
        below.set_yscale("symlog", linthresh=linear, linscale=1.0)
        largest = max(float(np.nanmax(np.abs(data.y - row.y))) for row in table.rows)
        decades = {np.ceil(np.log10(linear)), np.floor(np.log10(max(largest, linear)))}
        ticks = [sign * 10.0**d for d in sorted(decades) for sign in (-1, 1)]
        below.set_yticks([0, *ticks], [f"{v:g}" for v in (0, *ticks)])
        below.minorticks_off()
    below.axhline(0, color=GREY, lw=0.6)
    # Not autoscaled: where nothing was measured a model's initial transient may be anywhere.
    shown = np.concatenate([y[data.valid] for y in (data.y, *(row.y for row in table.rows))])
    measured, all_ = _range(data.y), _range(shown[np.isfinite(shown)])
    span = measured[1] - measured[0] or 1.0
    ax.set_ylim(
        max(all_[0], measured[0] - span) - 0.05 * span,
        min(all_[1], measured[1] + span) + 0.05 * span,
    )
    ax.set_ylabel(named(data.output, data.unit))
    below.set_ylabel(f"error [{data.unit}]")
    below.set_xlabel("$t$ [s]")
    ax.legend(loc="best")
    finish(ax, below, xlim=(0.0, float(data.t[-1]) or 1.0))
    return sign(ax, data.source)


def plot_residuals(
    fit: Fit, data: Dataset, *, lags: int | None = None, ax: Axes | None = None
) -> Axes:
    """Show the residuals' autocorrelation and, below, their correlation with the input.

    Grey bands hold 99 % of each lag's values: if the residuals are white, and if the input has
    nothing to do with them. Negative lags point to feedback, positive ones to missing dynamics.
    """
    test = residuals(fit, data, lags)
    ax, below = panels(ax, 0.5, sharex=False)
    ax.axhspan(-test.autocorrelation_band, test.autocorrelation_band, color=GREY, alpha=0.25, lw=0)
    _stems(ax, test.lags[1:], test.autocorrelation[1:], BLUE)
    ax.set_ylabel("$r_e$(lag)")
    band = BAND_99_PERCENT * test.cross_std
    below.fill_between(
        test.cross_lags, -band, band, step="mid", color=GREY, alpha=0.25, lw=0, label="99 %"
    )
    _stems(below, test.cross_lags, test.cross_correlation, VERMILION)
    below.axvline(-0.5, color=GREY, lw=0.6, ls=":")
    below.set_ylabel("$r_{eu}$(lag)")
    below.set_xlabel("lag [samples]")
    for panel, values, width in (
        (ax, test.autocorrelation[1:], test.autocorrelation_band),
        (below, test.cross_correlation, float(np.nanmax(band, initial=0.0))),
    ):
        reach = 1.25 * max(float(np.nanmax(np.abs(values), initial=0.0)), width, 1e-12)
        panel.set_ylim(-reach, 1.4 * reach)  # room for the p values
    ax.text(0.99, 0.93, _p_value("white", test.whiteness), **_corner(ax))
    below.text(0.99, 0.93, _p_value("no dynamics missing", test.missing_dynamics), **_corner(below))
    below.text(
        0.01, 0.93, _p_value("no feedback", test.feedback), **(_corner(below) | {"ha": "left"})
    )
    finish(ax)
    finish(below)
    return sign(ax, data.source)


def plot_bode(
    *models: Any,
    omega: ArrayLike | None = None,
    labels: Labels = None,
    ax: Axes | None = None,
) -> Axes:
    """Show magnitude and, below, phase, with bands of ±3 standard deviations where there are any.

    Parameters
    ----------
    *models
        `Fit`, or a python-control system with one input and one output.
    omega : array_like, optional
        Frequencies in rad/s; by default two and a half decades up to the highest Nyquist frequency.
    """
    highest = max((np.pi / m.Ts for m in models if hasattr(m, "Ts")), default=1e3)
    w = (
        np.geomspace(highest / 600, highest, 500)
        if omega is None
        else np.asarray(omega, np.float64)
    )
    ax, below = panels(ax, 0.42)
    least = np.inf
    for model, name, (colour, dash) in zip(models, _labels(models, labels), pens(), strict=False):
        x, G, std_magnitude, std_phase = _response(model, w)
        magnitude, phase = np.abs(G), _phase(G)
        least = min(least, float(magnitude.min(initial=np.inf)))
        if std_magnitude.any():
            low = np.maximum(magnitude - 3 * std_magnitude, magnitude * 1e-3)
            ax.fill_between(x, low, magnitude + 3 * std_magnitude, color=colour, alpha=0.25, lw=0)
            width = np.degrees(3 * std_phase)
            below.fill_between(x, phase - width, phase + width, color=colour, alpha=0.25, lw=0)
        ax.plot(x, magnitude, color=colour, ls=dash, label=name)
        below.plot(x, phase, color=colour, ls=dash)
    ax.set_xscale("log")
    ax.set_yscale("log")
    below.set_xscale("log")
    ax.set_ylim(bottom=least / 3)
    below.set_ylim(-365, 5)
    below.set_yticks([-360, -270, -180, -90, 0])
    ax.set_ylabel(f"$|G|$ [{_gain_unit(models)}]")
    below.set_ylabel("arg $G$ [°]")
    below.set_xlabel(r"$\omega$ [rad/s]")
    ax.legend(loc="lower left")
    finish(ax, below, xlim=(float(w[0]), float(w[-1])))
    return sign(ax, *_sources(models))


def plot_poles_zeros(*fits: Fit, labels: Labels = None, ax: Axes | None = None) -> Axes:
    """Show poles (×) and zeros (○) in the z plane with their 99 % regions, and the unit circle."""
    ax = axes(ax)
    angle = np.linspace(0, 2 * np.pi, 361)
    ax.plot(np.cos(angle), np.sin(angle), color=GREY, lw=0.8)
    ax.axhline(0, color=GREY, lw=0.5)
    ax.axvline(0, color=GREY, lw=0.5)
    reach = 1.1
    # The first is the largest, so that models that agree show around each other.
    sizes = (9.0, 6.5, 4.0, 4.0)
    for fit, name, (colour, _), size in zip(
        fits, _labels(fits, labels), pens(), cycle(sizes), strict=False
    ):
        for roots, marker in ((fit.poles(), "x"), (fit.zeros(), "o")):
            z = np.asarray(roots.values)
            style = {"color": colour, "mfc": "none", "ms": size, "mew": 1.2, "ls": "none"}
            label = name if marker == "x" else None
            ax.plot(z.real, z.imag, marker, label=label, zorder=3, **style)
            for centre, covariance in zip(z, roots.covariance, strict=True):
                ellipse = _ellipse(covariance)
                ax.plot(centre.real + ellipse[0], centre.imag + ellipse[1], color=colour, lw=0.7)
            inside = np.abs(z)[np.abs(z) < 3]  # what lies further out is off the figure
            reach = max(reach, 1.1 * float(inside.max(initial=0.0)))
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel="Re $z$", ylabel="Im $z$")
    ax.set_aspect("equal")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=4, frameon=False)
    finish(ax)
    return sign(ax, *_sources(fits))


def plot_step(
    *fits: Fit, n: int | None = None, labels: Labels = None, ax: Axes | None = None
) -> Axes:
    """Show the answer to a unit step, with bands of ±3 standard deviations.

    Parameters
    ----------
    n : int, optional
        Samples; by default 1 s or 50 samples, whichever is more.
    """
    ax = axes(ax)
    for fit, name, (colour, dash) in zip(fits, _labels(fits, labels), pens(), strict=False):
        answer = fit.step_response(n or max(50, round(1 / fit.Ts)))
        if answer.std.any():
            low, high = answer.y - 3 * answer.std, answer.y + 3 * answer.std
            ax.fill_between(answer.t, low, high, color=colour, alpha=0.25, lw=0)
        ax.plot(answer.t, answer.y, color=colour, ls=dash, label=name)
    ax.set_xlabel("$t$ [s]")
    ax.set_ylabel(f"{NAMES.get(fits[0].output, fits[0].output)} [{_gain_unit(fits)}]")
    ax.legend(loc="best")
    ax.margins(x=0)
    finish(ax)
    return sign(ax, *_sources(fits))


def plot_fit(fit: Fit) -> Figure:
    """Return a figure of one model: frequency and step response, poles and zeros."""
    from matplotlib import pyplot as plt

    figure = plt.figure(figsize=(9.0, 5.5))
    grid = figure.add_gridspec(
        nrows=2,
        ncols=2,
        width_ratios=(1.35, 1),
        height_ratios=(1, 1.3),
        left=0.09,
        right=0.97,
        bottom=0.15,
        top=0.93,
        hspace=0.5,
        wspace=0.3,
    )
    plot_bode(fit, ax=figure.add_subplot(grid[:, 0]))
    plot_step(fit, ax=figure.add_subplot(grid[0, 1]))
    plot_poles_zeros(fit, ax=figure.add_subplot(grid[1, 1]))
    return figure


def _stems(ax: Axes, x: NDArray[Any], y: NDArray[Any], colour: str) -> None:
    ax.vlines(x, 0, y, color=colour, lw=1.0)
    ax.plot(x, y, "o", color=colour, ms=2.6)
    ax.axhline(0, color=INK, lw=0.6)


def _labels(models: Sequence[Any], labels: Labels) -> list[str]:
    if labels is not None:
        return list(labels)
    names = []
    for model in models:
        orders = getattr(model, "orders", None)
        named = (
            f"{model.structure.upper()}[{' '.join(map(str, orders.values()))}]" if orders else ""
        )
        names.append(named or str(getattr(model, "name", "model")))
    return names


def _sources(models: Sequence[Any]) -> list[str]:
    return [getattr(model, "source", "") for model in models]


def _response(model: Any, omega: NDArray[np.float64]) -> tuple[NDArray[Any], ...]:
    """Return frequencies up to the model's Nyquist, G there, and its standard deviations."""
    if hasattr(model, "structure"):
        w = omega[omega <= np.pi / model.Ts * (1 + 1e-9)]
        answer = model.frequency_response(w)
        return w, answer.G, np.nan_to_num(answer.std_magnitude), np.nan_to_num(answer.std_phase)
    w = omega[omega <= np.pi / model.dt * (1 + 1e-9)] if model.dt else omega
    G = np.asarray(model(np.exp(1j * w * model.dt) if model.dt else 1j * w))
    return w, G, np.zeros(w.size), np.zeros(w.size)


def _phase(G: NDArray[Any]) -> NDArray[np.float64]:
    """Return the phase as a lag, -360° to 0°, with NaN where it passes from one end to the other.

    Not without jumps: at an undamped zero it jumps by 180°, and whether up or down is chance.
    """
    phase = np.degrees(np.angle(G)) % 360 - 360
    phase[1:][np.abs(np.diff(phase)) > 300] = np.nan
    return np.asarray(phase)


def _gain_unit(models: Sequence[Any]) -> str:
    for model in models:
        if getattr(model, "unit", "") and getattr(model, "input_unit", ""):
            return f"{model.unit}/{model.input_unit}"
    return "–"


def _ellipse(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the border (2, n) of the region that holds 99 % of a normal distribution."""
    value, vector = np.linalg.eigh(covariance)
    # chi-squared of two degrees of freedom: P(r² > x) = exp(-x/2).
    radii = np.sqrt(np.maximum(value, 0.0) * -2 * np.log(0.01))
    angle = np.linspace(0, 2 * np.pi, 73)
    return np.asarray(vector @ (radii[:, None] * np.array([np.cos(angle), np.sin(angle)])))


def _range(x: NDArray[np.float64]) -> tuple[float, float]:
    return (float(np.nanmin(x)), float(np.nanmax(x))) if x.size else (0.0, 1.0)


def _p_value(hypothesis: str, p: float) -> str:
    return f"{hypothesis}: p {'< 0.001' if p < 0.001 else f'= {p:.3f}'}"


def _corner(ax: Axes) -> dict[str, Any]:
    box = {"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 1.5}
    return {"transform": ax.transAxes, "ha": "right", "va": "top", "fontsize": "small", "bbox": box}
