"""Step response with its uncertainty, from random curves of a Gaussian process.

The impulse response g is 0 up to the dead time L. At L, g may jump by any amount. After L, g is a
random walk with decaying increments::

    var dg = c exp(-(t - L)/T) / (t - L)^2 dt

This prior allows for a fast rise followed by a slow approach to the final value. The noise of the
samples is white. For each L, c and T the posterior is a Gaussian process whose mean is a smoothing
spline. Each combination of L, c and T is weighted by its restricted likelihood. The level before
the step, and for an angle the speed before the step, are also estimated. The standard deviation of
a time, such as the 63 % time, is computed from its scatter among the drawn curves. This scatter
includes the effects of noise, missing samples and the dead time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded, solve_banded

from armrig.numerics.step_times import SHARE

Vector = NDArray[np.float64]
Setting = tuple[int, int, int]  # L in cells, index of c, index of T

DRAWS = 400
PRIOR_NO_DEAD_TIME = 0.5
"""Prior probability of no dead time. The remaining probability is distributed uniformly over the
dead times up to the 63 % time."""
MAX_NO_DEAD_TIME = 0.01
"""A dead time is reported if the probability of no dead time is below this limit."""

_CELLS = 1000  # number of cells of the time grid; larger if there are more samples
_MAX_CELLS_PER_SAMPLE = 4
_LOG_SMOOTHNESS = np.arange(-28.0, 16.0)  # logarithms of the tried ratios of the noise to c
_TIME_SHARES = 2.0 ** -np.arange(9.0)  # tried values of T, divided by the duration after the step
_MAX_WEIGHT = 1e10  # with larger weights, rounding errors make the equations singular
_DELAYS_AT_ONCE = 13  # number of dead times tried in a round
_MAX_DEVIANCE = 7.0  # excess of -2 log likelihood up to which neighbours are tried
_MIN_WEIGHT_SHARE = 0.01  # weights below this share of the largest weight are ignored
_MIN_NOISE_SHARE = 1e-6  # least standard deviation of the noise, as a share of the largest value
_MAX_CURVE_VALUES = 4_000_000  # number of values in memory at once


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NormalisedResponse:
    """Step response divided by its final value, with times and peaks of randomly drawn curves."""

    t: Vector
    """Times after the step, in s, (n,)."""
    y: Vector
    """Mean curve, (n,); the curve of the rate if y integrates."""
    std: Vector
    """Standard deviation of `y`, (n,)."""
    crossings: Vector
    """Time at which each curve reaches 63 %, in s, (DRAWS,)."""
    delays: Vector
    """Dead time of each curve, in s, (DRAWS,)."""
    settlings: Vector
    """Time after which each curve stays within the band about its final value, in s, (DRAWS,)."""
    peaks: Vector
    """Largest value of each curve, (DRAWS,)."""
    none: float
    """Probability of no dead time."""

    @property
    def dead_time(self) -> float:
        """Dead time in s; 0.0 if the probability of no dead time is 1 % or more."""
        return (
            float(np.median(self.delays[self.delays > 0])) if self.none < MAX_NO_DEAD_TIME else 0.0
        )

    @property
    def crossing(self) -> float:
        """Time at which the response reaches 63 %, in s."""
        return float(np.median(self.crossings))

    @property
    def settling(self) -> float:
        """Time after which the response stays within the band, in s."""
        return float(np.median(self.settlings))

    @property
    def settling_std(self) -> float:
        """Standard deviation of `settling`, in s.

        The settling times of 68.3 % of the curves are at most this distance from `settling`. The
        rounding of times to cells of the grid is added.
        """
        cell = float(self.t[1] - self.t[0])
        return float(np.hypot(_deviation(self.settlings - self.settling), cell / np.sqrt(12)))

    @property
    def overshoot(self) -> tuple[float, float]:
        """Overshoot (the largest value minus the final value 1) and its standard deviation."""
        above = float(np.max(self.y)) - 1
        return max(above, 0.0), float(np.sqrt(np.mean((self.peaks - 1 - above) ** 2)))

    @property
    def tau_std(self) -> float:
        """Standard deviation, in s, of the 63 % time minus the dead time.

        In 68.3 % of the curves this difference is at most one standard deviation from the reported
        difference. If the dead time is too uncertain to be reported, the standard deviation
        includes the uncertainty of the dead time.
        """
        return _deviation((self.crossings - self.delays) - (self.crossing - self.dead_time))

    @property
    def dead_time_interval(self) -> tuple[float, float]:
        """Shortest interval that contains the dead times of 95 % of the curves, in s.

        If no dead time is reported, the interval is extended to 0.
        """
        delays = np.sort(self.delays)
        n = int(np.ceil(0.95 * delays.size)) - 1
        first = int(np.argmin(delays[n:] - delays[: delays.size - n]))
        low = float(delays[first]) if self.dead_time else 0.0
        return low, float(delays[first + n])


def _deviation(error: Vector) -> float:
    """Return the 68.3 % quantile of |error|, on which a few large errors have little effect."""
    return float(np.quantile(np.abs(error), 0.683))


def step_answer(
    k: NDArray[np.int_],
    y: Vector,
    weight: Vector,
    Ts: float,
    *,
    integrates: bool,
    band: float,
    least_variance: float = 0.0,
) -> NormalisedResponse:
    """Return the posterior of the response to a step at k = 0.

    k (N,) is the number of each sample relative to the step, negative before the step. y (N,) is
    the response divided by its final value; NaN if not known. If the output integrates, y is the
    angle divided by the final value of the rate, and the rate is analysed. The noise variance of a
    sample is inversely proportional to its `weight` (N,). The response has settled when it stays
    within `band` of 1. `least_variance` is the lower limit of the estimated noise variance of a
    sample with the largest weight.

    References
    ----------
    .. [1] C. F. Ansley and R. Kohn, "Estimation, filtering, and smoothing in state space models
       with incompletely specified initial conditions", Annals of Statistics 13 (1985) 1286-1316.
    .. [2] G. Pillonetto, F. Dinuzzo, T. Chen, G. De Nicolao, L. Ljung, "Kernel methods in system
       identification, machine learning and function estimation", Automatica 50 (2014) 657-682.
    """
    record = _StepSamples(k, y, weight, Ts, integrates=integrates, least_variance=least_variance)
    splines, shares, none = _weigh_splines(record)
    counts = np.diff(np.floor(np.cumsum(shares) * DRAWS + 0.5).astype(int), prepend=0)
    size = record.t.size
    total, squares = np.zeros(size), np.zeros(size)
    read: list[tuple[Vector, ...]] = []
    for (setting, spline), count in zip(splines.items(), counts, strict=True):
        for curves in record.drawn(spline, int(count), _rng(setting)):
            total += curves.sum(axis=1)
            squares += (curves**2).sum(axis=1)
            delays = np.full(curves.shape[1], record.dt * spline.delay)
            settled = _settling_times(record.t, curves, band)
            read.append((_crossing_times(record.t, curves), delays, settled, curves.max(axis=0)))
    crossings, delays, settlings, peaks = (np.concatenate(x) for x in zip(*read, strict=True))
    mean = total / DRAWS
    return NormalisedResponse(
        t=record.t,
        y=mean,
        std=np.sqrt(np.maximum(squares / DRAWS - mean**2, 0.0)),
        crossings=crossings,
        delays=delays,
        settlings=settlings,
        peaks=peaks,
        none=none,
    )


def _crossing_times(t: Vector, curves: Vector) -> Vector:
    """Return the time at which each curve (n, draws) first reaches 63 % of its final value 1."""
    i = np.argmax(curves >= SHARE, axis=0)
    here, columns = curves[i, np.arange(i.size)], np.arange(i.size)
    before = np.where(i > 0, curves[i - 1, columns], 0.0)
    since = np.where(i > 0, t[i - 1], 0.0)
    share = (SHARE - before) / np.where(here > before, here - before, 1.0)
    return np.asarray(since + share * (t[i] - since))


def _settling_times(t: Vector, curves: Vector, band: float) -> Vector:
    """Return the time after which each curve (n, draws) stays within the band about 1."""
    last = t.size - 1 - np.argmax(np.abs(curves - 1)[::-1] > band, axis=0)
    return np.asarray((t[last] + t[np.minimum(last + 1, t.size - 1)]) / 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Spline:
    """Posterior of the curves for one setting of L, c and T: mean and covariance."""

    delay: int
    """Number of cells of the time grid from the step to the onset of the response."""
    z: Vector
    """Mean of z (the response, or the integral of a rate) from the onset on, (M - delay,)."""
    factor: Vector
    """Banded Cholesky factor of the precision times the noise variance."""
    lines: Vector
    """Decrease of z per unit of the level before the step, and per unit of the speed before the
    step."""
    lines_cov: Vector
    """Covariance of level and speed, divided by the noise variance."""
    variance: float
    """Variance of the noise."""
    criterion: float
    """-2 log of the restricted likelihood, up to a constant."""


class _StepSamples:
    """Samples of the response, and the time grid for the curves."""

    def __init__(
        self,
        k: NDArray[np.int_],
        y: Vector,
        weight: Vector,
        Ts: float,
        *,
        integrates: bool,
        least_variance: float,
    ) -> None:
        # The level is estimated from the second half of the samples before the step.
        known = np.isfinite(y) & (k >= k[0] // 2)
        k, self._y, self._w = k[known], y[known], weight[known] / weight.max()
        self._cells = int(np.clip(_CELLS // k[-1], 1, _MAX_CELLS_PER_SAMPLE))
        self._order = 3 if integrates else 2
        self._X = np.vander(k / k[-1], self._order - 1, increasing=True)
        self._after = k > 0
        self._at = self._cells * k[self._after] - 1
        self._least = max(least_variance, (_MIN_NOISE_SHARE * float(np.max(np.abs(self._y)))) ** 2)
        self.dt = Ts / self._cells
        self.size = self._cells * int(k[-1])
        grid = np.arange(self.size + (not integrates), dtype=np.float64)
        self.t: Vector = self.dt * (grid + 0.5 * integrates)

    def spline(self, delay: int, smooth: float, horizon: float) -> _Spline:
        """Return the posterior for one setting; `horizon` is T / (time after the step)."""
        d, M, m = self._order, self.size - delay, self._cells
        i = np.arange(M)
        rough = np.exp(np.minimum(i / (horizon * self.size), 50.0)) * ((i + 1) / m) ** 2
        cost = np.minimum(np.exp(smooth) * m ** (2 * d - 1) * rough, _MAX_WEIGHT)
        here = self._at >= delay
        at, after = self._at[here] - delay, np.flatnonzero(self._after)[here]
        w, X = self._w[after], self._X[after]
        A = _penalty(cost, d)
        A[-1, at] += w
        seen = np.zeros((M, d))
        seen[at, 0], seen[at, 1:] = w * self._y[after], w[:, None] * X
        factor = cholesky_banded(A, check_finite=False)
        solved = cho_solve_banded((factor, False), seen, check_finite=False)
        # One step of iterative refinement: if the noise is small, A has large elements, which cause
        # rounding errors.
        residual = seen - _apply_penalty(solved, cost, d)
        residual[at] -= w[:, None] * solved[at]
        solved += cho_solve_banded((factor, False), residual, check_finite=False)
        weighted = self._w[:, None] * self._X
        left = self._X.T @ weighted - seen[:, 1:].T @ solved[:, 1:]
        lines_cov = np.linalg.inv(left)
        level = lines_cov @ (weighted.T @ self._y - solved[:, 1:].T @ seen[:, 0])
        z = solved[:, 0] - solved[:, 1:] @ level
        off = self._y - self._X @ level
        off[after] -= z[at]
        squares = float(off @ (self._w * off)) + _cost(z, cost, d)
        freedom = self._y.size - d  # less 1 for the jump at the onset and d - 1 for the line
        variance = max(squares / freedom, self._least)
        log_det = 2 * np.sum(np.log(factor[-1])) + np.linalg.slogdet(left)[1]
        log_det -= np.sum(np.log(cost[d - 1 :])) + (np.log(cost[0]) if d == 3 else 0.0)
        criterion = float(log_det + freedom * np.log(variance) + squares / variance)
        return _Spline(
            delay=delay,
            z=z,
            factor=factor,
            lines=solved[:, 1:],
            lines_cov=lines_cov,
            variance=variance,
            criterion=criterion if np.isfinite(criterion) else np.inf,
        )

    def drawn(self, spline: _Spline, count: int, rng: np.random.Generator) -> Iterator[Vector]:
        """Yield `count` curves in blocks (n, ·), each curve divided by its final value."""
        most = max(1, _MAX_CURVE_VALUES // self.size)
        std, root = np.sqrt(spline.variance), np.linalg.cholesky(spline.lines_cov)
        for first in range(0, count, most):
            n = min(most, count - first)
            noise = rng.standard_normal((n, spline.z.size + self._order - 1)).T
            deviation = solve_banded(
                (0, self._order), spline.factor, noise[: spline.z.size], check_finite=False
            )
            deviation -= spline.lines @ (root @ noise[spline.z.size :])
            z = np.zeros((self.size + 1, n))
            z[spline.delay + 1 :] = spline.z[:, None] + std * deviation
            y = np.diff(z, axis=0) / self.dt if self._order == 3 else z
            # With strong noise a curve may end near 0, so the divisor is at least 0.1.
            yield y / np.maximum(y[-1], 0.1)


def _penalty(cost: Vector, d: int) -> Vector:
    """Return the banded matrix P (d + 1, M) with z' P z = sum_j cost_j (D^d z)_j²."""
    # z is 0 up to the onset. For d = 3 there is one more term: z begins as a parabola.
    row = np.array([-1.0, 3.0, -3.0, 1.0]) if d == 3 else np.array([1.0, -2.0, 1.0])
    banded = np.zeros((d + 1, cost.size))
    for a in range(d + 1):
        first = d if a == 0 else d - 1  # z at the onset is 0, so it is not an unknown
        for b in range(a, d + 1):
            banded[d - (b - a), first - d + b : cost.size - d + b] += row[a] * row[b] * cost[first:]
    if d == 3:
        banded[3, :2] += cost[0] * np.array([16.0, 1.0])
        banded[2, 1] -= 4 * cost[0]
    return banded


def _apply_penalty(z: Vector, cost: Vector, d: int) -> Vector:
    """Return P z for columns z (M, n), from differences of z; P is the matrix of `_penalty`."""
    rough = cost[d - 1 :, None] * np.diff(np.vstack([np.zeros_like(z[:1]), z]), d, axis=0)
    # The adjoint of the d-th difference.
    for _ in range(d):
        rough = -np.diff(rough, axis=0, prepend=0.0, append=0.0)
    rough = rough[1:]
    if d == 3:
        first = cost[0] * (4 * z[0] - z[1])
        rough[0] += 4 * first
        rough[1] -= first
    return rough


def _cost(z: Vector, cost: Vector, d: int) -> float:
    """Return z' P z; P is the matrix of `_penalty`."""
    total = float(cost[d - 1 :] @ np.diff(np.append(0.0, z), d) ** 2)
    return total + (float(cost[0] * (4 * z[0] - z[1]) ** 2) if d == 3 else 0.0)


class _Search:
    """Search over the settings (L, c, T), with the posteriors computed so far."""

    def __init__(self, record: _StepSamples) -> None:
        self._record = record
        self.found: dict[Setting, _Spline] = {}

    def criterion(self, at: Setting) -> float:
        """Return -2 log of the restricted likelihood of a setting, up to a constant."""
        if at not in self.found:
            delay, i, j = at
            self.found[at] = self._record.spline(delay, _LOG_SMOOTHNESS[i], _TIME_SHARES[j])
        return self.found[at].criterion

    @property
    def best(self) -> Setting:
        """Most likely setting so far."""
        return min(self.found, key=self.criterion)

    def climb(self, at: Setting) -> Setting:
        """Return the most likely setting reached in single steps from `at`, at fixed delay."""
        while (best := min((at, *_near(at)), key=self.criterion)) != at:
            at = best
        return at

    def spread(self) -> None:
        """Compute the posteriors of the neighbours of all likely settings."""
        limit = self.criterion(self.best) + _MAX_DEVIANCE
        tried = [at for at in self.found if self.criterion(at) < limit]
        while tried:
            new = [at for at in _near(tried.pop()) if at not in self.found]
            tried += [at for at in new if self.criterion(at) < limit]


def _near(at: Setting) -> Iterator[Setting]:
    delay, i, j = at
    for x in range(max(i - 1, 0), min(i + 2, _LOG_SMOOTHNESS.size)):
        for v in range(max(j - 1, 0), min(j + 2, _TIME_SHARES.size)):
            yield delay, x, v


def _weigh_splines(record: _StepSamples) -> tuple[dict[Setting, _Spline], Vector, float]:
    """Return the likely splines, their probabilities, and the probability of no dead time."""
    search = _Search(record)
    starts = [(0, i, j) for i in range(0, _LOG_SMOOTHNESS.size, 5) for j in (1, 4, 7)]
    best = search.climb(min(starts, key=search.criterion))
    (curves,) = record.drawn(
        search.found[best], min(DRAWS // 2, _MAX_CURVE_VALUES // record.size), _rng(best)
    )
    latest = int(np.quantile(np.argmax(curves >= SHARE, axis=0), 0.99)) + 1
    latest = min(latest, record.size // 2)
    at = best
    for delay in _delay_grid(1, latest):
        at = search.climb((delay, *at[1:]))
    at = search.best
    width = 1.5 * latest / _DELAYS_AT_ONCE
    for delay in _delay_grid(max(at[0] - width, 1), min(at[0] + width, latest)):
        search.climb((delay, *at[1:]))
    search.spread()
    least = search.criterion(search.best)
    # Sorted, because the curves must be drawn in a fixed order, and the order in which the search
    # finds the settings depends on rounding.
    candidates = dict(sorted(search.found.items(), key=lambda item: item[0]))
    weights = {at: np.exp((least - spline.criterion) / 2) for at, spline in candidates.items()}
    delays = np.array(sorted({at[0] for at in weights}))
    widths = np.gradient(delays.astype(np.float64)) / latest if delays.size > 1 else np.ones(1)
    prior = dict(zip(delays, (1 - PRIOR_NO_DEAD_TIME) * widths, strict=True)) | {
        0: PRIOR_NO_DEAD_TIME
    }
    shares = np.array([prior[at[0]] * weight for at, weight in weights.items()])
    shares /= shares.sum()
    none = float(sum(s for at, s in zip(weights, shares, strict=True) if at[0] == 0))
    kept = shares > _MIN_WEIGHT_SHARE * shares.max()
    splines = {at: candidates[at] for at, here in zip(weights, kept, strict=True) if here}
    return splines, shares[kept] / shares[kept].sum(), none


def _delay_grid(first: float, last: float) -> list[int]:
    return sorted({round(x) for x in np.linspace(first, last, _DELAYS_AT_ONCE)})


def _rng(setting: Setting) -> np.random.Generator:
    """Return the random generator for the curves of a setting."""
    # Each setting has its own: rounding can change the number of curves of another setting by one.
    return np.random.default_rng((1, *setting))
