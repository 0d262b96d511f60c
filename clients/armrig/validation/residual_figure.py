"""Figure of a test of residuals: autocorrelation, and correlation with the input, with bands."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from armrig.numerics.quantities import NBSP, p_relation
from armrig.numerics.whiteness import WHITE_LEVEL, Whiteness
from armrig.plots.captions import legend, sign
from armrig.plots.layout import BLUE, GREY, VERMILION, finish, panels, stems

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.validation.residuals import ResidualTest

BAND_99_PERCENT = 2.58
"""Two-sided 99 % quantile of the normal distribution."""
BAND = "99 % band of each lag"
_JOINT = f"joint test, level {100 * WHITE_LEVEL:g}{NBSP}%"


def plot_residual_test(test: ResidualTest, *, ax: Axes | None = None) -> Axes:
    """Show the autocorrelation of the residuals; below, their correlation with the input.

    If the residuals are white, the value at each lag is inside the upper band with a probability of
    99 %. If the residuals are independent of the input, the value at each lag is inside the lower
    band with a probability of 99 %. On average one of 100 values is outside its band by chance, so
    a test of all lags together decides. A correlation at negative lags indicates feedback. A
    correlation at positive lags indicates missing dynamics.
    """
    ax, below = panels(ax, 0.5, sharex=False)
    shade: dict[str, Any] = {"color": GREY, "alpha": 0.25, "lw": 0, "label": BAND}
    ax.axhspan(-test.autocorrelation_band, test.autocorrelation_band, **shade)
    stems(ax, test.lags[1:], test.autocorrelation[1:], BLUE)
    ax.set_ylabel("$r_e$(lag)")
    band = BAND_99_PERCENT * test.cross_std
    below.fill_between(test.cross_lags, -band, band, step="mid", **shade)
    stems(below, test.cross_lags, test.cross_correlation, VERMILION)
    below.axvline(-0.5, color=GREY, lw=0.6, ls=":")
    below.set_ylabel("$r_{eu}$(lag)")
    for panel in (ax, below):
        panel.set_xlabel("lag [samples]")
    for panel, values, width in (
        (ax, test.autocorrelation[1:], test.autocorrelation_band),
        (below, test.cross_correlation, float(np.nanmax(band, initial=0.0))),
    ):
        reach = 1.15 * max(float(np.nanmax(np.abs(values), initial=0.0)), width, 1e-12)
        panel.set_ylim(-reach, reach)
    finish(ax)
    finish(below)
    legend(
        below,
        f"no feedback: {_p(test.feedback)}; no dynamics missing: {_p(test.missing_dynamics)} "
        f"({_JOINT})",
    )
    return sign(ax, test.source, above=legend(ax, _verdict(test.white)))


def _verdict(found: Whiteness) -> str:
    """Return whether the residuals are white, with the p value and the level, as text."""
    if np.isnan(found.p_value):
        return f"residuals {found}"
    verdict = "coloured" if found.coloured else "white"
    return f"residuals {verdict}: {_p(found.p_value)} ({_JOINT})"


def _p(p: float) -> str:
    return f"p {p_relation(p)}".replace(" ", NBSP)
