"""Model with polynomials and responses, without results of an estimation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray

from armrig.models.responses import FrequencyResponse, Roots, StepResponse
from armrig.models.structure_table import named
from armrig.numerics.checks import column, require_integers
from armrig.numerics.polynomial import (
    by_denominator,
    by_numerator,
    evaluate,
    filtered,
    roots,
    without_integrator,
)

if TYPE_CHECKING:
    import control

    from armrig.data.dataset import Dataset

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Complex = NDArray[np.complex128]

_POLYNOMIALS = ("A", "B", "C", "D", "F")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Model:
    """A model A(q) y(t) = B(q)/F(q) u(t) + C(q)/D(q) e(t) without uncertainty.

    A `Fit` is an estimated model with uncertainty.
    """

    A: Vector = field(default_factory=lambda: np.ones(1))
    """Coefficients in q^-1, beginning with 1; the single coefficient 1 if the structure has no
    A."""
    B: Vector
    """Coefficients in q^-1, beginning with nk zeros."""
    C: Vector = field(default_factory=lambda: np.ones(1))
    """Coefficients in q^-1, beginning with 1."""
    D: Vector = field(default_factory=lambda: np.ones(1))
    """Coefficients in q^-1, beginning with 1."""
    F: Vector = field(default_factory=lambda: np.ones(1))
    """Coefficients in q^-1, beginning with 1. One root of F is exactly 1 if F contains the
    integrator."""
    nk: int
    """Number of samples before u affects y."""
    integrator: bool = False
    """True if F, or A if there is no F, has the factor 1 - q^-1 by construction."""
    offset: bool = False
    """True if the input has an unknown offset, which is estimated again from each data set."""
    Ts: float
    """Sampling time, in s."""
    output: str = "y"
    """Name of y."""
    unit: str = ""
    """Unit of y."""
    input_unit: str = ""
    """Unit of u."""

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        freeze(self, _POLYNOMIALS)

    @property
    def label(self) -> str:
        """Name in tables and legends."""
        return "model"

    @property
    def heading(self) -> str:
        """Label and the orders by name."""
        return f"{self.label}({named(self.orders)})"

    @property
    def orders(self) -> dict[str, int]:
        """Orders by name: always nb and nk, and na, nc, nd and nf if they are not 0."""
        return {name: n for name, n in self._sizes.items() if n or name in ("nb", "nk")}

    @property
    def _sizes(self) -> dict[str, int]:
        sizes = {"na": self.A.size - 1, "nb": self.B.size - self.nk, "nc": self.C.size - 1}
        return sizes | {"nd": self.D.size - 1, "nf": self.F.size - 1, "nk": self.nk}

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
    def trusted_covariance(self) -> Matrix:
        """Covariance of theta (d, d), used for all uncertainties; 0 if nothing was estimated."""
        return np.zeros((self.theta.size, self.theta.size))

    @property
    def parameters(self) -> int:
        """Number of free parameters: d, or d - 1 if a root is 1 by construction."""
        return int(self.theta.size) - int(self.integrator)

    def estimated_from(self, data: Dataset) -> bool:
        """Return whether the model was estimated from these data."""
        return False

    @property
    def denominator(self) -> Vector:
        """Product A F, whose roots are the poles from u to y."""
        return np.convolve(self.A, self.F)

    @property
    def integrating(self) -> Literal["", "a", "f"]:
        """Polynomial with the factor 1 - q^-1 by construction: "a", "f" or ""."""
        if not self.integrator:
            return ""
        return "f" if self.F.size > 1 else "a"

    def slice_of(self, letter: str) -> slice:
        """Return the slice of theta with the parameters of one polynomial, "a" … "f".

        Examples
        --------
        >>> import armrig
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> fit.names[fit.slice_of("f")]
        ('f1', 'f2', 'f3')
        >>> fit.theta[fit.slice_of("f")].round(2)
        array([-2.51,  2.11, -0.59])
        """
        begin = 0
        for name, p in self._free_coefficients.items():
            if name == letter:
                return slice(begin, begin + p.size)
            begin += p.size
        raise InputError(f"{letter!r} is none of a, b, c, d, f")

    def to_control(self) -> control.TransferFunction:
        """Return the model from u to y as a python-control transfer function with dt=Ts.

        Examples
        --------
        >>> import armrig
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> G = fit.to_control()
        >>> G.input_labels, G.output_labels, G.dt
        (['u'], ['alpha'], 0.01)
        >>> G.den[0][0].round(2)
        array([ 1.  , -2.51,  2.11, -0.59])
        """
        import control

        n = max(self.B.size, self.denominator.size)
        padded = [np.pad(p, (0, n - p.size)) for p in (self.B, self.denominator)]
        return control.tf(*padded, self.Ts, inputs=["u"], outputs=[self.output])

    def noise_to_control(self) -> control.TransferFunction:
        """Return the noise model H = C / (D A), from e to y, as a transfer function with dt=Ts.

        Examples
        --------
        >>> import armrig
        >>> fit = armrig.armax(armrig.example_recording().dataset("alpha"), na=3, nb=3, nc=3)
        >>> H = fit.noise_to_control()
        >>> H.input_labels, H.output_labels, H.dt
        (['e'], ['alpha'], 0.01)
        >>> H.num[0][0].round(1)
        array([ 1. , -2.5,  2.1, -0.6])
        """
        import control

        D = np.convolve(self.D, self.A)
        n = max(self.C.size, D.size)
        padded = [np.pad(p, (0, n - p.size)) for p in (self.C, D)]
        return control.tf(*padded, self.Ts, inputs=["e"], outputs=[self.output])

    def poles(self) -> Roots:
        """Return the poles from u to y: the roots of A, then the roots of F.

        Examples
        --------
        >>> import armrig
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> fit.poles().values.round(2)
        array([0.91+0.16j, 0.91-0.16j, 0.69+0.j  ])
        >>> fit.poles().std.round(4)
        array([0.0002, 0.0002, 0.0015])
        """
        parts = [self._roots(self.A, "a", 1), self._roots(self.F, "f", 1)]
        return Roots(
            values=np.concatenate([p.values for p in parts]),
            covariance=np.concatenate([p.covariance for p in parts]),
        )

    def zeros(self) -> Roots:
        """Return the zeros from u to y, without the zeros at 0 and at infinity that delays cause.

        Examples
        --------
        The zero at 1 means that alpha is 0 at a constant voltage.

        >>> import armrig
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> fit.zeros().values.round(2)
        array([ 1.  +0.j, -0.92+0.j])
        """
        return self._roots(self.B[self.nk :], "b", 0)

    def _roots(self, p: Vector, letter: str, first: int) -> Roots:
        """Return the roots of p, whose coefficients from `first` on were estimated.

        If p_k changes by dp_k, a root z of p(z) = sum p_k z^(n-k) changes by dz = -z^(n-k) / p'(z)
        dp_k.
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
        moved = both @ _factor(self.trusted_covariance[part, part])
        return Roots(values=z, covariance=moved @ moved.transpose(0, 2, 1))

    def frequency_response(self, omega: ArrayLike) -> FrequencyResponse:
        """Return G at omega (n,) in rad/s, up to the Nyquist frequency pi/Ts.

        The relative error of |G| is the real part of d ln G = dG/G. The error of the phase is the
        imaginary part of d ln G.

        Raises
        ------
        ValueError
            A frequency is outside 0 to pi/Ts.

        Examples
        --------
        The arm resonates near 18 rad/s.

        >>> import armrig
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> response = fit.frequency_response([2, 18, 160])
        >>> abs(response.G).round(3)
        array([0.015, 0.148, 0.003])
        """
        omega_ = self._frequencies(omega)
        G, dlnG = self._ratio(omega_, "b", "af")
        with np.errstate(invalid="ignore"):
            relative, phase = (
                standard_deviations(d, self.trusted_covariance) for d in (dlnG.real, dlnG.imag)
            )
            magnitude = np.abs(G) * relative
        return FrequencyResponse(omega=omega_, G=G, std_magnitude=magnitude, std_phase=phase)

    def _frequencies(self, omega: ArrayLike) -> Vector:
        omega_ = np.atleast_1d(np.asarray(omega, dtype=np.float64))
        nyquist = np.pi / self.Ts
        if omega_.size and not (omega_.min() >= 0 and omega_.max() <= nyquist * (1 + 1e-9)):
            raise InputError(
                f"omega from {omega_.min():g} to {omega_.max():g} rad/s is outside 0 to "
                f"{nyquist:g} rad/s (pi/Ts); a sampled model has no response above pi/Ts"
            )
        return omega_

    def _ratio(self, omega: Vector, above: str, below: str) -> tuple[Complex, Complex]:
        """Return a ratio R of polynomials at omega (n,), and the gradients of ln R (n, d)."""
        x = np.exp(-1j * omega * self.Ts)
        numerator, denominator = np.ones_like(x), np.ones_like(x)
        dlnR = np.zeros((x.size, self.theta.size), dtype=np.complex128)
        with np.errstate(divide="ignore", invalid="ignore"):
            for letter in above:
                value = self._evaluated(letter, x)
                numerator *= value
                dlnR[:, self.slice_of(letter)] = self._slope(letter, x) / value[:, None]
            for letter in below:
                value = self._evaluated(letter, x)
                denominator *= value
                dlnR[:, self.slice_of(letter)] = -self._slope(letter, x) / value[:, None]
            # Divide only once, at the end: the ratio of two infinite complex numbers is NaN.
            R = numerator / denominator
        return R, dlnR

    def _evaluated(self, letter: str, x: Complex) -> Complex:
        """Return a polynomial at x = q^-1, (n,)."""
        p = self.polynomial(letter)
        if letter == self.integrating:  # exact at omega = 0, unlike a sum of coefficients
            return np.asarray((1 - x) * evaluate(without_integrator(p), x))
        return np.asarray(evaluate(p, x))

    def _slope(self, letter: str, x: Complex) -> Complex:
        """Return the derivatives of a polynomial at x with respect to its parameters, (n, k)."""
        part = self.slice_of(letter)
        lags = (self.nk if letter == "b" else 1) + np.arange(part.stop - part.start)
        return np.asarray(x[:, None] ** lags)

    def polynomial(self, letter: str) -> Vector:
        """Return the coefficients of one polynomial, "a" … "f", beginning with q^0.

        Examples
        --------
        >>> import armrig
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> fit.polynomial("f").round(2)
        array([ 1.  , -2.51,  2.11, -0.59])
        """
        p: Vector = getattr(self, letter.upper())
        return p

    def step_response(self, n: int, *, rate: bool = False) -> StepResponse:
        """Return the first n samples, n >= 1, of the response to a unit step from rest.

        If `rate` is True, the response is the rate (y(t) - y(t-1))/Ts, at the middle of each
        sampling interval. Use `rate` for an integrating output, whose step response is a ramp.

        Examples
        --------
        >>> import armrig
        >>> data = armrig.example_recording().dataset("theta_1")
        >>> fit = armrig.oe(data, nb=4, nf=4, integrator=True)
        >>> response = fit.step_response(100, rate=True)
        >>> print(f"{response.y[-1]:.2f} rad/s per V")
        1.86 rad/s per V
        """
        require_integers(n=(n, 1))
        u = np.ones(n)
        if rate:
            u = np.zeros(n + 1)
            u[0] = 1 / self.Ts
        at = slice(int(rate), None)
        return StepResponse(
            t=self.Ts * (np.arange(u.size, dtype=np.float64) - 0.5 * rate)[at],
            y=self.simulate(u)[at],
            std=standard_deviations(self._sensitivity(u), self.trusted_covariance)[at],
            rate=rate,
        )

    def _sensitivity(self, u: Vector) -> Matrix:
        """Return the derivatives of simulate(u) with respect to theta, (N, d)."""
        y = self.simulate(u)
        J = np.zeros((y.size, self.theta.size))
        J[:, self.slice_of("a")] = by_denominator(y, self.A, self.A.size - 1)
        lags = range(self.nk, self.B.size)
        J[:, self.slice_of("b")] = by_numerator(u, self.denominator, lags)
        J[:, self.slice_of("f")] = by_denominator(y, self.F, self.F.size - 1)
        return J

    def simulate(self, u: ArrayLike) -> Vector:
        """Return the model's output (N,) for the input u (N,), from rest and without noise.

        u must not contain the input offset. If the offset was estimated, subtract `free[i].offset`,
        the offset of experiment i, from the measured input.

        u has the sampling time `Ts`. For a model of detrended data, first subtract the mean of the
        estimation data's input from u. Add the mean of the output to the result, unless the output
        integrates. `Dataset.trends` contains both means.

        Raises
        ------
        ValueError
            u is not (N,).

        Examples
        --------
        >>> import armrig, numpy as np
        >>> fit = armrig.oe(armrig.example_recording().dataset("alpha"), nb=3, nf=3)
        >>> alpha = fit.simulate(4.0 * np.ones(200))
        >>> print(f"largest {abs(alpha).max():.2f} rad, at the end {abs(alpha[-1]):.2f} rad")
        largest 0.29 rad, at the end 0.00 rad
        """
        return filtered(self.B, self.denominator, column("u", u))


def freeze(value: Any, names: tuple[str, ...]) -> None:
    """Replace the fields `names` of a dataclass by read-only arrays of numbers."""
    for name in names:
        array = np.array(getattr(value, name), dtype=np.float64)
        array.flags.writeable = False
        object.__setattr__(value, name, array)


def standard_deviations(J: Matrix, covariance: Matrix) -> Vector:
    """Return the standard deviations of J theta, (n,)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", J, covariance, J), 0.0)))


def _factor(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a factor L of the covariance C = L L'; NaN if C is not known.

    A variance from J L L' J' is never negative. If roots nearly coincide, a variance from J C J'
    can be negative by rounding.
    """
    if not np.isfinite(covariance).all():
        return np.full_like(covariance, np.nan)
    variances, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(variances, 0.0)))
