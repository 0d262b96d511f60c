"""High-order ARX model that removes the dynamics from data and leaves the prediction errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from armrig.data.columns import Vector
from armrig.numerics.gram import cholesky_factor
from armrig.numerics.least_squares import orthonormal, triangle
from armrig.numerics.polynomial import Array
from armrig.numerics.regressors import complete, in_blocks

_BLOCK_ROWS = 2_000
_MAX_ROWS = 100_000  # more rows do not improve the judgement of single samples


@dataclass(frozen=True, slots=True, kw_only=True)
class Whitening:
    """A(q) y(t) = B(q) u(t) + c + d t + e(t), estimated by least squares."""

    A: Vector
    """Coefficients of A (n + 1,), beginning with 1."""
    B: Array
    """Coefficients of B (nu, n + 1) of each input, beginning with the direct term."""
    c: float
    """Constant."""
    d: float
    """Slope, per sample; 0 if the slope is not estimated."""
    covariance: Array
    """Covariance of (a1 … an, b0 … bn of each input, c, d)."""
    rows: int
    """Number of equations without a missing sample, from which the model was estimated."""

    def residuals(self, u: Array, y: Vector) -> Vector:
        """Return e (N,), NaN where y(t) or one of the n outputs before it is missing."""
        n = self.A.size - 1
        e = np.convolve(y, self.A)[: y.size]
        for x, B in zip(u.reshape(y.size, -1).T, self.B, strict=True):
            e = e - np.convolve(x, B)[: y.size]
        e -= self.c + self.d * np.arange(y.size)
        e[:n] = np.nan
        return np.asarray(e)


def whitening(parts: Sequence[tuple[Array, Vector]], n: int, *, slope: bool = False) -> Whitening:
    """Estimate a model of order n from (u, y) of each experiment; a missing y is NaN.

    u is (N,) or (N, nu). If u has 200 000 values or more, only evenly spaced blocks of rows are
    used. The normal equations are solved. If the normal equations lose too many digits, QR is used.
    """
    parts = [(u.reshape(y.size, -1), y) for u, y in parts]
    m = (n + 1) * parts[0][0].shape[1]
    width = n + m + 1 + int(slope)
    total = sum(u.size for u, _ in parts)
    skip = max(1, total // _MAX_ROWS)
    blocks = [b for i, b in enumerate(_all_blocks(parts, n, slope)) if i % skip == 0]
    rows = sum(b.shape[0] for b in blocks)
    R = cholesky_factor(np.sum([b.T @ b for b in blocks], axis=0)) if rows else None
    if R is None:
        R = triangle(blocks, width + 1)
    basis = orthonormal(R[:, :-1])
    theta = basis.coefficients(R[:, -1])
    sse = float(np.sum(basis.without(R[:, -1]) ** 2))
    covariance = np.zeros((n + m + 2,) * 2)
    covariance[:width, :width] = sse / max(rows - basis.rank, 1) * (basis.W @ basis.W.T)
    return Whitening(
        A=np.append(1.0, theta[:n]),
        B=theta[n : n + m].reshape(-1, n + 1),
        c=float(theta[n + m]),
        d=float(theta[n + m + 1]) if slope else 0.0,
        covariance=covariance,
        rows=rows,
    )


def _all_blocks(parts: Sequence[tuple[Array, Vector]], n: int, slope: bool) -> Iterator[Array]:
    """Yield blocks of the rows [-y(t-1) … -y(t-n) u(t) … u(t-n) 1 t y(t)] without missing y.

    The column t is present only if `slope` is True.
    """
    for u, y in parts:
        if y.size <= n:
            continue
        # Windows are faster than lagged copies, and hampel estimates a model in each round.
        outputs, inputs = (sliding_window_view(x, n + 1, axis=0)[..., ::-1] for x in (y, u))
        inputs = inputs.reshape(len(inputs), -1)
        times = np.arange(n, y.size, dtype=np.float64)[:, None]
        blocks = (in_blocks(M, _BLOCK_ROWS) for M in (outputs, inputs, times))
        for ys, us, t in zip(*blocks, strict=True):
            block = np.ones((t.size, n + us.shape[1] + 2 + int(slope)))
            np.negative(ys[:, 1:], out=block[:, :n])
            block[:, n : n + us.shape[1]], block[:, -1] = us, ys[:, 0]
            if slope:
                block[:, -2] = t[:, 0]
            known = complete(ys)
            yield block if known.all() else block[known]
