"""An estimated model: how sure it is, what it fits, and how it was found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from armrig.data.dataset import Dataset
from armrig.data.finding import EstimateFinding
from armrig.models.model import Matrix, Model, Vector, freeze, standard_deviations
from armrig.models.responses import NoiseSpectrum
from armrig.models.structure import FreeResponse
from armrig.models.structure_table import KINDS
from armrig.numerics import criteria
from armrig.numerics.whiteness import Whiteness

MOST_CURVED = 0.5
"""Of `Estimate.curvature`, where deviations of coefficients still cover: 93 % of the true ones in
tests/benchmarks/cancelling.py."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """One start value of the search, and where it led."""

    name: str
    """How the start was found."""
    loss: float
    """Mean squared residual at the minimum reached from it."""
    iterations: int
    """Steps it took."""
    converged: bool
    """Cost and scaled gradient met the tolerance."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Estimate(Model):
    """A model with covariance, loss and search: all of a `Fit` but what it says and draws."""

    structure: str
    """Name of a `structure_table.Kind`, such as "oe"."""
    covariance: Matrix
    """Of theta, lambda (J^T J)^-1; right where the residuals are white."""
    covariance_robust: Matrix
    """Of theta, the sandwich form; also right where they are coloured."""
    noise_variance: float
    """Estimate of lambda, the variance of e, with the degrees of freedom subtracted."""
    loss: float
    """Mean squared residual (one step ahead) on the estimation data."""
    N: int
    """Residuals that the loss was averaged over."""
    fit_percent: float
    """100 (1 - |y - ŷ| / |y - mean y|), one step ahead, on the estimation data."""
    whiteness: float
    """p value of white residuals on the estimation data."""
    whiteness_test: str = ""
    """Name of the test that it is of; "" in files of armrig 0.1."""
    converged: bool = True
    """The search for the minimum met its tolerance."""
    starts: tuple[Start, ...] = ()
    """Start values and where each led, best first; empty for a closed form."""
    agreed: bool = True
    """All starts led to the same minimum."""
    curvature: float = 0.0
    """How far the loss, two deviations away, is from the parabola that `std` takes it for: |ln| of
    the ratio. 0 for a linear regression, and in files of earlier releases."""
    free: tuple[FreeResponse, ...] = ()
    """Initial state and input offset of each experiment, estimated with theta."""
    findings: tuple[EstimateFinding, ...] = ()
    """What a reader should know before trusting the numbers, as values for programs."""
    source: str = ""
    """Hash of the recording identified from, or ""."""
    history: tuple[str, ...] = ()
    """Treatment of the data."""
    digest: str = ""
    """Fingerprint of the estimation data."""

    def __post_init__(self) -> None:
        """Make the arrays as frozen as the rest."""
        Model.__post_init__(self)
        freeze(self, ("covariance", "covariance_robust"))

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader should know before trusting the numbers, a sentence each."""
        return tuple(f.text for f in self.findings)

    @property
    def label(self) -> str:
        """Structure and orders: OE[4 4 1]."""
        return KINDS[self.structure].short(self.orders)

    @property
    def heading(self) -> str:
        """Structure and orders by their names: OE(nb=4, nf=4, nk=1)."""
        return KINDS[self.structure].long(self.orders)

    @property
    def orders(self) -> dict[str, int]:
        """Orders by name: na, nb, nc, nd, nf and nk, those that the structure has."""
        sizes = self._sizes | {"order": self.A.size - 1}
        return {name: sizes[name] for name in (*KINDS[self.structure].orders, "nk")}

    @property
    def std(self) -> Vector:
        """Standard deviations of theta (d,), the classic form."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def std_robust(self) -> Vector:
        """Standard deviations of theta (d,), the sandwich form."""
        return np.sqrt(np.diag(self.covariance_robust))

    @property
    def white(self) -> Whiteness:
        """The test of white residuals; its str says what came out."""
        return Whiteness(p_value=self.whiteness, test=self.whiteness_test)

    @property
    def trusts_robust(self) -> bool:
        """The residuals are not white, and then only the robust covariance holds."""
        return self.white.coloured

    @property
    def trusts_coefficients(self) -> bool:
        """The deviations of the coefficients hold, and not only those of the responses."""
        return self.curvature <= MOST_CURVED

    @property
    def trusted_covariance(self) -> Matrix:
        """The covariance that the verdict says to trust: robust where residuals are not white.

        It is the one that poles, zeros, frequency and step response carry on.
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
        """Tell whether the model was estimated from these very data."""
        return bool(self.digest) and self.digest == data.digest

    def noise_spectrum(self, omega: ArrayLike) -> NoiseSpectrum:
        """Return the power spectrum of C/(A D) e at omega (n,) in rad/s, up to pi/Ts.

        Phi = lambda Ts |C/(A D)|², so that the variance is the integral of Phi/(2 pi) from -pi/Ts
        to pi/Ts. Its deviation allows for the estimated lambda, of variance 2 lambda²/N, too.

        Raises
        ------
        ValueError
            A frequency is outside 0 to pi/Ts.
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
