"""Step response of one or two time constants with dead time, with its uncertainty.

The response to a unit step is::

    y(t) = level + K (1 - (T_1 exp(-(t-L)/T_1) - T_2 exp(-(t-L)/T_2)) / (T_1 - T_2)),  t > L

T_2 = 0 is P1D, and 0 < T_2 <= T_1 is P2D. `armrig.process` estimates the same models, but limits
the dead time to a quarter of the record. It gives no deviation to a parameter at its bound, and
takes the error of a converter for white noise. Here the parameters are drawn from their posterior.
Thus a T_2 or L near 0 has an interval, as have a K and T_1 that the record leaves open. If the
converter's step exceeds the noise, the likelihood of a sample is the probability of its code.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr
from scipy.stats import chi2

from armrig.estimation.nonparametric.step_answer import NormalisedResponse
from armrig.numerics.step_times import SHARE

Vector = NDArray[np.float64]

_WALKERS, _BURN_IN, _THINNING, _KEPT = 60, 80, 6, 25
_MIN_RATIO, _MAX_RATIO = 1e-6, 0.999  # of T_2 to T_1; at 1 the formula is 0/0
_NO_RATIO = 1e-4  # a search ends this near to the bound without a second time constant
_MAX_T = 1e3  # largest T_1, divided by the duration after the step
_MIN_T = 0.05  # least T_1 in samples
_LATEST = 0.9  # largest dead time, as a share of the duration after the step
_WHITE_NOISE = 0.6  # standard deviation in steps of a converter from which its error is white
_MIN_NOISE = 0.02  # least standard deviation of the noise in steps of the converter
_MIN_NOISE_SHARE = 1e-6  # the same, as a share of the response
_SHAPES = 7  # shapes of the test of the misfit: smooth ones, and one of a direct path
_MISFIT_P = 1e-4  # level of the test of the misfit
_SURE_P2D = 0.95  # probability from which two time constants are reported
_MAX_EXCESS = 20.0  # of the logarithm of the likelihood, from which P1D is not drawn
_NO_DEAD_TIME_SHARE = 0.03  # ratio of the ends of the interval below which L may be 0
_FLAT = 10.0  # likely points of the grid from which the likelihood has no sharp maximum
_RATIOS = (_MIN_RATIO, 0.2, 0.4, 0.6, 0.8)  # of the grid of P2D
_SHIFTS = (-1.5, -1.0, -0.5, 0.5, 1.0, 1.5)  # samples; the cost has a kink at each sample


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProcessAnswer:
    """Posterior draws of a P1D or P2D step response."""

    answer: NormalisedResponse
    """Curve divided by `scale`, and the times of the draws."""
    scale: float
    """Median of `gains`."""
    gains: Vector
    """Final value of each draw, per unit of u."""
    time_constants: Vector
    """T_1 and T_2 of each draw in s, (draws, 2); T_2 is 0 for P1D."""
    form: str
    """P2D if two time constants are sure, else P1D."""
    end: float
    """Median share of the final value that the response reaches at the end of the record."""


def step_process(
    t: Vector, y: Vector, weight: Vector, Ts: float, *, quantum: float, steps: int, band: float
) -> ProcessAnswer | None:
    """Return the posterior of P1D and P2D for a unit step at t = 0, or None if neither fits.

    Parameters
    ----------
    t, y, weight : ndarray of shape (N,)
        Times in s, the response (NaN if missing), and weights inversely proportional to the
        variance of the noise.
    Ts : float
        Sampling time in s.
    quantum : float
        Step of the converter in the unit of y; 0 if y is not quantised.
    steps : int
        Number of steps of which y is the mean.
    band : float
        Half width of the band in which the response has settled, as a share of the final value.
    """
    used = np.isfinite(y) & (weight > 0)
    rows = _Rows(t[used], y[used], weight[used] / weight.max())
    record = _ProcessRegression(rows, Ts, quantum)
    ends = record.fits()
    spread = record.variance - quantum**2 / 12
    constant = bool(quantum) and spread < (_WHITE_NOISE * quantum) ** 2
    coded = rows.count_codes() if constant and steps == 1 else None
    if coded is None and record.misfits(ends[1]):
        return None
    rng = np.random.default_rng(1)
    forms = (3,) if record.excess(ends) > _MAX_EXCESS else (3, 2)
    draws = [record.draws(ends[free - 2], free, rng) for free in forms]
    if coded is not None:
        draws = [
            record.coded_draws(coded, start, free, rng)
            for start, free in zip(draws, forms, strict=True)
        ]
        if record.misfits_codes(coded, draws[0]):
            return None
        excess = float(draws[0].scores.max() - draws[-1].scores.max())
    else:
        excess = record.excess(ends)
    # Ratio of the likelihoods, averaged over the ratio of the time constants.
    occam = min(np.sqrt(2 * np.pi) * float(np.std(draws[0].theta[:, 1])), 1.0)
    p2d = 1.0 if len(draws) == 1 else 1 / (1 + np.exp(-np.clip(excess, -700, 700)) / occam)
    n = draws[0].gains.size
    second = rng.random(n) < p2d
    theta = np.where(second[:, None], draws[0].theta, draws[-1].theta)
    gains = np.where(second, draws[0].gains, draws[-1].gains)
    if constant and coded is None:  # the errors at both levels
        gains = gains + quantum / np.sqrt(6) * rng.standard_normal(n)
    T, ratio, L = np.exp(theta[:, 0]), theta[:, 1], theta[:, 2]
    early, late = np.quantile(L, [0.025, 0.975])
    scale, duration = float(np.median(gains)), float(t[-1])
    grid = np.linspace(0.0, duration, 1001)[1:]
    curves = gains[:, None] * _unit_responses(grid, theta) / scale
    return ProcessAnswer(
        answer=NormalisedResponse(
            t=grid,
            y=curves.mean(axis=0),
            std=curves.std(axis=0),
            crossings=L + T * _crossing_times(SHARE, ratio),
            delays=L,
            settlings=L + T * _crossing_times(1 - band, ratio),
            peaks=np.ones(n),
            none=float(early < _NO_DEAD_TIME_SHARE * late),
        ),
        scale=scale,
        gains=gains,
        time_constants=np.column_stack([T, np.where(second, ratio * T, 0.0)]),
        form="P2D" if p2d > _SURE_P2D else "P1D",
        end=float(np.median(_unit_response(duration - L, T, ratio))),
    )


def _unit_response(t: Any, T: Any, ratio: Any) -> Vector:
    """Return the response to a unit step at t = 0 with time constants T and ratio T, gain 1."""
    x = np.maximum(t, 0.0) / T
    if np.max(ratio) <= _MIN_RATIO:
        return np.asarray(1 - np.exp(-x))
    return np.asarray(1 - (np.exp(-x) - ratio * np.exp(-x / ratio)) / (1 - ratio))


def _unit_responses(t: Vector, theta: Vector) -> Vector:
    """Return the responses (n, N) of theta (n, 3): log T_1, T_2/T_1 and L."""
    T, ratio, L = (theta[:, i, None] for i in range(3))
    return _unit_response(t - L, np.exp(T), ratio)


def _crossing_times(share: float, ratio: Vector) -> Vector:
    """Return the time, divided by T_1, at which each response reaches a share of its gain."""
    low, high = np.zeros(ratio.size), np.full(ratio.size, 20.0)
    for _ in range(50):
        middle = (low + high) / 2
        above = _unit_response(middle, 1.0, ratio) > share
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.asarray((low + high) / 2)


def _columns(free: int) -> NDArray[np.int_]:
    """Return the free columns of theta: P1D has two, P2D has three."""
    return np.array([0, 2] if free == 2 else [0, 1, 2])


class _Rows(NamedTuple):
    """Samples at different times, or of different values, each with a weight."""

    t: Vector
    y: Vector
    weight: Vector

    def merge_early(self) -> _Rows:
        """Return the rows with the mean of those before the step, which all have one value."""
        early = self.t < 0
        w, late = self.weight[early], ~early
        first = (self.t[0], w @ self.y[early] / w.sum(), w.sum())
        return _Rows(*(np.append(x, column[late]) for x, column in zip(first, self, strict=True)))

    def count_codes(self) -> _Rows:
        """Return the rows with the counts of the codes before the step as weights."""
        late = self.t >= 0
        codes, counts = np.unique(self.y[~late], return_counts=True)
        return _Rows(
            np.append(np.full(codes.size, self.t[0]), self.t[late]),
            np.append(codes, self.y[late]),
            np.append(counts, np.ones(np.count_nonzero(late))),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _ProcessDraws:
    """Draws of one form."""

    theta: Vector
    gains: Vector
    levels: Vector
    noises: Vector
    """Standard deviation of the noise before the converter."""
    scores: Vector
    """Logarithm of the likelihood, up to a constant."""


class _ProcessRegression:
    """Least squares of the record, with gain and level projected out."""

    def __init__(self, rows: _Rows, Ts: float, quantum: float) -> None:
        self._rows = rows.merge_early()
        self._root, self._q, self._Ts = np.sqrt(self._rows.weight), quantum, Ts
        self._N = rows.y.size
        floor = (_MIN_NOISE_SHARE * float(np.max(np.abs(rows.y)))) ** 2
        self._least = max(self._q**2 / 12, floor)
        self._within = float(rows.weight @ rows.y**2 - self._rows.weight @ self._rows.y**2)
        duration = float(rows.t[-1])
        self._low = np.array([np.log(_MIN_T * Ts), _MIN_RATIO, 0.0])
        self._high = np.array([np.log(_MAX_T * duration), _MAX_RATIO, _LATEST * duration])
        self._Q = self._root / np.linalg.norm(self._root)
        self._z = self._weighted(self._rows.y)

    def _weighted(self, rows: Vector) -> Vector:
        """Return weighted rows without their level."""
        rows = self._root * rows
        return np.asarray(rows - (rows @ self._Q)[..., None] * self._Q)

    def _solve(self, theta: Vector) -> tuple[Vector, Vector, Vector]:
        """Return the cost, the gain, and the variance of the gain by that of the noise."""
        s = self._weighted(_unit_responses(self._rows.t, theta))
        power = np.maximum(np.sum(s**2, axis=1), 1e-300)
        product = s @ self._z
        return self._z @ self._z - product**2 / power, product / power, 1 / power

    def _residual(self, theta: Vector) -> Vector:
        s = self._weighted(_unit_responses(self._rows.t, theta[None]))[0]
        return np.asarray(self._z - s * (s @ self._z) / max(float(s @ s), 1e-300))

    def fits(self) -> list[Vector]:
        """Return the best theta of P1D and of P2D; the variance of the noise is that of P2D."""
        duration = float(self._rows.t[-1])
        logs = np.linspace(np.log(0.3 * self._Ts), np.log(10 * duration), 25)
        delays = duration * np.append(0.0, np.geomspace(0.005, 0.85, 24))
        self._grid = np.array([[T, _MIN_RATIO, L] for T in logs for L in delays])
        self._grid_costs = self._costs(self._grid)
        slow = self._search([self._grid[i] for i in np.argsort(self._grid_costs)[:3]], 2)
        near = [
            slow + np.array([0, r, -r * min(np.exp(slow[0]), slow[2])]) for r in (1e-3, 0.1, 0.4)
        ]
        both = self._search(near, 3)
        if both[1] < _NO_RATIO:
            both = slow
        cost = float(self._solve(both[None])[0][0]) + self._within
        self.variance = max(cost / (self._N - 5), self._least)
        return [slow, both]

    def _costs(self, grid: Vector) -> Vector:
        """Return the cost of each theta (n, 3), computed in blocks."""
        return np.concatenate([self._solve(block)[0] for block in np.array_split(grid, 25)])

    def excess(self, ends: list[Vector]) -> float:
        """Return the logarithm of the ratio of the likelihoods of P2D and P1D."""
        costs = self._solve(np.vstack(ends))[0]
        return float(costs[0] - costs[1]) / (2 * self.variance)

    def _search(self, starts: list[Vector], free: int) -> Vector:
        """Return the best theta that the searches reach, also from next to their best end."""
        columns = _columns(free)
        low, high = self._low[columns], self._high[columns]
        margin = 1e-6 * (high - low)

        def end_of(start: Vector) -> tuple[float, Vector]:
            theta = start.copy()

            def residual(x: Vector) -> Vector:
                theta[columns] = x
                return self._residual(theta)

            scale = np.array([0.1, 0.1, 0.1 * np.exp(min(start[0], self._high[0]))])[columns]
            inside = np.clip(start[columns], low + margin, high - margin)
            end = least_squares(
                residual, inside, bounds=(low, high), x_scale=scale, xtol=1e-12, ftol=1e-14,
                gtol=1e-15, max_nfev=40,
            )  # fmt: skip
            best = start.copy()
            best[columns] = end.x
            return float(end.cost), best

        cost, best = min(map(end_of, starts), key=lambda end: end[0])
        shifted = [best + np.array([0, 0, shift * self._Ts]) for shift in _SHIFTS]
        return min([(cost, best), *map(end_of, shifted)], key=lambda end: end[0])[1]

    def misfits(self, theta: Vector) -> bool:
        """Return whether the residual of white noise has a shape that P2D has not."""
        r = self._residual(theta)
        # A smooth misfit is part of the variance, but not of the differences.
        variance = np.clip(np.mean(np.diff(r) ** 2) / 2, self._least, self.variance)
        weight = self._rows.weight / variance
        return _misfits(self._rows.t, theta, self._root * r / variance, weight)

    def misfits_codes(self, rows: _Rows, draws: _ProcessDraws) -> bool:
        """Return the same for the codes of a converter, by the most likely draw."""
        best = int(np.argmax(draws.scores))
        theta, noise = draws.theta[best], float(draws.noises[best])
        curve = draws.gains[best] * _unit_responses(rows.t, theta[None])[0]
        off = rows.y - draws.levels[best] - curve
        # The information is the mean square of the score over the codes near the curve.
        near = (off - self._q * np.round(off / self._q))[:, None] + self._q * np.arange(-3, 4)
        slope, p = _code_score(near, noise, self._q)
        information = np.maximum(np.sum(p * slope**2, axis=1), 1e-12 / noise**2)
        score = _code_score(off, noise, self._q)[0]
        return _misfits(rows.t, theta, rows.weight * score, rows.weight * information)

    def draws(self, at: Vector, free: int, rng: np.random.Generator) -> _ProcessDraws:
        """Return draws by the likelihood of white Gaussian noise."""
        columns, white, low, high = _columns(free), self.variance, self._low, self._high

        def score(theta: Vector) -> Vector:
            inside = np.all((theta >= low) & (theta <= high), axis=1)
            cost = self._solve(np.clip(theta, low, high))[0]
            return np.where(inside, -cost / (2 * white), -np.inf)

        walkers = self._walkers_of_grid(free, rng)
        if walkers is None:
            walkers = self._walkers_about(at, columns, rng)
        theta, scores = _stretch_walkers(walkers, columns, score, rng)
        _, gains, variances = self._solve(theta)
        gains = gains + np.sqrt(white * variances) * rng.standard_normal(gains.size)
        w = self._rows.weight
        curves = gains[:, None] * _unit_responses(self._rows.t, theta)
        return _ProcessDraws(
            theta=theta,
            gains=gains,
            levels=(self._rows.y - curves) @ w / w.sum(),
            noises=np.full(gains.size, np.sqrt(white)),
            scores=scores,
        )

    def _walkers_of_grid(self, free: int, rng: np.random.Generator) -> Vector | None:
        """Return points of the grid, drawn by their likelihood; None if few are likely.

        Without a sharp maximum, the end of a search depends on a processor's rounding errors.
        """
        grid, shares = self._grid, self._likelihoods(self._grid_costs)
        if 1 / (shares @ shares) < _FLAT:
            return None
        if free == 3:
            grid = np.concatenate([grid + np.array([0, r - _MIN_RATIO, 0]) for r in _RATIOS])
            shares = self._likelihoods(self._costs(grid))
        return np.asarray(grid[rng.choice(len(grid), _WALKERS, p=shares)])

    def _likelihoods(self, costs: Vector) -> Vector:
        """Return the likelihoods of points with these costs, divided by their sum."""
        likelihoods = np.exp((costs.min() - costs) / (2 * self.variance))
        return np.asarray(likelihoods / likelihoods.sum())

    def _walkers_about(
        self, at: Vector, columns: NDArray[np.int_], rng: np.random.Generator
    ) -> Vector:
        """Return points from the Gaussian distribution about the most likely theta."""
        white, low, high = self.variance, self._low, self._high
        gain = float(self._solve(at[None])[1][0])
        X = self._weighted(_tangents(self._rows.t, at).T)
        s, slopes = X[0], X[1:][columns]
        J = gain * (slopes - np.outer(slopes @ s, s) / max(float(s @ s), 1e-300))
        information = J @ J.T / white + np.diag(16 / (high - low)[columns] ** 2)
        covariance = np.linalg.inv(information)
        # The start is rounded, so that a processor's rounding errors choose no other draws.
        unit = 10.0 ** np.floor(np.log10(np.sqrt(np.diag(covariance)))) / 10
        root = unit[:, None] * np.round(np.linalg.cholesky(covariance) / unit[:, None], 1)
        at = at.copy()
        at[columns] = unit * np.round(at[columns] / unit)
        walkers = np.repeat(at[None], _WALKERS, axis=0)
        moved = at[columns] + rng.standard_normal((_WALKERS, columns.size)) @ root.T
        # Reflect at the bounds, so that no walker begins outside.
        a, b = low[columns], high[columns]
        walkers[:, columns] = np.clip(b - np.abs(b - a - np.abs(moved - a)), a, b)
        return walkers

    def coded_draws(
        self, rows: _Rows, start: _ProcessDraws, free: int, rng: np.random.Generator
    ) -> _ProcessDraws:
        """Return draws by the probabilities of the codes of a converter."""
        first = rng.choice(start.gains.size, _WALKERS, replace=False)
        noise = np.sqrt(max(self.variance - self._q**2 / 12, 0.0)) + 0.1 * self._q

        def at_end(theta: Vector) -> Vector:
            return _unit_responses(rows.t[-1:], theta)[:, 0]

        # The value at the end of the record is better determined than the gain.
        walkers = np.column_stack([
            start.theta[first],
            start.gains[first] * at_end(start.theta[first]),
            start.levels[first],
            np.log(noise) + 0.3 * rng.standard_normal(_WALKERS),
        ])  # fmt: skip
        low = np.array([*self._low, -np.inf, -np.inf, np.log(_MIN_NOISE * self._q)])
        high = np.array([*self._high, np.inf, np.inf, np.log(10 * self._q)])

        def score(x: Vector) -> Vector:
            inside = np.all((x >= low) & (x <= high), axis=1)
            x = np.clip(x, low, high)
            s = _unit_responses(rows.t, x[:, :3])
            curves = x[:, 4, None] + (x[:, 3] / at_end(x[:, :3]))[:, None] * s
            p = _code_probability(rows.y - curves, np.exp(x[:, 5, None]), self._q)
            return np.where(inside, np.log(p) @ rows.weight, -np.inf)

        x, scores = _stretch_walkers(walkers, np.array([*_columns(free), 3, 4, 5]), score, rng)
        theta = x[:, :3]
        return _ProcessDraws(
            theta=theta,
            gains=x[:, 3] / at_end(theta),
            levels=x[:, 4],
            noises=np.exp(x[:, 5]),
            scores=scores,
        )


def _tangents(t: Vector, theta: Vector) -> Vector:
    """Return the unit response and its derivatives by theta, (N, 4)."""
    steps = np.diag([1e-4, -1e-4 if theta[1] > _MAX_RATIO / 2 else 1e-4, 1e-4 * np.exp(theta[0])])
    s = _unit_responses(t, np.vstack([theta, theta + steps]))
    return np.vstack([s[:1], (s[1:] - s[0]) / np.diag(steps)[:, None]]).T


def _misfits(t: Vector, theta: Vector, score: Vector, information: Vector) -> bool:
    """Return whether a score test finds a shape that P2D with a level has not."""
    L, root = theta[2], np.sqrt(information)
    x = np.log1p(3 * np.maximum(t - L, 0.0) / np.exp(theta[0]))
    shapes = np.cos(np.pi * np.outer(x / x[-1], np.arange(1.0, _SHAPES + 1)))
    shapes[t <= L] = 0.0
    shapes[:, -1] = t == 0  # a direct path
    Z = root[:, None] * np.column_stack([np.ones(t.size), _tangents(t, theta)])
    S = root[:, None] * shapes
    S -= Z @ np.linalg.lstsq(Z, S, rcond=1e-10)[0]
    off = score / root
    statistic = float(off @ S @ np.linalg.lstsq(S, off, rcond=1e-8)[0])
    return bool(chi2.sf(statistic, _SHAPES) < _MISFIT_P)


def _code_probability(off: Vector, noise: Any, quantum: float) -> Vector:
    """Return the probability of a code that is `off` from the value before the noise."""
    off = np.abs(off)  # so that no probability is the difference of two numbers near 1
    p = ndtr((quantum / 2 - off) / noise) - ndtr(-(quantum / 2 + off) / noise)
    return np.asarray(np.maximum(p, 1e-300))


def _code_score(off: Vector, noise: float, quantum: float) -> tuple[Vector, Vector]:
    """Return the derivative of log p by the value, and p."""
    p = _code_probability(off, noise, quantum)
    low, high = (off - quantum / 2) / noise, (off + quantum / 2) / noise
    slope = (np.exp(-(low**2) / 2) - np.exp(-(high**2) / 2)) / (np.sqrt(2 * np.pi) * noise)
    return slope / np.maximum(p, 1e-12), p


def _stretch_walkers(
    walkers: Vector,
    columns: NDArray[np.int_],
    score: Callable[[Vector], Vector],
    rng: np.random.Generator,
) -> tuple[Vector, Vector]:
    """Return draws and their scores by the stretch move of J. Goodman and J. Weare (2010)."""
    scores, half = score(walkers), len(walkers) // 2
    kept, kept_scores = [], []
    for i in range(_BURN_IN + _THINNING * _KEPT):
        for first in (0, half):
            moving, others = slice(first, first + half), slice(half - first, 2 * half - first)
            z = (rng.random(half) + 1) ** 2 / 2
            trial = walkers[moving].copy()
            partner = walkers[others][rng.integers(half, size=half)]
            trial[:, columns] = (partner + z[:, None] * (trial - partner))[:, columns]
            new = score(trial)
            change = (columns.size - 1) * np.log(z) + new - scores[moving]
            accepted = np.log(rng.random(half)) < change
            walkers[moving] = np.where(accepted[:, None], trial, walkers[moving])
            scores[moving] = np.where(accepted, new, scores[moving])
        if i >= _BURN_IN and i % _THINNING == 0:
            kept.append(walkers.copy())
            kept_scores.append(scores.copy())
    return np.concatenate(kept), np.concatenate(kept_scores)
