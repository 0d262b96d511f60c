"""Poles and zeros that cannot be told apart."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.numerics.quantile import joint_p_value

if TYPE_CHECKING:
    from armrig.models.model import Model

Complex = NDArray[np.complex128]

SAME = 0.01
"""p value of a pole and a zero that cannot be told apart."""
_NEAR = 0.3  # largest distance in the z plane at which they are compared
_REAL = 1e-9


def overlapping(model: Model) -> list[tuple[complex, complex, float]]:
    """Return pole, zero and p value of the pairs that cannot be told apart (1 %), nearest first.

    The difference of a pole and a zero has the covariance J P J^T, J their derivatives by theta:
    where the order is too high both wander, together, and only this difference is small. A
    conjugate pair is told once.
    """
    poles = [(letter, z) for letter in ("a", "f") for z in _roots(model, letter)]
    found = []
    for letter, pole in poles:
        if pole.imag < 0 or (letter == model.integrating and abs(pole - 1) < 1e-6):
            continue
        for zero in _roots(model, "b"):
            apart = pole - zero
            if zero.imag < -_REAL or abs(apart) > _NEAR:
                continue
            d = _derivative(model, letter, pole) - _derivative(model, "b", zero)
            J = np.vstack([d.real, d.imag])
            s = np.array([apart.real, apart.imag])
            p = joint_p_value(s, J @ model.trusted_covariance @ J.T)
            if p >= SAME:
                found.append((complex(pole), complex(zero), p))
    return sorted(found, key=lambda pair: abs(pair[0] - pair[1]))


def _roots(model: Model, letter: str) -> Complex:
    p = getattr(model, letter.upper())
    return np.roots(p[model.nk :] if letter == "b" else p).astype(np.complex128)


def _derivative(model: Model, letter: str, root: complex) -> Complex:
    """Return the derivative of a root by theta (d,): dz = -z^(n-k) / p'(z) dp_k."""
    p = getattr(model, letter.upper())
    p, first = (p[model.nk :], 0) if letter == "b" else (p, 1)
    powers = p.size - 1 - np.arange(first, p.size)
    out = np.zeros(model.theta.size, dtype=np.complex128)
    with np.errstate(divide="ignore", invalid="ignore"):
        out[model.slice_of(letter)] = -(root**powers) / np.polyval(np.polyder(p), root)
    return out
