"""The Gram matrix of windows, and when it is enough."""

from __future__ import annotations

import numpy as np
import pytest
from armrig.estimation.subspace import windows
from armrig.numerics.least_squares import cholesky_factor, gram_of_windows
from armrig.numerics.polynomial import Array, filtered
from numpy.lib.stride_tricks import sliding_window_view


def _signals(seed: int, sizes: list[int], std: float = 0.1) -> list[tuple[Array, Array]]:
    rng = np.random.default_rng(seed)
    parts = []
    for N in sizes:
        u = rng.standard_normal(N) + 0.5
        y = filtered([0.0, 1.0, 0.5], [1.0, -1.2, 0.6], u) + std * rng.standard_normal(N)
        parts.append((u[:, None], y[:, None]))
    return parts


def _plainly(parts: list[tuple[Array, Array]], length: int) -> Array:
    """Return the windows [U Y] that have no hole, less their means."""
    blocks = [np.hstack([sliding_window_view(x[:, 0], length) for x in part]) for part in parts]
    M = np.vstack(blocks)
    M = M[np.isfinite(M).all(axis=1)]
    return np.asarray(M - M.mean(axis=0))


@pytest.mark.parametrize("sizes", [[400], [60, 300], [25, 20, 21], [39, 200, 40]])
def test_the_gram_matrix_is_that_of_the_windows(sizes: list[int]) -> None:
    parts = _signals(1, sizes)

    G = gram_of_windows([[x[:, 0] for x in part] for part in parts], 20)

    M = _plainly(parts, 20)
    np.testing.assert_allclose(G, M.T @ M, atol=1e-11 * np.abs(G).max())


def test_windows_with_a_missing_sample_are_omitted_from_the_factor() -> None:
    """In the order [U_f U_p Y_p Y_f], over the holes of two experiments."""
    parts = _signals(2, [500, 90])
    parts[0][1][[3, 40, 41, 250]] = np.nan
    parts[1][1][60] = np.nan

    w = windows(parts, past=6, future=4)

    M = _plainly(parts, 10)
    M = np.hstack([M[:, 6:10], M[:, :6], M[:, 10:]])
    assert np.allclose(np.tril(w.R, -1), 0)
    np.testing.assert_allclose(w.R.T @ w.R, M.T @ M, atol=1e-11 * np.abs(w.R).max() ** 2)
    assert M.shape[0] == w.N


def test_only_the_first_windows_of_long_data_are_used() -> None:
    parts = _signals(3, [100, 100])
    parts[0][1][50] = np.nan

    w = windows(parts, past=5, future=5, most=120)

    known = [(u[:n], y[:n]) for (u, y), n in zip(parts, (100, 48), strict=True)]
    M = _plainly(known, 10)
    np.testing.assert_allclose(np.linalg.norm(w.R), np.linalg.norm(M), rtol=1e-12)
    assert w.N == M.shape[0] == 120


@pytest.mark.parametrize("std", [1e-6, 1e-9])
def test_windows_whose_squares_lose_digits_are_decomposed(std: float) -> None:
    """With little noise the windows are nearly dependent, and the square loses digits of R."""
    parts = _signals(5, [2000], std)

    w = windows(parts, past=8, future=8)

    assert cholesky_factor(gram_of_windows([[x[:, 0] for x in part] for part in parts], 16)) is None
    rest = np.abs(np.diag(w.R)[-4:]) / np.sqrt(w.N)
    assert ((rest > std / 10) & (rest < 10 * std)).all()
