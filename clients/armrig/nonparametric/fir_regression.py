"""The regression of y on u before, at and after each instant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import lagged

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FirRegression:
    """y = Phi g + e, what each experiment has of its own (level, ramp) projected out."""

    blocks: tuple[Matrix, ...]
    """Phi of each experiment, (N_i, d), zero in the rows that cannot be used."""
    targets: tuple[Vector, ...]
    """y of each experiment, (N_i,), zero in the same rows."""
    used: tuple[NDArray[np.bool_], ...]
    """(N_i,), True where y and all of the lagged inputs are known."""
    nuisance: int
    """Levels and ramps projected out."""

    @property
    def N(self) -> int:
        """Number of rows used."""
        return sum(int(np.count_nonzero(mask)) for mask in self.used)

    @property
    def Phi(self) -> Matrix:
        """All rows used, (N, d)."""
        return np.vstack([b[m] for b, m in zip(self.blocks, self.used, strict=True)])

    @property
    def y(self) -> Vector:
        """All rows used, (N,)."""
        return np.concatenate([t[m] for t, m in zip(self.targets, self.used, strict=True)])

    def residuals(self, g: Vector) -> list[Vector]:
        """Return y - Phi g of each experiment, (N_i,), NaN where it is not known."""
        parts = zip(self.blocks, self.targets, self.used, strict=True)
        return [np.where(m, t - b @ g, np.nan) for b, t, m in parts]


def regression(data: Dataset, lags: Sequence[int], *, integrator: bool) -> FirRegression:
    """Return the regression of y(t) on u(t - k), k in lags (rising, may be negative).

    For an integrating output the regressors are the running sums Ts (u(0) + … + u(t - k)), so that
    the coefficients are those of the rate and the noise stays on y as it was measured; besides a
    level each experiment then has a ramp, which is what an offset of the input does.
    """
    blocks, targets, masks, nuisance = [], [], [], 0
    mean = float(np.mean(data.u))
    first, last = max(lags[-1], 0), max(-lags[0], 0)
    for part in data.experiments():
        x = data.Ts * np.cumsum(part.u - mean) if integrator else part.u - mean
        ahead = lagged(x[::-1], [-k for k in lags if k < 0])[::-1]
        Phi = np.hstack([ahead, lagged(x, [k for k in lags if k >= 0])])
        mask = np.array(part.valid)
        mask[:first] = False
        mask[max(part.N - last, 0) :] = False
        own = orthonormal(np.vander(np.linspace(-1, 1, part.N), 1 + integrator)[mask])
        block, target = np.zeros_like(Phi), np.zeros(part.N)
        block[mask] = Phi[mask] - own.Q @ (own.Q.T @ Phi[mask])
        target[mask] = own.without(part.y[mask])
        blocks.append(block)
        targets.append(target)
        masks.append(mask)
        nuisance += own.rank
    return FirRegression(
        blocks=tuple(blocks), targets=tuple(targets), used=tuple(masks), nuisance=nuisance
    )
