"""Covariances of input and output over several experiments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armrig.data.dataset import Dataset

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Covariances:
    """Sample covariances at lags -L … L, each experiment about its own means."""

    uu: Vector
    """(2 L + 1,), of u(t + lag) with u(t)."""
    yy: Vector
    """(2 L + 1,), of y(t + lag) with y(t)."""
    yu: Vector
    """(2 L + 1,), of y(t + lag) with u(t): at a positive lag the input came first."""


def covariances(data: Dataset, L: int) -> Covariances:
    """Return R(k) = (1/N) sum over t of x(t + k) z(t), the biased form, for |k| <= L.

    No sample may be missing: see `armrig.estimation.nonparametric.missing_outputs`. A spectrum
    of these covariances is positive wherever the lag window's is.
    """
    u = [part.u - np.mean(part.u) for part in data.experiments()]
    y = [part.y - np.mean(part.y) for part in data.experiments()]
    return Covariances(
        uu=_sums(u, u, L) / data.N, yy=_sums(y, y, L) / data.N, yu=_sums(y, u, L) / data.N
    )


def _sums(x: list[Vector], z: list[Vector], L: int) -> Vector:
    """Return the sums of x(t + k) z(t), k = -L … L, over all experiments."""
    total = np.zeros(2 * L + 1)
    for a, b in zip(x, z, strict=True):
        size = 1 << int(np.ceil(np.log2(a.size + L + 1)))
        product = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
        reach = min(L, a.size - 1)
        k = np.arange(-reach, reach + 1)
        total[L + k] += product[k]
    return total
