"""Impulse response from any input: by least squares, or with a prior for a decaying response."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset, OfDataset, labels
from armrig.data.step import loop_notes, with_notes
from armrig.data.treatment.integrating import integration
from armrig.estimation.nonparametric.kernels import (
    KERNELS,
    Evidence,
    FirRegression,
    Kernel,
    Posterior,
    regression,
)
from armrig.models.responses import StepResponse
from armrig.models.spectral_estimate import SpectralEstimate
from armrig.numerics.checks import column, require_integers
from armrig.numerics.covariance import exogenous_score_in_blocks
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import summation
from armrig.numerics.quantities import digits, plural
from armrig.numerics.rounding import without_rounding
from armrig.numerics.whiteness import (
    LJUNG_BOX,
    Whiteness,
    autoregression,
    default_lags,
    join_residuals,
    ljung_box,
    two_sided,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

MAX_PLAIN_LAGS, MAX_REGULARISED_LAGS = 70, 100
"""Largest default number of lags, without and with a kernel."""
MAX_LAST_VARIANCE_SHARE = 0.05
"""A response is long enough if the prior variance at its last lag is below this share of the
prior's scale."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ImpulseResponse(OfDataset):
    """Coefficients g(k) of y(t) = sum of g(k) u(t - k), with their uncertainty."""

    lags: NDArray[np.int_]
    """Lags 0 … n - 1, in samples."""
    g: Vector
    """Coefficients at `lags`, in units of y per unit of u."""
    covariance: Matrix
    """Covariance of g."""
    rate: Vector | None
    """Response of the rate (y(t) - y(t-1))/Ts if y integrates; g is Ts times the sum of `rate`."""
    rate_covariance: Matrix | None
    """Covariance of `rate`."""
    kernel: str | None
    """Name of the kernel: "tc", "dc" or "ss"; None for least squares."""
    hyperparameters: dict[str, float]
    """Hyperparameters of the prior; empty without a prior."""
    noise_variance: float
    """Variance of the noise: sum of squared residuals divided by their degrees of freedom."""
    whiteness: float
    """p value of the Ljung-Box test of whiteness of the residuals."""
    N: int
    """Number of samples used."""
    warnings: tuple[str, ...]
    """Warnings about the reliability of the numbers."""

    @property
    def std(self) -> Vector:
        """Standard deviations of g; with a kernel, the standard deviations of the posterior."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def integrator(self) -> bool:
        """True if the output was treated as integrating."""
        return self.rate is not None

    @property
    def died_out(self) -> bool:
        """True if the last tenth of the response (of the rate if y integrates) is about 0."""
        return has_decayed(*with_covariance(self))

    @property
    def band_name(self) -> str:
        """Name of the band: confidence, or Bayesian."""
        return "confidence" if self.kernel is None else "Bayesian (credible)"

    @property
    def decaying(self) -> tuple[Vector, Vector]:
        """Decaying response and its standard deviations: `rate` if y integrates, otherwise g."""
        g, covariance = with_covariance(self)
        return g, np.sqrt(np.maximum(np.diag(covariance), 0.0))

    def band(self, level: float = 0.95) -> Vector:
        """Return the half width of the band of g at each lag, for a level between 0 and 1."""
        return two_sided(level) * self.std

    def significant(self, level: float = 0.99) -> NDArray[np.int_]:
        """Return the lags at which 0 is outside the band of g (of `rate` if y integrates)."""
        g, std = self.decaying
        return np.asarray(self.lags[np.abs(g) > two_sided(level) * std])

    def first_lag(self, level: float = 0.99) -> int | None:
        """Return the first significant lag, or None."""
        return next(iter(self.significant(level).tolist()), None)

    def step_response(self) -> StepResponse:
        """Return the response to a unit step: the running sum of g(0), g(1), …."""
        S = np.tri(self.g.size)
        return StepResponse(
            t=self.Ts * np.arange(self.g.size, dtype=np.float64),
            y=S @ self.g,
            std=np.sqrt(np.maximum(np.diag(S @ self.covariance @ S.T), 0.0)),
        )

    def spectrum(self, omega: ArrayLike) -> SpectralEstimate:
        """Return the Fourier transform of g at omega (n,) in rad/s, with standard deviations."""
        w = column("omega", np.atleast_1d(omega))
        g, covariance = with_covariance(self)
        turn = np.exp(-1j * np.outer(w, self.lags) * self.Ts)
        G = turn @ g
        along = turn * np.exp(-1j * np.angle(G))[:, None]
        magnitude, across = (
            np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", d, covariance, d), 0.0))
            for d in (along.real, along.imag)
        )
        S = summation(w, self.Ts) if self.integrator else np.ones(w.size, dtype=np.complex128)
        with np.errstate(divide="ignore", invalid="ignore"):
            return SpectralEstimate(
                omega=w,
                G=G * S,
                std_magnitude=magnitude * np.abs(S),
                std_phase=across / np.abs(G),
                method=f"transform of an impulse response ({self.kernel or 'least squares'})",
                integrator=self.integrator,
                N=self.N,
                **labels(self),
            )

    def plot(self, *, level: float = 0.99, ax: Axes | None = None) -> Figure:
        """Return the figure drawn by `armrig.plots.plot_impulse`: g and its band about 0."""
        from armrig.estimation.figures import plot_impulse
        from armrig.plots.layout import figure_of

        return figure_of(plot_impulse(self, level=level, ax=ax))

    @property
    def white(self) -> Whiteness:
        """Result of the whiteness test; str() returns it as text."""
        return Whiteness(p_value=self.whiteness, test=LJUNG_BOX)

    def __repr__(self) -> str:
        """Return the result as a few lines of text."""
        how = "plain least squares" if self.kernel is None else f"regularised, {self.kernel}"
        title = f"impulse response of {self.output}, lags 0 … {self.lags[-1]}, Ts {self.Ts:g} s"
        lines = [f"{title} ({how}; {plural(self.N, 'sample')})"]
        if self.hyperparameters:
            values = ", ".join(f"{k} {v:.4g}" for k, v in self.hyperparameters.items())
            lines.append(f"  prior: {values}")
        if self.integrator:
            lines.append("  y integrates: the response of its rate was estimated, then integrated")
        g, std = self.decaying
        k = int(np.argmax(np.abs(g)))
        name = "rate's largest" if self.integrator else "largest"
        lines.append(
            f"  {name} coefficient {g[k]:.4g} ± {digits(std[k], 2)} at lag {self.lags[k]}; the "
            f"first outside its 99 % {self.band_name} band is at lag {self.first_lag()}"
        )
        lines.append(f"  residuals: variance {self.noise_variance:.4g}, {self.white}")
        return with_notes(lines, self.warnings, "warning")


@takes_recordings
def impulse_response(
    data: Dataset,
    n: int | None = None,
    kernel: Kernel | None = "tc",
    *,
    integrator: bool | None = None,
) -> ImpulseResponse:
    """Estimate g in y(t) = c + sum over k = 0 … n-1 of g(k) u(t - k) + v(t).

    Each experiment has its own level c. A row of the regression is used only if its y is valid and
    all its inputs are inside the experiment.

    With kernel=None the method is least squares by QR, with a confidence band. The covariance of g
    is P M P, with P = (Phi^T Phi)^-1 and M = Phi^T R Phi. R is the covariance of an autoregression
    that is fitted to the residuals. AIC selects the order of this autoregression. For order 0 the
    covariance of g has the classic form sigma² P. If u does not depend on v, the band is valid for
    coloured output noise too.

    With a kernel, the coefficients g(0), g(1), … have the Gaussian prior N(0, s P(lambda)) with the
    scale s. The hyperparameters and sigma² maximise the marginal likelihood, and g is the posterior
    mean. The band is then Bayesian (credible). For white v the coverage of this band is correct on
    average over systems drawn from the prior, but not for each system.

    If y integrates, g does not decay. Then the response of the rate is estimated, with the running
    sums of u as regressors and the measured y as output. Each experiment has a level and a ramp. g
    is Ts times the running sum of the response of the rate.

    Parameters
    ----------
    data : Dataset
        N samples; missing samples and several experiments are allowed.
    n : int, optional
        Number of lags 0 … n - 1. The default is a fifth of N, at most 100. With kernel=None the
        default is a tenth of N, at most 70.
    kernel : {"tc", "dc", "ss", None}
        Kernel: tuned/correlated, diagonal/correlated or stable spline; None for least squares.
    integrator : bool, optional
        As in `etfe`.

    Returns
    -------
    ImpulseResponse
        `lags`, `g` and `std`, (n,), with g in units of y per unit of u.

    Raises
    ------
    ValueError
        There are too few samples for the lags, the kernel is unknown, or u excites too few
        frequencies.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 4.2 and 6.1.
    .. [2] T. Chen, H. Ohlsson, L. Ljung, Automatica 48 (2012) 1525-1535.

    Examples
    --------
    >>> response = armrig.impulse_response(armrig.example_recording().dataset("alpha"))
    >>> peak = abs(response.g).argmax()
    >>> print(f"lag {response.lags[peak]}: {response.g[peak]:.4f} ± {response.std[peak]:.4f} rad/V")
    lag 4: -0.0127 ± 0.0001 rad/V
    """
    if kernel is not None and kernel not in KERNELS:
        raise InputError(
            f"kernel={kernel!r} must be one of {', '.join(map(repr, KERNELS))}, or None"
        )
    if np.ptp(data.u) == 0:
        raise InputError("u is constant: it determines no response; record an input that varies")
    decided = integration(data, integrator)
    integrates = decided.integrates
    if n is None:
        share, most = (10, MAX_PLAIN_LAGS) if kernel is None else (5, MAX_REGULARISED_LAGS)
        n = max(2, min((data.N - data.missing) // share, most))
    require_integers(n=(n, 1))
    # A fifth more lags are estimated and then dropped. Without these extra lags the last
    # coefficients would include the effect of all later lags, because running sums at neighbouring
    # lags are similar.
    asked = n + 1 + n // 5 if kernel is None and integrates else n
    rows = regression(data, asked, integrator=integrates)
    needed = max((asked if kernel is None else 0) + rows.nuisance + 2, 3)
    if needed > rows.N:
        raise InputError(
            f"n={n} needs at least {plural(needed, 'row')} with all inputs known, got {rows.N} of "
            f"{plural(data.N, 'sample')}; lower the number of lags"
        )
    estimate = _plain(rows) if kernel is None else _regularise(rows, kernel)
    response = _response(data, rows, n, estimate, kernel, integrates=integrates)
    notes = (*loop_notes(data.history), *decided.notes)
    return replace(response, warnings=(*notes, *response.warnings))


def _response(
    data: Dataset,
    rows: FirRegression,
    n: int,
    estimate: Posterior,
    kernel: Kernel | None,
    *,
    integrates: bool,
) -> ImpulseResponse:
    """Return the response with a whiteness test; a response of the rate is also integrated."""
    g, covariance = estimate.g, estimate.covariance
    e = without_rounding(rows.residuals(g), rows.rounding)
    p = ljung_box(join_residuals(e, 40), default_lags(rows.N))
    white = Whiteness(p_value=p, test=LJUNG_BOX)
    g, covariance = g[:n], covariance[:n, :n]
    S = data.Ts * np.tri(n)
    return ImpulseResponse(
        lags=np.arange(n),
        g=S @ g if integrates else g,
        covariance=S @ covariance @ S.T if integrates else covariance,
        rate=g if integrates else None,
        rate_covariance=covariance if integrates else None,
        kernel=kernel,
        hyperparameters=estimate.hyperparameters,
        noise_variance=estimate.noise_variance,
        whiteness=p,
        N=rows.N,
        **labels(data),
        warnings=tuple(_warnings(g, covariance, kernel, white)),
    )


def long_enough(data: Dataset, lags: tuple[int, ...], *, integrator: bool) -> ImpulseResponse:
    """Return the regularised response for the first number of lags in `lags` that is large enough.

    A number is large enough if the response and the prior have decayed at the last lag.

    If no number is large enough, the result is the response whose prior has decayed most. The
    spectrum of a truncated response has ripples with the period 2 pi/(n Ts) rad/s. The standard
    deviations do not include these ripples. `has_decayed` alone does not detect a truncation,
    because the band is wide.
    """

    def left(response: ImpulseResponse) -> tuple[bool, float]:
        share = float(response.hyperparameters["decay"] ** response.lags.size)
        return not response.died_out, share

    most = max((data.N - data.missing) // 5, 2)
    tried: list[ImpulseResponse] = []
    for n in dict.fromkeys(min(n, most) for n in lags):
        tried.append(impulse_response(data, n, integrator=integrator))
        if left(tried[-1]) < (False, MAX_LAST_VARIANCE_SHARE):
            break
    return min(tried, key=left)


def with_covariance(response: ImpulseResponse) -> tuple[Vector, Matrix]:
    """Return the decaying response and its covariance: of the rate if y integrates."""
    if response.rate is None or response.rate_covariance is None:
        return response.g, response.covariance
    return response.rate, response.rate_covariance


def has_decayed(g: Vector, covariance: Matrix) -> bool:
    """Return True if |mean of the last tenth of g| is at most 4 std or at most 2 % of max |g|."""
    tail = max(1, g.size // 10)
    mean = np.full(tail, 1 / tail)
    std = float(np.sqrt(max(mean @ covariance[-tail:, -tail:] @ mean, 0.0)))
    return bool(abs(mean @ g[-tail:]) <= max(4 * std, 0.02 * float(np.max(np.abs(g)))))


def _plain(rows: FirRegression) -> Posterior:
    """Return the least-squares estimate, computed from the triangular factor of [Phi y]."""
    R = rows.triangle()
    d = R.shape[0] - 1
    basis = orthonormal(R[:, :d])
    if basis.rank < d:
        raise InputError(
            f"u determines only {basis.rank} of {d} lags, because u has too few frequencies; "
            "excite with a richer input (telegraph, PRBS), or use a kernel with fewer lags"
        )
    g = basis.coefficients(R[:, d])
    degrees = rows.N - d - rows.nuisance
    noise = autoregression(rows.residuals(g), least=rows.rounding)
    middle = exogenous_score_in_blocks(rows.backwards(), noise, d) * rows.N / degrees
    bread = basis.W @ basis.W.T
    variance = max(float(R[d, d] ** 2) / degrees, rows.rounding**2)
    covariance = bread @ middle @ bread
    return Posterior(g=g, covariance=covariance, noise_variance=variance, hyperparameters={})


def _regularise(rows: FirRegression, kernel: Kernel) -> Posterior:
    R = rows.triangle()
    d = R.shape[0] - 1
    return Evidence(
        kernel=kernel,
        R=R[:d, :d],
        r=R[:d, d],
        rest=max(float(R[d, d] ** 2), rows.N * rows.rounding**2),
        M=rows.N - rows.nuisance,
    ).posterior()


def _warnings(
    g: Vector, covariance: Matrix, kernel: Literal["tc", "dc", "ss"] | None, white: Whiteness
) -> Iterator[str]:
    if not has_decayed(g, covariance):
        yield "the response has not decayed at the last lags: give more lags (n)"
    if kernel is not None and white.coloured:
        yield (
            f"the residuals are {white} and the Bayesian band assumes white noise; "
            "kernel=None has a band for coloured noise"
        )
