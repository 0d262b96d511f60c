"""Search from several start values, and from additional start values if the minimum is in doubt.

In an additional start value one mode of C, D or F is moved to another frequency or damping. If the
noise is strong, the prediction error has several minima of nearly equal cost. In each minimum a
weak mode fits the noise at a different frequency. If the noise and the input are slow, a real root
may also fit the noise. Therefore the search moves each mode.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from armrig.estimation.hannan_rissanen import (
    armax_start,
    equation_error,
    high_order_output,
    noise_start,
    steiglitz_mcbride,
)
from armrig.estimation.prediction_error import PredictionErrorProblem
from armrig.numerics.levenberg_marquardt import Optimum
from armrig.numerics.polynomial import Array, filtered, reduced, reflected, roots

Ends = list[tuple[str, Optimum]]
"""Name of each start value, and the minimum reached by the search from this start value."""

SAME_COST_TOLERANCE = 1e-6  # relative difference in cost up to which two searches agree
ROUNDING_SHARE = 1e-18  # share of |y|² below which |e|² is rounding noise
_MIN_NOISE_SHARE = 0.2  # if noise is a larger share of the output's variance, a mode may fit noise
_MAX_ROUNDS = 6
_MAX_MOVED_COEFFICIENTS = 30  # coefficients of C, D and F; with 60 a round takes a minute
_STAGES = ((10, 16), (40, 1))  # (steps of each search, number of searches that continue)
_RETURN_TOLERANCE = 1e-7  # relative difference in cost up to which two minima are the same
_PAIR_ANGLES = np.linspace(0.1, 3.0, 15)  # angles of a moved pair, in rad per sample
_REAL_ROOTS = (0.99, 0.95, 0.8, 0.3, -0.3, -0.8)
_MAX_REAL_ROOT = 0.998
_REAL_TOLERANCE = 1e-9
_PAIR_RADII = (0.98, 0.85, 0.6)
_STARTS_PER_KIND = 6
_F_INDEX = 2  # index of F in (C, D, F)
_ADDED_ROOTS = (0.5, -0.5)  # roots added to F for a model of higher order
_MAX_LARGER_STEPS = 60  # steps of the search for the model of higher order
_MAX_OE_STEPS = 12  # steps of the search for an output-error start value; it need not converge


def searched_minimum(
    problem: PredictionErrorProblem,
    part: PredictionErrorProblem | None = None,
    *,
    thorough: bool = True,
) -> Ends:
    """Return the minimum reached from each start value, best first.

    If the minimum is in doubt, the search moves each mode of the best model and starts again, as
    long as the cost decreases. The minimum is always in doubt if the searches end in different
    minima. In a thorough search without `part`, the minimum is also in doubt if the cost is larger
    than rounding errors explain. In any other search, the minimum is also in doubt if F has at
    least two roots and the noise is strong. If C, D and F have more than 30 coefficients, no mode
    is moved, because a single mode then has little meaning.

    Parameters
    ----------
    part : PredictionErrorProblem, optional
        Problem for a part of long data. All searches start on this part. From each minimum on the
        part, one search continues on all data.
    thorough : bool
        True: move complex pairs and real roots of C, D and F. False: move only complex pairs of F.
    """
    ends = _from_starts(problem) if part is None else _through(part, problem)
    if not (thorough or problem.structure.nf >= 2):
        return ends
    doubtful = _doubtful(problem, ends, strict=thorough and part is None)
    for _ in range(_MAX_ROUNDS if doubtful else 0):
        best = ends[0][1]
        lowest = _lowest_beside(problem, best, thorough=thorough)
        if same_minimum(problem, lowest.cost, best.cost):
            break
        ends.insert(0, ("mode at another frequency", lowest))
    return ends


def _lowest_beside(problem: PredictionErrorProblem, best: Optimum, *, thorough: bool) -> Optimum:
    """Return the lowest minimum reached from a moved mode, or `best` if no minimum is lower.

    After ten steps only the 16 searches with the least cost continue. A search that returned to the
    minimum `best` does not continue.
    """
    starts = list(moved_modes(problem, best.theta, all_kinds=thorough))
    for steps, kept in _STAGES:
        near = [problem.minimise(start, most=steps, known=best.cost) for start in starts]
        near = [end for end in near if abs(end.cost - best.cost) > _RETURN_TOLERANCE * best.cost]
        near.sort(key=lambda end: end.cost)
        starts = [end.theta for end in near[:kept]]
    lowest = min(near, key=lambda end: end.cost, default=best)
    if lowest.cost >= best.cost:
        return best
    return lowest if lowest.converged else problem.minimise(lowest.theta)


def _from_starts(problem: PredictionErrorProblem) -> Ends:
    """Return the minimum reached from each start value, best first.

    The first search is from the start value of least cost.
    """
    starts = sorted(start_values(problem), key=lambda start: problem.cost(start[1]))
    ends: Ends = []
    for name, theta in starts:
        known = min((end.cost for _, end in ends), default=float("nan"))
        ends.append((name, problem.minimise(theta, known=known)))
    return sorted(ends, key=lambda end: end[1].cost)


def _through(part: PredictionErrorProblem, problem: PredictionErrorProblem) -> Ends:
    """Continue from the minima on a part of the data, and return the minima on all data.

    The best minimum is the first.
    """
    ends: Ends = []
    previous: tuple[float, Optimum] | None = None
    for name, on_part in _from_starts(part):
        if previous is not None and same_minimum(part, previous[0], on_part.cost):
            end = previous[1]
        else:
            known = min((end.cost for _, end in ends), default=float("nan"))
            end = problem.minimise(on_part.theta, known=known)
        previous = on_part.cost, end
        steps = on_part.iterations + end.iterations
        ends.append((name, replace(end, iterations=steps)))
    return sorted(ends, key=lambda end: end[1].cost)


def rounding_floor(problem: PredictionErrorProblem) -> float:
    """Return the cost below which the residuals are rounding errors."""
    return ROUNDING_SHARE * sum(float(np.sum(x.y[x.rows] ** 2)) for x in problem.experiments)


def same_minimum(problem: PredictionErrorProblem, lower: float, higher: float) -> bool:
    """Return whether two costs belong to the same minimum."""
    return higher <= lower * (1 + SAME_COST_TOLERANCE) + rounding_floor(problem)


def _doubtful(problem: PredictionErrorProblem, ends: Ends, *, strict: bool) -> bool:
    n = problem.structure
    if not 0 < n.nc + n.nd + n.nf <= _MAX_MOVED_COEFFICIENTS:
        return False
    if not same_minimum(problem, ends[0][1].cost, ends[-1][1].cost):
        return True
    if strict:
        return ends[0][1].cost > rounding_floor(problem)
    if n.nf < 2:
        return False
    parts = problem.solve(ends[0][1].theta).parts
    left = [(x.y - p.driven)[x.rows] for x, p in zip(problem.experiments, parts, strict=True)]
    y = [x.y[x.rows] for x in problem.experiments]
    noise = sum(float(np.sum(v**2)) for v in left)
    variance = sum(float(np.sum((s - s.mean()) ** 2)) for s in y if s.size)
    return noise > _MIN_NOISE_SHARE * variance


def moved_modes(
    problem: PredictionErrorProblem, theta: Array, *, all_kinds: bool = True
) -> Iterator[Array]:
    """Yield start values with one moved mode of C, D or F, up to six for each kind of move.

    A complex pair, or the two smallest real roots, is replaced by another complex pair or by two
    other real roots. A real root is replaced by another real root. For each polynomial and each
    kind of move, the start values of least cost are returned.

    Parameters
    ----------
    all_kinds : bool
        True: move all modes. False: move only pairs of F, to other frequencies.
    """
    polynomials = problem.polynomials(theta)
    kinds = (other_pairs, _other_reals, other_real) if all_kinds else (other_pairs,)
    for which, polynomial in enumerate(polynomials):
        for kind in kinds if all_kinds or which == _F_INDEX else ():
            starts = []
            for moved in kind(roots(polynomial)):
                others = [*polynomials]
                others[which] = np.real(np.poly(moved))
                start = np.concatenate([other[1:] for other in others])
                starts.append((problem.cost(start), start))
            starts.sort(key=lambda start: start[0])
            yield from (start for _, start in starts[:_STARTS_PER_KIND])
    if all_kinds:
        yield from _moved_together(problem, theta)
        yield from _with_white_noise(problem, theta)
        yield from _through_a_higher_order(problem, theta)


def _moved_together(problem: PredictionErrorProblem, theta: Array) -> Iterator[Array]:
    """Yield start values in which real roots of C and D move to nearly equal values."""
    C, D, F = problem.polynomials(theta)
    starts = []
    for z, w in product(_without_one_real(roots(C)), _without_one_real(roots(D))):
        for root, share in product(_REAL_ROOTS, (0.9, 1 / 0.9)):
            near = np.clip(root * share, -_MAX_REAL_ROOT, _MAX_REAL_ROOT)
            c, d = np.real(np.poly(np.append(z, near))), np.real(np.poly(np.append(w, root)))
            start = np.concatenate([c[1:], d[1:], F[1:]])
            starts.append((problem.cost(start), start))
    starts.sort(key=lambda start: start[0])
    yield from (start for _, start in starts[:_STARTS_PER_KIND])


def _with_white_noise(problem: PredictionErrorProblem, theta: Array) -> Iterator[Array]:
    """Yield start values in which F is estimated again, from signals filtered by D/C."""
    n = problem.structure
    C, D, _ = problem.polynomials(theta)
    if n.nf == 0 or n.nc + n.nd == 0:
        return
    signals = [(filtered(D, C, x.u), filtered(D, C, x.y)) for x in problem.experiments]
    smooth = high_order_output(signals, n)
    for F, on in ((np.ones(1), smooth), (np.ones(1), signals)):
        for better in steiglitz_mcbride(on, F, n, iterations=5):
            yield np.concatenate([theta[: n.nc + n.nd], better[1:]])


def _through_a_higher_order(problem: PredictionErrorProblem, theta: Array) -> Iterator[Array]:
    """Yield start values from an output-error model of higher order, with one mode removed.

    The larger model has one more b and one more f. During the search for the larger model, a mode
    can move past a frequency at which the cost of the smaller model has a maximum.
    """
    n = problem.structure
    if n.nf == 0 or n.na + n.nc + n.nd:
        return
    larger = replace(problem, structure=replace(n, nb=n.nb + 1, nf=n.nf + 1))
    starts: list[Array] = []
    for root in _ADDED_ROOTS:
        F = np.convolve(np.append(1.0, theta), [1.0, -root])
        found = larger.minimise(F[1:], most=_MAX_LARGER_STEPS).theta
        starts.extend(lower[1:] for lower in reduced(np.append(1.0, found)))
    yield from sorted(starts, key=problem.cost)[:_STARTS_PER_KIND]


def other_pairs(z: Array) -> Iterator[Array]:
    """Yield the roots z with one pair replaced by another complex pair."""
    for kept in _without_one_pair(z):
        for radius, angle in product(_PAIR_RADII, _PAIR_ANGLES):
            yield np.concatenate([kept, radius * np.exp(1j * np.array([angle, -angle]))])


def _other_reals(z: Array) -> Iterator[Array]:
    for kept in _without_one_pair(z):
        for pair in combinations(_REAL_ROOTS, 2):
            yield np.concatenate([kept, pair])


def other_real(z: Array) -> Iterator[Array]:
    """Yield the roots z with one real root replaced by another real root."""
    for kept in _without_one_real(z):
        for root in _REAL_ROOTS:
            yield np.append(kept, root)


def _without_one_real(z: Array) -> Iterator[Array]:
    for i in np.flatnonzero(np.abs(z.imag) <= _REAL_TOLERANCE):
        yield np.delete(z, i)


def _without_one_pair(z: Array) -> Iterator[Array]:
    """Yield the roots with one complex pair removed, for each complex pair.

    Then yield the roots with the two smallest real roots removed, if there are two.
    """
    rest = np.arange(z.size)
    for i in np.flatnonzero(z.imag > _REAL_TOLERANCE):
        partner = int(np.argmin(np.abs(z - np.conj(z[i]))))
        yield z[(rest != i) & (rest != partner)]
    real = np.flatnonzero(np.abs(z.imag) <= _REAL_TOLERANCE)
    if real.size >= 2:
        smallest = real[np.argsort(np.abs(z[real]))[:2]]
        yield z[~np.isin(rest, smallest)]


def start_values(problem: PredictionErrorProblem) -> Iterator[tuple[str, Array]]:
    """Yield named start values (c, d, f) with stable C and F.

    F is estimated by output-error models. C and D are then estimated from the residual noise. The
    last start value is the fitted output-error model. With strong noise this start value alone is
    not sufficient, because a Box-Jenkins search from it ends in a poor minimum.
    """
    n = problem.structure
    if n.nf == 0:
        yield from _without_denominator(problem)
        return
    output_error = replace(problem, structure=replace(n, na=0, nc=0, nd=0))
    found = []
    for name, F in denominators(output_error):
        found.append(F)
        yield name, _with_noise(problem, F)
    if n.nc + n.nd:
        best = min(found, key=lambda F: output_error.cost(F[1:]))
        f = output_error.minimise(best[1:], most=_MAX_OE_STEPS).theta
        yield "OE", _with_noise(problem, np.append(1.0, f))


def denominators(problem: PredictionErrorProblem) -> Iterator[tuple[str, Array]]:
    """Yield named start values of a stable F in an output-error problem.

    Missing samples of y are interpolated for these start values, but not in the search itself.
    """
    signals = [(x.u, x.y) for x in problem.experiments]
    n = problem.structure
    F, _ = equation_error(signals, np.ones(1), n)
    yield "ARX", reflected(F)
    smooth = high_order_output(signals, n)
    at_rest = replace(n, at_rest=True)
    *_, F_smooth = steiglitz_mcbride(smooth, np.ones(1), at_rest, iterations=5)
    candidates = [F_smooth, *steiglitz_mcbride(signals, F_smooth, n, iterations=5)]
    yield (
        "high-order ARX, Steiglitz-McBride",
        min(candidates, key=lambda F: problem.cost(F[1:])),
    )


def _without_denominator(problem: PredictionErrorProblem) -> Iterator[tuple[str, Array]]:
    n = problem.structure
    plain = np.ones(1)
    if n.nc + n.nd == 0:
        yield "least squares", np.zeros(0)
        return
    if n.na and n.nc and not n.nd:
        C = armax_start(problem.experiments, na=n.na, nb=n.nb, nc=n.nc, nk=n.nk)
        yield "Hannan-Rissanen", C[1:]
    yield "ARX" if n.na else "FIR", _with_noise(problem, plain)


def _with_noise(problem: PredictionErrorProblem, F: Array) -> Array:
    """Return (c, d, f) for a given F; C and D are fitted to the noise A y - (B/F) u."""
    n = problem.structure
    f = F[1:]
    if n.nc + n.nd == 0:
        return f
    theta = np.concatenate([np.zeros(n.nc + n.nd), f])
    solution = problem.solve(theta)
    A = problem.named(solution.ab, theta)["A"]
    v = []
    for x, part in zip(problem.experiments, solution.parts, strict=True):
        noise = filtered(A, [1.0], x.y) - part.driven
        noise[~x.rows] = np.nan
        v.append(noise)
    C, D = noise_start(v, nc=n.nc, nd=n.nd)
    return np.concatenate([C[1:], D[1:], f])
