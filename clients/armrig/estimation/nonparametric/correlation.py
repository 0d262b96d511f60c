"""Correlation analysis: impulse response from the correlation of y with the whitened input."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset, OfDataset, labels
from armrig.data.step import loop_notes, with_notes
from armrig.data.treatment import difference
from armrig.data.treatment.integrating import integration
from armrig.numerics.checks import require_integers
from armrig.numerics.polynomial import apply_filter
from armrig.numerics.quantities import digits, plural
from armrig.numerics.whiteness import autoregression, join_residuals, two_sided

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Correlation(OfDataset):
    """Impulse response by correlation analysis."""

    lags: NDArray[np.int_]
    """Lags -L … L; at a positive lag u is earlier than y."""
    g: Vector
    """Impulse response R_yu(lag)/R_u(0) of the whitened signals, in units of y per unit of u."""
    std: float
    """Standard deviation of g at each lag under the hypothesis that y and u are not related."""
    autocorrelation: Vector
    """Autocorrelation of the whitened input at `lags`: 1 at lag 0, small at the other lags."""
    whitener: Vector
    """Coefficients in q^-1 of the filter L(q) that whitens u, beginning with 1."""
    rate: bool
    """True if y is the rate of an integrating output."""
    N: int
    """Number of samples used."""
    notes: tuple[str, ...] = ()
    """Notes on the reliability of the estimate."""

    def band(self, level: float = 0.99) -> float:
        """Return the half width of the band that contains g if y and u are not related."""
        return two_sided(level) * self.std

    def plot(self, *, level: float = 0.99, ax: Axes | None = None) -> Figure:
        """Return the figure drawn by `armrig.plots.plot_correlation`: g and its band."""
        from armrig.estimation.figures import plot_correlation
        from armrig.plots.layout import figure_of

        return figure_of(plot_correlation(self, level=level, ax=ax))

    def __repr__(self) -> str:
        """Return the result as a few lines of text."""
        band, positive = self.band(), self.lags >= 0
        outside = self.lags[np.abs(self.g) > band]
        first = next((int(k) for k in outside if k >= 0), None)
        k = int(np.argmax(np.where(positive, np.abs(self.g), -1.0)))
        before = int(np.count_nonzero(outside < 0))
        lines = [
            f"correlation analysis of {self.output}, {plural(self.N, 'sample')} at {self.Ts:g} s, "
            f"input whitened by order {self.whitener.size - 1}",
            f"  largest g {self.g[k]:.4g} at lag {self.lags[k]}; 99 % band of no relation "
            f"±{digits(band, 3)}",
            f"  first lag >= 0 outside: {first}; {before} of "
            f"{plural(np.count_nonzero(~positive), 'negative lag')}"
            " outside (feedback, if more than chance)",
        ]
        return with_notes(lines, self.notes, "note")


@takes_recordings
def correlation(data: Dataset, lags: int = 20, *, integrator: bool | None = None) -> Correlation:
    """Estimate the impulse response by correlating y with u after whitening u.

    Both signals are filtered by L(q), an autoregression fitted to u, with the order that has the
    least AIC. Then ::

        g(k) = R_yu(k) / R_u(0)

    If y and u are not related, the standard deviation of g is sqrt(sum over j of R_y(j) R_u(j) / N)
    / R_u(0). For a white u the standard deviation is sqrt(R_y(0)/(N R_u(0))). The band shows only
    whether y and u are related. The confidence band of g itself is computed by `impulse_response`.

    Parameters
    ----------
    data : Dataset
        N samples; missing samples and several experiments are allowed.
    lags : int, default 20
        Largest lag L, >= 1.
    integrator : bool, optional
        As in `etfe`. If y integrates, the rate of y is analysed.

    Returns
    -------
    Correlation
        `lags` and `g`, (2 L + 1,); g is the response of the rate if y integrates.

    Raises
    ------
    ValueError
        u is constant, or there are too few samples for the lags.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 6.1.
    .. [2] G. E. P. Box, G. M. Jenkins, *Time Series Analysis*, 1976, section 11.2.

    Examples
    --------
    >>> print(armrig.correlation(armrig.example_recording().dataset("alpha")))
    correlation analysis of alpha, 2999 samples at 0.01 s, input whitened by order 1
      largest g -0.011... at lag 4; 99 % band of no relation ±0.0015...
      first lag >= 0 outside: 1; 0 of 20 negative lags outside (feedback, if more than chance)
    """
    require_integers(lags=(lags, 1))
    if np.ptp(data.u) == 0:
        raise InputError("u is constant and has no correlation; record an input that varies")
    decided = integration(data, integrator)
    integrates = decided.integrates
    treated = difference(data) if integrates else data
    parts = list(treated.experiments())
    L, _ = autoregression([part.u - np.mean(part.u) for part in parts])
    gap = max(lags, 40)
    u = join_residuals((_whiten(part.u, L) for part in parts), gap)
    y = join_residuals((_whiten(part.y, L) for part in parts), gap)
    R_yu, pairs = _cross_means(y, u, lags)
    R_uu, _ = _cross_means(u, u, gap)
    R_yy, _ = _cross_means(y, y, gap)
    if pairs.min() < 10:
        raise InputError(
            f"lags={lags} leaves {plural(int(pairs.min()), 'pair')} of samples at a lag, 10 are "
            "needed: lower lags"
        )
    N = int(np.count_nonzero(np.isfinite(y)))
    # Bartlett's window keeps the sum from being negative.
    P = float(np.sum(R_yy * R_uu * (1 - np.abs(np.arange(-gap, gap + 1)) / (gap + 1)) ** 2))
    return Correlation(
        lags=np.arange(-lags, lags + 1),
        g=R_yu / R_uu[gap],
        std=sqrt(max(P, 0.0) / N) / float(R_uu[gap]),
        autocorrelation=R_uu[gap - lags : gap + lags + 1] / R_uu[gap],
        whitener=L,
        rate=integrates,
        N=N,
        **labels(treated),
        notes=(*loop_notes(data.history), *decided.notes),
    )


def _whiten(x: Vector, L: Vector) -> Vector:
    """Return x minus its mean, filtered by L(q); NaN where L needs an unknown sample."""
    y = apply_filter(L, [1.0], x - np.nanmean(x))
    y[: L.size - 1] = np.nan
    return y


def _cross_means(y: Vector, u: Vector, L: int) -> tuple[Vector, Vector]:
    """Return the means of y(t + k) u(t), k = -L … L, over known pairs, and the numbers of pairs."""
    means: list[float] = []
    counts: list[int] = []
    for k in range(-L, L + 1):
        a, b = (y[k:], u[: u.size - k]) if k >= 0 else (y[:k], u[-k:])
        product = a * b
        there = np.isfinite(product)
        counts.append(int(np.count_nonzero(there)))
        means.append(float(np.sum(product[there])) / max(counts[-1], 1))
    return np.array(means), np.array(counts, dtype=np.float64)
