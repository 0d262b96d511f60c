"""Figures of the physical model: its structure, its step response, and its sensitivities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from armrig.canvas import BLUE, GREY, INK, VERMILION, axes, finish, pens
from armrig.physics.step_response import characteristics, step_response, step_sensitivities
from armrig.physics.systems import ArmParameters

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BOX = {"boxstyle": "round,pad=0.5", "fc": "white"}


def plot_rig(*, ax: Axes | None = None) -> Axes:
    """Show the parts of the rig and the quantities between them (phase 1 of the derivation)."""
    ax = axes(ax)
    parts = {
        "circuit\n$R_m\\,i = u - u_m$": (0.0, 0.0, VERMILION),
        "motor\n$Q_m = K_m\\,i$": (2.3, 0.0, VERMILION),
        "gear\n$Q_E = N\\,Q_m$": (4.6, 0.0, INK),
        "chassis\n$J_1\\,\\ddot\\theta_1 = Q_E + Q_s$": (7.2, 0.0, BLUE),
        "spring\n$Q_s = K_{lin}\\,\\alpha$": (10.0, 0.0, BLUE),
        "arm\n$J_2(\\ddot\\theta_1+\\ddot\\alpha) = -Q_s$": (12.9, 0.0, BLUE),
        "back-EMF\n$u_m = K_m N\\,\\dot\\theta_1$": (2.3, -1.7, VERMILION),
    }
    for text, (x, y, colour) in parts.items():
        ax.text(x, y, text, ha="center", va="center", fontsize=9, bbox=_BOX | {"ec": colour})
    for begin, end, label in (
        ((-2.0, 0.0), (-0.95, 0.0), "$u$"),
        ((0.95, 0.0), (1.5, 0.0), "$i$"),
        ((3.1, 0.0), (3.75, 0.0), "$Q_m$"),
        ((5.45, 0.0), (5.95, 0.0), "$Q_E$"),
        ((9.1, 0.12), (8.45, 0.12), "$Q_s$"),
        ((8.45, -0.12), (9.1, -0.12), ""),
        ((10.9, 0.12), (11.45, 0.12), "$Q_s$"),
        ((11.45, -0.12), (10.9, -0.12), ""),
    ):
        ax.annotate("", end, begin, arrowprops={"arrowstyle": "->", "color": INK})
        middle = ((begin[0] + end[0]) / 2, begin[1] + 0.17)
        ax.text(*middle, label, ha="center", va="bottom", fontsize=9)
    ax.text(8.78, -0.22, r"$\theta_1$", ha="center", va="top", fontsize=9)
    ax.text(11.18, -0.22, r"$\alpha$", ha="center", va="top", fontsize=9)
    for way in (([7.2, 7.2, 3.45], [-0.45, -1.7, -1.7]), ([1.15, 0.0, 0.0], [-1.7, -1.7, -0.45])):
        ax.plot(*way, color=INK, lw=1.0)
    ax.annotate("", (3.4, -1.7), (3.6, -1.7), arrowprops={"arrowstyle": "->", "color": INK})
    ax.annotate("", (0.0, -0.42), (0.0, -0.6), arrowprops={"arrowstyle": "->", "color": INK})
    ax.text(7.3, -1.0, r"$\dot\theta_1$", va="center", fontsize=9)
    ax.text(0.1, -1.0, r"$u_m$", va="center", fontsize=9)
    ax.text(0.0, 0.75, "electrical", color=VERMILION, fontsize=9, ha="center")
    ax.text(10.0, 0.75, "mechanical", color=BLUE, fontsize=9, ha="center")
    ax.set_xlim(-2.2, 14.9)
    ax.set_ylim(-2.3, 1.1)
    ax.set_axis_off()
    return ax


def plot_physical_step(
    cases: Mapping[str, ArmParameters] | None = None,
    *,
    u: float = 1.0,
    seconds: float = 1.0,
    ax: Axes | None = None,
) -> Axes:
    """Show the chassis' speed after a step from rest, for several sets of parameters.

    The first one's steady speed and initial slope are drawn beside it.

    Parameters
    ----------
    cases : mapping of str to ArmParameters, optional
        Label -> parameters; the handout's by default.
    u : float, default 1
        Height of the step in V.
    """
    ax = axes(ax)
    cases = {"handout": ArmParameters()} if cases is None else cases
    t = np.linspace(0.0, seconds, 1001)
    top = 0.0
    for (label, p), (colour, dash) in zip(cases.items(), pens(), strict=False):
        speed = step_response(p, t, u=u)
        top = max(top, float(speed.max()))
        ax.plot(t, speed, color=colour, ls=dash, lw=1.2, label=label)
    first = characteristics(next(iter(cases.values())))
    steady = first.steady_speed * u
    top = max(top, steady)
    rise = np.array([0.0, 1.08 * top / (first.initial_slope * u)])
    ax.plot(rise, first.initial_slope * u * rise, color=GREY, ls=":", lw=1.2)
    ax.axhline(steady, color=GREY, ls=":", lw=1.2)
    label = f"steady {steady:.4g} rad/s, slope {first.initial_slope * u:.4g} rad/s²"
    ax.plot([], [], color=GREY, ls=":", lw=1.2, label=label)
    ax.set_ylim(0.0, 1.12 * top)
    ax.set_xlabel("$t$ [s]")
    ax.set_ylabel(r"$\dot\theta_1$ [rad/s]")
    ax.legend(loc="lower right", fontsize="small")
    finish(ax, xlim=(0.0, seconds))
    return ax


def plot_sensitivities(
    p: ArmParameters | None = None,
    *,
    names: Sequence[str] = ("J_1", "J_2", "K_lin", "R_m", "K_m", "N"),
    u: float = 1.0,
    seconds: float = 1.0,
    ax: Axes | None = None,
) -> Axes:
    """Show what 1 % more of each parameter does to the chassis' speed after a step of u volts."""
    ax = axes(ax)
    p = ArmParameters() if p is None else p
    t = np.linspace(0.0, seconds, 1001)
    by = step_sensitivities(p, t, names=names, u=u)
    ax.axhline(0, color=GREY, lw=0.6)
    drawn: list[str] = []
    for name, (colour, dash) in zip(names, pens(), strict=False):
        twin = next((x for x in drawn if np.allclose(by[x], by[name], atol=1e-9)), None)
        label = f"{name} (as {twin})" if twin else name
        ax.plot(t, 10 * by[name], color=colour, ls=dash, lw=1.2, label=label)
        drawn.append(name)
    ax.set_xlabel("$t$ [s]")
    ax.set_ylabel(r"change of $\dot\theta_1$ for 1 % [mrad/s]")
    ax.legend(loc="best", fontsize="small", ncols=2)
    finish(ax, xlim=(0.0, seconds))
    return ax
