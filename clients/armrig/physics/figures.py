"""Figures of the physical model: structure, step response, sensitivities and calibration."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.errors import InputError

from armrig.numerics.quantities import with_std, with_unit
from armrig.physics.calibration_readings import Readings, readings_of
from armrig.physics.calibration_turns import IDEAL_DRIVER, Speeds, TerminalVoltage, Turning
from armrig.physics.step_response import characteristics, step_response, step_sensitivities
from armrig.physics.systems import ArmParameters
from armrig.plots.captions import legend, symbol
from armrig.plots.layout import BLUE, GREY, INK, VERMILION, axes, finish, panels, pens

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.physics.calibration import CalibrationEstimate
    from armrig.recordings.recording import Recording

_TOP, _LOW, _BETWEEN = 2.0, 0.0, 1.0  # heights of the rows of the drawing
_PARTS = {
    "circuit": ("$R_m\\,i = u - u_m$", (1.25, _TOP), VERMILION),
    "motor": ("$Q_m = K_m\\,i$", (2.65, _TOP), VERMILION),
    "gear": ("$Q_E = N\\,Q_m$", (4.0, _TOP), INK),
    "back-EMF": ("$u_m = K_m N\\,\\dot\\theta_1$", (2.2, _BETWEEN), VERMILION),
    "chassis": ("$J_1\\,\\ddot\\theta_1 = Q_E + Q_s$", (4.0, _LOW), BLUE),
    "spring": ("$Q_s = K_{lin}\\,\\alpha$", (2.65, _LOW), BLUE),
    "arm": ("$J_2(\\ddot\\theta_1+\\ddot\\alpha) = -Q_s$", (1.25, _LOW), BLUE),
}
_STRAIGHT = "arc3"
_UP_THEN_LEFT = "angle,angleA=90,angleB=0,rad=0"
_LEFT_THEN_UP = "angle,angleA=180,angleB=90,rad=0"
# Begin, end, offset of the arrow from the centres, its form, and label and place of the quantity.
_QUANTITIES = (
    ("circuit", "motor", (0.0, 0.0), _STRAIGHT, "$i$", (1.95, _TOP + 0.2)),
    ("motor", "gear", (0.0, 0.0), _STRAIGHT, "$Q_m$", (3.3, _TOP + 0.2)),
    ("gear", "chassis", (0.1, 0.0), _STRAIGHT, "$Q_E$", (4.3, _BETWEEN)),
    ("chassis", "back-EMF", (-0.1, 0.0), _UP_THEN_LEFT, r"$\dot\theta_1$", (3.25, 1.22)),
    ("back-EMF", "circuit", (0.0, 0.0), _LEFT_THEN_UP, "$u_m$", (1.05, _BETWEEN + 0.35)),
    ("spring", "chassis", (0.0, 0.08), _STRAIGHT, "$Q_s$", (3.25, 0.28)),
    ("chassis", "spring", (0.0, -0.08), _STRAIGHT, r"$\theta_1$", (3.25, -0.28)),
    ("spring", "arm", (0.0, 0.08), _STRAIGHT, "$Q_s$", (2.03, 0.28)),
    ("arm", "spring", (0.0, -0.08), _STRAIGHT, r"$\alpha$", (2.03, -0.28)),
)
_PARAMETER = re.compile(rf"\b({'|'.join(f.name for f in fields(ArmParameters))})\b")


def plot_rig(*, ax: Axes | None = None) -> Axes:
    """Plot the parts of the rig and the quantities between them (phase 1 of the derivation).

    The electrical parts are at the top. The mechanical parts are at the bottom, from right to left.
    """
    ax = axes(ax)
    points = 72 / ax.figure.dpi
    size = min(10.0, points * ax.bbox.width / 36, points * ax.bbox.height / 10)
    boxes: dict[str, Any] = {}
    places = {name: place for name, (_, place, _) in _PARTS.items()}
    for name, (equation, (x, y), colour) in _PARTS.items():
        box = {"boxstyle": "round,pad=0.4", "fc": "white", "ec": colour}
        style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": size}
        boxes[name] = ax.text(x, y, f"{name}\n{equation}", bbox=box, **style).get_bbox_patch()
    arrow: dict[str, Any] = {"arrowstyle": "->", "color": INK, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", places["circuit"], (0.3, _TOP), arrowprops=arrow | {"patchB": boxes["circuit"]})
    ax.text(0.5, _TOP + 0.2, "$u$", **style)
    for begin, end, beside, way, label, (x, y) in _QUANTITIES:
        # Each arrow runs from centre to centre and is clipped at the boxes.
        ends = {"patchA": boxes[begin], "patchB": boxes[end], "connectionstyle": way}
        first, last = ((places[k][0] + beside[0], places[k][1] + beside[1]) for k in (begin, end))
        last = last if way == _STRAIGHT else places[end]
        ax.annotate("", last, first, arrowprops=arrow | ends)
        ax.text(x, y, label, **style)
    ax.text(0.02, 1.45, "electrical", color=VERMILION, fontsize=size, va="center")
    ax.text(0.02, 0.45, "mechanical", color=BLUE, fontsize=size, va="center")
    ax.set_xlim(-0.05, 4.6)
    ax.set_ylim(-0.45, 2.4)
    ax.set_axis_off()
    return ax


def plot_physical_step(
    cases: Mapping[str, ArmParameters] | None = None,
    *,
    u: float = 1.0,
    seconds: float = 1.0,
    ax: Axes | None = None,
) -> Axes:
    """Plot the chassis' speed after a step from rest, for several sets of parameters.

    The legend contains the steady speed and the initial slope of each set. Grey lines show the
    steady speed and the initial slope of the first set.

    Parameters
    ----------
    cases : mapping of str to ArmParameters, optional
        Sets of parameters by label; the default is a single set, the parameters of the handout.
        `beside_the_handout` of `armrig.physics.systems` returns a mapping of this form.
    u : float, default 1
        Height of the step in V.
    seconds : float, default 1
        Duration in s.
    """
    ax = axes(ax)
    cases = {"handout": ArmParameters()} if cases is None else cases
    t = np.linspace(0.0, seconds, 1001)
    top = 0.0
    for (label, p), pen in zip(cases.items(), pens(len(cases)), strict=True):
        speed = step_response(p, t, u=u)
        top = max(top, float(speed.max()))
        features = characteristics(p)
        steady, slope = u * features.steady_speed, u * features.initial_slope
        text = f"{_in_symbols(label)}: steady {steady:.4f} rad/s, initial slope {slope:.2f} rad/s²"
        ax.plot(t, speed, label=text, **pen)
    first = characteristics(next(iter(cases.values())))
    steady = first.steady_speed * u
    top = max(top, steady)
    rise = np.array([0.0, 1.08 * top / (first.initial_slope * u)])
    label = f"steady speed and initial slope, {_in_symbols(next(iter(cases)))}"
    ax.plot(rise, first.initial_slope * u * rise, color=GREY, ls="-", lw=0.8, label=label)
    ax.axhline(steady, color=GREY, ls="-", lw=0.8)
    ax.set_ylim(0.0, 1.08 * top)
    ax.set_xlabel("$t$ [s]")
    ax.set_ylabel(r"$\dot\theta_1$ [rad/s]")
    finish(ax, xlim=(0.0, seconds))
    legend(ax, f"step of {u:g} V from rest")
    return ax


def _in_symbols(label: str) -> str:
    """Return a label with its parameter names in mathtext."""
    return label if "$" in label else _PARAMETER.sub(lambda found: symbol(found[0]), label)


def plot_sensitivities(
    p: ArmParameters | None = None,
    *,
    names: Sequence[str] = ("J_1", "J_2", "K_lin", "R_m", "K_m", "N"),
    u: float = 1.0,
    seconds: float = 1.0,
    ax: Axes | None = None,
) -> Axes:
    """Plot the change of the chassis' speed after a step of u volts if a parameter is 1 % larger.

    Parameters with equal effects share a curve.
    """
    ax = axes(ax)
    p = ArmParameters() if p is None else p
    t = np.linspace(0.0, seconds, 1001)
    by = step_sensitivities(p, t, names=names, u=u)
    ax.axhline(0, color=GREY, lw=0.6)
    drawn: dict[str, list[str]] = {}
    for name in names:
        twin = next((x for x in drawn if np.allclose(by[x], by[name], atol=1e-9)), name)
        drawn.setdefault(twin, []).append(name)
    for (name, alike), pen in zip(drawn.items(), pens(len(drawn)), strict=True):
        ax.plot(t, 10 * by[name], label=", ".join(map(symbol, alike)), **(pen | {"lw": 1.3}))
    ax.set_xlabel("$t$ [s]")
    ax.set_ylabel("change of $\\dot\\theta_1$ [mrad/s]")
    finish(ax, xlim=(0.0, seconds))
    legend(ax, "change if one parameter is 1 % larger")
    return ax


def plot_calibration(
    estimate: CalibrationEstimate, turns: Recording | Readings, *, ax: Axes | None = None
) -> Axes:
    """Plot theta_1's readings and the edges of its track; below, plot speed against voltage.

    Parameters
    ----------
    turns : Recording or Readings
        Run at constant voltages from which `estimate` was made.

    Raises
    ------
    InputError
        The estimate was made from a recording at rest only.
    """
    turned, size = estimate.turned, estimate.rad_per_count
    if turned is None or size is None:
        raise InputError("no figure of a calibration without turns: record turns with --volts")
    ax, below = panels(ax, 0.45, sharex=False)
    readings = readings_of(turns)
    ax.plot(readings.t, readings.first, ".", color=BLUE, ms=1.5)
    for edge, name, dash in ((turned.low, "low", "--"), (turned.high, "high", "-.")):
        text = f"{name} edge {with_std(edge.value, edge.std)}"
        ax.axhline(edge.value, color=VERMILION, ls=dash, lw=1.0, label=text)
    ax.set_xlim(0.0, float(readings.t[-1]) or 1.0)
    ax.set_xlabel("$t$ [s]")
    ax.set_ylabel(r"$\theta_1$ [counts]")
    _plot_speeds(below, turned, estimate.speeds, estimate.terminal)
    finish(ax)
    finish(below)
    legend(ax, f"one count is {with_unit(size.value, size.std, 'rad')}")
    legend(below)
    return ax


def _plot_speeds(
    ax: Axes, turned: Turning, speeds: Speeds | None, terminal: TerminalVoltage | None
) -> None:
    """Plot the speed at each voltage with ±2 σ, and the line through the speeds."""
    offset, gain = (terminal or IDEAL_DRIVER).line
    v = offset + gain * turned.volts
    scale = 2 * np.pi * turned.direction / turned.per_turn.value
    omega = scale * turned.slopes
    std = abs(scale) * np.sqrt(np.diag(turned.covariance)[:-1])
    ax.errorbar(v, omega, 2 * std, fmt="o", color=BLUE, ms=4, lw=1.0, capsize=3, label="measured")
    if speeds is not None:
        stop = speeds.zero_torque.value
        ends = np.array([stop, 1.05 * float(v.max())])
        rate = f"{with_std(speeds.rate.value, speeds.rate.std)} rad/s/V"
        ax.plot(ends, speeds.rate.value * (ends - stop), color=INK, lw=0.9, label=rate)
        at = f"stops at {with_std(stop, speeds.zero_torque.std)} V"
        ax.plot(stop, 0.0, "s", color=VERMILION, ms=5, mfc="none", ls="none", label=at)
    ax.axhline(0, color=GREY, lw=0.6)
    ax.set_xlabel("$u$ at the terminals [V]" if terminal is not None else "$u$ of the code [V]")
    ax.set_ylabel(r"$\dot\theta_1$ [rad/s]")
