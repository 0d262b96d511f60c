"""Search from several start values, and from additional start values if the minimum is in doubt.

In an additional start value one mode of A, C, D or F is moved to another frequency or damping. If
the noise is strong, the prediction error has several minima of nearly equal cost. In each minimum a
weak mode fits the noise at a different frequency. If the noise and the input are slow, a real root
may also fit the noise. Therefore the search moves each mode.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Any, TypeVar

import numpy as np

from armrig.estimation.continuous_problem import ContinuousProblem
from armrig.estimation.problem import PolynomialProblem
from armrig.estimation.start_values import denominators_of_signals, start_values
from armrig.models.innovations import with_output
from armrig.numerics.covariance import pairwise_covariance, whitening
from armrig.numerics.levenberg_marquardt import FIRST_DAMPING, MAX_STEPS, Optimum
from armrig.numerics.polynomial import Array, apply_filter, monic, of_roots, reduce_order, roots
from armrig.numerics.rounding import rounding_std

Ends = list[tuple[str, Optimum]]
"""Name of each start value, and the minimum reached by the search from this start value."""
End = TypeVar("End")
Problem = PolynomialProblem | ContinuousProblem

SAME_COST_TOLERANCE = 1e-6  # relative difference in cost up to which two searches agree
_MIN_NOISE_SHARE = 0.2  # if noise is a larger share of the output's variance, a mode may fit noise
_MAX_ROUNDS = 6
_MAX_MOVED_COEFFICIENTS = 30  # coefficients of C, D and F; with 60 a round takes a minute
_STAGES = ((10, 16), (40, 1))  # (steps of each search, number of searches that continue)
_OTHER_MINIMUM = 1e-4  # relative difference in cost of two searches that need not be completed
_RETURN_TOLERANCE = 1e-7  # relative difference in cost up to which two minima are the same
_PAIR_ANGLES = np.linspace(0.1, 3.0, 15)  # angles of a moved pair, in rad per sample
_REAL_ROOTS = (0.99, 0.95, 0.8, 0.3, -0.3, -0.8)
_MAX_REAL_ROOT = 0.998
_REAL_TOLERANCE = 1e-9
_PAIR_RADII = (0.98, 0.85, 0.6)
_STARTS_PER_KIND = 6
_STARTS_IF_AGREED = 3  # likewise, if all searches so far ended in the same minimum
_ADDED_ROOTS = (0.5, -0.5)  # roots added to F for a model of higher order
# An added root that cancels is a saddle point, which rounding errors alone would leave.
_SHRINKAGE = 0.9999  # factor of all roots of the model of higher order
_MAX_LARGER_STEPS = 20  # steps of the search for the model of higher order
_FIRST_STEPS = 10  # steps of the search for the model that completes data with gaps
_MAX_STEPS_WITH_GAPS = 30  # steps between two estimates of Lambda, each of which takes long
_MAX_REWEIGHTINGS = 10
_SAME_TOLERANCE = 1e-6  # relative change of Lambda at which the iteration from a start ends
_END_TOLERANCE = 1e-10  # relative change of Lambda at which the last iteration ends
_MAX_MOVES = 3  # largest number of rounds in which a mode of several outputs is moved
_MOVED_STARTS = 3  # start values with a moved mode in each of these rounds


def search_minima(
    problem: PolynomialProblem, part: PolynomialProblem | None = None, *, thorough: bool = True
) -> Ends:
    """Return the minimum reached from each start value, best first.

    If the minimum is in doubt, the search moves each mode of the best model and starts again, as
    long as the cost decreases by more than chance explains. The minimum is in doubt if the searches
    end in different minima. In a thorough search without `part`, it is also in doubt if the cost is
    larger than rounding errors explain. In any other search, it is also in doubt if an F has at
    least two roots and the noise is strong. A single mode of more than 30 coefficients has little
    meaning and is not moved.

    All searches start on `part`, a part of long data. From each minimum on the part, one search
    continues on all data. If the search is not thorough, it moves only complex pairs of F. If C and
    D of a model with F only fit chance, it moves no mode of C and D.
    """
    ends = from_starts(problem) if part is None else _through(part, problem)
    movable = thorough or max(problem.rows[0].sizes, default=0) >= 2
    doubtful = movable and _doubtful(problem, ends, strict=thorough and part is None)
    for _ in range(_MAX_ROUNDS if doubtful else 0):
        best = ends[0][1]
        letters = "acdf" if thorough and _noise_matters(problem, best) else "f"
        agreed = same_minimum(problem, best.cost, ends[-1][1].cost)
        most = _STARTS_IF_AGREED if agreed else _STARTS_PER_KIND
        moves = {"letters": letters, "all_kinds": thorough, "most": most}
        lowest = _lowest_without_gaps(problem, best, **moves)
        if same_minimum(problem, lowest.cost, best.cost):
            break
        ends.insert(0, ("mode at another frequency", lowest))
        if _by_chance(problem, lowest.cost, best.cost, 1):
            break
    return ends


def _lowest_without_gaps(problem: PolynomialProblem, best: Optimum, **moves: Any) -> Optimum:
    """Return the minimum from the best moved mode, with predicted values of missing outputs."""
    if not problem.gaps:
        return lowest_beside(problem, best, starts_with_moved_mode(problem, best.theta, **moves))
    filled = _fill_by_prediction(problem, best.theta)
    begin = filled.minimise(_transfer_theta(filled, problem, best.theta))
    lowest = lowest_beside(filled, begin, starts_with_moved_mode(filled, begin.theta, **moves))
    if same_minimum(filled, lowest.cost, begin.cost):
        return best
    optimum = problem.minimise(
        _transfer_theta(problem, filled, lowest.theta), earlier_cost=best.cost
    )
    return optimum if optimum.cost < best.cost else best


def _fill_by_prediction(problem: PolynomialProblem, theta: Array) -> PolynomialProblem:
    """Return the problem with estimates of the missing outputs of a noise model."""
    return _fill_gaps(
        problem, [[p.y for p in row_errors] for row_errors in problem.solve_scaled(theta)[0].parts]
    )


def _fill_gaps(
    problem: PolynomialProblem, outputs: Sequence[Sequence[Array]] | None = None
) -> PolynomialProblem:
    """Return the problem without gaps, with the given outputs, by default interpolated ones."""
    filled_outputs = outputs or [[x.y for x in experiment] for experiment in problem.experiments]
    experiments = tuple(
        tuple(
            with_output(x, n, y) if x.gaps else x
            for x, n, y in zip(experiment, problem.rows, ys, strict=True)
        )
        for experiment, ys in zip(problem.experiments, filled_outputs, strict=True)
    )
    return replace(problem, experiments=experiments)


def lowest_beside(
    problem: Problem,
    best: Optimum,
    starts: Iterable[Array],
    stages: Iterable[tuple[int, int]] = _STAGES,
) -> Optimum:
    """Return the lowest minimum reached from a moved mode, or `best` if no minimum is lower.

    A stage has a number of steps, and the number of searches that continue after these steps.
    """
    target = best.cost * (1 - _RETURN_TOLERANCE)
    searches = [(start, FIRST_DAMPING) for start in starts]
    for steps, kept in stages:
        ends = [
            problem.minimise(theta, most=steps, target=target, best=best.theta, damping=damping)
            for theta, damping in searches
        ]
        near = [end for end in ends if end.cost < target or end.iterations == steps]
        near.sort(key=lambda end: end.cost)
        searches = [(end.theta, end.damping) for end in near[:kept]]
    lowest = min(near, key=lambda end: end.cost, default=best)
    if lowest.cost >= best.cost:
        return best
    return lowest if lowest.converged else problem.minimise(lowest.theta)


def from_starts(problem: PolynomialProblem) -> Ends:
    """Return the minimum reached from each start value of polynomials, best first.

    In data with gaps, the first searches have interpolated outputs, then predicted ones. From each
    of their minima, one search continues with the gaps.
    """
    other = np.inf if problem.rows[0].white else _OTHER_MINIMUM
    if not problem.gaps:
        return from_each(problem, start_values(problem), other)
    filled = _predict_gaps(problem)
    return _continue_searches(problem, filled, from_each(filled, start_values(filled), other))


def _predict_gaps(problem: PolynomialProblem) -> PolynomialProblem:
    """Return the problem with the predictions of a first model, which has interpolated outputs."""
    filled = _fill_gaps(problem)
    first = from_each(filled, start_values(filled))[0][1]
    return _fill_by_prediction(problem, _transfer_theta(problem, filled, first.theta))


def from_each(problem: Problem, starts: Iterable[tuple[str, Array]], other: float = np.inf) -> Ends:
    """Return the minimum reached from each start value, best first.

    The first search is from the start value of least cost. A later search ends before its minimum
    if the relative difference to the least cost will remain above `other`.
    """
    ends: Ends = []
    for name, theta in sorted(starts, key=lambda start: problem.cost(start[1])):
        least_cost = min((end.cost for _, end in ends), default=float("nan"))
        ends.append(
            (
                name,
                problem.minimise(theta, earlier_cost=least_cost, target=least_cost * (1 + other)),
            )
        )
    return sorted(ends, key=lambda end: end[1].cost)


def _through(part: PolynomialProblem, problem: PolynomialProblem) -> Ends:
    """Continue from the minima on a part of the data; return the minima on all data, best first."""
    return _continue_searches(problem, part, from_starts(part))


def _continue_searches(
    problem: PolynomialProblem, part: PolynomialProblem, known_ends: Ends
) -> Ends:
    """Continue from the distinct minima of another problem; return the minima, best first."""
    ends: Ends = []
    previous: tuple[float, Optimum] | None = None
    for name, on_part in known_ends:
        if previous is not None and same_minimum(part, previous[0], on_part.cost):
            end = previous[1]
        else:
            least_cost = min((end.cost for _, end in ends), default=float("nan"))
            end = problem.minimise(
                _transfer_theta(problem, part, on_part.theta), earlier_cost=least_cost
            )
        previous = on_part.cost, end
        steps = on_part.iterations + end.iterations
        ends.append((name, replace(end, iterations=steps)))
    return sorted(ends, key=lambda end: end[1].cost)


def _transfer_theta(problem: PolynomialProblem, part: PolynomialProblem, theta: Array) -> Array:
    """Return the parameters from those of `part`; only one of the problems may search A."""
    if problem.size <= theta.size:
        return theta[theta.size - problem.size :]
    return np.append(part.named(part.solve(theta).ab, theta)["A"][1:], theta)


def rounding_floor(problem: PolynomialProblem) -> float:
    """Return the cost below which the residuals are rounding errors."""
    outputs = [x.y[x.rows] for experiment in problem.experiments for x in experiment]
    return sum(y.size * rounding_std(y) ** 2 for y in outputs)


def same_minimum(problem: PolynomialProblem, lower: float, higher: float) -> bool:
    """Return whether two costs belong to the same minimum."""
    return higher <= lower * (1 + SAME_COST_TOLERANCE) + rounding_floor(problem)


def _doubtful(problem: PolynomialProblem, ends: Ends, *, strict: bool) -> bool:
    if not 0 < problem.size <= _MAX_MOVED_COEFFICIENTS:
        return False
    if not same_minimum(problem, ends[0][1].cost, ends[-1][1].cost):
        return True
    if strict:
        return ends[0][1].cost > rounding_floor(problem)
    if max(problem.rows[0].sizes, default=0) < 2:
        return False
    parts = problem.solve_scaled(ends[0][1].theta)[0].parts
    noise = variance = 0.0
    for (x,), (p,) in zip(problem.experiments, parts, strict=True):
        y = x.y[x.rows]
        noise += float(np.sum((y - p.driven[x.rows]) ** 2))
        variance += float(np.sum((y - y.mean()) ** 2)) if y.size else 0.0
    return noise > _MIN_NOISE_SHARE * variance


def _noise_matters(problem: PolynomialProblem, best: Optimum) -> bool:
    """Return whether C and D, given F, lower the cost by more than chance explains."""
    n = problem.rows[0]
    if n.white or n.na or not any(n.sizes):
        return True
    white = replace(problem, rows=(n.output_error,))
    cost = white.cost(best.theta[np.array(problem.letters) == "f"])
    return not _by_chance(problem, best.cost, cost, n.nc + n.nd)


def _by_chance(problem: PolynomialProblem, lower: float, higher: float, parameters: int) -> bool:
    """Return whether two costs differ by at most the description length of some parameters."""
    return bool(higher <= lower * problem.N ** (parameters / problem.N))


def starts_with_moved_mode(
    problem: PolynomialProblem, theta: Array, *, letters: str, all_kinds: bool, most: int
) -> Iterator[Array]:
    """Yield start values with one moved mode of `letters`, up to `most` for each kind of move.

    A complex pair, or the two smallest real roots, is replaced by another complex pair or by two
    other real roots. A real root is replaced by another real root. For each polynomial and each
    kind of move, the start values of least cost are returned. Without `all_kinds` only pairs of F
    are moved.
    """
    kinds = (other_pairs, _other_reals, other_real) if all_kinds else (other_pairs,)
    for k, letter in enumerate(problem.layout.letters):
        for kind in kinds if letter in letters else ():
            yield from cheapest(problem, _with_mode(problem, theta, k, kind), most)
    if all_kinds:
        if "c" in letters:
            yield from cheapest(problem, _starts_with_close_roots(problem, theta), most)
        yield from _with_white_noise(problem, theta)
        yield from cheapest(problem, _through_a_higher_order(problem, theta), most)


def _with_mode(
    problem: PolynomialProblem, theta: Array, k: int, kind: Callable[[Array], Iterator[Array]]
) -> Iterator[Array]:
    """Yield theta with one moved mode of polynomial k."""
    part = problem.layout.slices[k]
    for z in kind(roots(monic(theta[part]))):
        start = theta.copy()
        start[part] = of_roots(z)[1:]
        yield start


def cheapest(problem: Problem, starts: Iterable[Array], most: int) -> list[Array]:
    """Return the start values of least cost."""
    priced = sorted(((problem.cost(start), start) for start in starts), key=lambda of: of[0])
    return [start for _, start in priced[:most]]


def _starts_with_close_roots(problem: PolynomialProblem, theta: Array) -> Iterator[Array]:
    """Yield start values in which real roots of C and D move to nearly equal values."""
    of_c, of_d = problem.slice_of("c", 0), problem.slice_of("d", 0)
    C, D = roots(monic(theta[of_c])), roots(monic(theta[of_d]))
    for z, w in product(_without_one_real(C), _without_one_real(D)):
        for root, share in product(_REAL_ROOTS, (0.9, 1 / 0.9)):
            near = np.clip(root * share, -_MAX_REAL_ROOT, _MAX_REAL_ROOT)
            start = theta.copy()
            start[of_c] = of_roots(np.append(z, near))[1:]
            start[of_d] = of_roots(np.append(w, root))[1:]
            yield start


def _with_white_noise(problem: PolynomialProblem, theta: Array) -> Iterator[Array]:
    """Yield start values in which F is estimated again, from signals filtered by D/C."""
    at = np.array(problem.letters) == "f"
    if not at.any() or at.all():
        return
    D, C = (monic(theta[problem.slice_of(letter, 0)]) for letter in "dc")
    signals = [
        [(np.column_stack([apply_filter(D, C, u) for u in x.u.T]), apply_filter(D, C, x.y))]
        for (x,) in problem.experiments
    ]
    output_error = replace(problem, rows=tuple(n.output_error for n in problem.rows))
    for f in denominators_of_signals(output_error, signals):
        start = theta.copy()
        start[at] = f
        yield start


def _through_a_higher_order(problem: PolynomialProblem, theta: Array) -> Iterator[Array]:
    """Yield start values from an output-error model of higher order, with one mode removed."""
    # In the larger model a mode can pass a frequency where the smaller model has maximal cost.
    n = problem.rows[0]
    if len(n.groups) > 1 or not any(n.sizes) or not n.white:
        return
    nb, nf = (
        tuple(k + 1 if count else 0 for k, count in zip(x, n.nb, strict=True)) for x in (n.nb, n.nf)
    )
    larger = replace(problem, rows=(replace(n, nb=nb, nf=nf),))
    for root in _ADDED_ROOTS:
        F = np.convolve(monic(theta), [1.0, -root]) * _SHRINKAGE ** np.arange(theta.size + 2)
        larger_f = larger.minimise(F[1:], most=_MAX_LARGER_STEPS).theta
        yield from (lower[1:] for lower in reduce_order(monic(larger_f)))


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
    """Yield the roots without each complex pair, then without the two smallest real roots."""
    indices = np.arange(z.size)
    for i in np.flatnonzero(z.imag > _REAL_TOLERANCE):
        partner = int(np.argmin(np.abs(z - np.conj(z[i]))))
        yield z[(indices != i) & (indices != partner)]
    real = np.flatnonzero(np.abs(z.imag) <= _REAL_TOLERANCE)
    if real.size >= 2:
        smallest = real[np.argsort(np.abs(z[real]))[:2]]
        yield z[~np.isin(indices, smallest)]


def search_together(problem: PolynomialProblem) -> tuple[PolynomialProblem, Ends]:
    """Return the problem of several outputs with an estimated Lambda, and its minima, best first.

    Data with gaps are completed by the predictions of a first model. After the search in these
    data, one search continues in the data with gaps.
    """
    if not problem.gaps:
        return _reweigh(problem, from_starts(problem))
    _, start = min(start_values(problem), key=lambda start: problem.cost(start[1]))
    filled = _fill_by_prediction(problem, problem.minimise(start, most=_FIRST_STEPS).theta)
    filled, ends = _reweigh(filled, from_starts(filled))
    name, best = ends[0]
    begin = replace(best, theta=_transfer_theta(problem, filled, best.theta))
    Lambda = noise_covariance(filled, best.theta)
    _, problem, end = _iterate_weights(with_noise_weights(problem, Lambda), begin, _END_TOLERANCE)
    return problem, [(name, end), *ends[1:]]


def _reweigh(problem: PolynomialProblem, ends: Ends) -> tuple[PolynomialProblem, Ends]:
    """Return the problem of least det Lambda, and the minima with an estimated Lambda."""
    # The best minimum need not be the first of `ends`, which the variances of y weighted.
    candidates = [(name, *_iterate_weights(problem, end, _SAME_TOLERANCE)) for name, end in ends]
    candidates = rank_ends(candidates, lambda one: one[1])
    for _ in range(_MAX_MOVES):
        best = candidates[0]
        moved = [
            ("moved mode", *_iterate_weights(best[2], best[2].minimise(theta), _SAME_TOLERANCE))
            for theta in _best_moved_starts(best[2], best[3].theta)
        ]
        candidates = rank_ends([*candidates, *moved], lambda one: one[1])
        if candidates[0] is best:
            break
    name, _, weighted, end = candidates[0]
    _, weighted, end = _iterate_weights(weighted, end, _END_TOLERANCE)
    return weighted, [(name, end), *((other, end) for other, _, _, end in candidates[1:])]


def _best_moved_starts(problem: PolynomialProblem, theta: Array) -> list[Array]:
    """Move one mode of A and F, or else of C and D; return the start values of least cost."""
    letters = problem.layout.letters
    moved = "af" if set(problem.letters) & set("af") else "cd"
    starts = [
        start
        for k, letter in enumerate(letters)
        if letter in moved
        for kind in (other_real, other_pairs)
        for start in _with_mode(problem, theta, k, kind)
    ]
    return cheapest(problem, starts, _MOVED_STARTS)


def _iterate_weights(
    problem: PolynomialProblem, end: Optimum, tolerance: float
) -> tuple[float, PolynomialProblem, Optimum]:
    """Return log det Lambda, the problem and its minimum after Lambda hardly changes."""
    Lambda = noise_covariance(problem, end.theta)
    most = _MAX_STEPS_WITH_GAPS if problem.gaps else MAX_STEPS
    steps = end.iterations
    for _ in range(_MAX_REWEIGHTINGS):
        problem = with_noise_weights(problem, Lambda)
        end = problem.minimise(end.theta, most=most)
        steps += end.iterations
        before, Lambda = Lambda, noise_covariance(problem, end.theta)
        std = np.sqrt(np.diag(Lambda))
        if (np.abs(Lambda - before) <= tolerance * np.outer(std, std)).all():
            break
    end = replace(end, iterations=steps)
    return float(np.linalg.slogdet(Lambda)[1]), problem, end


def with_noise_weights(problem: PolynomialProblem, Lambda: Array) -> PolynomialProblem:
    """Return the problem of several rows with the weights inv(Lambda)."""
    masks = [np.column_stack([x.rows for x in experiment]) for experiment in problem.experiments]
    return replace(problem, weights=tuple(whitening(Lambda, m) for m in masks))


def noise_covariance(problem: PolynomialProblem, theta: Array) -> Array:
    """Return the covariance of the errors at theta."""
    e = [
        np.column_stack(
            [np.where(x.rows, p.e, np.nan) for x, p in zip(experiment, parts, strict=True)]
        )
        for experiment, parts in zip(problem.experiments, problem.solve(theta).parts, strict=True)
    ]
    return pairwise_covariance(np.vstack(e))


def rank_ends(ends: Iterable[End], criterion: Callable[[End], float]) -> list[End]:
    """Return the results of searches, best first; results at the same minimum keep their order.

    At the same minimum only rounding errors, which differ from processor to processor, decide which
    cost is lower. `criterion` returns the logarithm of the cost of a result.
    """
    all_ends = list(ends)
    values = np.array([criterion(end) for end in all_ends])
    values[np.isnan(values)] = np.inf
    higher = values > values.min()
    steps = np.zeros(values.size)
    steps[higher] = np.rint((values[higher] - values.min()) / SAME_COST_TOLERANCE)
    return [all_ends[i] for i in np.argsort(steps, kind="stable")]
