"""The result of an estimation: a model, how sure it is, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armrig.data.dataset import Dataset
from armrig.models.free_response import FreeResponse
from armrig.models.responses import FrequencyResponse, NoiseSpectrum, Roots, StepResponse
from armrig.numerics.checks import column, require_integers
from armrig.numerics.polynomial import evaluate, filtered, roots, without_integrator
from armrig.numerics.sensitivity import by_denominator, by_numerator
from armrig.numerics.whiteness import WHITE_LEVEL

if TYPE_CHECKING:
    from os import PathLike

    import control
    from matplotlib.figure import Figure

    from armrig.models.summary import Summary

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Complex = NDArray[np.complex128]


_ORDERS = {
    "arx": ("na", "nb"),
    "iv4": ("na", "nb"),
    "armax": ("na", "nb", "nc"),
    "oe": ("nb", "nf"),
    "bj": ("nb", "nc", "nd", "nf"),
    "pem": ("na", "nb", "nc", "nd", "nf"),
}


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
class Fit:
    """A model A(q) y(t) = B(q)/F(q) u(t) + C(q)/D(q) e(t) with its uncertainty."""

    structure: str
    """"arx", "iv4", "armax", "oe", "bj" or "pem", the general one."""
    A: Vector
    """Coefficients in q^-1, beginning with 1; 1.0 alone where the structure has none."""
    B: Vector
    """Coefficients in q^-1, beginning with nk zeros."""
    C: Vector = field(default_factory=lambda: np.ones(1))
    """As A."""
    D: Vector = field(default_factory=lambda: np.ones(1))
    """As A."""
    F: Vector = field(default_factory=lambda: np.ones(1))
    """As A; with an integrator one of its roots is 1 exactly."""
    nk: int
    """Samples before u reaches y."""
    integrator: bool = False
    """F, or A where there is no F, contains 1 - q^-1 by construction."""
    offset: bool = False
    """The input's offset was estimated along, and is anew from other data."""
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
    Ts: float
    """Sampling time, in s."""
    fit_percent: float
    """100 (1 - |y - ŷ| / |y - mean y|), one step ahead, on the estimation data."""
    whiteness: float
    """p value of white residuals on the estimation data."""
    converged: bool = True
    """The search for the minimum met its tolerance."""
    starts: tuple[Start, ...] = ()
    """Start values and where each led, best first; empty for a closed form."""
    agreed: bool = True
    """All starts led to the same minimum."""
    free: tuple[FreeResponse, ...] = ()
    """Initial state and input offset of each experiment, estimated with theta."""
    warnings: tuple[str, ...] = ()
    """What a reader should know before trusting the numbers."""
    output: str = "y"
    """Name of y."""
    unit: str = ""
    """Unit of y."""
    input_unit: str = ""
    """Unit of u."""
    source: str = ""
    """Hash of the recording identified from, or ""."""
    history: tuple[str, ...] = ()
    """Treatment of the data."""
    digest: str = ""
    """Fingerprint of the estimation data."""

    def __post_init__(self) -> None:
        """Make the arrays as frozen as the rest."""
        for name in ("A", "B", "C", "D", "F", "covariance", "covariance_robust"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def orders(self) -> dict[str, int]:
        """Orders by name: na, nb, nc, nd, nf and nk, those that the structure has."""
        sizes = {"na": self.A.size - 1, "nb": self.B.size - self.nk, "nc": self.C.size - 1}
        sizes |= {"nd": self.D.size - 1, "nf": self.F.size - 1, "nk": self.nk}
        return {name: sizes[name] for name in (*_ORDERS[self.structure], "nk")}

    @property
    def _free_coefficients(self) -> dict[str, Vector]:
        whole = {"a": self.A[1:], "b": self.B[self.nk :], "c": self.C[1:]}
        return whole | {"d": self.D[1:], "f": self.F[1:]}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in the order of theta: a1 …, b1 …, c1 …, d1 …, f1 …."""
        parts = self._free_coefficients.items()
        return tuple(f"{letter}{k + 1}" for letter, p in parts for k in range(p.size))

    @property
    def theta(self) -> Vector:
        """Parameters (d,)."""
        return np.concatenate(list(self._free_coefficients.values()))

    @property
    def std(self) -> Vector:
        """Standard deviations of theta (d,), the classic form."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def std_robust(self) -> Vector:
        """Standard deviations of theta (d,), the sandwich form."""
        return np.sqrt(np.diag(self.covariance_robust))

    @property
    def trusted_covariance(self) -> Matrix:
        """The covariance that the verdict says to trust: robust where residuals are not white.

        It is the one that poles, zeros, frequency and step response carry on.
        """
        return self.covariance_robust if self.whiteness < WHITE_LEVEL else self.covariance

    @property
    def parameters(self) -> int:
        """Number of parameters that were free, nuisance parameters not counted."""
        return int(self.theta.size) - int(self.integrator)

    @property
    def fpe(self) -> float:
        """Akaike's final prediction error, loss (1 + d/N) / (1 - d/N)."""
        share = self.parameters / self.N
        return self.loss * (1 + share) / (1 - share) if share < 1 else float("inf")

    @property
    def aic(self) -> float:
        """Akaike's criterion, -2 log likelihood + 2 d, for Gaussian e."""
        return self._deviance + 2 * self.parameters

    @property
    def mdl(self) -> float:
        """Rissanen's criterion (BIC), -2 log likelihood + d log N, for Gaussian e."""
        return self._deviance + self.parameters * float(np.log(self.N))

    @property
    def _deviance(self) -> float:
        loss = max(self.loss, float(np.finfo(np.float64).tiny))
        return self.N * float(np.log(2 * np.pi * loss) + 1)

    @property
    def denominator(self) -> Vector:
        """A F, whose roots are the poles from u to y."""
        return np.convolve(self.A, self.F)

    @property
    def integrating(self) -> Literal["", "a", "f"]:
        """The polynomial that has the factor 1 - q^-1 by construction: "a", "f" or ""."""
        if not self.integrator:
            return ""
        return "f" if self.F.size > 1 else "a"

    def slice_of(self, letter: str) -> slice:
        """Return where the parameters of one polynomial ("a" … "f") lie in theta."""
        begin = 0
        for name, p in self._free_coefficients.items():
            if name == letter:
                return slice(begin, begin + p.size)
            begin += p.size
        msg = f"{letter!r} is none of a, b, c, d, f"
        raise ValueError(msg)

    def to_control(self) -> control.TransferFunction:
        """Return the model from u to y as a python-control transfer function with dt=Ts."""
        import control

        n = max(self.B.size, self.denominator.size)
        padded = [np.pad(p, (0, n - p.size)) for p in (self.B, self.denominator)]
        return control.tf(*padded, self.Ts, inputs=["u"], outputs=[self.output])

    def poles(self) -> Roots:
        """Return the poles from u to y, those of A before those of F."""
        parts = [self._roots(self.A, "a", 1), self._roots(self.F, "f", 1)]
        return Roots(
            values=np.concatenate([p.values for p in parts]),
            covariance=np.concatenate([p.covariance for p in parts]),
        )

    def zeros(self) -> Roots:
        """Return the zeros from u to y, without those at 0 and infinity that delays make."""
        return self._roots(self.B[self.nk :], "b", 0)

    def _roots(self, p: Vector, letter: str, first: int) -> Roots:
        """Return the roots of p, whose coefficients from `first` on were estimated.

        A root z of p(z) = sum p_k z^(n-k) moves by dz = -z^(n-k) / p'(z) dp_k.
        """
        z = roots(p).astype(np.complex128)
        n = z.size
        if n == 0:
            return Roots(values=z, covariance=np.zeros((0, 2, 2)))
        if letter == self.integrating:
            fixed = np.argmin(np.abs(z - 1))
            z[fixed] = 1.0
        powers = p.size - 1 - np.arange(first, p.size)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = np.polyval(np.polyder(p), z)
            dz = -(z[:, None] ** powers) / slope[:, None]
        if letter == self.integrating:
            dz[fixed] = 0.0
        both = np.stack([dz.real, dz.imag], axis=1)
        part = self.slice_of(letter)
        covariance = both @ self.trusted_covariance[part, part] @ both.transpose(0, 2, 1)
        return Roots(values=z, covariance=covariance)

    def frequency_response(self, omega: ArrayLike) -> FrequencyResponse:
        """Return G at omega (n,) in rad/s, up to the Nyquist frequency pi/Ts.

        With d ln G = dG/G the relative error of |G| is its real part and the error of the phase
        its imaginary part.

        Raises
        ------
        ValueError
            A frequency is outside 0 to pi/Ts.
        """
        omega_ = self._frequencies(omega)
        G, dlnG = self._ratio(omega_, "b", "af")
        with np.errstate(invalid="ignore"):
            relative, phase = (_std(d, self.trusted_covariance) for d in (dlnG.real, dlnG.imag))
            magnitude = np.abs(G) * relative
        return FrequencyResponse(omega=omega_, G=G, std_magnitude=magnitude, std_phase=phase)

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
            relative = np.hypot(2 * _std(dlnH.real, self.trusted_covariance), np.sqrt(2 / self.N))
            std = Phi * relative
        return NoiseSpectrum(omega=omega_, Phi=Phi, std=std)

    def _frequencies(self, omega: ArrayLike) -> Vector:
        omega_ = np.atleast_1d(np.asarray(omega, dtype=np.float64))
        nyquist = np.pi / self.Ts
        if omega_.size and not (omega_.min() >= 0 and omega_.max() <= nyquist * (1 + 1e-9)):
            msg = f"omega from {omega_.min():g} to {omega_.max():g} rad/s is outside 0 to "
            msg += f"{nyquist:g} rad/s (pi/Ts); a sampled model answers nothing beyond"
            raise ValueError(msg)
        return omega_

    def _ratio(self, omega: Vector, above: str, below: str) -> tuple[Complex, Complex]:
        """Return R (n,), a ratio of polynomials at omega, and d ln R by theta (n, d)."""
        x = np.exp(-1j * omega * self.Ts)
        sides = {True: np.ones_like(x), False: np.ones_like(x)}
        dlnR = np.zeros((x.size, self.theta.size), dtype=np.complex128)
        with np.errstate(divide="ignore", invalid="ignore"):
            for letter in above + below:
                p, sign = getattr(self, letter.upper()), 1 if letter in above else -1
                value = evaluate(p, x)
                if letter == self.integrating:  # exact at 0, where a sum of coefficients is not
                    value = (1 - x) * evaluate(without_integrator(p), x)
                sides[letter in above] *= value
                part = self.slice_of(letter)
                lags = (self.nk if letter == "b" else 1) + np.arange(part.stop - part.start)
                dlnR[:, part] = sign * x[:, None] ** lags / value[:, None]
            # One division: that of an infinite complex number by another is not a number.
            R = sides[True] / sides[False]
        return R, dlnR

    def step_response(self, n: int) -> StepResponse:
        """Return the first n samples, n >= 1, of the answer to a unit step from rest."""
        require_integers(n=(n, 1))
        u = np.ones(n)
        return StepResponse(
            t=self.Ts * np.arange(n, dtype=np.float64),
            y=self.simulate(u),
            std=_std(self._sensitivity(u), self.trusted_covariance),
        )

    def _sensitivity(self, u: Vector) -> Matrix:
        """Return (N, d), the derivatives of simulate(u) by theta."""
        y = self.simulate(u)
        J = np.zeros((y.size, self.theta.size))
        J[:, self.slice_of("a")] = by_denominator(y, self.A, self.A.size - 1)
        lags = range(self.nk, self.B.size)
        J[:, self.slice_of("b")] = by_numerator(u, self.denominator, lags)
        J[:, self.slice_of("f")] = by_denominator(y, self.F, self.F.size - 1)
        return J

    def simulate(self, u: ArrayLike) -> Vector:
        """Return the model's output (N,) for the input u (N,), from rest and without noise.

        The model's own u counts from its offset: subtract `free[i].offset` from a raw input where
        an integrator was identified with one.

        Raises
        ------
        ValueError
            u is not (N,).
        """
        return filtered(self.B, self.denominator, column("u", u))

    def predict(self, data: Dataset, horizon: int | None = 1) -> Vector:
        """Return ŷ(t) (N,) from u up to t and y up to t - horizon; None is simulation.

        The initial state is estimated from the data by least squares (with an integrator, or if
        it was with the model, the input offset too); NaN where the past is not yet known: at the
        beginning for a model without C, and with a noise model within `horizon` of a gap.
        """
        from armrig.models.prediction import predicted

        return predicted(self, data, horizon)

    def summary(self) -> Summary:
        """Return poles, zeros, gain, bandwidth and the like with 95 % ranges; print it.

        They are linearised, or by draws of the parameters where that is poor: see
        `armrig.numerics.confidence_regions`.
        """
        from armrig.models.summary import summary

        return summary(self)

    def plot(self) -> Figure:
        """Return a figure of frequency and step response, poles and zeros, with 95 % regions.

        For one of them, for several models and for axes of your own see `armrig.plots`.
        """
        from armrig.models.figures import plot_fit

        return plot_fit(self)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the model as JSON, every number to its last digit; `armrig.load_fit` reads it.

        The file holds the hash of the recording and the treatment of its data, too.
        """
        from armrig.models.model_file import save_fit

        save_fit(self, path)

    def latex(self) -> str:
        """Return the equation with standard deviations as LaTeX, an `aligned` block."""
        from armrig.models.markup import latex

        return latex(self)

    def typst(self) -> str:
        """Return the equation with standard deviations as a block of Typst's mathematics."""
        from armrig.models.markup import typst

        return typst(self)

    def _repr_html_(self) -> str:
        """Show itself in a notebook."""
        from armrig.models.markup import html

        return html(self)

    def __repr__(self) -> str:
        """Say it in a few lines, equation first."""
        from armrig.models.equation import described

        return described(self)


def _std(J: Matrix, covariance: Matrix) -> Vector:
    """Return the standard deviations of J theta, (n,)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", J, covariance, J), 0.0)))
