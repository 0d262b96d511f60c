"""ARX estimated sample by sample, for a stream that does not end."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtrs

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.numerics.checks import require_integers
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RarxState:
    """All that is known after some samples; `rarx_step` gives the next one."""

    na: int
    """Number of a's."""
    nb: int
    """Number of b's."""
    nk: int
    """Samples before u reaches y."""
    forgetting: float
    """lambda: a sample k steps ago weighs lambda^k."""
    R: Matrix
    """Triangle of the weighted [Phi y], (d + 1, d + 1), d = na + nb."""
    u: Vector
    """u(t) … u(t - nk - nb + 2), latest first, NaN where not known."""
    y: Vector
    """y(t) … y(t - na + 1), latest first, NaN where not known."""
    weight: float
    """Sum of the samples' weights: the effective number of samples."""
    error: float
    """Prediction error of the last sample with the parameters before it; NaN without any."""

    @property
    def theta(self) -> Vector:
        """a1 … a_na b1 … b_nb (d,); zero in directions that nothing has excited yet."""
        T, z = self.R[:-1, :-1], self.R[:-1, -1]
        if _well_conditioned(T):
            return np.asarray(dtrtrs(T, z)[0])
        return np.asarray(orthonormal(T).coefficients(z))

    @property
    def determined(self) -> bool:
        """The samples so far determine all parameters."""
        T = self.R[:-1, :-1]
        return _well_conditioned(T) or orthonormal(T).rank == self.na + self.nb

    @property
    def noise_variance(self) -> float:
        """Weighted squared error over its degrees of freedom; NaN while there are none.

        Those are sum w - d (sum w²) / (sum w): white noise's own expectation, for a steady input.
        """
        degrees = self.weight - (self.na + self.nb) * self._share
        return float(self.R[-1, -1] ** 2 / degrees) if degrees > 0 else float("nan")

    @property
    def std(self) -> Vector:
        """Standard deviations of theta (d,), for white noise; inf while it is not determined.

        Weighted by w = lambda^k the covariance is s² G^-1 (sum of w² phi phi^T) G^-1, with G the
        sum of w phi phi^T; for a steady input the middle is G times (sum of w²) / (sum of w).
        """
        if not self.determined:
            return np.full(self.na + self.nb, np.inf)
        W = orthonormal(self.R[:-1, :-1]).W
        variance = self._share * self.noise_variance * np.einsum("ij,ij->i", W, W)
        return np.asarray(np.sqrt(variance))

    @property
    def _share(self) -> float:
        """(sum of w²) / (sum of w)."""
        return (2 - self.weight * (1 - self.forgetting)) / (1 + self.forgetting)

    @property
    def A(self) -> Vector:
        """Coefficients in q^-1, beginning with 1."""
        return np.append(1.0, self.theta[: self.na])

    @property
    def B(self) -> Vector:
        """Coefficients in q^-1, beginning with nk zeros."""
        return np.append(np.zeros(self.nk), self.theta[self.na :])


def _well_conditioned(T: Array) -> bool:
    """Tell, quickly, that the triangle is far from singular."""
    return bool(np.abs(np.diag(T)).min() > 1e-6 * np.abs(T).max())


def rarx_start(*, na: int, nb: int, nk: int = 1, forgetting: float = 1.0) -> RarxState:
    """Return the state before the first sample.

    Parameters
    ----------
    na, nb : int
        Number of a's, >= 0, and of b's, >= 1.
    nk : int, default 1
        Samples before u reaches y; 0 is a direct term.
    forgetting : float, default 1
        lambda in (0, 1]: some 1/(1 - lambda) samples are remembered, 1 forgets nothing.

    Raises
    ------
    ValueError
        An order or `forgetting` is out of range.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 11.2.
    """
    require_integers(na=(na, 0), nb=(nb, 1), nk=(nk, 0))
    if not 0 < forgetting <= 1:
        raise InputError(f"forgetting={forgetting!r} must be above 0 and at most 1, such as 0.99")
    d = na + nb
    return RarxState(
        na=na,
        nb=nb,
        nk=nk,
        forgetting=float(forgetting),
        R=np.zeros((d + 1, d + 1)),
        u=np.full(nk + nb - 1, np.nan),
        y=np.full(na, np.nan),
        weight=0.0,
        error=float("nan"),
    )


def rarx_step(state: RarxState, u: float, y: float) -> RarxState:
    """Return the state after a sample: u applied from t on, y measured at t, NaN if missing.

    The row [phi y] is rotated into the triangle of those before it, each older row weighing
    sqrt(lambda) less: after N steps this is the weighted least-squares estimate of all samples, to
    rounding, with no covariance matrix that could lose its sign. A row that looks back on a
    missing y leaves everything as it is, and forgets nothing.
    """
    inputs = np.append(u, state.u)
    phi = np.append(-state.y, inputs[state.nk : state.nk + state.nb])
    after = replace(
        state,
        u=inputs[: state.u.size],
        y=np.append(y, state.y)[: state.na],
        error=float("nan"),
    )
    row = np.append(phi, y)
    if not np.isfinite(row).all():
        return after
    error = float(y - phi @ state.theta) if state.weight else float("nan")
    R = _rotated(sqrt(state.forgetting) * state.R, row)
    return replace(after, R=R, weight=state.forgetting * state.weight + 1, error=error)


def _rotated(R: Array, row: Array) -> Array:
    return np.asarray(np.linalg.qr(np.vstack([R, row]), mode="r"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecursiveEstimate:
    """What `rarx` found on the way."""

    theta: Matrix
    """Parameters after each sample, (N, d); NaN until they are determined."""
    error: Vector
    """Prediction error of each sample, (N,), NaN where there is none."""
    state: RarxState
    """After the last sample."""


@takes_recordings
def rarx(
    data: Dataset, *, na: int, nb: int, nk: int = 1, forgetting: float = 1.0
) -> RecursiveEstimate:
    """Return the parameters of an ARX model after each sample, see `rarx_start`.

    Nothing is looked back on across the boundary of two experiments; the parameters go on.
    """
    state = rarx_start(na=na, nb=nb, nk=nk, forgetting=forgetting)
    fresh = state
    theta, error, known = np.full((data.N, na + nb), np.nan), np.full(data.N, np.nan), False
    starts = set(data.starts)
    for t in range(data.N):
        if t in starts:
            state = replace(state, u=fresh.u, y=fresh.y)
        state = rarx_step(state, float(data.u[t]), float(data.y[t]))
        known = known or state.determined
        if known:
            theta[t], error[t] = state.theta, state.error
    return RecursiveEstimate(theta=theta, error=error, state=state)
