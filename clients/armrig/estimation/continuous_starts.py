"""Start values of a transfer function in s: from sampled models, and by refined instruments.

The simplified refined instrumental variable (SRIV) method filters u and y by 1/F(s). A linear
regression, with the model's own output as instrument, then gives a new F and B. The first filters
have all poles at one frequency.

References
----------
.. [1] P. C. Young, A. J. Jakeman, Int. J. Control 31 (1980) 741-764.
.. [2] G. P. Rao, H. Garnier, *Continuous-time system identification of a benchmark*, in
   Identification of Continuous-time Models from Sampled Data, 2008, chapter 9.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product
from typing import Any

import numpy as np
from scipy.linalg import solve_toeplitz

from armrig.estimation.continuous_problem import ContinuousProblem, continuous_denominator
from armrig.estimation.start_values import start_values
from armrig.models.innovations import trend
from armrig.numerics.exact_sampling import Hold, SampledSystem, sample_system
from armrig.numerics.polynomial import Array, apply_filter, monic, roots

_CUTOFFS = (0.1, 0.5)  # frequencies of the first filters, in 1/sample
_SLOW_CUTOFF = 8.0  # lowest of these frequencies, times the number of samples
_ITERATIONS = 4
_RATES = 9  # rates to which a mode is moved
_FASTEST_MODE = 2.0  # 1/sample
_ANGLES = (np.pi - 1.45, np.pi - 0.8)  # of a moved pair, in the s plane
_MAX_REAL_PAIRS = 3  # pairs of real poles that are moved
_MAX_RESPONSE = 600  # lags of the impulse response from which a delay starts
_BACK_STEPS = (0.5, 2.0, 4.0, 8.0, 16.0)  # samples before the first clear lag
_SHARES = (0.5, 0.25, 0.0)  # of the first clear lag, which may be wrong for a slow plant
_CLEAR = 4.0  # robust deviations


def continuous_starts(problem: ContinuousProblem) -> Iterator[tuple[str, Array]]:
    """Yield named start values theta."""
    for delay in _delays(problem):
        fixed = replace(problem, delay=delay)
        for name, theta in (*_from_sampled(fixed), *_by_instruments(fixed)):
            noise, f, _ = fixed.parts_of(theta)
            if problem.admits(theta := problem.joined(noise, f, delay)):
                yield name, theta


def _delays(problem: ContinuousProblem) -> list[float]:
    """Return the given delay, or delays that the impulse response suggests, in samples."""
    if problem.delay is not None:
        return [problem.delay]
    first = first_lag(problem)
    each = [first - back for back in _BACK_STEPS] + [first * share for share in _SHARES]
    kept: list[float] = []
    for d in each:
        near = any(abs(d - other) < 1.0 for other in kept)
        if 0 <= d <= problem.longest and not near:
            kept.append(float(d))
    return kept


def first_lag(problem: ContinuousProblem) -> int:
    """Return the first lag at which the impulse response differs clearly from 0."""
    most = _MAX_RESPONSE
    covariance, cross = np.zeros((2, most))
    for (x,) in problem.sampled_problem.experiments:
        n = min(most, x.y.size)
        u, y = x.u[:, 0], x.y
        if problem.integrates:  # u was summed
            u, y = np.diff(u, prepend=u[0]), np.diff(y, prepend=y[0])
        u, y = u - u.mean(), y - y.mean()
        size = 1 << (2 * u.size - 1).bit_length()
        U, Y = np.fft.rfft(u, size), np.fft.rfft(y, size)
        covariance[:n] += np.fft.irfft(np.abs(U) ** 2)[:n]
        cross[:n] += np.fft.irfft(np.conj(U) * Y)[:n]
    most = min(most, int(problem.longest) + 60, problem.N // 3)
    ridge = covariance[0] * np.append(1e-3, np.zeros(most - 1))
    h = solve_toeplitz(covariance[:most] + ridge, cross[:most])
    h = np.convolve(h, np.ones(3) / 3, mode="same")
    spread = 1.5 * float(np.median(np.abs(h - np.median(h))))
    clear = np.flatnonzero(np.abs(h) > max(_CLEAR * spread, 0.15 * float(np.max(np.abs(h)))))
    return int(clear[0]) if clear.size else 0


def _from_sampled(problem: ContinuousProblem) -> Iterator[tuple[str, Array]]:
    """Yield start values from the start values of the sampled model with free coefficients."""
    k = problem.noise_size
    any_f = _filter(problem.poles - problem.integrates, _CUTOFFS[1])
    of_orders = problem.at(problem.joined(np.zeros(k), any_f, 0.0)).problem
    free = replace(of_orders, combination=None)
    name, theta = min(start_values(free), key=lambda start: free.cost(start[1]))
    f = continuous_denominator(monic(theta[k:]))
    yield f"sampled, {name}", problem.joined(theta[:k], f, 0.0)


def _filter(n: int, cutoff: float) -> Array:
    return np.atleast_1d(np.poly(np.full(n, -cutoff)))[1:]


def _by_instruments(problem: ContinuousProblem) -> Iterator[tuple[str, Array]]:
    """Yield the start value of least cost among the iterations of the SRIV method."""
    n = problem.poles - problem.integrates
    if n == 0:
        return
    white = replace(problem.sampled_problem, rows=(problem.row.output_error,))
    output_error = replace(problem, sampled_problem=white)

    def cost(f: Array) -> float:
        return output_error.cost(f) if output_error.admits(f) else np.inf

    slow = min(_SLOW_CUTOFF / problem.N, _CUTOFFS[0] / 2)
    cutoffs = (slow, np.sqrt(slow * _CUTOFFS[0]), *_CUTOFFS)
    first = [_regress(problem, _filter(n, cutoff), instruments=False) for cutoff in cutoffs]
    costs = [cost(f) for f in first]
    f = first[int(np.argmin(costs))]
    best, least = f, min(costs)
    for _ in range(_ITERATIONS):
        f = _regress(problem, f, instruments=True)
        if (now := cost(f)) < least:
            best, least = f, now
    if not np.isfinite(least):
        best = _filter(n, _CUTOFFS[1])
    yield "SRIV", problem.joined(np.zeros(problem.noise_size), best, 0.0)


def _regress(problem: ContinuousProblem, f: Array, *, instruments: bool) -> Array:
    """Return f_1 … of the regression with signals filtered by 1/F(s), with stable poles."""
    n, m = f.size, min(problem.zeros, f.size - 1)
    hold: Hold = "foh" if problem.integrates else problem.hold
    of_y, of_u = sample_system(f, 0.0, "foh"), sample_system(f, problem.delay or 0.0, hold)
    blocks, tools = [], []
    for (x,) in problem.sampled_problem.experiments:
        y, u = _derivatives(x.y, of_y), _derivatives(x.u[:, 0], of_u)
        driven = np.column_stack([u[:, : m + 1], trend(problem.row, x.y.size)])
        top = x.y - y[:, ::-1] @ f  # s^n/F y
        blocks.append(np.column_stack([-y[:, ::-1], driven, top])[x.known])
        if instruments:
            b = np.linalg.lstsq(driven[x.known], x.y[x.known], rcond=None)[0]
            y = _derivatives(driven @ b, of_y)
        tools.append(np.column_stack([-y[:, ::-1], driven])[x.known])
    X, Z = np.vstack(blocks), np.vstack(tools)
    size = np.maximum(np.linalg.norm(X[:, :-1], axis=0), 1e-300)
    left, right = Z.T @ X[:, :-1] / size, Z.T @ X[:, -1]
    rows = np.maximum(np.linalg.norm(left, axis=1), 1e-300)
    theta = np.linalg.lstsq(left / rows[:, None], right / rows, rcond=None)[0] / size
    return _stable(theta[:n])


def starts_with_moved_pole(problem: ContinuousProblem, theta: Array) -> Iterator[Array]:
    """Yield theta with a real pole moved, or two poles replaced by a pair or two real poles."""
    noise, f, delay = problem.parts_of(theta)
    s = roots(monic(f)).astype(np.complex128)
    rates = np.geomspace(max(2.0 / problem.N, 1e-4), _FASTEST_MODE, _RATES)
    reals = [k for k in range(s.size) if s[k].imag == 0]
    up = [k for k in range(s.size) if s[k].imag > 0]
    pairs = [(k, m) for k, m in product(up, range(s.size)) if s[m] == np.conj(s[k])]
    pairs += [(k, m) for k, m in combinations(reals, 2)][:_MAX_REAL_PAIRS]
    each: list[tuple[tuple[int, ...], Any]] = [((k,), [-rate]) for k in reals for rate in rates]
    for pair in pairs:
        for rate in rates:
            each += [(pair, rate * np.exp(1j * np.array([a, -a]))) for a in _ANGLES]
        each += [(pair, [-a, -b]) for a, b in combinations(rates[::2], 2)]
    for removed, added in each:
        moved = np.real(np.poly(np.append(np.delete(s, removed), added)))[1:]
        if problem.admits(theta := problem.joined(noise, moved, delay)):
            yield theta


def _derivatives(x: Array, system: SampledSystem) -> Array:
    """Return s^p/F x for p = 0 … n - 1, (N, n)."""
    before = np.zeros(system.nk)
    return np.column_stack([apply_filter(np.append(before, b), system.F, x) for b in system.B.T])


def _stable(f: Array) -> Array:
    """Return f with each pole in the left half plane, and no pole faster than the samples show."""
    s = roots(monic(f)).astype(np.complex128)
    s.real = np.clip(-np.abs(s.real), -3.0, -1e-5)
    s.imag = np.clip(s.imag, -3.0, 3.0)
    return np.asarray(np.real(np.poly(s))[1:])
