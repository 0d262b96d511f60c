"""Whitening of several outputs by the covariance of their noise, with missing samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armrig.numerics.polynomial import Array


def whitening(noise_covariance: Array, rows: Array) -> Array:
    """Return matrices G (N, ny, ny) so that G(t) e(t) is white with the identity as covariance.

    `rows` (N, ny) is False where an output is missing. G(t) is the inverse Cholesky factor of the
    covariance of the outputs measured at t, and 0 in the rows and columns of missing outputs.
    """
    N, ny = rows.shape
    G = np.zeros((N, ny, ny))
    codes = rows @ (1 << np.arange(ny))
    for code in np.unique(codes):
        at = np.flatnonzero(code >> np.arange(ny) & 1)
        if at.size:
            L = np.linalg.cholesky(noise_covariance[np.ix_(at, at)])
            whole = np.zeros((ny, ny))
            whole[np.ix_(at, at)] = np.linalg.inv(L)
            G[codes == code] = whole
    return G


def spread(G: Array, blocks: Sequence[Array]) -> Array:
    """Return the whitened rows (ny N, k) of all outputs; each output has one block (N, k)."""
    ny = len(blocks)
    return np.vstack(
        [np.sum([G[:, i, j, None] * blocks[j] for j in range(ny)], axis=0) for i in range(ny)]
    )


def spread_apart(G: Array, blocks: Sequence[Array]) -> Array:
    """Return the whitened rows (ny N, sum of k_i); each output has its own columns (N, k_i)."""
    ny = len(blocks)
    return np.vstack(
        [np.hstack([G[:, i, j, None] * blocks[j] for j in range(ny)]) for i in range(ny)]
    )


def unspread(G: Array, M: Array) -> list[Array]:
    """Return the product G^T M as one block (N, k) for each output; M is (ny N, k)."""
    ny = G.shape[1]
    parts = np.split(M, ny)
    return [
        np.asarray(np.sum([G[:, i, j, None] * parts[i] for i in range(ny)], axis=0))
        for j in range(ny)
    ]
