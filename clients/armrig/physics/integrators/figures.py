"""Figures of numerical integration: stability regions, errors and the stability limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike

from armrig.numerics.quantities import number
from armrig.physics.integrators.accuracy import Convergence, Sinusoid, all_methods
from armrig.physics.integrators.methods import METHODS, amplification
from armrig.physics.integrators.stability import stability_limit
from armrig.physics.integrators.stepping import integrate, system
from armrig.plots.captions import legend
from armrig.plots.layout import BLUE, GREY, INK, MISSING, VERMILION, axes, finish, panels, pens

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BELOW_BOUND, _ABOVE_BOUND = 0.999, 1.001


def plot_stability_regions(
    A: ArrayLike | None = None,
    *,
    h: float | None = None,
    methods: Sequence[str] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot the stability regions of the methods in the plane of z = h lambda.

    Parameters
    ----------
    A : array_like, shape (nx, nx), optional
        System matrix; its eigenvalues lambda are plotted as points h lambda.
    h : float, optional
        Step in s; by default the limit of forward Euler.
    methods : sequence of str, optional
        Names of methods; by default all. Methods with the same region share a curve.
    """
    ax = axes(ax)
    x, y = np.meshgrid(np.linspace(-2.4, 0.8, 321), np.linspace(-2.2, 2.2, 441))
    z = x + 1j * y
    ax.axhline(0, color=GREY, lw=0.5)
    ax.axvline(0, color=GREY, lw=0.5)
    regions: dict[bytes, list[str]] = {}
    for name in all_methods(methods):
        regions.setdefault(METHODS[name].stability_polynomial.tobytes(), []).append(name)
    for names, pen in zip(regions.values(), pens(len(regions)), strict=True):
        size = amplification(METHODS[names[0]], z)
        ax.contour(
            x, y, size, levels=[1.0], colors=[pen["color"]], linestyles=[pen["ls"]], linewidths=1.5
        )
        label = ", ".join(METHODS[n].name for n in names)
        ax.plot([], [], label=label, **(pen | {"lw": 1.5}))
    if A is not None:
        h = stability_limit(A, "forward_euler") if h is None else h
        points = h * np.linalg.eigvals(system(A, np.zeros(np.shape(A)[0]))[0])
        label = rf"$h\lambda$, $h$ = {_in_ms(h)}"
        ax.plot(points.real, points.imag, "x", color=INK, ms=7, mew=1.5, label=label)
    ax.set_xlim(-2.4, 0.8)
    ax.set_ylim(-2.2, 2.2)
    ax.set_aspect("equal")
    ax.set_xlabel(r"Re $h\lambda$")
    ax.set_ylabel(r"Im $h\lambda$")
    finish(ax)
    legend(ax)
    return ax


def plot_convergence(studies: Sequence[Convergence], *, ax: Axes | None = None) -> Axes:
    """Plot the error against the step, with the observed orders and the stability limits.

    A dotted line marks the stability limit of each method. At steps above the limit, the error
    grows with the span. A step at which the solution overflows has no point.
    """
    ax = axes(ax)
    tops = []
    for study, pen in zip(studies, pens(len(studies)), strict=True):
        seen = np.isfinite(study.error)
        label = f"{METHODS[study.method].name}, order {study.order:.2f}"
        ax.plot(study.h[seen], study.error[seen], marker=".", ms=5, label=label, **pen)
        if np.isfinite(study.limit) and study.limit > 0:
            ax.axvline(study.limit, color=pen["color"], ls=":", lw=1.2)
        tops.append(study.error[seen & (study.h <= study.limit)].max(initial=0.0))
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_ylim(top=30 * max([*tops, 1e-12]))
    ax.set_xlabel("step $h$ [s]")
    ax.set_ylabel("largest error of a state,\nover its largest value")
    finish(ax)
    legend(ax, "dotted: largest stable step of each method")
    return ax


def plot_stability_edge(
    A: ArrayLike, method: str, *, state: int = -1, n: int = 6000, ax: Axes | None = None
) -> Axes:
    """Plot a state of the free motion at steps of 0.999 and 1.001 times the stability limit.

    The initial state excites all modes equally. The method must have a finite stability limit.

    Raises
    ------
    ValueError
        The method has no finite stability limit for this system.
    """
    A_, *_ = system(A, np.zeros(np.shape(A)[0]))
    limit = stability_limit(A_, method)
    if not 0 < limit < np.inf:
        raise InputError(
            f"the stability limit of {method} on this system is {limit}: no figure is possible"
        )
    ax, below = panels(ax, 0.5)
    x0 = np.real(np.linalg.eig(A_)[1].sum(axis=1))
    B = np.zeros(A_.shape[0])
    for panel, share, colour in ((ax, _BELOW_BOUND, BLUE), (below, _ABOVE_BOUND, VERMILION)):
        _, x = integrate(A_, B, lambda t: 0.0, x0, share * limit, n, method)
        panel.plot(np.arange(n + 1), x[:, state], color=colour, lw=0.5, rasterized=True)
        panel.set_ylabel(f"$x$ at {share:g} limit")
    below.set_xlabel(f"step number, {METHODS[method].name}, limit {limit:.5g} s")
    finish(ax, below)
    return ax


def plot_solution(
    problem: Sinusoid,
    h: float | Mapping[str, float],
    *,
    methods: Sequence[str] | None = None,
    state: int = 0,
    label: str = "x",
    ax: Axes | None = None,
) -> Axes:
    """Plot a state as computed by each method, and the exact state; below, plot the errors.

    Parameters
    ----------
    h : float or mapping of str to float
        Step in s: a number for all methods, or a mapping from the name of a method to its step.
    methods : sequence of str, optional
        Names of methods; by default the keys of `h` if `h` is a mapping, otherwise all methods.
    """
    ax, below = panels(ax, 0.4)
    steps = h if isinstance(h, Mapping) else dict.fromkeys(all_methods(methods), h)
    names = all_methods(methods) if methods is not None else tuple(steps)
    same_h = len(set(steps.values())) == 1
    end = max(steps[name] * max(1, round(problem.span / steps[name])) for name in names)
    fine = np.linspace(0.0, end, 1000)
    right = problem.truth(fine)[:, state]
    ax.plot(fine, right, color=MISSING, lw=4.0, label="exact")
    for name, pen in zip(names, pens(len(names)), strict=True):
        t, x = problem.solve(steps[name], max(1, round(problem.span / steps[name])), name)
        text = METHODS[name].name if same_h else f"{METHODS[name].name}, {_in_ms(steps[name])}"
        ax.plot(t, x[:, state], label=text, **(pen | {"lw": 0.7 * pen["lw"]}))
        below.plot(t, x[:, state] - problem.truth(t)[:, state], **(pen | {"lw": 0.7 * pen["lw"]}))
    span = float(np.ptp(right)) or 1.0
    ax.set_ylim(float(right.min()) - 0.3 * span, float(right.max()) + 0.3 * span)
    below.set_ylim(-0.5 * span, 0.5 * span)
    with np.errstate(invalid="ignore"):
        errors = [float(np.nanmax(np.abs(line.get_ydata()))) for line in below.lines]
    finite = [e for e in errors if e < 0.5 * span]
    if finite:
        below.set_ylim(-1.2 * max(finite), 1.2 * max(finite))
    ax.set_ylabel(label)
    below.set_ylabel(f"error\n{label[label.rfind(' [') + 1 :]}" if " [" in label else "error")
    below.set_xlabel("$t$ [s]")
    finish(ax, below, xlim=(0.0, end))
    legend(ax, *([f"$h$ = {_in_ms(steps[names[0]])}"] if same_h else []))
    return ax


def _in_ms(h: float) -> str:
    return f"{number(1e3 * h)} ms"
