"""Figures of the tests for feedback and for delay."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from armrig.estimation.figures import label_coefficients
from armrig.models.spectral_estimate import gain_unit
from armrig.numerics.quantities import NBSP, p_relation
from armrig.numerics.whiteness import BAND_99_PERCENT
from armrig.plots.captions import legend, sign, symbol_of
from armrig.plots.layout import BLUE, GREY, VERMILION, axes, drawable, finish, panels, stems

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.validation.feedback_and_delay.delay_result import Delay
    from armrig.validation.feedback_and_delay.open_loop import OpenLoop


# The bands of the delay have the level of its tests, so that figure and verdict agree.
_BAND_99_9_PERCENT = 3.29
_CHI2_99_9_PERCENT = 10.83  # one degree of freedom
_ABOUT = 15  # lags shown on the causal side
_BEYOND = 6  # lags shown after nk
_OF_ZERO = "{} band of a coefficient that is 0"


def plot_open_loop(result: OpenLoop, *, ax: Axes | None = None) -> Axes:
    """Show the coefficients of u in the regression of y(t), and the result of the test.

    At positive lags u precedes y, and the coefficients of u may differ from 0. At the other lags,
    which are shaded, all coefficients are 0 in open loop.
    """
    from matplotlib.ticker import MaxNLocator

    ax = axes(ax)
    if result.sims is None:
        ax.text(0.5, 0.5, drawable(result.verdict), transform=ax.transAxes, ha="center")
        return sign(ax, result.source)
    window = result.sims.lags <= _ABOUT
    name = symbol_of(result.output)
    band, label = BAND_99_PERCENT * result.sims.std[window], _OF_ZERO.format("99 %")
    coefficients = result.sims.coefficients[window]
    stems(ax, result.sims.lags[window], coefficients, BLUE, band=band, label=label)
    ax.set_ylabel(f"coefficient of $u$ in {name}\n[{gain_unit(result)}]")
    first = float(result.sims.lags[0]) - 0.5
    label = f"tested: the input after {name} was read"
    ax.axvspan(first, 0.5, color=VERMILION, alpha=0.07, lw=0, label=label)
    ax.axvline(0.5, color=GREY, lw=0.6, ls=":")
    ax.set_xlabel("lag of the input [samples]")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    finish(ax)
    test = (
        f"{result.verdict} (Sims' F-test: p {p_relation(result.p_value)}, "
        f"level {100 * result.level:g}{NBSP}%)"
    )
    return sign(ax, result.source, above=legend(ax, test))


def plot_delay(result: Delay, *, ax: Axes | None = None) -> Axes:
    """Show the start of the impulse response; the lower panel shows the loss for each nk.

    The band and the dotted line correspond to the level of the tests, 0.1 %.
    """
    ax, below = panels(ax, 0.5, sharex=False)
    last, response = result.nk + _BEYOND, result.response
    g, std = response.decaying
    window = (response.lags >= 0) & (response.lags <= last)
    band, label = _BAND_99_9_PERCENT * std[window], _OF_ZERO.format("99.9 %")
    stems(ax, response.lags[window], g[window], BLUE, band=band, label=label)
    label_coefficients(ax, response)
    for panel in (ax, below):
        panel.axvline(result.nk, color=GREY, lw=0.8, ls="--", label=result.nk_range)
    nk, V = np.array(list(result.arx_loss)), np.array(list(result.arx_loss.values()))
    best = float(V.min())
    rise = result.response.N * np.log(V / best) if best > 0 else np.zeros(V.size)
    below.plot(nk, rise, marker="o", ms=4, lw=0.8, color=BLUE, label="ARX model", mfc="none")
    below.axhline(_CHI2_99_9_PERCENT, color=GREY, lw=0.8, ls=":", label="not worse, 99.9 %")
    below.set_yscale("symlog", linthresh=10)
    below.set_yticks([0, 10, 100, 1000, 10000], ["0", "10", "100", "1000", "10000"])
    below.set_ylim(bottom=-1)
    below.minorticks_off()
    below.set_ylabel("$N$ ln(loss/least loss)")
    below.set_xlabel("nk of the model [samples]")
    for panel in (ax, below):
        panel.set_xticks(range(last + 1))
        panel.set_xlim(-0.5, last + 0.5)
    ax.set_xlabel("lag [samples]")
    finish(ax)
    finish(below)
    legend(below)
    return sign(ax, result.source, above=legend(ax))
