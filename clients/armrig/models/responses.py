"""Properties of a model with their uncertainty: roots, frequency response, step response."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Roots:
    """Poles or zeros with their covariance; numpy.asarray returns the complex values."""

    values: Complex
    """Roots in the z plane, (n,)."""
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
                f"{z.real:10.5f} {re:8.2g}  {z.imag:10.5f} {im:8.2g}  {abs(z):8.5f} "
                f"{np.angle(z):7.3f}"
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
