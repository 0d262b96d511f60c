"""Correlation of residuals with missing values (NaN), and tests of whiteness."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isnan, log10, sqrt

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.numerics.criteria import aic
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array
from armrig.numerics.quantities import p_relation

Vector = NDArray[np.float64]

WHITE_LEVEL = 0.01
"""Each test of residuals in this package rejects whiteness if the p value is below this number."""
BAND_99_PERCENT = 2.58
"""Two-sided 99 % quantile of the normal distribution."""
PORTMANTEAU = "portmanteau test"
LJUNG_BOX = "Ljung-Box test"
SCALED = "scaled Ljung-Box test"
_MIN_SIZE = 0.1  # least size of a tested combination of effects, relative to the largest
_ROBUST_LIMIT = 3.5  # robust standard deviations at which residuals are cut off
_MAX_BURG = 100_000  # residuals; the bias of Yule and Walker's equations is of the order 1/N
_MIN_EIGENVALUE = 0.1  # least eigenvalue of V^-1/2 M V^-1/2 for the portmanteau test


@dataclass(frozen=True, slots=True, kw_only=True)
class Whiteness:
    """Result of a test of whiteness."""

    p_value: float
    """p value of the hypothesis that the residuals are white; NaN if there was no test."""
    test: str
    """Name of the test; "" if it is not known."""
    ljung_box: float = float("nan")
    """p value of the Ljung-Box test, which does not allow for uncertain parameters; NaN if it was
    not compared."""

    @property
    def unclear(self) -> bool:
        """True if only the Ljung-Box test rejects whiteness at `WHITE_LEVEL`."""
        return self.p_value >= WHITE_LEVEL > self.ljung_box

    @property
    def coloured(self) -> bool:
        """True if the test rejects whiteness at `WHITE_LEVEL`."""
        return self.p_value < WHITE_LEVEL

    @property
    def doubtful(self) -> bool:
        """True if one of the two tests rejects whiteness at `WHITE_LEVEL`."""
        return self.coloured or self.unclear

    def __str__(self) -> str:
        """Return the text that follows "residuals": coloured (p < 0.001, Ljung-Box test)."""
        if isnan(self.p_value):
            return "not tested (too few, or all zero)"
        by = f", {self.test}" if self.test else ""
        if self.unclear:
            box = f"p {p_relation(self.ljung_box)}, {LJUNG_BOX}"
            return f"perhaps coloured (p {p_relation(self.p_value)}{by}; {box})"
        return f"{'coloured' if self.coloured else 'white'} (p {p_relation(self.p_value)}{by})"


NOT_TESTED = Whiteness(p_value=float("nan"), test="")


def join_residuals(parts: Iterable[Vector], gap: int) -> Vector:
    """Return the residuals of all experiments as one signal, with `gap` NaNs after each."""
    pieces = [np.concatenate([part, np.full(gap, np.nan)]) for part in parts]
    return np.concatenate(pieces)


def autocovariance(e: Vector, lags: int) -> tuple[Vector, Vector]:
    """Return the autocovariances R(0) … R(lags) for mean 0, and the number of pairs at each lag."""
    there = np.isfinite(e)
    e, mark = np.where(there, e, 0.0), there.astype(np.float64)
    N = e.size
    count = np.array([mark[k:] @ mark[: N - k] for k in range(lags + 1)])
    total = np.array([e[k:] @ e[: N - k] for k in range(lags + 1)])
    return total / np.maximum(count, 1.0), count


def ljung_box(e: Vector, lags: int, parameters: int = 0) -> float:
    """Return the p value of the hypothesis that e is white.

    Q = (N + 2)/N sum of n_k r(k)², k = 1 … lags, is chi-squared with `lags - parameters` degrees of
    freedom. n_k is the number of pairs at lag k, which is N - k if no sample is missing.
    `parameters` is the number of noise parameters that were fitted to the same data.

    References
    ----------
    .. [1] G. M. Ljung, G. E. P. Box, Biometrika 65 (1978) 297-303.
    """
    from scipy.special import chdtrc

    R, count = autocovariance(e, lags)
    N = count[0]
    degrees = lags - parameters
    if N < 2 or R[0] == 0 or degrees < 1:
        return float("nan")
    # For r(k) from sums, Var r(k) is (N - k) / N². For r(k) from means over pairs, it is 1/n_k. The
    # factor (N + 2)/N corrects the level for small N.
    Q = (N + 2) / N * float(np.sum(count[1:] * (R[1:] / R[0]) ** 2))
    return float(chdtrc(degrees, Q))


def autoregression(
    residuals: Sequence[Vector],
    criterion: Callable[[float, int, int], Array] = aic,
    least: float = 0.0,
) -> tuple[Vector, float]:
    """Return C and s² of the autoregression C e = white noise of variance s², for all experiments.

    The order has the least value of the criterion, by default AIC. Residuals whose rms is at most
    `least` are rounding errors: they have the order 0 and the variance least².

    Burg's recursion minimises the forward and backward errors of each order. C is therefore
    stable, and nearly unbiased for a resonance in short data, unlike that of Yule and Walker [2]_.
    These equations determine C only if most stretches without a missing sample are too short, or
    the data are so long that they are quicker and as exact. For white residuals the order is
    usually 0.

    References
    ----------
    .. [1] P. Stoica, R. Moses, *Spectral Analysis of Signals*, 2005, sections 3.4-3.5 and 3.9.3.
    .. [2] M. J. L. de Hoon et al., "Why Yule-Walker should not be used for autoregressive
       modelling", Ann. Nucl. Energy 23 (1996) 1219-1228.
    """
    N = sum(int(np.count_nonzero(np.isfinite(e))) for e in residuals)
    if sum(float(np.nansum(e**2)) for e in residuals) <= N * least**2:
        return np.ones(1), least**2
    highest = min(int(10 * log10(max(N, 10))), N // 10)
    e = join_residuals(residuals, 1)[:-1]
    measured = np.isfinite(e)  # a value that depends on a missing sample is 0
    ahead = behind = np.where(measured, e, 0.0)
    full_windows = np.convolve(measured, np.ones(highest + 1, dtype=int), "valid") > highest
    burg = N <= _MAX_BURG and 2 * np.count_nonzero(full_windows) >= N
    R, pairs = autocovariance(join_residuals(residuals, highest), 0 if burg else highest)
    # A correlation of few pairs varies more, so that N counts less in the criterion.
    each = np.array([int(np.count_nonzero(np.isfinite(e))) for e in residuals])
    lags = np.array([highest]) if burg else np.arange(1, highest + 1)
    pairs = np.array([np.count_nonzero(full_windows)]) if burg else pairs[1:]
    possible = np.maximum(each - lags[:, None], 0).sum(axis=1)
    n = int(N * min(np.min(pairs / np.maximum(possible, 1), initial=1.0), 1.0))
    highest = min(highest, n // 10)
    s2, order = float(R[0]), 0
    lowest, best = float(criterion(s2, 0, n)), (np.ones(1), s2)
    C = np.eye(1, highest + 1)[0]
    while order < highest and s2 > 0:
        order += 1
        if burg:
            ahead, behind = ahead[1:], behind[:-1]
            if e.size > N:
                measured = measured[1:] & measured[:-1]
                ahead, behind = ahead * measured, behind * measured
            power = float(ahead @ ahead + behind @ behind)
            reflection = -2 * float(ahead @ behind) / max(power, 1e-300)
            ahead, behind = ahead + reflection * behind, behind + reflection * ahead
        else:
            reflection = -float(C[:order] @ R[order:0:-1]) / s2
        if abs(reflection) >= 1:  # missing samples can make R indefinite
            break
        C[: order + 1] += reflection * C[order::-1]
        s2 *= 1 - reflection**2
        value = float(criterion(s2, order, n))
        if value < lowest:
            lowest, best = value, (C[: order + 1].copy(), s2)
    w = np.convolve(e, best[0], "valid")
    w = w[np.isfinite(w)]
    if not burg and w @ w > w.size * R[0]:  # correlations of few pairs need not be those of a noise
        return np.ones(1), float(R[0])
    return best


def default_lags(N: int) -> int:
    """Return the number of lags of a residual test: 25 as in MATLAB, fewer for short data."""
    return max(min(25, N // 4), 1)


def portmanteau(
    residuals: Sequence[Vector],
    blocks: Sequence[Array],
    spans: Sequence[Array],
    lags: int,
    theta_covariance: Array | None = None,
    Q: Array | None = None,
) -> Whiteness:
    """Test the hypothesis that e is white, with allowance for the estimated parameters.

    The sums s_k of e(t) e(t - k), k = 1 ... lags, are tested jointly by the statistic (s - m)^T
    M^-1 (s - m). The residuals are the noise minus the projection Q Q^T of the noise on the fitted
    responses. This projection shifts the mean m of the sums and reduces their covariance M. If the
    columns of Z are the lagged residuals, then ::

        m_k = -R(0) sum of q(t)^T q(t - k),     q(t)^T the rows of Q
        M = V - R(0) Z^T Q Q^T Z   [ + (Z^T Psi) cov(theta) (Psi^T Z) on other data ]

    Q spans the free responses and, on estimation data, also Psi. V = R(0)² N/(N + 2) diag(pairs at
    each lag) is the variance for a known model, as in the test of Ljung and Box. After the fit of d
    quantities, R(0) is smaller than the variance of the noise by the factor 1 - d/N, and V is
    divided by this factor. Without it, the test rejects 13 % of an ARMAX model's white residuals at
    N = 100 and the level 5 %, and 8 % with it. The Lagrange multiplier test has R(0) Z^T Z instead
    of V. At N = 500 and the level 5 %, it rejects only 3.5 % of white residuals.

    M is derived for white residuals. For coloured residuals Z^T Z is far from R(0) N I, and the
    subtracted term may exceed V. M is then indefinite in the directions that show the colour. If
    only the noise determines a parameter, as in a pure autoregression, an eigenvalue of M is 0. The
    estimate of this eigenvalue may have either sign. Therefore, if an eigenvalue of V^-1/2 M V^-1/2
    is below 0.1, the Ljung-Box test replaces the portmanteau test. The Ljung-Box test weights the
    lags by V^-1 ::

        (s - m)^T V^-1 (s - m)     against chi-squared with tr(V^-1 M) degrees of freedom

    The degrees of freedom are the mean of the statistic under the hypothesis. A negative eigenvalue
    of V^-1/2 M V^-1/2 counts as 0. Let x be the eigenvalues. If the ratio (sum of x²)/(sum of x)
    exceeds 1, the statistic and the degrees of freedom are divided by this ratio. The variance of
    the statistic is then also correct. If only the noise determines A, C and D, the number of
    degrees of freedom is lags - na - nc - nd, as given by Ljung and Box. A parameter that the input
    determines, such as any parameter of an OE model, does not reduce the degrees of freedom.

    Each experiment has residuals (N_i,), NaN if they are not known, a block Psi (N_i, d), and a
    span (N_i, r_i). Psi contains the derivatives of the prediction with respect to theta, minus
    their projection on the free response. The span is an orthonormal basis of the free response.
    Both are zero in the rows without a residual. `theta_covariance` (d, d) is given if the
    parameters were estimated from other data. Q is an orthonormal basis of the columns of all
    blocks, if it is known.

    References
    ----------
    .. [1] L. G. Godfrey, Econometrica 46 (1978) 1303-1310 (the Lagrange multiplier form).
    .. [2] G. M. Ljung, G. E. P. Box, Biometrika 65 (1978) 297-303.
    """
    N = sum(int(np.count_nonzero(np.isfinite(part))) for part in residuals)
    R, pairs = autocovariance(join_residuals(residuals, lags), lags)
    d = sum(s.shape[1] for s in spans)
    if lags + d + blocks[0].shape[1] >= N or R[0] == 0:
        return NOT_TESTED
    d += blocks[0].shape[1] * (theta_covariance is None)
    Psi = np.vstack(blocks)
    edges = np.cumsum([0, *(e.size for e in residuals)])
    if theta_covariance is not None:
        Q = np.zeros((Psi.shape[0], 0))
    fitted = orthonormal(Psi).Q if Q is None else Q
    V = R[0] ** 2 * pairs[1:] * N / (N + 2) * N / (N - d)
    M = np.diag(V)
    m = np.zeros(lags)
    by_fitted, by_theta = np.zeros((lags, fitted.shape[1])), np.zeros((lags, Psi.shape[1]))
    for part, whole_span, (a, b) in zip(residuals, spans, pairwise(edges), strict=True):
        e, rows = np.nan_to_num(part), np.flatnonzero(whole_span.any(axis=1))
        span = whole_span[: rows[-1] + 1] if rows.size else whole_span[:0]
        m -= R[0] * (_autocorrelation(span, lags) + _autocorrelation(fitted[a:b], lags))
        explained = _with_past(e, span, lags)
        M -= R[0] * explained @ explained.T
        by_fitted = by_fitted + _with_past(e, fitted[a:b], lags)
        if theta_covariance is not None:
            by_theta = by_theta + _with_past(e, Psi[a:b], lags)
    M -= R[0] * by_fitted @ by_fitted.T
    if theta_covariance is not None:
        M += by_theta @ theta_covariance @ by_theta.T
    return whiteness_of_sums(pairs[1:] * R[1:] - m, M, V, N)


def whiteness_of_sums(s: Vector, M: Array, V: Vector, N: int) -> Whiteness:
    """Return the test of the sums s with weights M^-1, or 1/V if M is nearly indefinite."""
    used = V > 0
    z = s[used] / np.sqrt(V[used])
    value, vector = np.linalg.eigh(M[np.ix_(used, used)] / np.sqrt(np.outer(V[used], V[used])))
    if value.size and value[0] > _MIN_EIGENVALUE:
        Q, degrees, test = float(np.sum((vector.T @ z) ** 2 / value)), float(z.size), PORTMANTEAU
    else:
        # Scale times chi-squared has the mean of z^T z and, if scale > 1, also its variance.
        value = np.maximum(value, 0.0)
        scale = max(1.0, float(np.sum(value**2) / max(np.sum(value), 1e-300)))
        Q, degrees = float(z @ z) / scale, float(np.sum(value)) / scale
        test = LJUNG_BOX if scale == 1 else SCALED
    return Whiteness(p_value=portmanteau_p_value(Q, max(degrees, 1.0), N), test=test)


def _with_past(e: Vector, M: Array, lags: int) -> Array:
    """Return the sums (lags, d) of e(t - k) m(t)^T, k = 1 … lags, over the rows m(t)^T of M."""
    # A single matrix product would be slower: it needs copies of e at all 25 lags.
    n = M.shape[0]
    before = np.concatenate([np.zeros(lags), e[:n]])
    return np.array([before[lags - k : lags - k + n] @ M for k in range(1, lags + 1)])


def _autocorrelation(Q: Array, lags: int) -> Array:
    """Return the sums of q(t)^T q(t - k), k = 1 … lags, over the rows q(t)^T of Q (N, r)."""
    none = np.zeros(lags)
    sums = [np.correlate(np.concatenate([q, none]), q)[1:] for q in Q.T if q.size]
    return np.sum(sums, axis=0) if sums else none


def portmanteau_p_value(Q: float, m: float, N: float) -> float:
    """Return P(Q' >= Q) for a portmanteau statistic Q' with m degrees of freedom.

    Q' is computed from N white residuals. The mean of Q' is m, but its variance is not 2 m, because
    all r(k)² are divided by the same R(0)² and contain the same residuals. The variance was
    simulated with 60 000 runs for each combination of N = 100, 250, 500 and m = 5, 10, 25. For N >=
    250 the simulated variance was 2 m (1 + c). The number c differed from (2 m - 5.5)/N by at most
    0.02. At N = 500, m = 25 and the level 5 %, a chi-squared test would reject 5.8 % of white
    residuals. Therefore Q/m is compared with an F(m, v) distribution, scaled to the mean 1. The
    parameter v is chosen so that this distribution has the simulated variance.

    References
    ----------
    .. [1] N. Davies, C. M. Triggs, P. Newbold, Biometrika 64 (1977) 517-522.
    """
    from scipy.special import chdtrc, fdtrc

    if m == 0:
        return float("nan")
    c = (2 * m - 5.5) / N
    if c <= 0:
        return float(chdtrc(m, Q))
    v = 4 + (m + 2) / c
    return float(fdtrc(m, v, Q / m * v / (v - 2)))


def two_sided(level: float) -> float:
    """Return z with P(|x| < z) = level for a standard normal x: 1.96 for 0.95."""
    from scipy.special import erfinv

    if not 0 < level < 1:
        raise InputError(f"level={level!r} must lie between 0 and 1, for example 0.95")
    return sqrt(2) * float(erfinv(level))


def joint_p_value(
    s: Array,
    M: Array,
    least: float = 1e-8,
    N: float | None = None,
    *,
    independent: bool = False,
) -> float:
    """Return P(chi² >= s^T M^+ s); the degrees of freedom are the rank of M. NaN for rank 0.

    An eigenvector of the correlation matrix of s does not count if its eigenvalue is less than the
    share `least` of the largest. Give N if the noise variance in M is an estimate with N degrees of
    freedom. Then s^T M^+ s / N has the beta distribution with the parameters k/2 and (N - k)/2,
    where k is the rank. For large k a chi-squared test would reject too rarely. If the estimate is
    `independent` of s, because it is from other data, s^T M^+ s / k has an F(k, N) distribution.
    """
    from scipy.special import betainc, chdtrc, fdtrc

    scale = np.sqrt(np.maximum(np.diag(M), 0.0))
    used = scale > 1e-10 * max(float(scale.max(initial=0.0)), 1e-300)
    if not used.any():
        return float("nan")
    s, M = s[used] / scale[used], M[np.ix_(used, used)] / np.outer(scale[used], scale[used])
    value, vector = np.linalg.eigh(M)
    kept = value > least * value[-1]
    z = vector[:, kept].T @ s
    k, Q = int(np.count_nonzero(kept)), np.sum(z**2 / value[kept])
    if N is None:
        return float(chdtrc(k, Q))
    if independent:
        return float(fdtrc(k, max(N, 1.0), Q / k))
    if k >= N:
        return float("nan")
    return float(betainc((N - k) / 2, k / 2, max(1.0 - Q / N, 0.0)))


def effects_p_value(e: Array, effects: Array, most: int, degrees: int) -> float:
    """Return the p value of the hypothesis that e (N,) is not correlated with any effect (N, k).

    At most `most` principal combinations of the effects are tested jointly. Large e are cut off at
    3.5 robust standard deviations. `degrees` are the degrees of freedom of the variance of e.
    """
    robust = 1.4826 * float(np.median(np.abs(e)))
    if robust == 0 or not effects.size:
        return float("nan")
    U, S, _ = np.linalg.svd(effects / np.linalg.norm(effects, axis=0), full_matrices=False)
    U = U[:, _MIN_SIZE * S[0] < S][:, :most]
    e = np.clip(e, -_ROBUST_LIMIT * robust, _ROBUST_LIMIT * robust)
    return joint_p_value(U.T @ e, np.eye(U.shape[1]) * float(e @ e) / degrees, N=degrees)
