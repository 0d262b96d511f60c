"""Figure of a nonparametric estimate of a frequency response."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.confidence_regions import HALF_WIDTH
from armrig.plots.captions import legend, sign
from armrig.plots.layout import (
    BLUE,
    GREEN,
    GREY,
    SKY,
    VERMILION,
    bare_minor,
    decibel_ticks,
    decibels,
    finish,
    hertz,
    panels,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.models.spectral_estimate import SpectralEstimate

Vector = NDArray[np.float64]


def plot_spectral(estimate: SpectralEstimate, *, ax: Axes | None = None) -> Axes:
    """Plot magnitude and phase with 95 % bands, and coherence if it is known."""
    ax, below = panels(ax, 0.36)
    w, G = estimate.omega, estimate.G
    known = np.isfinite(G) & (w > 0) & (np.abs(G) > 0)
    w, magnitude = w[known], np.abs(G[known])
    phase = np.degrees(estimate.phase[known])
    # The phase is unwrapped from the lowest frequency, at which it is between -360° and 0°.
    phase = phase - 360 * np.ceil(phase[0] / 360) if phase.size else phase
    lines = w.size < 200 and estimate.coherence is None
    style: dict[str, Any] = {"marker": "o", "ms": 2.5, "lw": 0.6} if lines else {"lw": 1.1}
    std, across = estimate.std_magnitude[known], np.degrees(estimate.std_phase[known])
    if np.isfinite(std).any():
        width = HALF_WIDTH * np.nan_to_num(std)
        low, high = np.maximum(magnitude - width, 0.03 * magnitude), magnitude + width
        shaded: dict[str, Any] = {"color": SKY, "alpha": 0.45, "lw": 0}
        ax.fill_between(w, decibels(low), decibels(high), label="95 %", **shaded)
        reach = np.minimum(HALF_WIDTH * np.nan_to_num(across), 180)
        below.fill_between(w, phase - reach, phase + reach, **shaded)
    ax.plot(w, decibels(magnitude), color=BLUE, label=estimate.method.split(",")[0], **style)
    below.plot(w, phase, color=BLUE, **style)
    if estimate.nonlinear_std is not None and np.isfinite(estimate.nonlinear_std).any():
        for x, name, colour, dash in (
            (
                estimate.nonlinear_std[known],
                "nonlinear distortion (one realisation)",
                VERMILION,
                "--",
            ),
            (_of(estimate.noise_only_std, known), "noise", GREEN, ":"),
        ):
            shown = np.where(x > 0, x, np.nan)
            ax.plot(w, decibels(shown), color=colour, ls=dash, lw=1.0, label=name)
    ax.set_xscale("log")
    if phase.size:
        ticks = 90 * np.arange(np.floor(phase.min() / 90), np.ceil(phase.max() / 90) + 1)
        below.set_yticks(ticks[:: max(1, ticks.size // 6)])
        below.set_ylim(phase.min() - 60, phase.max() + 60)
    ax.set_ylabel(f"$|G|$ [dB re 1 {_gain(estimate)}]")
    below.set_ylabel("arg $G$ [°]")
    decibel_ticks(ax)
    below.set_xlabel(r"$\omega$ [rad/s]")
    bare_minor(below.xaxis)
    finish(ax, below, xlim=(float(w[0]), float(w[-1])) if w.size > 1 else None)
    lift = hertz(ax)
    if estimate.coherence is not None:
        other = ax.twinx()
        other.plot(w, estimate.coherence[known], color=GREY, lw=0.8, ls="--")
        other.set_ylim(0, 1.02)
        other.set_ylabel("coherence", color=GREY)
        other.tick_params(colors=GREY)
        other.spines["top"].set_visible(False)
        ax.plot([], [], color=GREY, lw=0.8, ls="--", label="coherence")
    return sign(ax, estimate.source, above=legend(ax, lift=lift))


def _of(x: NDArray[Any] | None, known: NDArray[np.bool_]) -> NDArray[np.float64]:
    return np.full(int(np.count_nonzero(known)), np.nan) if x is None else np.asarray(x[known])


def _gain(estimate: SpectralEstimate) -> str:
    """Return the unit of y per unit of u."""
    unit = estimate.unit or "–"
    return f"{unit}/{estimate.input_unit}" if estimate.input_unit else unit
