"""Start values of noise models by two linear regressions: long autoregression, then its errors.

References
----------
.. [1] E. J. Hannan, J. Rissanen, Biometrika 69 (1982) 81-94.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armrig.models.innovations import Experiment
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array, filtered, reflected
from armrig.numerics.regressors import arx_rows, complete, past
from armrig.numerics.whiteness import autoregression, joined

_PASSES = 3
_LARGEST_ROOT = 0.98  # of a start value; the search may go beyond


def noise_start(v: Sequence[Array], *, nc: int, nd: int) -> tuple[Array, Array]:
    """Return C and D of D v = C e, both stable, for signals v with holes (NaN)."""
    if nc + nd == 0:
        return np.ones(1), np.ones(1)
    e = _long_innovations(v) if nc else [np.full(x.size, np.nan) for x in v]
    C, D = np.ones(1), np.ones(1)
    for _ in range(_PASSES if nc else 1):
        columns = [
            np.hstack([-past(x, range(1, nd + 1)), past(i, range(1, nc + 1))])
            for x, i in zip(v, e, strict=True)
        ]
        theta = _solved(columns, v)
        D = reflected(np.append(1.0, theta[:nd]), _LARGEST_ROOT)
        C = reflected(np.append(1.0, theta[nd:]), _LARGEST_ROOT)
        e = [_innovations(D, C, x) for x in v]
    return C, D


def armax_start(experiments: Sequence[Experiment], *, na: int, nb: int, nc: int, nk: int) -> Array:
    """Return C of A y = B u + C e, stable."""
    y = [np.where(_known(x), x.y, np.nan) for x in experiments]
    n = _long_order(y, na + nb + nc)
    long = _regressors(experiments, y, na=n, lags=range(nk, nk + n))
    theta = _solved(long, y)
    e = [v - Phi @ theta for Phi, v in zip(long, y, strict=True)]
    Phis = _regressors(experiments, y, na=na, lags=range(nk, nk + nb))
    C = np.ones(1)
    for _ in range(_PASSES):
        blocks = [
            np.hstack([Phi, past(i, range(1, nc + 1))]) for Phi, i in zip(Phis, e, strict=True)
        ]
        theta = _solved(blocks, y)
        C = reflected(np.append(1.0, theta[na + nb :]), _LARGEST_ROOT)
        left = [v - Phi @ theta[: na + nb] for Phi, v in zip(Phis, y, strict=True)]
        e = [_innovations(np.ones(1), C, v) for v in left]
    return C


def _known(experiment: Experiment) -> Array:
    known = np.zeros(experiment.y.size, dtype=np.bool_)
    for s in experiment.stretches:
        known[s] = True
    return known


def _regressors(
    experiments: Sequence[Experiment], y: Sequence[Array], *, na: int, lags: Sequence[int]
) -> list[Array]:
    """Return the regressors of A y = B u + e, for each experiment."""
    return [arx_rows(x.u, v, na=na, lags=lags).Phi for x, v in zip(experiments, y, strict=True)]


def _long_order(v: Sequence[Array], parameters: int) -> int:
    """Return the order of the long autoregression: it grows slowly with the data."""
    N = sum(x.size for x in v)
    return int(max(1, min(2 * parameters + 10 * np.log10(max(N, 10)) - 10, N // 10, N // 4)))


def _long_innovations(v: Sequence[Array]) -> list[Array]:
    """Return the errors of a long autoregression, by Yule and Walker's equations."""
    D, _ = autoregression(joined(v, 40))
    return [_innovations(D, np.ones(1), x) for x in v]


def _innovations(D: Array, C: Array, x: Array) -> Array:
    """Return D/C x from rest, holes taken as zero and kept as holes."""
    e = filtered(D, C, np.nan_to_num(x))
    e[~np.isfinite(x)] = np.nan
    return e


def _solved(blocks: Sequence[Array], y: Sequence[Array]) -> Array:
    """Return the least-squares coefficients over the rows where all is known."""
    M, right = np.vstack(blocks), np.concatenate(y)
    rows = complete(M, right)
    return orthonormal(M[rows]).coefficients(right[rows])
