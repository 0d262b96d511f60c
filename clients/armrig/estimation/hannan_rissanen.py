"""Start values for a search: noise models and output-error models from linear regressions.

References
----------
.. [1] E. J. Hannan, J. Rissanen, Biometrika 69 (1982) 81-94.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from armrig.models.innovations import Experiment, trend
from armrig.models.structure import Structure, free_columns
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array, filtered, lagged, reflected
from armrig.numerics.regressors import arx_rows, complete, past
from armrig.numerics.whiteness import autoregression

_PASSES = 3
_MAX_START_ROOT = 0.98  # largest modulus of a root in a start value; the search may exceed it
_HIGH_ORDER = 12


def noise_start(v: Sequence[Array], *, nc: int, nd: int) -> tuple[Array, Array]:
    """Return stable C and D in D v = C e; a missing sample of the signals v is NaN."""
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
        D = reflected(np.append(1.0, theta[:nd]), _MAX_START_ROOT)
        C = reflected(np.append(1.0, theta[nd:]), _MAX_START_ROOT)
        e = [_innovations(D, C, x) for x in v]
    return C, D


def armax_start(experiments: Sequence[Experiment], *, na: int, nb: int, nc: int, nk: int) -> Array:
    """Return a start value of C in A y = B u + C e, with stable C."""
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
        C = reflected(np.append(1.0, theta[na + nb :]), _MAX_START_ROOT)
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
    """Return, for each experiment, the regressors of A y = B u + e."""
    return [arx_rows(x.u, v, na=na, lags=lags).Phi for x, v in zip(experiments, y, strict=True)]


def _long_order(v: Sequence[Array], parameters: int) -> int:
    """Return the order of the long autoregression; the order grows slowly with N."""
    N = sum(x.size for x in v)
    return int(max(1, min(2 * parameters + 10 * np.log10(max(N, 10)) - 10, N // 10, N // 4)))


def _long_innovations(v: Sequence[Array]) -> list[Array]:
    """Return the errors of a long autoregression, by Yule and Walker's equations."""
    D, _ = autoregression(v)
    return [_innovations(D, np.ones(1), x) for x in v]


def _innovations(D: Array, C: Array, x: Array) -> Array:
    """Return D/C x from a zero state; a NaN in x counts as 0 and remains NaN in the result."""
    e = filtered(D, C, np.nan_to_num(x))
    e[~np.isfinite(x)] = np.nan
    return e


def _solved(blocks: Sequence[Array], y: Sequence[Array]) -> Array:
    """Return the least-squares coefficients over the rows in which all columns are known."""
    M, right = np.vstack(blocks), np.concatenate(y)
    rows = complete(M, right)
    return orthonormal(M[rows]).coefficients(right[rows])


def equation_error(
    signals: Sequence[tuple[Array, Array]],
    F: Array,
    sizes: Structure,
) -> tuple[Array, Array]:
    """Return F (nf + 1,) and B (nk + nb,) that minimise |F y_F - B u_F|.

    The signals y_F and u_F are y and u filtered by 1/F, where F is the argument. If the argument F
    is 1, the result is an ARX model. The free response of each experiment is projected out. No
    sample of the signal pairs (u, y) may be missing.
    """
    nf, nb, nk = sizes.nf, sizes.nb, sizes.nk
    blocks = []
    for u, y in signals:
        y_F, u_F = filtered([1.0], F, y), filtered([1.0], F, u)
        regressors = [-lagged(y_F, range(1, nf + 1)), lagged(u_F, range(nk, nk + nb))]
        block = np.column_stack([*regressors, y_F])
        pulses = free_columns(F, y.size, count=sizes.count, drift=False)
        blocks.append(orthonormal(np.hstack([pulses, trend(sizes, y.size)])).without(block))
    stacked = np.vstack(blocks)
    theta = orthonormal(stacked[:, :-1]).coefficients(stacked[:, -1])
    return np.append(1.0, theta[:nf]), np.append(np.zeros(nk), theta[nf:])


def steiglitz_mcbride(
    signals: Sequence[tuple[Array, Array]],
    F: Array,
    sizes: Structure,
    *,
    iterations: int,
) -> Iterator[Array]:
    """Yield a stable F (nf + 1,) after each iteration, until F changes by less than 0.1 %.

    References
    ----------
    .. [1] K. Steiglitz, L. E. McBride, IEEE Trans. Automatic Control 10 (1965) 461-464.
    """
    for _ in range(iterations):
        previous = F
        F, _ = equation_error(signals, F, sizes)
        F = reflected(F)
        yield F
        if F.size == previous.size and np.linalg.norm(F - previous) < 1e-3 * np.linalg.norm(F):
            return


def high_order_output(
    signals: Sequence[tuple[Array, Array]], sizes: Structure
) -> list[tuple[Array, Array]]:
    """Return (u, ŷ) of each experiment; ŷ is simulated from rest by a high-order ARX model.

    The bias of the model decreases with its order. ŷ is therefore y without most of the noise and
    without the free response.
    """
    nf, nb, nk = sizes.nf, sizes.nb, sizes.nk
    n = min(_HIGH_ORDER + max(nf, nb), *(y.size // 4 for _, y in signals))
    if n < max(nf, nb):
        return list(signals)
    blocks = []
    for u, y in signals:
        past = [-lagged(y, range(1, n + 1)), lagged(u, range(nk, nk + n))]
        blocks.append(np.column_stack([*past, trend(sizes, y.size), y])[n + nk :])
    stacked = np.vstack(blocks)
    # The high order may exceed the rank of the data; dependent columns have coefficient 0.
    theta = orthonormal(stacked[:, :-1]).coefficients(stacked[:, -1])
    A, B = reflected(np.append(1.0, theta[:n])), np.append(np.zeros(nk), theta[n : 2 * n])
    return [(u, filtered(B, A, u)) for u, _ in signals]
