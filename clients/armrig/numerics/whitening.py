"""Whitening of several outputs by the covariance of their noise, with missing samples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from armrig.numerics.polynomial import Array


def whitening(noise_covariance: Array, rows: Array) -> Array:
    """Return matrices G (N, ny, ny) so that G(t) e(t) is white with the identity as covariance.

    `rows` (N, ny) is False where an output is missing. G(t) is the inverse Cholesky factor of the
    covariance of the outputs measured at t, and 0 in the rows and columns of missing outputs.
    """
    N, ny = rows.shape
    if rows.all():
        whole = np.linalg.inv(np.linalg.cholesky(noise_covariance))
        return np.broadcast_to(whole, (N, ny, ny))
    G = np.zeros((N, ny, ny))
    for measured, times in patterns(rows):
        L = np.linalg.cholesky(noise_covariance[np.ix_(measured, measured)])
        whole = np.zeros((ny, ny))
        whole[np.ix_(measured, measured)] = np.linalg.inv(L)
        G[times] = whole
    return G


def patterns(rows: Array) -> Iterator[tuple[Array, Array]]:
    """Yield the outputs of each set that is measured at some instants, and these instants.

    `rows` (N, ny) is False where an output is missing. Instants without an output are left out.
    """
    bits = np.arange(rows.shape[1])
    codes = rows @ (1 << bits)
    for code in np.unique(codes[codes > 0]):
        yield np.flatnonzero(code >> bits & 1), np.flatnonzero(codes == code)


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
