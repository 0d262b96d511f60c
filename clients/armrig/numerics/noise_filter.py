"""Innovations of noise with missing samples, by a Kalman filter.

The signal v(t) follows D v = z + C e with a known input z. Its state-space model is ::

    x(t+1) = Phi x(t) - d z(t) + K e(t),    v(t) = x_1(t) + z(t) + e(t)

Phi is the companion matrix of D in observer form, and K is c - d. Without missing samples the
filter is e = (D v - z)/C. After a missing sample the state is uncertain, with a covariance P in
units of the variance of e. The variance of the innovation is then s = 1 + P_11, and the gain of
the filter differs from K. Both depend on the pattern of the missing samples only. In n samples
after a gap, P changes from P_0 to F^n (inv(P_0) + W_n)^-1 F^nT. F is the companion matrix of C, and
W_n is the sum of w_i w_i^T for i < n, with the first row w_i of F^i.

References
----------
.. [1] R. H. Jones, Technometrics 22 (1980) 389-395.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtbtrs

from armrig.numerics.polynomial import Array
from armrig.numerics.stretches import Mask, stretches

_SETTLED_SIZE = 1e-7  # largest entry of F^n at which P, which has its square, counts as 0
_COMPLEX_STEP = 1e-20


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseFilter:
    """Filter from v and z to the innovations, which are scaled to the variance of e.

    Each innovation is divided by the square root of s(t), its variance over the variance of e. The
    state before the first sample is 0. An unknown state has the effect of pulses of z at the first
    `memory` samples.
    """

    C: Array
    """Coefficients of C (nc + 1,), beginning with 1."""
    D: Array
    """Coefficients of D (nd + 1,), beginning with 1."""
    rows: Mask
    """Mask (N,), False where v is missing."""
    gain: Array
    """Gain of the innovation v - x_1 - z at each sample, (N, r)."""
    s: Array
    """Variance of the innovation divided by the variance of e, (N,); 1 at a missing sample."""

    @property
    def memory(self) -> int:
        """Dimension of the state."""
        return max(self.C.size, self.D.size) - 1

    @property
    def log_scale(self) -> float:
        """Sum of log s(t) over the measured samples."""
        return float(np.sum(np.log(self.s)))

    def predictions(self, v: Array, z: Array) -> Array:
        """Return the predictions of v (N,) from its measured past; a missing v is not used."""
        v = np.where(self.rows, v, 0.0)
        return np.asarray(self._predicted((_delayed(self.gain, v) + z)[:, None])[:, 0])

    def innovations(self, v: Array) -> Array:
        """Return the scaled innovations of v (N,) for z = 0; 0 at a missing sample."""
        return self._scaled(v - self.predictions(v, np.zeros(v.size)))

    def responses(self, z: Array) -> Array:
        """Return the share of each z (N, k) in the scaled innovations, with the opposite sign."""
        return self._scaled(self._predicted(z))

    def ahead(self, e: Array, horizon: int) -> Array:
        """Return the errors of the predictions of v from v up to t - horizon, (N,).

        e (N,) are the scaled innovations, 0 at a missing sample. The error is the sum of psi_j(t)
        nu(t - j) for j < horizon. nu is the innovation without the scale; psi_0 is 1, and psi_j(t)
        is row 1 of Phi^(j - 1) times the gain at t - j.
        """
        nu = np.sqrt(self.s) * e
        total, r = nu.copy(), self.memory
        Phi = np.eye(r, k=1) - np.pad(self.D[1:], (0, r + 1 - self.D.size))[:, None] * np.eye(1, r)
        row = np.eye(1, r)[0]
        for j in range(1, horizon):
            total[j:] += ((self.gain @ row) * nu)[:-j]
            row = row @ Phi
        return np.asarray(total)

    def derivatives(self, v: Array, z: Array) -> tuple[Array, Array]:
        """Return the derivatives of the scaled innovations of v and z, and of the sum of log s(t).

        The derivatives are with respect to (c, d): shapes (N, nc + nd) and (nc + nd,). The
        derivatives of the gains are computed by a complex step, which has no truncation error.
        """
        nc, nd = self.C.size - 1, self.D.size - 1
        if nc + nd == 0:
            return np.zeros((v.size, 0)), np.zeros(0)
        steps = 1j * _COMPLEX_STEP * np.eye(nc + nd)
        gains, variances = _gains(
            np.pad(steps[:, :nc], ((0, 0), (1, 0))) + self.C,
            np.pad(steps[:, nc:], ((0, 0), (1, 0))) + self.D,
            self.rows,
        )
        by_gain, by_s = gains.imag / _COMPLEX_STEP, variances.imag / _COMPLEX_STEP
        p = self.predictions(v, z)
        e = np.where(self.rows, v - p, 0.0)
        right = np.stack([_delayed(g, e) for g in by_gain], axis=1)
        for k in range(nd):
            right[k + 1 :, nc + k] -= p[: p.size - k - 1]
        return (
            self._scaled(-self._predicted(right) - 0.5 * (e / self.s)[:, None] * by_s.T),
            np.sum(by_s / self.s, axis=1),
        )

    def _predicted(self, right: Array) -> Array:
        """Return the predictions p of v from their equation, which is triangular and has a band."""
        r, N = self.memory, right.shape[0]
        if r == 0 or right.shape[1] == 0:
            return right
        band = np.ones((r + 1, N))
        band[1:] = np.where(self.rows, self.gain.T, 0.0)
        band[1 : self.D.size] += self.D[1:, None]
        p, _ = dtbtrs(band, right, uplo="L", diag="U")
        return np.asarray(p)

    def _scaled(self, e: Array) -> Array:
        weight = np.where(self.rows, 1 / np.sqrt(self.s), 0.0)
        return weight * e if e.ndim == 1 else weight[:, None] * e


def noise_filter(C: Array, D: Array, rows: Mask) -> NoiseFilter:
    """Return the filter for the measured samples `rows`."""
    gain, s = _gains(C[None], D[None], rows)
    return NoiseFilter(C=C, D=D, rows=rows, gain=gain[0], s=s[0])


def _delayed(gain: Array, e: Array) -> Array:
    """Return the sum of gain_i(t - i) e(t - i) over the lags i, (N,)."""
    x = np.zeros(e.size)
    for i in range(gain.shape[1]):
        x[i + 1 :] += (gain[:, i] * e)[: e.size - i - 1]
    return x


def _gains(C: Array, D: Array, rows: Mask) -> tuple[Array, Array]:
    """Return the gains (m, N, r) and variances (m, N) of m filters."""
    m, N = C.shape[0], rows.size
    r = max(C.shape[1], D.shape[1]) - 1
    c, d = (np.pad(p[:, 1:], ((0, 0), (0, r + 1 - p.shape[1]))) for p in (C, D))
    s = np.ones((m, N), dtype=c.dtype)
    gain = np.repeat((c - d)[:, None], N, axis=1)
    parts = stretches(rows)
    if r == 0 or not parts or (len(parts) == 1 and parts[0].start == 0):
        return gain, s
    e1 = np.eye(1, r)
    F = np.eye(r, k=1) - c[:, :, None] * e1
    powers = _powers(F, max(part.stop - part.start for part in parts))
    w = powers[:, :, 0]
    W = np.zeros_like(powers)
    W[:, 1:] = np.cumsum(w[:, :-1, :, None] * w[:, :-1, None, :], axis=1)
    P = _after_gaps(c, d, powers, W, parts)
    # All gaps at once, one sample after the other; the longest stretches are the first.
    lengths = np.array([part.stop - part.start for part in parts])
    order = np.argsort(-lengths, kind="stable")
    starts, lengths, M = np.array([p.start for p in parts])[order], lengths[order], P[:, order]
    for n in range(powers.shape[1] - 1):
        k = int(np.searchsorted(-lengths, -n, side="left"))  # stretches longer than n
        if k == 0:
            break
        a = np.einsum("mkij,mj->mki", M[:, :k], w[:, n])
        variance = 1 + np.einsum("mki,mi->mk", a, w[:, n])
        s[:, starts[:k] + n] = variance
        gain[:, starts[:k] + n] += (
            np.einsum("mij,mkj->mki", powers[:, n + 1], a) / variance[..., None]
        )
        M = M[:, :k] - a[..., :, None] * a[..., None, :] / variance[..., None, None]
    return gain, s


def _powers(F: Array, longest: int) -> Array:
    """Return F^0, F^1 … (m, n, r, r) until they have decayed, at most `longest` + 1 of them."""
    found = np.broadcast_to(np.eye(F.shape[1], dtype=F.dtype), F.shape)[:, None]
    step = F[:, None]
    while found.shape[1] <= longest and np.abs(found[:, -1]).max() > _SETTLED_SIZE:
        found = np.concatenate([found, found @ step], axis=1)
        step = step @ step
    return np.asarray(found[:, : longest + 1])


def _after_gaps(c: Array, d: Array, powers: Array, W: Array, parts: list[slice]) -> Array:
    """Return P (m, number of stretches, r, r) at the first sample of each stretch."""
    m, r = c.shape
    Phi = np.eye(r, k=1) - d[:, :, None] * np.eye(1, r)
    K = c - d
    through: dict[int, tuple[Array, Array]] = {}
    P, stop, found = np.zeros((m, r, r), dtype=c.dtype), 0, []
    for part in parts:
        gap = part.start - stop
        if gap not in through:
            through[gap] = _through(Phi, K[:, :, None] * K[:, None, :], gap)
        power, noise = through[gap]
        P = power @ P @ power.transpose(0, 2, 1) + noise
        found.append(P)
        n = part.stop - part.start
        if n < powers.shape[1]:
            P = _updated(P, W[:, n], powers[:, :n, 0])
            P = powers[:, n] @ P @ powers[:, n].transpose(0, 2, 1)
        else:
            P = np.zeros_like(P)
        stop = part.stop
    return np.stack(found, axis=1)


def _updated(P: Array, W: Array, w: Array) -> Array:
    """Return (inv(P) + W)^-1, (m, r, r), for the sum W of w_i w_i^T; w is (m, n, r)."""
    try:
        return np.linalg.solve(np.eye(P.shape[1]) + P @ W, P)
    except np.linalg.LinAlgError:  # P is so large that the 1 is lost: one sample after the other
        for now in w.transpose(1, 0, 2):
            a = np.einsum("mij,mj->mi", P, now)
            s = 1 + np.einsum("mi,mi->m", a, now)
            P = P - a[:, :, None] * a[:, None, :] / s[:, None, None]
        return P


def _through(Phi: Array, noise: Array, n: int) -> tuple[Array, Array]:
    """Return Phi^n, and the covariance of the noise that n steps add."""
    if n == 0:
        return np.broadcast_to(np.eye(Phi.shape[1], dtype=Phi.dtype), Phi.shape), 0 * noise
    power, total = _through(Phi, noise, n // 2)
    total = total + power @ total @ power.transpose(0, 2, 1)
    power = power @ power
    if n % 2:
        total = noise + Phi @ total @ Phi.transpose(0, 2, 1)
        power = Phi @ power
    return power, total
