"""The regression of y on u before, at and after each instant, block of rows by block."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.numerics.least_squares import orthonormal, triangle

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

_ROWS = 4096  # made at once: they stay in the cache


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FirExperiment:
    """One experiment; its rows are made when they are asked for, N d numbers are never held."""

    windows: Matrix
    """x(t - k) of all lags k, (N, d), a view; 0 outside the experiment."""
    y: Vector
    """Output (N,) without what the experiment has of its own, 0 where it is not used."""
    used: NDArray[np.bool_]
    """(N,), True where y and all of the lagged inputs are known."""
    own: Matrix
    """Orthonormal basis of what the experiment has of its own (level, ramp), (N, k)."""
    shadow: Matrix
    """Coefficients of the regressors along it, (k, d)."""

    def rows(self, part: slice) -> Matrix:
        """Return Phi of these rows, zero in those that cannot be used."""
        Phi = np.where(self.used[part, None], self.windows[part], 0.0)
        return np.asarray(Phi - self.own[part] @ self.shadow)

    def parts(self) -> list[slice]:
        """Return the rows of each block, first to last."""
        N = self.y.size
        return [slice(a, min(a + _ROWS, N)) for a in range(0, N, _ROWS)]

    def residuals(self, g: Vector) -> Vector:
        """Return y - Phi g (N,), NaN where it is not known."""
        e = np.full(self.y.size, np.nan)
        for part in self.parts():
            there = self.used[part]
            e[part][there] = (self.y[part] - self.rows(part) @ g)[there]
        return e


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FirRegression:
    """y = Phi g + e, what each experiment has of its own (level, ramp) projected out."""

    experiments: tuple[FirExperiment, ...]
    """Rows of each."""
    nuisance: int
    """Levels and ramps projected out."""

    @property
    def N(self) -> int:
        """Number of rows used."""
        return sum(int(np.count_nonzero(x.used)) for x in self.experiments)

    def triangle(self) -> Matrix:
        """Return R (d + 1, d + 1) of Q R = [Phi y], all rows used."""
        return triangle(self._blocks(), self.experiments[0].windows.shape[1] + 1)

    def _blocks(self) -> Iterator[Matrix]:
        for x in self.experiments:
            for part in x.parts():
                there = x.used[part]
                yield np.column_stack([x.rows(part), x.y[part]])[there]

    def residuals(self, g: Vector) -> list[Vector]:
        """Return y - Phi g of each experiment, (N_i,), NaN where it is not known."""
        return [x.residuals(g) for x in self.experiments]

    def backwards(self) -> Iterator[Iterator[Matrix]]:
        """Yield each experiment's Phi as blocks of rows, the last block first."""
        for x in self.experiments:
            yield (x.rows(part) for part in reversed(x.parts()))


def regression(data: Dataset, lags: range, *, integrator: bool) -> FirRegression:
    """Return the regression of y(t) on u(t - k), k in lags (from one <= 0 to one >= 0).

    For an integrating output the regressors are the running sums Ts (u(0) + … + u(t - k)), so that
    the coefficients are those of the rate and the noise stays on y as it was measured; besides a
    level each experiment then has a ramp, which is what an offset of the input does.
    """
    mean = float(np.mean(data.u))
    experiments = []
    for part in data.experiments():
        x = data.Ts * np.cumsum(part.u - mean) if integrator else part.u - mean
        experiments.append(_experiment(part, x, lags, columns=1 + integrator))
    return FirRegression(
        experiments=tuple(experiments), nuisance=sum(x.own.shape[1] for x in experiments)
    )


def _experiment(part: Dataset, x: Vector, lags: range, *, columns: int) -> FirExperiment:
    """Return one experiment's rows; `columns` of 1, t are its own."""
    first, last = lags[-1], -lags[0]
    padded = np.concatenate([np.zeros(first), x, np.zeros(last)])
    windows = sliding_window_view(padded, len(lags))[:, ::-1]
    used = np.array(part.valid)
    used[:first] = False
    used[max(part.N - last, 0) :] = False
    basis = orthonormal(np.vander(np.linspace(-1, 1, part.N), columns)[used]).spread(used)
    y = np.where(used, part.y, 0.0)
    found = FirExperiment(
        windows=windows,
        y=basis.without(y),
        used=used,
        own=basis.Q,
        shadow=np.zeros((basis.rank, len(lags))),
    )
    for rows in found.parts():
        found.shadow[:] += basis.Q[rows].T @ windows[rows]
    return found
