"""Errors of a predictor whose missing samples are estimated, for searches.

With complete outputs y the white errors z of a model of constant gain are H(q) y minus the effects
of u and of the initial state. They are linear in the values of missing samples. The effects of
these values are the columns of T: the responses H_k from each missing sample on. The values of
least |z|² are estimated, so that their effects are projected out ::

    z - T inv(T^T T) T^T z

|z|² is then the sum of the squared innovations of the Kalman filter
(`armrig.numerics.kalman_gains`). The sum of the log determinants of their variances is log det
T^T T, plus that of the variances of e. T^T T has a band. Its Cholesky factor takes a tenth of the
time of the filter, and a derivative of the log determinant hardly more than an evaluation.

References
----------
.. [1] R. Kohn, C. F. Ansley, J. Am. Stat. Assoc. 81 (1986) 751-761.
.. [2] A. M. Erisman, W. F. Tinney, Comm. ACM 18 (1975) 177-179 (inverse within the band).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpbtrf, dpbtrs

from armrig.numerics.polynomial import Array

_LENGTHS = (512, 8192)  # samples of a response
_SETTLED_SHARE = 1e-13  # share of the largest value below which a response is 0
_MOST_PRODUCTS = (
    2e4  # products per sample for a Cholesky factor; above it the Kalman filter is used
)
_MOST_VALUES = 5e7  # values of the band
_MIN_BLOCK = 32  # columns of a block of the inverse

Filter = Callable[[Array], Array]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MissingSamples:
    """Projection on the effects T of m missing samples; signals are (N, k, ny)."""

    H: Array
    """Responses of the errors to the outputs, (L, ny, ny)."""
    at: tuple[NDArray[np.int_], NDArray[np.int_]]
    """Time and output of each missing sample, (m,) each, in the order of time."""
    N: int
    """Number of samples."""
    forward: Filter
    """Filter H from outputs to errors."""
    backward: Filter
    """Its transpose."""
    band: Array
    """Cholesky factor of T^T T in LAPACK's form, (width + 1, m)."""

    @property
    def log_det(self) -> float:
        """Value of log det T^T T."""
        return 2 * float(np.sum(np.log(self.band[0])))

    def values(self, z: Array) -> Array:
        """Return the coefficients (m, k) of the projection of z on the columns of T."""
        back = self.backward(z).swapaxes(1, 2)[self.at]
        return np.asarray(dpbtrs(self.band, back, lower=1)[0])

    def without(self, z: Array) -> Array:
        """Return z minus its projection on the columns of T."""
        if not z.size:
            return z
        values = np.zeros(z.shape)
        values.swapaxes(1, 2)[self.at] = self.values(z)
        return np.asarray(z - self.forward(values))

    def log_det_gradient(self) -> Array:
        """Return the derivatives of `log_det` with respect to the responses, (L, ny, ny)."""
        (L, ny, _), (t, i) = self.H.shape, self.at
        inverse, gradient = _inverse_band(self.band), np.zeros(self.H.shape)
        late = int(np.searchsorted(t, self.N - L, side="right"))  # with responses that end early
        sums = np.zeros((L, ny, ny))
        for k, row in enumerate(inverse[:, : t.size]):
            ends = np.arange(min(late, t.size - k)) if k == 0 else np.arange(t.size - k)
            ends = ends[ends < late]
            lag = t[ends + k] - t[ends]
            ends, lag = ends[lag < L], lag[lag < L]
            share = row[ends] * (1 if k == 0 else 2)
            np.add.at(sums, (lag, i[ends], i[ends + k]), share)
        for a, j, p in np.ndindex(ny, ny, ny):  # R_k[j, p] = sum of H_(m+k)[a, j] H_m[a, p]
            gradient[:, a, j] += np.convolve(sums[:, j, p], self.H[:, a, p])[:L]
            gradient[:, a, p] += np.correlate(self.H[:, a, j], sums[:, j, p], "full")[L - 1 :]
        if late < t.size:
            count = t.size - late
            part = np.zeros((count, count))
            for k in range(min(len(inverse), count)):
                row = np.arange(count - k)
                part[row + k, row] = part[row, row + k] = inverse[k, late : t.size - k]
            T = _late_columns(self.H, t[late:], i[late:], self.N)
            slope = 2 * np.tensordot(T, part, axes=1)  # (rows, ny, count)
            first = self.N - len(T)
            for column, (begin, output) in enumerate(zip(t[late:] - first, i[late:], strict=True)):
                gradient[: len(T) - begin, :, output] += slope[begin:, :, column]
        return gradient


@np.errstate(over="ignore", invalid="ignore")
def missing_samples(
    responses: Callable[[int], Array], rows: Array, forward: Filter, backward: Filter
) -> MissingSamples | None:
    """Return the projection for outputs measured at `rows` (N, ny).

    `responses` returns the first L responses of the errors, (L, ny, ny). None if they do not
    settle, if the band would be too wide, or if its factor has no digits.
    """
    t, i = np.nonzero(~rows)
    for most in _LENGTHS:
        H = responses(min(most, len(rows)))
        size = np.abs(H).reshape(len(H), -1).max(axis=1)
        if not np.isfinite(size).all():
            return None
        length = int(np.flatnonzero(size > _SETTLED_SHARE * size.max())[-1]) + 1
        if length < len(H) or len(H) == len(rows):
            break
    else:
        return None
    H = H[:length]
    width = int(np.max(np.searchsorted(t, t + length) - np.arange(t.size))) - 1
    if t.size * width > _MOST_VALUES or t.size * width**2 > _MOST_PRODUCTS * len(rows):
        return None
    band = _gram(H, t, i, len(rows), width)
    if not np.isfinite(band).all():
        return None
    factor, failed = dpbtrf(band, lower=1)
    if failed:
        return None
    return MissingSamples(
        H=H, at=(t, i), N=len(rows), forward=forward, backward=backward, band=factor
    )


def _gram(H: Array, t: NDArray[np.int_], i: NDArray[np.int_], N: int, width: int) -> Array:
    """Return T^T T in LAPACK's form."""
    (L, ny, _), m = H.shape, t.size
    R = np.zeros((N + L, ny, ny))
    for j, p in np.ndindex(ny, ny):
        R[:L, j, p] = sum(np.correlate(H[:, a, j], H[:, a, p], "full")[L - 1 :] for a in range(ny))
    band = np.zeros((width + 1, m))
    for k in range(width + 1):
        band[k, : m - k] = R[t[k:] - t[: m - k], i[: m - k], i[k:]]
    # The responses of the last missing samples end before they have settled.
    late = int(np.searchsorted(t, N - L, side="right"))
    if late < m:
        T = _late_columns(H, t[late:], i[late:], N).reshape(-1, m - late)
        last = T.T @ T
        for k in range(min(width + 1, len(last))):
            band[k, late : m - k] = np.diagonal(last, -k)
    return band


def _late_columns(H: Array, t: NDArray[np.int_], i: NDArray[np.int_], N: int) -> Array:
    """Return the last rows of the columns of T (rows, ny, m) of some last missing samples."""
    first = int(t[0])
    T = np.zeros((N - first, H.shape[1], t.size))
    for column, (begin, output) in enumerate(zip(t - first, i, strict=True)):
        rows = min(len(H), N - first - begin)
        T[begin : begin + rows, :, column] = H[:rows, :, output]
    return T


def _inverse_band(factor: Array) -> Array:
    """Return the band of the inverse of the matrix with this Cholesky factor, in the same form.

    The matrix is divided into blocks of as many columns as the band has, so that it is block
    tridiagonal. The blocks of the inverse follow from the last to the first.
    """
    width, m = len(factor) - 1, factor.shape[1]
    size = max(width, _MIN_BLOCK)
    count = -(-m // size)
    padded = np.zeros((size + 1, count * size))
    padded[: width + 1, :m] = factor
    padded[0, m:] = 1.0
    each = padded.reshape(size + 1, count, size)
    r, c = np.tril_indices(size)
    triangles, below = np.zeros((2, count, size, size))
    triangles[:, r, c] = each[r - c, :, c].T
    r, c = np.triu_indices(size)
    below[:, r, c] = each[size + r - c, :, c].T
    inverse = np.linalg.inv(triangles)
    M = below @ inverse
    diagonal, beside = inverse.swapaxes(1, 2) @ inverse, np.zeros_like(M)
    for b in range(count - 2, -1, -1):
        beside[b] = -diagonal[b + 1] @ M[b]
        diagonal[b] -= M[b].T @ beside[b]
    band = np.zeros_like(each)
    r, c = np.tril_indices(size)
    band[r - c, :, c] = diagonal[:, r, c].T
    r, c = np.triu_indices(size)
    band[size + r - c, :, c] = beside[:, r, c].T
    return band.reshape(size + 1, -1)[: width + 1, :m]
