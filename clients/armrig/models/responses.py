"""Roots and responses of one channel, with standard deviations by linearisation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray

from armrig.models.state_space import Complex, Matrix, Vector
from armrig.models.transfer_function import TransferFunction
from armrig.numerics.polynomial import (
    by_denominator,
    by_numerator,
    evaluate,
    roots,
    without_integrator,
)
from armrig.numerics.quantities import digits

if TYPE_CHECKING:
    from armrig.models.fit import Fit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Roots:
    """Poles or zeros with their covariance; numpy.asarray returns the complex values."""

    values: Complex
    """Roots in the z plane, or in the s plane in 1/s for a model in continuous time, (n,)."""
    covariance: NDArray[np.float64]
    """Covariance of (real, imaginary part) of each root, (n, 2, 2)."""

    @property
    def std(self) -> Vector:
        """Spread in the complex plane, (n,): the square root of the trace of the covariance."""
        return np.asarray(np.sqrt(np.trace(self.covariance, axis1=1, axis2=2)))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the values as a plain array."""
        return np.array(self.values, dtype=dtype)

    def __iter__(self) -> Iterator[complex]:
        """Iterate over the values."""
        return iter(self.values.tolist())

    def __len__(self) -> int:
        """Return the number of roots."""
        return int(self.values.size)

    def __getitem__(self, i: int) -> complex:
        """Return root number i."""
        return complex(self.values[i])

    def __repr__(self) -> str:
        """Return a table of the roots: real and imaginary part with ±, modulus and angle."""
        if not len(self):
            return "no roots"
        lines = [f"{'real':>10} {'±':>8}  {'imaginary':>10} {'±':>8}  {'modulus':>8} {'angle':>7}"]
        with np.errstate(invalid="ignore"):
            parts = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        for z, (re, im) in zip(self, parts, strict=True):
            lines.append(
                f"{z.real:10.5f} {digits(re, 2):>8}  {z.imag:10.5f} {digits(im, 2):>8}  "
                f"{abs(z):8.5f} {np.angle(z):7.3f}"
            )
        return "\n".join(lines)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrequencyResponse:
    """Frequency response G(exp(i omega Ts)) with standard deviations by linearisation."""

    omega: Vector
    """Frequencies in rad/s, (n,)."""
    G: Complex
    """Response, (n,), in units of y per unit of u."""
    std_magnitude: Vector
    """Standard deviation of |G|, (n,)."""
    std_phase: Vector
    """Standard deviation of arg G, (n,), in rad."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseSpectrum:
    """Power spectrum of the model's noise with standard deviations by linearisation."""

    omega: Vector
    """Frequencies in rad/s, (n,)."""
    Phi: Vector
    """Power density, (n,), in (unit of y)² s."""
    std: Vector
    """Standard deviation of Phi, (n,)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StepResponse:
    """Response to a unit step at t = 0, with standard deviations by linearisation."""

    t: Vector
    """Time in s, (n,)."""
    y: Vector
    """Output, (n,)."""
    std: Vector
    """Standard deviation of y, (n,)."""
    rate: bool = False
    """True if y is the rate of the output, in units of the output per s."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the output as a plain array."""
        return np.array(self.y, dtype=dtype)


def polynomial_roots(model: Fit, letter: str) -> Roots:
    """Return the roots of one polynomial; for "b" without the zeros at 0 and at infinity."""
    z, dz = root_derivatives(model, letter)
    if z.size == 0:
        return Roots(values=z, covariance=np.zeros((0, 2, 2)))
    both = np.stack([dz.real, dz.imag], axis=1)
    part = model.slice_of(letter)
    with np.errstate(invalid="ignore"):  # a double root has no derivative, and a covariance of NaN
        moved = both @ _factor(model.trusted_covariance[part, part])
        return Roots(values=z, covariance=moved @ moved.transpose(0, 2, 1))


def root_derivatives(model: Fit, letter: str) -> tuple[Complex, Complex]:
    """Return the roots of one polynomial, and their derivatives (n, k) by its k parameters.

    If p_k changes by dp_k, a root z of p(z) = sum p_k z^(n-k) changes by dz = -z^(n-k) / p'(z)
    dp_k. A root of an integrator does not change. A polynomial in s has the same form.
    """
    first = int(letter != "b")
    p = model.polynomial(letter)[0 if first else model.nk :]
    z = roots(p).astype(np.complex128)
    if z.size == 0:
        return z, np.zeros((0, p.size - first), dtype=np.complex128)
    powers = p.size - 1 - np.arange(first, p.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        if letter == model.integrating:
            root = 1.0 if model.Ts else 0.0
            fixed = np.argmin(np.abs(z - root))
            z[fixed] = root
        dz = -(z[:, None] ** powers) / np.polyval(np.polyder(p), z)[:, None]
    if letter == model.integrating:
        dz[fixed] = 0.0
    return z, dz


def frequencies(model: Fit, omega: ArrayLike) -> Vector:
    """Return omega (n,) in rad/s; refuse one below 0, or above pi/Ts for a sampled model."""
    omega_ = np.atleast_1d(np.asarray(omega, dtype=np.float64))
    if model.Ts == 0:
        if omega_.size and not (omega_.min() >= 0 and np.isfinite(omega_).all()):
            raise InputError(f"omega from {omega_.min():g} rad/s must be 0 or more, and finite")
        return omega_
    nyquist = np.pi / model.Ts
    if omega_.size and not (omega_.min() >= 0 and omega_.max() <= nyquist * (1 + 1e-9)):
        raise InputError(
            f"omega from {omega_.min():g} to {omega_.max():g} rad/s is outside 0 to "
            f"{nyquist:g} rad/s (pi/Ts); a sampled model has no response above pi/Ts"
        )
    return omega_


def ratio(model: Fit, omega: Vector, above: str, below: str) -> tuple[Complex, Complex]:
    """Return a ratio R of polynomials at omega (n,), and the gradients of ln R (n, d).

    The response of a model in continuous time contains its delay.
    """
    x = np.asarray(np.exp(-1j * omega * model.Ts) if model.Ts else 1j * omega)
    product = {1: np.ones_like(x), -1: np.ones_like(x)}
    dlnR = np.zeros((x.size, model.theta.size), dtype=np.complex128)
    with np.errstate(divide="ignore", invalid="ignore"):
        for letter in above + below:
            sign, value = 1 if letter in above else -1, _polynomial_values(model, letter, x)
            product[sign] *= value
            dlnR[:, model.slice_of(letter)] = sign * _slope(model, letter, x) / value[:, None]
        # Divide only once, at the end: the ratio of two infinite complex numbers is NaN.
        R: Complex = product[1] / product[-1]
        if isinstance(model.form, TransferFunction):
            R *= np.exp(-x * model.form.delay)
            dlnR[:, model.slice_of("delay")] = -x[:, None]
    return R, dlnR


def _polynomial_values(model: Fit, letter: str, x: Complex) -> Complex:
    """Return a polynomial at x = q^-1, or at x = s in continuous time, (n,)."""
    p = model.polynomial(letter)
    if model.Ts == 0:
        return np.asarray(np.polyval(p, x))
    if letter == model.integrating:  # exact at omega = 0, unlike a sum of coefficients
        return np.asarray((1 - x) * evaluate(without_integrator(p), x))
    return np.asarray(evaluate(p, x))


def _slope(model: Fit, letter: str, x: Complex) -> Complex:
    """Return the derivatives of a polynomial at x with respect to its parameters, (n, k)."""
    part = model.slice_of(letter)
    n = part.stop - part.start
    lags = (model.nk if letter == "b" else 1) + np.arange(n) if model.Ts else np.arange(n)[::-1]
    return np.asarray(x[:, None] ** lags)


def sensitivity(model: Fit, u: Vector) -> Matrix:
    """Return the derivatives of simulate(u) with respect to theta, (N, d)."""
    y = model.simulate(u)
    J = np.zeros((y.size, model.theta.size))
    J[:, model.slice_of("a")] = by_denominator(y, model.A, model.A.size - 1)
    lags = range(model.nk, model.B.size)
    J[:, model.slice_of("b")] = by_numerator(u, model.denominator, lags)
    J[:, model.slice_of("f")] = by_denominator(y, model.F, model.F.size - 1)
    return J


def standard_deviations(J: Matrix, covariance: Matrix) -> Vector:
    """Return the standard deviations of J theta, (n,)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", J, covariance, J), 0.0)))


def _factor(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a factor L of the covariance C = L L^T; NaN if C is not known."""
    # J L L^T J^T is never negative; J C J^T can be, by rounding, if roots nearly coincide.
    if not np.isfinite(covariance).all():
        return np.full_like(covariance, np.nan)
    variances, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(variances, 0.0)))
