"""Figures of nonparametric estimates, and of a table of orders."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from armrig.data.columns import Vector
from armrig.models.spectral_estimate import gain_unit
from armrig.numerics.criteria import Criterion
from armrig.numerics.quantities import digits
from armrig.plots.captions import legend, sign, symbol_of
from armrig.plots.layout import (
    BLUE,
    GREEN,
    GREY,
    INK,
    SKY,
    VERMILION,
    axes,
    bare_minor,
    finish,
    hertz,
    logarithmic,
    panels,
    stems,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.estimation.nonparametric.correlation import Correlation
    from armrig.estimation.nonparametric.impulse import ImpulseResponse
    from armrig.estimation.nonparametric.sampling_time import SamplingTime
    from armrig.estimation.nonparametric.step_analysis import StepAnalysis
    from armrig.estimation.order_table import OrderTable


MIN_SHOWN_POWER = 1e-5
"""Share of the largest power; a figure does not show power below this share."""


def plot_impulse(response: ImpulseResponse, *, level: float = 0.99, ax: Axes | None = None) -> Axes:
    """Plot the impulse response with its band about 0; coefficients outside are significant.

    If the output integrates, the upper panel shows the response of the rate. The lower panel shows
    the running sum of this response, with a band about the sum.
    """
    g, std = response.decaying
    width = response.band(level)
    scale = width / np.where(response.std > 0, response.std, 1.0)
    if response.integrator:
        ax, below = panels(ax, 0.42)
        below.fill_between(
            response.lags, response.g - width, response.g + width, color=SKY, alpha=0.4, lw=0
        )
        below.plot(response.lags, response.g, color=BLUE)
        below.set_ylabel(f"$g$ of {symbol_of(response.output)}\n[{gain_unit(response)}]")
        below.set_xlabel("lag [samples]")
    else:
        ax, below = axes(ax), None
        ax.set_xlabel("lag [samples]")
    band = std * float(scale.max(initial=0.0))
    name = f"{100 * level:g} % {response.band_name} band"
    stems(ax, response.lags, g, VERMILION, band=band, label=name)
    rate = label_coefficients(ax, response)
    how = f"{response.kernel.upper()} kernel" if response.kernel else "least squares"
    finish(*(p for p in (ax, below) if p is not None))
    if below is not None:
        legend(below, f"running sum: impulse response of {symbol_of(response.output)}")
    return sign(ax, response.source, above=legend(ax, f"impulse response of {rate}, by {how}"))


def label_coefficients(ax: Axes, response: ImpulseResponse) -> str:
    """Label the axis of an impulse response, and return the name of the responding signal."""
    name = symbol_of(response.output)
    name = f"rate of {name}" if response.integrator else name
    ax.set_ylabel(f"$g$ of {name}\n[{gain_unit(response, rate=response.integrator)}]")
    return name


def plot_correlation(result: Correlation, *, level: float = 0.99, ax: Axes | None = None) -> Axes:
    """Plot the result of a correlation analysis with the band for unrelated y and u."""
    ax = axes(ax)
    band = result.band(level)
    ax.axhspan(-band, band, color=GREY, alpha=0.25, lw=0, label=f"{100 * level:g} %, no relation")
    stems(ax, result.lags, result.g, VERMILION)
    ax.axvline(-0.5, color=GREY, lw=0.6, ls=":")
    ax.set_xlabel("lag [samples], negative: y is earlier")
    ax.set_ylabel(f"$R_{{yu}}/R_u(0)$, whitened [{gain_unit(result)}]")
    finish(ax)
    return sign(ax, result.source, above=legend(ax))


def plot_step_analysis(result: StepAnalysis, *, ax: Axes | None = None) -> Axes:
    """Plot the mean response to a unit step, with final value, dead time and 63 % time."""
    ax = axes(ax)
    ax.plot(result.t, result.y, ".", color=GREY, ms=2.5, label="measured, mean of all steps")
    t, y, std = (np.append(0.0, x) for x in (result.smooth_t, result.smooth, result.smooth_std))
    ax.fill_between(t, y - 2 * std, y + 2 * std, color=SKY, alpha=0.4, lw=0, label="smoothed, 95 %")
    ax.plot(t, y, color=BLUE, lw=1.1, label="smoothed from the step on")
    end, level = float(result.t[-1]), 0.0
    if np.isfinite(result.gain):
        level, name = result.gain, f"final value {digits(result.gain, 3)}"
        ax.axhline(level, color=INK, lw=0.8, ls=":", label=name)
    if result.dead_time > 0:
        ax.axvspan(0, result.dead_time, color=GREY, alpha=0.2, lw=0, label="dead time")
    if np.isfinite(result.gain * result.tau):
        at, rise = result.dead_time + result.tau, (1 - np.exp(-1)) * level
        end = min(end, 2.5 * max(2 * at, float(np.nan_to_num(result.settling))))
        ax.plot([at, at], [0, rise], color=VERMILION, lw=1.0, ls="--")
        ax.plot([0, at], [rise, rise], color=VERMILION, lw=1.0, ls="--")
        name = rf"63 %: $\tau$ = {digits(1e3 * result.tau, 3)} ms"
        ax.plot(at, rise, "o", color=VERMILION, ms=4, label=name)
    ax.set_xlabel("$t$ from the step [s]")
    ax.set_ylabel(f"{symbol_of(result.output)} [{gain_unit(result)}]")
    finish(ax, xlim=(max(float(result.t[0]), -0.15 * end), end))
    _about(ax, np.append(result.smooth[result.smooth_t <= end], [0.0, level]))
    return sign(ax, result.source, above=legend(ax))


def plot_sampling_time(result: SamplingTime, *, ax: Axes | None = None) -> Axes:
    """Plot the step response with the recommended samples, and the spectrum with its bandwidth."""
    ax, below = panels(ax, 0.5, sharex=False)
    end = 1.5 * result.settling
    t, response = _with_gaps(result.t, result.response)
    ax.plot(t, response, color=BLUE, lw=1.1, label="step response, smoothed")
    grid = np.arange(0.0, min(end, float(result.t[-1])), result.Ts)
    dots = np.interp(grid, t, response)
    name = rf"recommended samples, every {1e3 * result.Ts:g} ms"
    ax.plot(grid, dots, "o", color=VERMILION, ms=1.5, label=name)
    ax.axhspan(0.95, 1.05, color=GREY, alpha=0.25, lw=0, label="final value ±5 %")
    ax.axhline(1 - np.exp(-1), color=INK, lw=0.7, ls=":", label="63 % of the final value")
    ax.set_xlim(0, end)
    ax.set_xlabel("$t$ [s]")
    ax.set_ylabel("response over\nits final value")
    s = result.spectrum
    # |G| below two standard deviations is noise and is not drawn.
    significant = np.isfinite(s.G) & (s.magnitude > 2 * np.nan_to_num(s.std_magnitude))
    relative = np.where(significant, s.magnitude, np.nan) / result.gain
    below.plot(s.omega, relative, color=BLUE, lw=1.1, label="$|G|$, relative")
    below.plot(result.omega, result.power, color=GREY, lw=0.8, ls="--", label="power of the output")
    below.axhline(np.sqrt(0.5), color=INK, lw=0.7, ls=":", label="−3 dB")
    for w, name, colour, dash in (
        (result.omega_step, r"$1/\tau$ of the step", GREEN, "-."),
        (result.omega_spectrum, "bandwidth of $|G|$", VERMILION, "--"),
        (np.pi / result.Ts, rf"Nyquist $\pi/T_s$ of {1e3 * result.Ts:g} ms", INK, "-"),
    ):
        below.axvline(w, color=colour, ls=dash, lw=1.0, label=name)
    below.set_xscale("log")
    below.set_yscale("log")
    drawn = np.concatenate([relative[significant], result.power, [np.sqrt(0.5), 1.0]])
    drawn = drawn[drawn > MIN_SHOWN_POWER]
    below.set_ylim(0.5 * float(drawn.min()), 2 * float(drawn.max()))
    below.set_xlabel(r"$\omega$ [rad/s]")
    below.set_ylabel("relative magnitude")
    bare_minor(below.yaxis)
    finish(ax)
    finish(below, xlim=(float(s.omega[0]), max(float(s.omega[-1]), 1.2 * np.pi / result.Ts)))
    legend(below, lift=hertz(below))
    return sign(ax, result.source, above=legend(ax))


def plot_orders(
    table: OrderTable, criterion: Criterion | None = None, *, ax: Axes | None = None
) -> Axes:
    """Plot the best structure for each number of parameters, and the choice of each criterion.

    The ordinate is the one-step loss divided by the least loss. If there are validation data, the
    losses are computed on these data.
    """
    ax = axes(ax)
    on_other = table.validation_loss is not None
    loss = table.loss if table.validation_loss is None else table.validation_loss
    share = loss / float(np.nanmin(np.where(np.isfinite(loss) & (loss > 0), loss, np.nan)))
    d = table.parameters
    best = table.envelope(criterion)
    finite = np.isfinite(share)
    ax.plot(d[finite], share[finite], ".", color=GREY, ms=4, alpha=0.5, label="all structures")
    ax.plot(d[best], share[best], "o-", color=BLUE, ms=4, lw=1.0, label="best for each number")
    chosen: dict[int, list[str]] = {}
    for name in table.criteria:
        chosen.setdefault(table.chosen(name), []).append(name)
    for k, (i, names) in enumerate(sorted(chosen.items(), key=lambda x: int(d[x[0]]))):
        o = table.orders(i)
        label = ", ".join(x.upper() if x != "validation" else x for x in names)
        ax.plot(d[i], share[i], "s", color=VERMILION, ms=8, mfc="none", mew=1.4)
        ax.annotate(
            f"{label} [{o.na} {o.nb} {o.nk}]",
            (d[i], share[i]),
            xytext=(0, -14 - 13 * k),
            textcoords="offset points",
            ha="right" if d[i] > 0.6 * d.max() else "left",
            fontsize="small",
            bbox={"facecolor": "white", "alpha": 0.8, "lw": 0, "pad": 1.0},
            arrowprops={"arrowstyle": "-", "color": GREY, "lw": 0.6},
        )
    top = float(share[best].max()) if best.size else 1.0
    logarithmic(ax.yaxis, 0.6, max(1.5 * top, 2.5))
    ax.locator_params(axis="x", integer=True)
    ax.set_xlabel("number of parameters, $n_a + n_b$")
    ax.set_ylabel(f"loss{' on validation data' if on_other else ''} over the least loss")
    finish(ax)
    legend(ax)
    return ax


def _with_gaps(t: Vector, y: Vector) -> tuple[Vector, Vector]:
    """Return a curve with a NaN in each gap, so that no line crosses the gap."""
    gaps = np.flatnonzero(np.diff(t) > 1.5 * np.median(np.diff(t))) + 1
    return np.insert(t, gaps, t[gaps - 1] + 1e-9), np.insert(y, gaps, np.nan)


def _about(ax: Axes, y: Vector) -> None:
    """Limit the y axis to the range of a curve, so that noisy dots do not flatten the curve."""
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    room = 0.25 * (high - low) or 1.0
    ax.set_ylim(low - room, high + room)
