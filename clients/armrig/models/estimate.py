"""Estimated model with uncertainty, quality on the data and results of the search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from armrig.data.dataset import Dataset
from armrig.data.finding import EstimateFinding
from armrig.models.model import Matrix, Model, Vector, freeze, standard_deviations
from armrig.models.responses import NoiseSpectrum
from armrig.models.structure import FreeResponse
from armrig.models.structure_table import DESCRIBED
from armrig.numerics import criteria
from armrig.numerics.whiteness import Whiteness

MAX_TRUSTED_CURVATURE = 0.5
"""Largest `Estimate.curvature` at which the coefficients' standard deviations are reliable. Up to
this limit the 95 % intervals contain 95 % of the true values (docs/benchmarks.md)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """One start value of the search, and its result."""

    name: str
    """Method that found the start value."""
    loss: float
    """Mean squared residual at the minimum that the search reached."""
    iterations: int
    """Number of steps of the search."""
    converged: bool
    """True if the change of the loss and the scaled gradient are within the tolerance."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Estimate(Model):
    """A model with covariance, loss and search results: a `Fit` without texts and figures."""

    structure: str
    """Name of a `structure_table.RegisteredStructure`, such as "oe"."""
    covariance: Matrix
    """Covariance of theta, lambda (J^T J)^-1; valid if the residuals are white."""
    covariance_robust: Matrix
    """Covariance of theta, sandwich form; also valid if the residuals are coloured."""
    noise_variance: float
    """Estimate of lambda, the variance of e, in the squared unit of y. It is the sum of squared
    residuals divided by its degrees of freedom."""
    loss: float
    """Mean squared residual (one step ahead) on the estimation data, in the squared unit of y."""
    N: int
    """Number of residuals in the loss."""
    fit_percent: float
    """100 (1 - |y - ŷ| / |y - mean y|), one step ahead, on the estimation data."""
    whiteness: float
    """p value of the whiteness test of the residuals on the estimation data."""
    whiteness_test: str = ""
    """Name of the test of whiteness."""
    converged: bool = True
    """True if the search for the minimum converged within its tolerance."""
    starts: tuple[Start, ...] = ()
    """Start values with their results, best first; empty if no search was necessary."""
    agreed: bool = True
    """True if all starts led to the same minimum."""
    curvature: float = 0.0
    """Deviation of the loss from the parabola that `std` assumes. The deviation is |ln r|. The
    ratio r is the rise of the loss divided by the rise of the parabola, both at two standard
    deviations from the minimum. The deviation is 0 for a linear regression and in older files."""
    free: tuple[FreeResponse, ...] = ()
    """Initial state and input offset of each experiment, estimated with theta."""
    findings: tuple[EstimateFinding, ...] = ()
    """Findings about the reliability of the numbers, with codes for programs."""
    source: str = ""
    """Hash of the recording that the model was identified from, or ""."""
    history: tuple[str, ...] = ()
    """Steps of the treatment of the estimation data, in order."""
    digest: str = ""
    """Fingerprint of the estimation data."""

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        Model.__post_init__(self)
        freeze(self, ("covariance", "covariance_robust"))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences of the findings about the reliability of the numbers."""
        return tuple(f.text for f in self.findings)

    @property
    def label(self) -> str:
        """Structure and orders in the shortest form, such as OE[4 4 1]."""
        return DESCRIBED[self.structure].short(self.orders)

    @property
    def heading(self) -> str:
        """Structure, and orders by their names, such as OE(nb=4, nf=4, nk=1)."""
        return DESCRIBED[self.structure].long(self.orders)

    @property
    def orders(self) -> dict[str, int]:
        """Orders of the structure by name: na, nb, nc, nd, nf or order, and nk."""
        sizes = self._sizes | {"order": self.A.size - 1}
        return {name: sizes[name] for name in (*DESCRIBED[self.structure].orders, "nk")}

    @property
    def std(self) -> Vector:
        """Standard deviations of theta (d,), from `covariance`."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def std_robust(self) -> Vector:
        """Standard deviations of theta (d,), from `covariance_robust`."""
        return np.sqrt(np.diag(self.covariance_robust))

    @property
    def white(self) -> Whiteness:
        """Result of the whiteness test; str() returns it as text."""
        return Whiteness(p_value=self.whiteness, test=self.whiteness_test)

    @property
    def trusts_robust(self) -> bool:
        """True if the residuals are coloured, so that only the robust covariance is valid."""
        return self.white.coloured

    @property
    def trusts_coefficients(self) -> bool:
        """True if the standard deviations of the coefficients are valid.

        If False, only the standard deviations of the responses are valid.
        """
        return self.curvature <= MAX_TRUSTED_CURVATURE

    @property
    def trusted_covariance(self) -> Matrix:
        """`covariance_robust` if the residuals are coloured, otherwise `covariance`.

        Poles, zeros, frequency and step response use this covariance.
        """
        return self.covariance_robust if self.trusts_robust else self.covariance

    @property
    def fpe(self) -> float:
        """Akaike's final prediction error, loss (1 + d/N) / (1 - d/N)."""
        return float(criteria.fpe(self.loss, self.parameters, self.N))

    @property
    def aic(self) -> float:
        """Akaike's criterion, -2 log likelihood + 2 d, for Gaussian e."""
        return float(criteria.aic(self.loss, self.parameters, self.N))

    @property
    def mdl(self) -> float:
        """Rissanen's criterion (BIC), -2 log likelihood + d log N, for Gaussian e."""
        return float(criteria.mdl(self.loss, self.parameters, self.N))

    def estimated_from(self, data: Dataset) -> bool:
        """Return whether the model was estimated from these data.

        Examples
        --------
        >>> import armrig
        >>> first, second = armrig.example_recording().dataset("alpha").split(2)
        >>> fit = armrig.oe(first, nb=3, nf=3)
        >>> fit.estimated_from(first), fit.estimated_from(second)
        (True, False)
        """
        return bool(self.digest) and self.digest == data.digest

    def noise_spectrum(self, omega: ArrayLike) -> NoiseSpectrum:
        """Return the power spectrum of C/(A D) e at omega (n,) in rad/s, up to pi/Ts.

        Phi is lambda Ts |C/(A D)|². The variance of the noise is the integral of Phi/(2 pi) from
        -pi/Ts to pi/Ts. The standard deviation of Phi includes the uncertainty of lambda, whose
        variance is 2 lambda²/N.

        Raises
        ------
        ValueError
            A frequency is outside 0 to pi/Ts.

        Examples
        --------
        The noise of an output-error model is white.

        >>> import armrig
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> spectrum = fit.noise_spectrum([1, 10, 100])
        >>> (spectrum.Phi / (fit.noise_variance * fit.Ts)).round(3)
        array([1., 1., 1.])
        """
        omega_ = self._frequencies(omega)
        H, dlnH = self._ratio(omega_, "c", "ad")
        Phi = self.noise_variance * self.Ts * np.abs(H) ** 2
        with np.errstate(invalid="ignore"):
            relative = np.hypot(
                2 * standard_deviations(dlnH.real, self.trusted_covariance), np.sqrt(2 / self.N)
            )
            std = Phi * relative
        return NoiseSpectrum(omega=omega_, Phi=Phi, std=std)
