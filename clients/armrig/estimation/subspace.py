"""State-space models from projections of the future outputs on past data.

At each instant a window contains p past samples and f future samples of nu inputs and ny outputs.
The matrix M = [U_f W_p Y_f], with W_p = [U_p Y_p], has the triangular factor ::

        R11 R12 R13
    R =     R22 R23
                R33

The functions of this module need only R. Column k of R represents column k of M.

References
----------
.. [1] P. Van Overschee, B. De Moor, *Subspace Identification for Linear Systems*, 1996, chapters
   4 and 5.
.. [2] W. E. Larimore, Proc. 29th Conf. Decision and Control (1990) 596-604 (CVA).
.. [3] D. Bauer, Automatica 37 (2001) 1561-1573 (order).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import LinAlgError, solve_discrete_are
from scipy.linalg.lapack import dggev

from armrig.estimation.orders import Integers
from armrig.models.structure_table import Weights
from armrig.numerics.criteria import aic, mdl
from armrig.numerics.least_squares import (
    cholesky_factor,
    least_squares,
    triangle,
    without_span,
)
from armrig.numerics.polynomial import Array, lag_columns
from armrig.numerics.regressors import in_blocks
from armrig.numerics.stretches import stretches

Parts = Sequence[tuple[Array, Array]]
"""Inputs (N, nu) and outputs (N, ny) of each experiment or stretch; a missing output is NaN."""
_BLOCK_ROWS = 1024  # rows decomposed at once
_SINGULAR_VALUE_ROUNDING = 1e-10  # a singular value below this share of the largest is 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Windows:
    """Past and future samples of all complete windows, reduced to a triangular factor."""

    R: Array
    """Triangular factor of [1 U_f U_p Y_p Y_f], without the row and column of the constant."""
    past: int
    """Number of past samples, p."""
    future: int
    """Number of future samples, f."""
    N: int
    """Number of windows."""
    nu: int
    """Number of inputs."""
    ny: int
    """Number of outputs."""

    def columns(self, *names: str) -> Integers:
        """Return the indices in R of the columns "uf", "up", "yp" or "yf", oldest samples first."""
        return _columns(self.future, self.past, self.nu, self.ny, names)


@cache
def _columns(f: int, p: int, nu: int, ny: int, names: tuple[str, ...]) -> Integers:
    widths = {"uf": f * nu, "up": p * nu, "yp": p * ny, "yf": f * ny}
    begins = dict(zip(widths, np.cumsum([0, *widths.values()]).tolist(), strict=False))
    columns = np.concatenate([begins[name] + np.arange(widths[name]) for name in names])
    columns.flags.writeable = False
    return columns


def windows(parts: Parts, *, past: int, future: int, most: int | None = None) -> Windows:
    """Return the windows in which no output is missing.

    The means of u and y are projected out, because the data may have offsets. Only the first `most`
    windows are used. R is the Cholesky factor of the Gram matrix of the windows. If the squares in
    the Gram matrix lose too many digits, R is computed by a QR decomposition of the windows.
    """
    length = past + future
    (u, y), *_ = parts
    nu, m = u.shape[1], u.shape[1] + y.shape[1]
    signals = _centre([np.hstack(part) for part in complete_stretches(parts, length, most)])
    N = sum(x.shape[0] - length + 1 for x in signals)
    at = np.arange(m * length).reshape(m, length).T  # instant after instant
    order = np.concatenate(
        [at[past:, :nu], at[:past, :nu], at[:past, nu:], at[past:, nu:]], axis=None
    )
    G, total = np.zeros((at.size, at.size)), np.zeros(at.size)
    for M in _blocks(signals, length):
        G += M.T @ M
        total += M.sum(axis=0)
    G -= np.outer(total, total) / max(N, 1)
    R = cholesky_factor(G[np.ix_(order, order)])
    if R is None:
        ordered = (np.insert(M[:, order], 0, 1.0, axis=1) for M in _blocks(signals, length))
        R = np.triu(triangle(ordered, 1 + order.size))[1:, 1:]
    return Windows(R=R, past=past, future=future, N=N, nu=nu, ny=m - nu)


def complete_stretches(
    parts: Parts, length: int, most: int | None = None
) -> list[tuple[Array, Array]]:
    """Return the stretches of `length` samples or more without a gap, of at most `most` windows."""
    runs, left = [], np.inf if most is None else most
    for u, y in parts:
        for s in stretches(np.asarray(np.isfinite(y).all(axis=1))):
            if s.stop - s.start >= length and left > 0:
                stop = int(min(s.stop, s.start + length - 1 + left))
                runs.append((u[s.start : stop], y[s.start : stop]))
                left -= stop - s.start - length + 1
    return runs


def _centre(parts: list[Array]) -> list[Array]:
    """Return the signals (N, m) minus their means over all parts, which keeps more digits."""
    if not parts:
        return []
    mean = np.array([np.mean(column) for column in np.ascontiguousarray(np.vstack(parts).T)])
    return [x - mean for x in parts]


def _blocks(parts: list[Array], length: int) -> Iterator[Array]:
    """Yield blocks of windows, with the samples of one signal after those of another."""
    for x in parts:
        for block in in_blocks(sliding_window_view(x, length, axis=0), _BLOCK_ROWS):
            yield block.reshape(len(block), -1)


def shorten_windows(w: Windows, samples: int) -> Windows:
    """Return the windows of the same instants, shortened to `samples` past and future samples."""
    nu, ny = samples * w.nu, samples * w.ny
    uf, up, yp, yf = (w.columns(name) for name in ("uf", "up", "yp", "yf"))
    kept = np.concatenate([uf[:nu], up[-nu:], yp[-ny:], yf[:ny]])
    R = np.asarray(np.linalg.qr(w.R[:, kept], mode="r"))
    return Windows(R=R, past=samples, future=samples, N=w.N, nu=w.nu, ny=w.ny)


def autoregressive_order(w: Windows) -> int:
    """Return the order that AIC chooses for an ARX model.

    The model of order n predicts y(t) from u(t), n past samples of y and n past samples of u. The
    chosen n past samples cover the memory of the predictor and therefore determine the state.
    """
    up, yp = (w.columns(name).reshape(w.past, -1)[::-1] for name in ("up", "yp"))
    lags = np.hstack([yp, up]).ravel()
    chosen = np.concatenate([w.columns("uf")[: w.nu], lags, w.columns("yf")[: w.ny]])
    n = np.arange(1, w.past + 1)
    losses = _losses(w.R[:, chosen], w, w.nu + n * (w.nu + w.ny))
    return int(n[np.argmin(aic(losses, n * (w.nu + w.ny) * w.ny, w.N))])


def _losses(M: Array, w: Windows, counts: Integers) -> Array:
    """Return det of the mean of e e^T, for y regressed on `known` first columns of M = [X Y]."""
    y = np.asarray(np.linalg.qr(M, mode="r"))[:, -w.ny :]
    sums = np.cumsum((y[:, :, None] * y[:, None, :])[::-1], axis=0)[::-1]
    return np.asarray(np.linalg.det(sums[counts] / w.N))


@dataclass(frozen=True, slots=True, kw_only=True)
class SubspaceProjection:
    """Projection of the future outputs on the past, for given future inputs."""

    H: Array
    """Matrix H in Y_f = H W_p + L U_f + noise, (f ny, p (nu + ny))."""
    U: Array
    """Left singular vectors, multiplied by the inverse of the left weight matrix, (f ny, f ny). The
    first n vectors span the columns of the observability matrix."""
    singular_values: Array
    """Singular values (f ny,); with "cva" the canonical correlations of past and future."""


def projection(w: Windows, weights: Weights) -> SubspaceProjection:
    """Return the singular value decomposition of the weighted projection."""
    f, past, future = w.future * w.nu, w.columns("up", "yp"), w.columns("yf")
    R12, R22 = w.R[:f, past], w.R[f : f + past.size, past]
    R23, R33 = w.R[f : f + past.size, future], w.R[f + past.size :, future]
    # Columns of the past may be linearly dependent; without noise they are always dependent.
    H = least_squares(R22, R23).T
    if weights == "cva":
        _, values, V = np.linalg.svd(np.vstack([R23, R33]), full_matrices=False)
        # S^(1/2) of the future's covariance, limited from below for the division.
        root = np.maximum(values, 1e-12 * values[0])
        U, sigma, _ = np.linalg.svd((V @ R23.T) / root[:, None], full_matrices=False)
        U = V.T @ (root[:, None] * U)
    elif weights == "moesp":
        U, sigma, _ = np.linalg.svd(R23.T, full_matrices=False)
    else:
        U, sigma, _ = np.linalg.svd(H @ np.hstack([R12.T, R22.T]), full_matrices=False)
    return SubspaceProjection(H=H, U=U, singular_values=sigma)


def visible_states(w: Windows) -> int:
    """Return the number of states that the data show; without noise, at most the system's order."""
    past, future = w.columns("up", "yp"), w.columns("yf")
    values = np.linalg.svd(w.R[np.ix_(past, future)], compute_uv=False)
    return int(np.count_nonzero(values > _SINGULAR_VALUE_ROUNDING * values[0]))


def one_step_losses(w: Windows, decomposition: SubspaceProjection, most: int) -> Array:
    """Return the losses of the one-step errors of models with 1 … `most` states, (most,).

    The n states are the components of H W_p along the first n singular vectors.
    """
    y, now = w.R[:, w.columns("yf")[: w.ny]], w.R[:, w.columns("uf")[: w.nu]]
    states = w.R[:, w.columns("up", "yp")] @ (decomposition.H.T @ decomposition.U[:, :most])
    return _losses(np.column_stack([now, states, y]), w, w.nu + np.arange(1, most + 1))


def order_by_mdl(w: Windows, decomposition: SubspaceProjection, most: int) -> int:
    """Return the order that minimises MDL of the one-step loss.

    A state has nu + 2 ny parameters, in B, K and the observable form of A and C. In 120 trials
    (four systems of order 2 or 3, N = 500 and N = 2000, CVA weights, 25 past and 25 future samples)
    MDL chose the true order in 110 trials, and Bauer's criterion [3]_ in 62 trials.
    """
    n = np.arange(1, most + 1)
    return 1 + int(
        np.argmin(mdl(one_step_losses(w, decomposition, most), n * (w.nu + 2 * w.ny), w.N))
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Realisation:
    """Matrices of x(t+1) = A x(t) + … + w(t), y(t) = C x(t) + … + v(t)."""

    A: Array
    """Transition matrix (n, n)."""
    C: Array
    """Matrix of the outputs (ny, n)."""
    covariance: Array
    """Covariance of [w v], (n + ny, n + ny)."""

    def predictor_poles(self) -> Array | None:
        """Return the eigenvalues of A - K C for one output, or None without a steady filter.

        Q, S and r are the blocks of `covariance`. With F = A - S C / r, the Riccati equation has
        the pencil below. The eigenvalues of A - K C are the n smallest eigenvalues of the pencil ::

            | F^T               0 |       | I  C C^T / r |
            | (S S^T / r - Q)   I | - z * | 0  F         |

        K itself is not needed. The states are scaled so that C C^T / r and S S^T / r - Q have the
        same norm for any unit of y.

        References
        ----------
        .. [1] T. Pappas, A. Laub, N. Sandell, IEEE Trans. Automatic Control 25 (1980) 631-641.
        """
        (C,), n = self.C, len(self.A)
        Q, S, r = self.covariance[:n, :n], self.covariance[:n, n], float(self.covariance[n, n])
        if not r > 0:
            return None
        F = self.A - np.outer(S, C) / r
        gain, noise = np.outer(C, C) / r, np.outer(S, S) / r - Q
        sizes = float(np.linalg.norm(gain)), float(np.linalg.norm(noise))
        scale = np.sqrt(sizes[1] / sizes[0]) if all(sizes) else 1.0
        left, right = np.eye(2 * n), np.eye(2 * n)
        left[:n, :n], left[n:, :n] = F.T, noise / scale
        right[:n, n:], right[n:, n:] = gain * scale, F
        real, imaginary, over, *_, failed = dggev(left, right, compute_vl=0, compute_vr=0)
        with np.errstate(all="ignore"):
            z = (real + 1j * imaginary) / over
        z = z[np.argsort(np.where(np.isnan(z), np.inf, np.abs(z)))][:n]
        return None if failed or not np.isfinite(z).all() else np.asarray(z)

    def gain(self) -> Array:
        """Return the gain K (n, ny) of the steady Kalman filter; 0 if there is none."""
        n = len(self.A)
        Q, S, R = self.covariance[:n, :n], self.covariance[:n, n:], self.covariance[n:, n:]
        try:
            P = solve_discrete_are(self.A.T, self.C.T, Q, R, s=S)
            K = np.linalg.solve(self.C @ P @ self.C.T + R, self.C @ P @ self.A.T + S.T).T
        except (LinAlgError, ValueError):
            return np.zeros((n, len(self.C)))
        return np.asarray(K)


def realise(w: Windows, decomposition: SubspaceProjection, n: int) -> Realisation:
    """Return A, C and the covariance of the noise for n states.

    A is computed from the shift invariance of the observability matrix. The covariance is that of
    the residuals of a regression of x(t + 1) and y(t) on x(t) and u, with projected states x.
    """
    ny, nu = w.ny, w.nu
    Gamma = decomposition.U[:, :n] * np.sqrt(decomposition.singular_values[:n])
    shift = np.linalg.pinv(Gamma[:-ny])
    uf, yf = w.columns("uf"), w.columns("yf")
    X = w.R[:, w.columns("up", "yp")] @ np.linalg.lstsq(Gamma, decomposition.H, rcond=None)[0].T
    later = np.concatenate([w.columns("up"), uf[:nu], w.columns("yp"), yf[:ny]])
    regressors = w.R[:, np.concatenate([uf[nu:], later])]
    coefficients = least_squares(regressors, w.R[:, yf[ny:]])
    ahead = w.R[:, later] @ coefficients[uf.size - nu :]
    left = np.column_stack([ahead @ shift.T, w.R[:, yf[:ny]]])
    rho = without_span(np.hstack([X, w.R[:, uf]]), left)
    covariance = rho.T @ rho / max(w.N - n - uf.size, 1)
    return Realisation(A=shift @ Gamma[ny:], C=Gamma[:ny], covariance=covariance)


def long_regression(parts: Parts, lags: int, *, direct: bool) -> Array:
    """Return the coefficients (lags, ny, nu + ny) of past u and y in a regression of y."""
    blocks, right = [], []
    for u, y in parts:
        s = np.hstack([u, y])
        past = np.stack([lag_columns(x, range(1, lags + 1)) for x in s.T], axis=-1)
        now = [np.ones((len(y), 1)), *([u] if direct else [])]
        blocks.append(np.hstack([*now, past.reshape(len(y), -1)])[lags:])
        right.append(y[lags:])
    theta = least_squares(np.vstack(blocks), np.vstack(right))
    m, ny = s.shape[1], y.shape[1]
    return theta[-lags * m :].reshape(lags, m, ny).transpose(0, 2, 1)
