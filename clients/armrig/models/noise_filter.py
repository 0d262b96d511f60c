"""Innovations of noise with missing samples, by a Kalman filter or by projection.

The signal v(t) follows D v = z + C e with a known input z. Its state-space model is ::

    x(t+1) = Phi x(t) - d z(t) + K e(t),    v(t) = x_1(t) + z(t) + e(t)

Phi is the companion matrix of D in observer form, and K is c - d. Without missing samples the
filter is e = (D v - z)/C. After a missing sample the state is uncertain: the innovation has s times
the variance of e, and the gain differs from K. Both depend on the pattern of the missing samples
only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armrig.models.innovations_filter import InnovationsFilter, innovations_filter
from armrig.models.state_space import StateSpace
from armrig.numerics.missing_samples import MissingSamples, missing_samples
from armrig.numerics.polynomial import Array, apply_filter, impulse, lag_columns
from armrig.numerics.stretches import Mask

_MOST_VALUES = 1 << 23  # values of the states that are computed at once


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseFilter:
    """Filter from v and z to the innovations, which are scaled to the variance of e.

    Each innovation is divided by the square root of s(t), its variance over the variance of e. The
    state before the first sample is 0. An unknown state has the effect of pulses of z at the first
    samples. The values of missing samples do not matter.
    """

    filter: InnovationsFilter
    """Filter with the input z and the output v."""
    orders: tuple[int, int]
    """Orders nc and nd."""

    @property
    def log_scale(self) -> float:
        """Sum of log s(t) over the measured samples."""
        return self.filter.log_det

    def predictions(self, v: Array, z: Array) -> Array:
        """Return the predictions of v (N,) from its measured past."""
        v, z = v[:, None, None], z[:, None, None]
        return self.filter.outputs(self._states(v, z), z)[:, 0, 0]

    def innovations(self, v: Array) -> Array:
        """Return the scaled innovations of v (N,) for z = 0; 0 at a missing sample."""
        return self._innovations(v[:, None], np.zeros((v.size, 1)))[:, 0]

    def responses(self, z: Array) -> Array:
        """Return the share of each z (N, k) in the scaled innovations, with the opposite sign."""
        few = max(_MOST_VALUES // (len(z) * self.filter.system.order), 1)
        blocks = [z[:, k : k + few] for k in range(0, z.shape[1], few)]
        return -np.hstack([z[:, :0], *(self._innovations(np.zeros_like(x), x) for x in blocks)])

    def derivatives(self, v: Array, z: Array) -> tuple[Array, Array]:
        """Return the derivatives of the scaled innovations of v and z, and of the sum of log s(t).

        The derivatives are with respect to (c, d): shapes (N, nc + nd) and (nc + nd,).
        """
        (nc, nd), r = self.orders, self.filter.system.order
        v, z = v[:, None, None], z[:, None, None]
        x = self._states(v, z)
        by_c, by_d = np.eye(nc, r), np.eye(nd, r)
        by = {name: np.zeros((nc + nd, r, r)) for name in "ABCDK"}
        by["A"][nc:, :, 0] = -by_d
        by["B"] = np.vstack([0 * by_c, -by_d])[:, :, None]
        by["C"], by["D"] = by["C"][:, :1], by["D"][:, :1, :1]
        by["K"] = np.vstack([by_c, -by_d])[:, :, None]
        nu = self.filter.innovations(x, z, v)[:, 0]
        slopes, by_log = self.filter.derivatives(by, x[:, 0], z[:, 0], nu)
        return slopes[:, :, 0], by_log

    def _states(self, v: Array, z: Array) -> Array:
        return self.filter.states(z, v, np.zeros((v.shape[1], self.filter.system.order)))

    def _innovations(self, v: Array, z: Array) -> Array:
        """Return the scaled innovations (N, k) of v and z (N, k)."""
        v, z = v[:, :, None], z[:, :, None]
        return self.filter.whiten(self.filter.innovations(self._states(v, z), z, v))[:, :, 0]


def noise_filter(C: Array, D: Array, rows: Mask) -> NoiseFilter:
    """Return the filter for the measured samples `rows`."""
    r = max(C.size, D.size, 2) - 1
    c, d = (np.pad(p[1:], (0, r + 1 - p.size)) for p in (C, D))
    system = StateSpace(
        A=np.eye(r, k=1) - d[:, None] * np.eye(1, r),
        B=-d[:, None],
        C=np.eye(1, r),
        D=np.eye(1),
        K=(c - d)[:, None],
    )
    state_filter = innovations_filter(system, np.eye(1), rows[:, None])
    return NoiseFilter(filter=state_filter, orders=(C.size - 1, D.size - 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseProjection:
    """Filter from v and z to errors in which the missing samples are projected out.

    Its errors are not those of `NoiseFilter`, but have the same sum of squares.
    """

    C: Array
    """Coefficients of C (nc + 1,), beginning with 1."""
    D: Array
    """Coefficients of D (nd + 1,), beginning with 1."""
    missing: MissingSamples
    """Projection on the effects of the missing samples."""

    @property
    def log_scale(self) -> float:
        """Sum of log s(t) over the measured samples."""
        return self.missing.log_det

    def innovations(self, v: Array) -> Array:
        """Return the errors (N,) of v for z = 0; the values of missing samples do not matter."""
        return self._without(apply_filter(self.D, self.C, v)[:, None])[:, 0]

    def responses(self, z: Array) -> Array:
        """Return the share of each z (N, k) in the errors, with the opposite sign."""
        return self._without(apply_filter([1.0], self.C, z.T).T) if z.size else z

    def predictions(self, v: Array, z: Array) -> Array:
        """Return v (N,) with the estimates of the missing samples."""
        v_hat = v.copy()
        e = apply_filter([1.0], self.C, apply_filter(self.D, [1.0], v) - z)
        v_hat[self.missing.at[0]] -= self.missing.values(e[:, None, None])[:, 0]
        return v_hat

    def derivatives(self, v: Array, z: Array) -> tuple[Array, Array]:
        """Return the derivatives by (c, d) of the errors of v and z, and of `log_scale`.

        Those of the errors are for fixed values of the missing samples, and projected.
        """
        v_hat, gradient = self.predictions(v, z), self.missing.log_det_gradient()[:, 0, 0]
        e = apply_filter([1.0], self.C, apply_filter(self.D, [1.0], v_hat) - z)
        at_1 = impulse(self.C, gradient.size)
        of_e, of_v = apply_filter([1.0], self.C, np.array([-e, v_hat]))
        of_H = -apply_filter(self.D, np.convolve(self.C, self.C), np.eye(1, at_1.size)[0])
        slopes, by_log = [], []
        for of_errors, of_response, p in ((of_e, of_H, self.C), (of_v, at_1, self.D)):
            slopes.append(lag_columns(of_errors, range(1, p.size)))
            by_log.append(lag_columns(of_response, range(1, p.size)).T @ gradient)
        return self._without(np.hstack(slopes)), np.concatenate(by_log)

    def _without(self, X: Array) -> Array:
        return self.missing.without(X[:, :, None])[:, :, 0]


def noise_projection(C: Array, D: Array, rows: Mask) -> NoiseProjection | None:
    """Return the filter for the measured samples `rows`; None as `missing_samples` documents."""

    def forward(x: Array) -> Array:
        return apply_filter(D, C, x[:, :, 0].T).T[:, :, None]

    missing = missing_samples(
        lambda L: forward(np.eye(L, 1)[:, :, None]),
        rows[:, None],
        forward,
        lambda x: forward(x[::-1])[::-1],
    )
    return None if missing is None else NoiseProjection(C=C, D=D, missing=missing)
