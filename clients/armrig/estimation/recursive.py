"""Recursive estimation of ARX models, sample by sample."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from armrig_core.errors import InputError
from scipy.linalg.lapack import dtrtrs

from armrig.data.argument import takes_recordings
from armrig.data.columns import Matrix, Vector
from armrig.data.dataset import Dataset
from armrig.numerics.checks import MAX_ORDER, require_integers
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RarxState:
    """State of the recursive estimate; `rarx_step` returns the next state.

    Examples
    --------
    The samples satisfy y(t) = 0.5 y(t-1) + 2 u(t-1).

    >>> state = armrig.rarx_start(na=1, nb=1)
    >>> for u, y in [(1.0, 0.0), (0.0, 2.0), (1.0, 1.0), (0.0, 2.5)]:
    ...     state = armrig.rarx_step(state, u, y)
    >>> state.determined, state.A.round(3), state.B.round(3)
    (True, array([ 1. , -0.5]), array([0., 2.]))
    """

    na: int
    """Number of a's."""
    nb: int
    """Number of b's."""
    nk: int
    """Samples before u reaches y."""
    forgetting: float
    """Forgetting factor lambda: a sample k steps ago has the weight lambda^k."""
    R: Matrix
    """Triangular factor of the weighted [Phi y], (d + 1, d + 1), d = na + nb."""
    u: Vector
    """Inputs u(t) … u(t - nk - nb + 2), latest first, NaN if not known."""
    y: Vector
    """Outputs y(t) … y(t - na + 1), latest first, NaN if not known."""
    weight: float
    """Sum of the samples' weights: the effective number of samples."""
    error: float
    """Prediction error of the last sample with the previous parameters; NaN if it is unknown."""

    @property
    def theta(self) -> Vector:
        """Parameters a1 … a_na b1 … b_nb (d,); 0 in directions that are not excited yet."""
        T, z = self.R[:-1, :-1], self.R[:-1, -1]
        if _well_conditioned(T):
            return np.asarray(dtrtrs(T, z)[0])
        return np.asarray(orthonormal(T).coefficients(z))

    @property
    def determined(self) -> bool:
        """True if the samples so far determine all parameters."""
        T = self.R[:-1, :-1]
        return _well_conditioned(T) or orthonormal(T).rank == self.na + self.nb

    @property
    def noise_variance(self) -> float:
        """Weighted sum of squared errors divided by its degrees of freedom; NaN if there are none.

        With the weights w = lambda^k the degrees of freedom are sum w - d (sum w²) / (sum w), their
        expected number for white noise and a stationary input.
        """
        degrees = self.weight - (self.na + self.nb) * self._share
        return float(self.R[-1, -1] ** 2 / degrees) if degrees > 0 else float("nan")

    @property
    def std(self) -> Vector:
        """Standard deviations of theta (d,), for white noise; inf if theta is not determined.

        With the weights w = lambda^k, where lambda is `forgetting`, the covariance is s² G^-1 (sum
        of w² phi phi^T) G^-1. G is the sum of w phi phi^T, and s² is `noise_variance`. For a
        stationary input the middle factor is G (sum of w²) / (sum of w).
        """
        if not self.determined:
            return np.full(self.na + self.nb, np.inf)
        W = orthonormal(self.R[:-1, :-1]).W
        variance = self._share * self.noise_variance * np.einsum("ij,ij->i", W, W)
        return np.asarray(np.sqrt(variance))

    @property
    def _share(self) -> float:
        """Ratio (sum of w²) / (sum of w) of the weights w of the samples."""
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
    """Return whether the triangular matrix T is far from singular, by a fast test."""
    return bool(np.abs(np.diag(T)).min() > 1e-6 * np.abs(T).max())


def rarx_start(*, na: int, nb: int, nk: int = 1, forgetting: float = 1.0) -> RarxState:
    """Return the state of the recursive estimate before the first sample.

    Parameters
    ----------
    na, nb : int
        Numbers of coefficients of A and of B, na >= 0 and nb >= 1.
    nk : int, default 1
        Number of samples before u reaches y; 0 means a direct term.
    forgetting : float, default 1
        Factor lambda in (0, 1]; the memory is about 1/(1 - lambda) samples, and unlimited for
        lambda = 1.

    Raises
    ------
    ValueError
        An order or `forgetting` is out of range.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 11.2.

    Examples
    --------
    >>> state = armrig.rarx_start(na=2, nb=2, forgetting=0.99)
    >>> state.determined, state.theta
    (False, array([0., 0., 0., 0.]))
    """
    require_integers(MAX_ORDER, na=(na, 0), nb=(nb, 1), nk=(nk, 0))
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
    """Return the state after the sample at time t.

    u is applied from t on, and y is measured at t. A missing value is NaN.

    The triangular factor R of the earlier rows is multiplied by the square root of the forgetting
    factor. Rotations then add the row [phi y] to R. The result equals, except for rounding, the
    weighted least-squares estimate. A row that depends on a missing y changes neither R nor the
    weights.

    Examples
    --------
    >>> data = armrig.example_recording().dataset("alpha")[:500]
    >>> state = armrig.rarx_start(na=2, nb=2, forgetting=0.99)
    >>> for u, y in zip(data.u, data.y, strict=True):
    ...     state = armrig.rarx_step(state, u, y)
    >>> state.A.round(1)
    array([ 1. , -1.9,  0.9])
    """
    inputs = np.append(u, state.u)
    phi = np.append(-state.y, inputs[state.nk : state.nk + state.nb])
    after = replace(
        state, u=inputs[: state.u.size], y=np.append(y, state.y)[: state.na], error=float("nan")
    )
    row = np.append(phi, y)
    if not np.isfinite(row).all():
        return after
    error = float(y - phi @ state.theta) if state.weight else float("nan")
    R = np.linalg.qr(np.vstack([sqrt(state.forgetting) * state.R, row]), mode="r")
    return replace(after, R=np.asarray(R), weight=state.forgetting * state.weight + 1, error=error)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecursiveEstimate:
    """Recursive estimate after every sample of a data set, returned by `rarx`."""

    theta: Matrix
    """Parameters after each sample, (N, d); NaN until they are determined."""
    error: Vector
    """Prediction error of each sample, (N,), NaN where the error is unknown."""
    state: RarxState
    """State after the last sample."""


@takes_recordings
def rarx(
    data: Dataset, *, na: int, nb: int, nk: int = 1, forgetting: float = 1.0
) -> RecursiveEstimate:
    """Return the parameters of an ARX model after each sample.

    `rarx_start` documents the arguments. At the start of each experiment, earlier values of u and y
    are unknown. The parameters from the previous experiment are kept.

    Examples
    --------
    After the last sample, the result equals the result of `arx`.

    >>> import numpy as np
    >>> data = armrig.example_recording().dataset("alpha")
    >>> estimate = armrig.rarx(data, na=3, nb=3)
    >>> estimate.theta.shape
    (3000, 6)
    >>> np.allclose(estimate.theta[-1], armrig.arx(data, na=3, nb=3).theta)
    True
    """
    state = rarx_start(na=na, nb=nb, nk=nk, forgetting=forgetting)
    fresh = state
    theta, error, determined = np.full((data.N, na + nb), np.nan), np.full(data.N, np.nan), False
    starts = set(data.starts)
    for t in range(data.N):
        if t in starts:
            state = replace(state, u=fresh.u, y=fresh.y)
        state = rarx_step(state, float(data.u[t]), float(data.y[t]))
        determined = determined or state.determined
        if determined:
            theta[t], error[t] = state.theta, state.error
    return RecursiveEstimate(theta=theta, error=error, state=state)
