"""Tests of the lag at which u acts first: by first coefficients, and by the shape of the onset."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np

from armrig.data.dataset import Dataset, Vector
from armrig.estimation.nonparametric.impulse import ImpulseResponse, with_covariance
from armrig.estimation.polynomial_structures import oe
from armrig.models.fit import Fit
from armrig.numerics.criteria import aic
from armrig.numerics.least_squares import column_norms, triangle, upper_inverse
from armrig.numerics.polynomial import apply_filter
from armrig.numerics.regressors import arx_rows, in_blocks
from armrig.numerics.rounding import rounding_std

Progress = Callable[[int, int, str], object]
"""Function of the number of finished estimates, the number of all estimates, and the next lag."""
LEVEL = 0.001
SURPRISING = 9.21  # 99 % point of chi-squared, two degrees of freedom
_MAX_DISTANCE_RATIO = 3.0  # largest sqrt(chi²) of a possible lag, in units of the least sqrt(chi²)
_HOPELESS = 100 * SURPRISING  # misfit from which on still earlier lags are not fitted
_POLES = 4  # number of poles of the arm
_MAX_EXTRA_LAGS = 4  # lags by which the range is extended at each end
FIRST_LAGS = 50
"""Number of lags of u, for the delay and B together, of the first model."""
_ORDERS = (20, 10, 5)  # largest na; a smaller number if too many rows contain a missing sample
MOST_PAST = _ORDERS[0]
"""Largest order of A."""
_MIN_WHOLE_SHARE = 0.5  # share of the rows that must have no missing past y
_ROWS_PER_ORDER = 20  # samples for each a that is tried
_BLOCK = 4096  # rows decomposed at once: they stay in the cache
_MIN_OWN_ROUNDING = 10.0  # norm that determines a past output, in norms of the rounding errors
_GROWTH = 3.0  # a first coefficient is at least 1/(1 + 3 n) of the coefficient n samples later
_SMOOTH = 0.1  # share of a lag of u that the others leave unexplained, below which u is smooth
_SMOOTH_ERROR = 0.35  # relative deviation of an onset predicted from later lags of a smooth u
_ONSET = 2  # number of lags after the first significant lag that determine the slope of the onset
_COEFFICIENTS_AFTER_FIRST = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class Before:
    """Test for a weak effect of u one lag before the first significant lag."""

    k: int
    """The tested lag."""
    found: float
    """Size of the coefficient of u at the tested lag, in σ."""
    predicted: float
    """Least size, in σ, that the coefficient would have if u acted first at this lag. The size is
    computed from later coefficients."""
    p_value: float
    """One-sided p value of the hypothesis that u acts first at this lag."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LagTests:
    """Tests of the hypotheses that u does not act at the lags `first` … k, for each k.

    Each array over k begins at lag `first`.
    """

    first: int
    """Least lag of the model: 0, or 1 if feedback hides lag 0."""
    p_values: Vector
    """p values of H_k: b_first = … = b_k = 0, (n,)."""
    p_without_one: Vector
    """Largest p value of H_k if any one row is left out, (n,). If u changes rarely, a few rows
    determine a coefficient, and one large error of y in these rows can look like an effect of u."""
    coefficient: Vector
    """b_k of the model that begins at lag k, (n,), in the unit of y per unit of u."""
    std: Vector
    """Standard deviation of `coefficient`, (n,)."""
    loss: Vector
    """Mean squared error of the model that begins at lag k, (n,)."""
    responses: tuple[Vector, ...]
    """Impulse responses, from lag 0 on, of models that begin at the first significant lag, and, if
    u is smooth, at each earlier lag. With a smooth u, later coefficients take the part of earlier
    coefficients."""
    A: Vector
    """Polynomial A of that model, (na + 1,); 1 if the model is an impulse response."""
    effect: Vector
    """Effect of each coefficient b_j, in columns, on the size of `coefficient` in σ, in rows: lower
    triangular, (n, n)."""
    N: int
    """Number of rows used."""

    @property
    def na(self) -> int:
        """Order of A; 0 if the model is an impulse response."""
        return self.A.size - 1

    @property
    def shown(self) -> int:
        """First lag at which H_k is rejected without any one row; the last lag + 1 if none is."""
        return self.first + _first(self.p_without_one)

    @property
    def none_shown(self) -> bool:
        """True if no H_k is rejected."""
        return _first(self.p_without_one) == self.p_without_one.size

    @property
    def _error(self) -> float:
        """Relative deviation of a predicted onset."""
        return _SMOOTH_ERROR if len(self.responses) > 1 else 0.0

    def before(self, k: int) -> Before:
        """Test whether u may act first at lag k with a coefficient that is not significant.

        `armrig.delay` describes the bound of a first coefficient.
        """
        from scipy.special import ndtr

        later = np.arange(self.shown, self.responses[0].size)
        least = min(
            float(np.max(np.abs(response[later]) / (1 + _GROWTH * (later - k))))
            for response in self._responses(k)
        )
        onset = self._smooth_onset(k)
        least = least if onset is None else min(least, abs(float(onset[0])))
        std = self.std[k - self.first]
        size, predicted = abs(float(self.coefficient[k - self.first])) / std, least / std
        return Before(
            k=k,
            found=float(size),
            predicted=float(predicted),
            p_value=float(ndtr((size - predicted) / np.hypot(1, self._error * predicted))),
        )

    def _responses(self, k: int) -> tuple[Vector, ...]:
        """Return the responses that may be that of a model whose u acts first at lag k."""
        first, *earlier = self.responses
        return (first, earlier[k - self.first]) if earlier else (first,)

    def _smooth_onset(self, k: int) -> Vector | None:
        """Return the response from lag k to the lag before `shown`, if it begins like n^d.

        s(j) = c (j - k + 1)^d is the step response. d is the steepest slope of log s against
        log (j - k + 1) over the first significant lags. None if no smooth onset begins at k.
        """
        onsets = [self._onset_of(response, k) for response in self._responses(k)]
        known = [onset for onset in onsets if onset is not None]
        return min(known, key=lambda onset: abs(float(onset.sum())), default=None)

    def _onset_of(self, response: Vector, k: int) -> Vector | None:
        s = np.cumsum(response)[self.shown :][: _ONSET + 1]
        if k == 0 or s.size < 2 or not np.all(s):  # under a hold, none begins at 0
            return None
        lags = self.shown - k
        n = np.log(np.arange(s.size) + lags + 1)
        d = float(np.max(np.diff(np.log(np.abs(s))) / np.diff(n)))
        rise = (np.arange(lags + 1) / (lags + 1)) ** max(d, 1.0)
        return np.asarray(s[0] * np.diff(rise))

    def _p_value_of_onset(self, k: int) -> float:
        """Return the one-sided p value of a smooth onset at lag k, in all lags before `shown`.

        The sizes of the coefficients in σ are independent, with the means μ = `effect` b of the
        onset b. Therefore μ'z/|μ| is normal with the mean |μ|.
        """
        from scipy.special import ndtr

        onset = self._smooth_onset(k)
        if onset is None or onset.size == 1:  # `before` tests a single lag
            return 1.0
        lags = slice(k - self.first, self.shown - self.first)
        mean = self.effect[lags, lags] @ apply_filter(self.A, np.ones(1), onset)
        size = float(np.linalg.norm(mean))
        z = self.coefficient[lags] / self.std[lags]
        if not size > 0:
            return 1.0
        return float(ndtr((mean @ z / size - size) / np.hypot(1, self._error * size)))

    def least(self) -> int:
        """Return the least lag that is not ruled out, searched downwards from `shown`."""
        k = self.shown
        while k > self.first and self._may_begin_at(k - 1):
            k -= 1
        return k

    def _may_begin_at(self, k: int) -> bool:
        return min(self.before(k).p_value, self._p_value_of_onset(k)) >= LEVEL


def lag_tests(
    data: Dataset, response: ImpulseResponse, determined: int, first: int = 0
) -> LagTests:
    """Test the first lags in an ARX model, or in the impulse response if too many y are missing.

    The model is ARX with a constant for each experiment. AIC chooses na <= 20 and the number of
    lags of u, which is at most the number of lags in `response`. Their sum is at most `determined`
    (see `count_determined_lags`), because past outputs could replace further lags of u. An ARX
    model of
    high order approximates any linear system and any colour of the noise [1]_. Therefore the F test
    has the correct level without a separate model of the noise ::

        F_k = (V_k+1 - V_0)/(k + 1) / (V_0/(N - d)),      H_k: b_0 = … = b_k = 0

    V_k is the sum of squared residuals of the model that begins at lag k, from one QR decomposition
    with the columns u(t - L) … u(t). The tests begin at lag `first`: 1 with feedback, because the
    controller causes b_0.

    References
    ----------
    .. [1] L. Ljung, B. Wahlberg, Adv. Appl. Probab. 24 (1992) 412-440.
    .. [2] L. Ljung, *System Identification*, 2nd ed., 1999, sections 16.4 and 16.5.
    """
    samples = data.N - data.missing
    lags = range(first, response.lags.size)
    row_count = sum(block.shape[0] for block in _rows(data, 0, lags))
    for most in _ORDERS:
        na = max(min(most, samples // _ROWS_PER_ORDER, determined - len(lags)), 0)
        blocks = _rows(data, na, lags)
        N = sum(block.shape[0] for block in blocks)
        if max(_MIN_WHOLE_SHARE * row_count, 2 * (na + len(lags) + len(blocks))) <= N:
            return _in_arx(blocks, na, lags, rounding_std(data.y))
    return _in_response(response, first)


def _rows(data: Dataset, na: int, lags: range) -> list[Vector]:
    """Return the complete rows [y lagged, u lagged, y] of each experiment, minus their means."""
    blocks = []
    for part in data.experiments():
        rows = arx_rows(part.u, part.y, na=na, lags=lags)
        complete = rows.block[rows.usable]
        if complete.shape[0]:
            complete -= complete.mean(axis=0)
            blocks.append(complete)
    return blocks


def _in_arx(blocks: list[Vector], most: int, lags: range, rounding: float) -> LagTests:
    N, width = sum(block.shape[0] for block in blocks), most + len(lags) + 1
    R = triangle((piece for block in blocks for piece in in_blocks(block, _BLOCK)), width)
    scale = column_norms(R)
    scale[scale == 0] = 1.0
    least = N * (rounding / scale[-1]) ** 2  # without noise, F would be 0/0
    na, nb = _orders(R / scale, most, len(lags), N, least)

    def tests(nb: int) -> LagTests:
        columns = [*range(na), *range(most + nb - 1, most - 1, -1), width - 1]
        T, d = _triangle_of(R / scale, columns), na + nb
        latest_first = np.arange(d - 1, na - 1, -1)  # of the lags of u in T
        diagonal, t = np.diag(T)[latest_first], T[latest_first, -1]
        left = max(float(T[d, -1] ** 2), least)
        degrees = N - d - len(blocks)
        s = np.sqrt(left / degrees)
        unit = scale[-1] / scale[most : most + nb]
        rows = (
            piece[:, columns] / scale[columns] for b in blocks for piece in in_blocks(b, _BLOCK)
        )
        p_without_one = _joint(_least_without_one(rows, T, nb) / s**2, degrees)
        shown = _first(p_without_one)
        size = lags.start + shown + _COEFFICIENTS_AFTER_FIRST
        A, response = _model(T, scale[columns], na, shown, lags.start, size)
        earlier = range(shown if np.median(np.abs(diagonal[: shown + 1])) < _SMOOTH else 0)
        responses = [_model(T, scale[columns], na, i, lags.start, size)[1] for i in earlier]
        return LagTests(
            first=lags.start,
            p_values=_joint(np.cumsum(t**2) / s**2, degrees),
            p_without_one=p_without_one,
            coefficient=t / diagonal * unit,
            std=s / np.abs(diagonal) * unit,
            loss=(left + np.append(0.0, np.cumsum(t**2)[:-1])) * scale[-1] ** 2 / N,
            responses=(response, *responses),
            A=A,
            effect=np.sign(diagonal)[:, None] * T[np.ix_(latest_first, latest_first)] / (s * unit),
            N=N,
        )

    outcome = tests(nb)
    # The last lag of a model also represents later lags: u(t) is correlated with its past.
    while _first(outcome.p_without_one) == nb - 1 < len(lags) - 1:
        nb = min(2 * nb, len(lags))
        outcome = tests(nb)
    return outcome


def _first(p_values: Vector) -> int:
    """Return the index of the first p value below the level, or the number of p values."""
    significant = np.flatnonzero(p_values < LEVEL)
    return int(significant[0]) if significant.size else p_values.size


def _model(
    T: Vector, scale: Vector, na: int, left_out: int, first: int, size: int
) -> tuple[Vector, Vector]:
    """Return A and the impulse response (size,) of the model without the first lags of u."""
    d, k = T.shape[1] - 1 - left_out, first + left_out
    theta = np.linalg.solve(T[:d, :d], T[:d, -1]) * scale[-1] / scale[:d]
    A, B = np.append(1.0, theta[:na]), np.append(np.zeros(k), theta[na:][::-1])
    return A, apply_filter(B, A, np.eye(1, size)[0])


def _triangle_of(R: Vector, columns: list[int]) -> Vector:
    """Return the triangular factor; its last row is what the other columns leave unexplained."""
    return np.asarray(np.linalg.qr(R[:, columns], mode="r"))


def _orders(R: Vector, most: int, lags: int, N: int, least: float) -> tuple[int, int]:
    """Return na and the number of lags of u (from the least lag on) with the least AIC.

    A sum of squares below `least` is due to rounding errors. A past output that depends on later
    ones and on the lags of u is not tried, and no earlier one.
    """
    own_norms = np.diag(_triangle_of(R, [*range(most, most + lags), *range(most)]))[lags:]
    is_determined = np.abs(own_norms) > _MIN_OWN_ROUNDING * np.sqrt(least)
    most_determined = int(np.argmin(np.append(is_determined, False)))
    values = np.empty((most_determined + 1, lags))
    for na in range(most_determined + 1):
        T = _triangle_of(R, [*range(na), *range(most, most + lags + 1)])
        sse = np.cumsum(T[::-1, -1] ** 2)[::-1]
        d = na + np.arange(1, lags + 1)
        values[na] = aic(np.maximum(sse[d], least) / N, d, N)
    na, last = divmod(int(np.argmin(values)), lags)
    return na, last + 1


def _in_response(response: ImpulseResponse, first: int) -> LagTests:
    """Return Wald tests of the first coefficients of the impulse response.

    The components of L^-1 g are independent if L L^T is the covariance of g. L_kk times component k
    estimates g(k) of a response that is 0 before lag k.
    """
    g, covariance = with_covariance(response)
    rounding = rounding_std(g) ** 2
    L = np.linalg.cholesky(covariance + rounding * np.eye(g.size))
    whitening = np.linalg.inv(L)
    score, std = (whitening @ g)[first:], np.diag(L)[first:]
    p_values = _joint(np.cumsum(score**2), max(response.N - g.size, 1))
    return LagTests(
        first=first,
        p_values=p_values,
        p_without_one=p_values,
        coefficient=std * score,
        std=std,
        loss=response.noise_variance * (1 + np.append(0.0, np.cumsum(score**2)[:-1]) / response.N),
        responses=(g,),
        A=np.ones(1),
        effect=whitening[first:, first:],
        N=response.N,
    )


def _joint(squares: Vector, degrees: int) -> Vector:
    """Return the p value for each k: the sum of the first k squared scores, over k, is F."""
    from scipy.special import fdtrc

    k = np.arange(1, squares.size + 1)
    return np.asarray(fdtrc(k, degrees, squares / k))


def _least_without_one(rows: Iterable[Vector], T: Vector, nb: int) -> Vector:
    """Return the least sum of the first k squared scores if one row is left out, for each k.

    A score is the sum q' e_k, with the column q of Q for a lag of u, and the residuals e_k of the
    model without the first k lags.
    """
    d = T.shape[1] - 1
    dependent = np.diag(T)[:d] == 0
    inverse, t = upper_inverse(T[:d, :d] + np.diag(dependent)), T[:d, -1]
    late = np.arange(d - 1, d - nb - 1, -1)
    total, least = np.cumsum(t[late] ** 2), np.full(nb, np.inf)
    for block in rows:
        Q = block[:, :d] @ inverse
        explained = np.cumsum(Q[:, late] * t[late], axis=1)
        leverage = np.cumsum(Q[:, late] ** 2, axis=1)
        e = (block[:, -1] - Q @ t)[:, None] + explained
        least = np.minimum(least, np.min(total - 2 * e * explained + e**2 * leverage, axis=0))
    return least


def smooth_onsets(
    data: Dataset, first: int, last: int, *, integrator: bool, progress: Progress | None = None
) -> dict[int, float]:
    """Return chi-squared of the model with a smooth onset, for each first lag.

    OE models with different first lags k are compared. Their numerator is the product of (1 + q^-1)
    and a polynomial of three coefficients, so that the onset is smooth. The statistic is ::

        chi² = (N - d)(V_k - V_0)/V_0,      two degrees of freedom

    V_k is the loss of the model with the first lag k. V_0 is the least loss of all these models and
    of a model with a free numerator. A first coefficient that is too small to see indicates a short
    sampling time, for which a second-order onset has a zero near -1 [1]_. The range first … last is
    extended at each end, by at most four lags, until chi² at that end exceeds its 1 % point.

    References
    ----------
    .. [1] K. J. Åström, P. Hagander, J. Sternby, "Zeros of sampled systems", Automatica 20 (1984)
       31-38.
    """
    averaged = _average_input(data)

    def fit_oe(data: Dataset, nb: int, nk: int) -> Fit:
        return oe(data, nb=nb, nf=_POLES, nk=nk, integrator=integrator, starts="few")

    @cache
    def loss(k: int) -> float:
        if progress and first <= k <= last:
            progress(last - k, last - first + 1, f"lag {k}")
        return fit_oe(averaged, _POLES - 1, k).loss

    best = low = high = last
    # The misfit grows with the distance from the onset, so the earlier lags are not fitted.
    while low > first and loss(low) <= loss(best) * (1 + _HOPELESS / data.N):
        low -= 1
        best = min(best, low, key=loss)
    free = fit_oe(data, _POLES, best)
    degrees = free.N - free.parameters
    least = min(free.loss, loss(best))

    def misfit(k: int) -> float:
        return degrees * (loss(k) / least - 1) if least > 0 else 0.0

    bound = max(SURPRISING, _MAX_DISTANCE_RATIO**2 * misfit(best))
    while low > first and misfit(low) < bound:
        low -= 1
    while low > max(first - _MAX_EXTRA_LAGS, 0) and misfit(low) <= SURPRISING:
        low -= 1
    while high < last + _MAX_EXTRA_LAGS and misfit(high) <= SURPRISING:
        high += 1
    return {k: misfit(k) for k in range(low, high + 1)}


def possible(misfit: dict[int, float]) -> tuple[int, int]:
    """Return the least and the greatest lag at which the onset may begin, given the misfits.

    The best lag is possible, and each lag whose misfit is below the 1 % point of chi-squared. The
    root of the misfit grows with the distance from the true onset. Therefore a lag is also possible
    if this root is less than three times the least. If the best lag is within a quarter sample of
    the true onset, this adds no lag.
    """
    least = min(misfit.values())
    bound = max(SURPRISING, least)
    lags = [
        k for k, chi2 in misfit.items() if chi2 <= bound or chi2 < _MAX_DISTANCE_RATIO**2 * least
    ]
    return min(lags), max(lags)


def _average_input(data: Dataset) -> Dataset:
    """Return the data with the input (u(t) + u(t - 1))/2, for the factor 1 + q^-1 of the model."""
    before = np.concatenate([data.u[:1], data.u[:-1]])
    starts = list(data.starts)
    before[starts] = data.u[starts]
    return data.replaced(u=(data.u + before) / 2, step=None)
