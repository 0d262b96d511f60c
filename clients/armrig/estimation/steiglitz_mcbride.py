"""Steiglitz-McBride iteration: an output-error model from least squares alone, as a start."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from armrig.models.innovations import trend
from armrig.models.structure import Structure, free_columns
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array, filtered, lagged, reflected

_HIGH_ORDER = 12


def equation_error(
    signals: Sequence[tuple[Array, Array]],
    F: Array,
    sizes: Structure,
) -> tuple[Array, Array]:
    """Return F (nf + 1,), B (nk + nb,) of least |F y_F - B u_F|, both signals filtered by 1/F.

    With F = 1 this is ARX by least squares; the free response of each experiment is projected
    out. Each signal pair (u, y) has no holes.
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
    """Yield a stable F (nf + 1,) after each iteration, until it moves by less than 1e-3.

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
    """Return (u, ŷ) of each experiment with ŷ the output, from rest, of a high-order ARX model.

    Its bias shrinks with its order, so ŷ is y without most of the noise and the free response.
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
    # The high order may exceed what the data determine; what depends on the rest is left out.
    theta = orthonormal(stacked[:, :-1]).coefficients(stacked[:, -1])
    A, B = reflected(np.append(1.0, theta[:n])), np.append(np.zeros(nk), theta[n : 2 * n])
    return [(u, filtered(B, A, u)) for u, _ in signals]
