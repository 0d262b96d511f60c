"""Figures of a law: root locus, Bode and Nyquist diagram of the open loop, and steps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from armrig.plots.captions import legend, symbol_of
from armrig.plots.layout import (
    BLUE,
    GREY,
    INK,
    SKY,
    VERMILION,
    axes,
    decibel_ticks,
    decibels,
    finish,
    hertz,
    panels,
)

if TYPE_CHECKING:
    from armrig_core.control.control_law import ControlLaw
    from matplotlib.axes import Axes

    from armrig.control.law_check import LawCheck
    from armrig.control.loop_comparison import LoopComparison

_EDGES = (2.5, 97.5)
_NYQUIST = 2.5
"""Largest distance from 0 in the Nyquist diagram."""
_MOST_CURVES = 100
"""Number of draws in a cloud of curves."""
_BAND: dict[str, Any] = {"color": SKY, "alpha": 0.45, "lw": 0}


def plot_root_locus(check: LawCheck, *, ax: Axes | None = None) -> Axes:
    """Plot the poles of the closed loop for gains of the plant from a fiftieth to 50 times its own.

    Crosses are the poles at the plant's own gain, and dots those with the gain 20 % lower and
    higher.
    """
    ax = axes(ax)
    factors, poles = check.root_locus
    circle = np.exp(1j * np.linspace(0, 2 * np.pi, 400))
    ax.plot(circle.real, circle.imag, color=GREY, lw=0.8, label="unit circle")
    ax.scatter(
        poles.real, poles.imag, c=BLUE, s=1.5, lw=0, label="gain from 1/50 to 50 times its own"
    )
    for factor in (0.8, 1.2):
        at = poles[np.argmin(np.abs(factors - factor))]
        name = "gain 20 % lower and higher" if factor < 1 else "_"
        ax.plot(at.real, at.imag, "o", color=VERMILION, ms=3, label=name)
    nominal = poles[np.argmin(np.abs(factors - 1))]
    ax.plot(nominal.real, nominal.imag, "x", color=INK, ms=7, label="poles of the loop")
    ax.set_aspect("equal")
    ax.set_xlim(-1.3, 1.3)
    ax.set_ylim(-1.3, 1.3)
    ax.set_xlabel("Re $z$")
    ax.set_ylabel("Im $z$")
    finish(ax)
    legend(ax)
    return ax


def plot_loop(check: LawCheck, *, ax: Axes | None = None) -> Axes:
    """Plot magnitude and phase of the open loop L, with 95 % bands over the draws.

    Dots are at the frequencies of the gain and the phase margin.
    """
    ax, below = panels(ax, 0.42)
    w, L = check.omega, check.L
    phase = np.degrees(np.unwrap(np.angle(L[0])))
    phase -= 360 * np.round((phase[0] + 90) / 360)
    if len(L) > 1:
        low, high = np.percentile(decibels(np.abs(L[1:])), _EDGES, axis=0)
        ax.fill_between(w, low, high, label="95 % of the draws", **_BAND)
        low, high = np.percentile(np.degrees(np.angle(L[1:] / L[0])), _EDGES, axis=0)
        below.fill_between(w, phase + low, phase + high, **_BAND)
    ax.plot(w, decibels(np.abs(L[0])), color=BLUE, label="open loop $L$ of the model")
    below.plot(w, phase, color=BLUE)
    ax.axhline(0, color=INK, lw=0.6)
    below.axhline(-180, color=INK, lw=0.6)
    m = check.nominal
    if m.gain_at:
        ax.plot(m.gain_at, -decibels(np.array(m.gain)), "o", color=VERMILION, ms=4)
    if m.phase_at:
        at = np.interp(np.log(m.phase_at), np.log(w), phase)
        below.plot(m.phase_at, at, "o", color=VERMILION, ms=4)
    ax.set_xscale("log")
    ax.set_ylim(-60, 60)
    below.set_ylim(max(float(phase.min()) - 20, -720), max(float(phase.max()) + 20, 0))
    decibel_ticks(ax)
    ax.set_ylabel("$|L|$ [dB]")
    below.set_ylabel("arg $L$ [°]")
    below.set_xlabel(r"$\omega$ [rad/s]")
    finish(ax, below, xlim=(float(w[0]), float(w[-1])))
    legend(ax, lift=hertz(ax))
    return ax


def plot_nyquist(check: LawCheck, *, ax: Axes | None = None) -> Axes:
    """Plot the open loop in the complex plane, with a cloud of draws, the corners' Ms and a circle.

    A loop outside the circle around -1 has Ms below 2.
    """
    ax = axes(ax)
    for k, row in enumerate(check.L[1 : _MOST_CURVES + 1]):
        name = "draws of the model" if k == 0 else "_"
        ax.plot(row.real, row.imag, color=SKY, lw=0.6, alpha=0.4, label=name)
    ax.plot(check.L[0].real, check.L[0].imag, color=BLUE, label="open loop $L$ of the model")
    angle = np.linspace(0, 2 * np.pi, 200)
    radii = {"Ms = 2": (0.5, INK, "--")}
    if np.isfinite(check.worst_Ms):
        radii[f"Ms = {check.worst_Ms:.2f}, the worst"] = (1 / check.worst_Ms, VERMILION, "-")
    for name, (radius, colour, dashes) in radii.items():
        ax.plot(
            -1 + radius * np.cos(angle), radius * np.sin(angle), dashes, color=colour, label=name
        )
    ax.plot(-1, 0, "+", color=INK, ms=8)
    ax.set_aspect("equal")
    ax.set_xlim(-_NYQUIST, _NYQUIST)
    ax.set_ylim(-_NYQUIST, _NYQUIST)
    ax.set_xlabel("Re $L$")
    ax.set_ylabel("Im $L$")
    finish(ax)
    legend(ax)
    return ax


def plot_law_steps(check: LawCheck, *, ax: Axes | None = None) -> Axes:
    """Plot the response to a step of r, and the change of the voltage, with 95 % bands."""
    ax, below = panels(ax, 0.42)
    steps, reference = check.steps, check.law.reference
    for panel, values in ((ax, steps.z), (below, steps.u)):
        if len(values) > 1 and np.isfinite(values).all():
            low, high = np.percentile(values[1:], _EDGES, axis=0)
            panel.fill_between(steps.t, low, high, step="post", label="95 % of the draws", **_BAND)
    ax.axhline(steps.height, color=INK, lw=0.8, ls="--", label="$r$")
    ax.plot(steps.t, steps.z[0], color=BLUE, label="model")
    below.step(steps.t, steps.u[0], where="post", color=BLUE)
    unit = f" [{reference.unit}]" if reference.unit else ""
    ax.set_ylabel(f"{symbol_of(reference.name)}{unit}")
    below.set_ylabel("change of $u$ [V]")
    below.set_xlabel("$t$ [s]")
    finish(ax, below, xlim=(0.0, float(steps.t[-1])))
    legend(ax)
    return ax


def plot_loop_comparison(comparison: LoopComparison, *, ax: Axes | None = None) -> Axes:
    """Plot a run in control next to its prediction: the variable that follows r, and the voltage.

    The band contains 95 % of the draws of the model; the lighter one has twice the noise of the
    measurement, too.
    """
    ax, below = panels(ax, 0.42)
    reference, t = comparison.law.reference, comparison.t
    low, high = comparison.band()
    if not np.isnan(comparison.noise):
        wide = 2 * comparison.noise
        ax.fill_between(t, low - wide, high + wide, color=GREY, alpha=0.2, lw=0, label="noise")
    if len(comparison.predicted) > 1:
        ax.fill_between(t, low, high, label="95 % of the draws", **_BAND)
        low, high = np.percentile(comparison.predicted_u[1:], _EDGES, axis=0)
        below.fill_between(t, low, high, step="post", **_BAND)
    ax.step(t, comparison.r, where="post", color=INK, lw=0.8, ls="--", label="$r$")
    ax.plot(t, comparison.z, color=VERMILION, lw=0.8, label="measured")
    ax.plot(t, comparison.predicted[0], color=BLUE, label="predicted")
    below.step(t, comparison.u, where="post", color=VERMILION, lw=0.8)
    below.step(t, comparison.predicted_u[0], where="post", color=BLUE)
    for limit in (comparison.law.lo, comparison.law.hi):
        below.axhline(limit, color=INK, lw=0.6)
    if comparison.prelude:
        for panel in (ax, below):
            panel.axvspan(0.0, comparison.prelude * comparison.Ts, color=GREY, alpha=0.15, lw=0)
    unit = f" [{reference.unit}]" if reference.unit else ""
    ax.set_ylabel(f"{symbol_of(reference.name)}{unit}")
    below.set_ylabel("$u$ [V]")
    below.set_xlabel("$t$ [s]")
    finish(ax, below, xlim=(0.0, float(t[-1])))
    legend(ax)
    return ax


_BOXES: dict[str, tuple[float, float, str]] = {
    "law": (1.3, 1.0, "law"),
    "limits": (2.5, 1.0, "limits\nslew"),
    "rig": (3.7, 1.0, "rig"),
    "delay": (2.5, 0.25, "$z^{-1}$"),
    "monitor": (3.7, 1.85, "monitor"),
}
"""Place and text of each box of the diagram."""


def plot_loop_diagram(law: ControlLaw, *, ax: Axes | None = None) -> Axes:
    """Plot the loop of a law and a rig, with its signals."""
    ax = axes(ax)
    size = 9.0
    style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": size}
    arrow: dict[str, Any] = {"arrowstyle": "->", "color": INK, "shrinkA": 0, "shrinkB": 0}
    boxes: dict[str, Any] = {}
    for name, (x, y, text) in _BOXES.items():
        if name != "monitor" or law.monitor is not None:
            box = {"boxstyle": "round,pad=0.4", "fc": "white", "ec": BLUE}
            boxes[name] = ax.text(x, y, text, bbox=box, **style).get_bbox_patch()
    measured = ", ".join(symbol_of(output.name) for output in law.outputs)
    reference = symbol_of(law.reference.name)

    def connect(begin: tuple[float, float], end: str, label: str, at: tuple[float, float]) -> None:
        ax.annotate("", _BOXES[end][:2], begin, arrowprops=arrow | {"patchB": boxes[end]})
        ax.text(*at, label, **style)

    connect((0.3, 1.0), "law", f"$r$ of {reference}", (0.55, 1.15))
    connect((1.55, 1.0), "limits", "$v$", (1.9, 1.1))
    connect((2.85, 1.0), "rig", "$u$", (3.1, 1.1))
    ax.annotate("", (4.7, 1.0), (3.9, 1.0), arrowprops=arrow)
    ax.text(4.45, 1.13, measured, **style)
    ax.plot([4.3, 4.3, 2.7], [1.0, 0.25, 0.25], color=INK, lw=0.8)
    connect((2.75, 0.25), "delay", "", (2.7, 0.25))
    ax.plot([2.3, 1.3], [0.25, 0.25], color=INK, lw=0.8)
    connect((1.3, 0.25), "law", "$y[k-1]$", (1.75, 0.37))
    ax.plot([3.0, 3.0, 1.15], [1.0, 1.5, 1.5], color=INK, lw=0.8)
    connect((1.15, 1.5), "law", "$u[k-1]$", (1.75, 1.62))
    if law.monitor is not None:
        ax.plot([3.0, 3.0], [1.5, 1.85], color=INK, lw=0.8)
        connect((3.0, 1.85), "monitor", "", (3.2, 1.95))
        ax.plot([4.3, 4.3], [1.0, 1.85], color=INK, lw=0.8)
        connect((4.3, 1.85), "monitor", "", (4.1, 1.95))
    ax.set_xlim(0.1, 4.9)
    ax.set_ylim(0.0, 2.15)
    ax.set_axis_off()
    return ax
