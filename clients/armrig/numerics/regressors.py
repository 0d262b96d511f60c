"""Regressors of signals with missing samples (NaN), and an ARX model that whitens the signals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import log

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from armrig.numerics.least_squares import Basis, cholesky_factor, orthonormal, triangle
from armrig.numerics.polynomial import Array, lag_columns, monic
from armrig.numerics.rounding import SHARE, rounding_std
from armrig.numerics.stretches import Mask

_BLOCK_ROWS = 2_000
_MAX_ROWS = 100_000  # more rows hardly improve a model of the noise, or a test


@dataclass(frozen=True, slots=True, kw_only=True)
class ArxRows:
    """Regression y = Phi theta + e of one experiment."""

    block: Array
    """[-y(t-1) … -y(t-na), each input at its lags, y], (N, na + nu len(lags) + 1)."""
    usable: Mask
    """Rows in which y and all regressors are known, (N,)."""

    @property
    def Phi(self) -> Array:
        """Regressors (N, na + nu len(lags)), a view of the block."""
        return self.block[:, :-1]

    @property
    def y(self) -> Array:
        """Output (N,), a view of the block."""
        return self.block[:, -1]


def past(x: Array, lags: Sequence[int]) -> Array:
    """Return an array (N, len(lags)) with x(t - lags[j]) in column j, NaN if t < lags[j]."""
    columns = lag_columns(np.asarray(x, dtype=np.float64), lags)
    for j, lag in enumerate(lags):
        columns[:lag, j] = np.nan
    return columns


def complete(*columns: Array) -> Mask:
    """Return a mask (N,) of the rows in which all columns, each (N,) or (N, k), are known."""
    masks = [np.isfinite(c) if c.ndim == 1 else np.isfinite(c).all(axis=1) for c in columns]
    return np.asarray(np.logical_and.reduce(masks))


def arx_rows(u: Array, y: Array, *, na: int, lags: Sequence[int]) -> ArxRows:
    """Return the rows of A y = B u + e, with na past outputs and the inputs at the given lags."""
    inputs = [past(x, lags) for x in u.reshape(y.size, -1).T]
    block = np.hstack([-past(y, range(1, na + 1)), *inputs, y[:, None]])
    return ArxRows(block=block, usable=complete(block))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LongArx:
    """A(q) y(t) = c + sum of B_j(q) u_j(t) + e(t) with p lags, and a constant per experiment."""

    base: Basis
    """Basis of the regressors in `rows`."""
    rows: Mask
    """Rows in which y and all regressors are known, (N,)."""
    lags: tuple[int, int]
    """First lag of the inputs, and p."""
    nu: int
    """Number of inputs."""

    def errors(self, M: Array) -> Array:
        """Return the columns M (N,) or (N, k) minus their best approximation, in `rows`."""
        return self.base.without(M[self.rows])

    def polynomials(self, y: Array) -> tuple[Array, Array]:
        """Return A (p + 1,) and B (nu, p + 1) that minimise the errors of an output y (N,)."""
        first, p = self.lags
        theta, n = self.base.coefficients(y[self.rows]), p + 1 - first
        B = theta[p : p + self.nu * n].reshape(self.nu, n)
        return monic(theta[:p]), np.pad(B, ((0, 0), (first, 0)))

    def with_terms(self, y: Array, terms: Array) -> tuple[float, float, float, Array]:
        """Return BIC, A(1), B_1(1) and c of A y = c_0 + sum of B_j u_j + terms c + e."""
        basis, k = orthonormal(self.errors(terms)), terms.shape[1]
        e = self.errors(y)
        c = basis.coefficients(e)
        loss, n = float(np.sum(basis.without(e) ** 2)), e.size
        A, B = self.polynomials(y - terms @ c)
        return n * log(max(loss, 1e-300)) + k * log(n), float(np.sum(A)), float(np.sum(B[0])), c


def long_arx(parts: Sequence[tuple[Array, Array]], p: int, first: int) -> LongArx:
    """Return the model of (u, y) of each experiment with p lags of y and lags `first` … p of u.

    Of 200 000 samples or more, only evenly spaced blocks are used.
    """
    skip = max(1, sum(y.size for _, y in parts) // _MAX_ROWS)
    used, blocks = [], []
    for constant, (u, y) in zip(np.eye(len(parts)), parts, strict=True):
        rows, length = np.zeros(y.size, dtype=np.bool_), _BLOCK_ROWS if skip > 1 else max(y.size, 1)
        for begin in range(0, y.size, skip * length):
            lead = min(p, begin)
            piece = slice(begin - lead, begin + length)
            equations = arx_rows(u[piece], y[piece], na=p, lags=range(first, p + 1))
            usable = equations.usable[lead:]
            rows[begin : begin + usable.size] = usable
            Phi = equations.Phi[lead:][usable]
            blocks.append(np.hstack([Phi, np.tile(constant, (Phi.shape[0], 1))]))
        used.append(rows)
    nu = parts[0][0].size // parts[0][1].size
    base = orthonormal(np.vstack(blocks))
    return LongArx(base=base, rows=np.concatenate(used), lags=(first, p), nu=nu)


def best_arx(
    parts: Sequence[tuple[Array, Array]],
    orders: Sequence[int],
    criterion: Callable[[float, int, int], Array],
    rows_per_parameter: int,
) -> LongArx | None:
    """Return the model of the order p with the least criterion; None if there are too few rows."""
    y, least, best = np.concatenate([y for _, y in parts]), np.inf, None
    for p in orders:
        arx = long_arx(parts, p, 0)
        e, d = arx.errors(y), arx.base.W.shape[0]
        if e.size < rows_per_parameter * d:
            break
        value = float(criterion(float(np.mean(e**2)), d, e.size))
        if best is None or value < least:
            least, best = value, arx
    return best


def arx_errors(A: Array, B: Array, u: Array, y: Array) -> Array:
    """Return A y - sum of B_j u_j (N,), NaN where y(t) or one of the n y before it is missing."""
    e = np.convolve(y, A)[: y.size]
    for x, b in zip(u.reshape(y.size, -1).T, B, strict=True):
        e = e - np.convolve(x, b)[: y.size]
    e[: A.size - 1] = np.nan
    return np.asarray(e)


def in_blocks(M: Array, rows: int) -> Iterator[Array]:
    """Yield successive blocks of M (N, d) with `rows` rows; the last block has the remainder."""
    for begin in range(0, M.shape[0], rows):
        yield M[begin : begin + rows]


@dataclass(frozen=True, slots=True, kw_only=True)
class Whitening:
    """A(q) y(t) = B(q) u(t) + c + d t + e(t), estimated by least squares."""

    A: Array
    """Coefficients of A (n + 1,), beginning with 1."""
    B: Array
    """Coefficients of B (nu, n + 1) of each input, beginning with the direct term."""
    c: float
    """Constant."""
    d: float
    """Slope, per sample; 0 if the slope is not estimated."""
    covariance: Array
    """Covariance of (a1 … an, b0 … bn of each input, c, d); the noise is at least rounding."""
    rows: int
    """Number of equations without a missing sample, from which the model was estimated."""
    exact: bool
    """True if the errors are rounding errors, so that y has no noise."""
    unique: bool
    """True if the regressors are linearly independent, so that each coefficient is unique."""

    @property
    def ambiguous(self) -> bool:
        """True if y has no noise, and other coefficients describe it as well."""
        return self.exact and not self.unique

    @property
    def at_1(self) -> float:
        """A(1); 0.0 if it is a rounding error, as for an integrator without noise."""
        total = float(np.sum(self.A))
        return total if abs(total) > SHARE * float(np.sum(np.abs(self.A))) else 0.0

    def residuals(self, u: Array, y: Array) -> Array:
        """Return e (N,), NaN where y(t) or one of the n outputs before it is missing."""
        return arx_errors(self.A, self.B, u, y) - self.c - self.d * np.arange(y.size)


def whitening(parts: Sequence[tuple[Array, Array]], n: int, *, slope: bool = False) -> Whitening:
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
    floor = rows * rounding_std(*(y for _, y in parts)) ** 2
    sse = max(float(np.sum(basis.without(R[:, -1]) ** 2)), floor)
    covariance = np.zeros((n + m + 2,) * 2)
    covariance[:width, :width] = sse / max(rows - basis.rank, 1) * (basis.W @ basis.W.T)
    return Whitening(
        A=np.append(1.0, theta[:n]),
        B=theta[n : n + m].reshape(-1, n + 1),
        c=float(theta[n + m]),
        d=float(theta[n + m + 1]) if slope else 0.0,
        covariance=covariance,
        rows=rows,
        exact=rows > basis.rank and sse <= floor,
        unique=basis.rank == width,
    )


def unique_whitening(
    parts: Sequence[tuple[Array, Array]], n: int, *, slope: bool = False
) -> Whitening:
    """Return the model of the highest order, from n down to 1, that is not ambiguous.

    In data without noise the regressors of a high order are dependent. The constant of such a model
    depends on the regressors that are left out, and so on rounding errors.
    """
    model = whitening(parts, n, slope=slope)
    while n > 1 and model.ambiguous:
        n -= 1
        model = whitening(parts, n, slope=slope)
    return model


def _all_blocks(parts: Sequence[tuple[Array, Array]], n: int, slope: bool) -> Iterator[Array]:
    """Yield blocks of rows [-y(t-1) … -y(t-n) u(t) … u(t-n) 1 (t if `slope`) y(t)] of known y."""
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
            measured = complete(ys)
            yield block if measured.all() else block[measured]
