"""The search from several start values, and from more where the minimum is in doubt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from armrig.estimation.moved_modes import moved_modes
from armrig.estimation.prediction_error import PredictionError
from armrig.estimation.start_values import start_values
from armrig.numerics.levenberg_marquardt import Optimum

Ends = list[tuple[str, Optimum]]
"""Name of each start and where it led."""

SAME_MINIMUM = 1e-6  # relative difference in cost up to which two searches agree
ROUNDING = 1e-18  # share of |y|² below which |e|² is rounding noise
_MUCH_NOISE = 0.2  # share of the output's variance from which a mode may settle on noise
_ROUNDS = 6
_MOST_MOVED = 30  # coefficients of C, D and F; of 60 each round takes a minute
_STAGES = ((10, 8), (40, 1))  # steps from each other start, how many of them go on
_RETURNED = 1e-7  # relative difference in cost up to which a search has come back


def searched_minimum(
    problem: PredictionError, part: PredictionError | None = None, *, thorough: bool = True
) -> Ends:
    """Return where each start led, best first.

    A thorough search tries each mode of the best model at other frequencies too, again while that
    leads lower; what does not is left out. Another search does so where the ends differ, or where
    there is much noise. Of more than 30 coefficients no mode is tried: they mean little.

    Parameters
    ----------
    part : PredictionError, optional
        A part of much data: the starts are searched from on it first, and only where they lead
        apart is the whole searched from more than once.
    thorough : bool
        Whether modes of C and D, and real ones, are moved, too. Without `part` they are then moved
        wherever the cost is more than rounding.
    """
    ends = _from_starts(problem) if part is None else _through(part, problem)
    if not (thorough or problem.structure.nf >= 2):
        return ends
    doubtful = _doubtful(problem, ends, strict=thorough and part is None)
    for _ in range(_ROUNDS if doubtful else 0):
        best = ends[0][1]
        lowest = _lowest_beside(problem, best, thorough=thorough)
        if same_minimum(problem, lowest.cost, best.cost):
            break
        ends.insert(0, ("mode at another frequency", lowest))
    return ends


def _lowest_beside(problem: PredictionError, best: Optimum, *, thorough: bool) -> Optimum:
    """Return the lowest minimum that a moved mode leads to, or `best`.

    After ten steps most starts are dropped: the poor ones, and those that return to `best`.
    """
    starts = list(moved_modes(problem, best.theta, all_kinds=thorough))
    for steps, kept in _STAGES:
        near = [problem.minimise(start, most=steps, known=best.cost) for start in starts]
        near = [end for end in near if abs(end.cost - best.cost) > _RETURNED * best.cost]
        near.sort(key=lambda end: end.cost)
        starts = [end.theta for end in near[:kept]]
    lowest = min(near, key=lambda end: end.cost, default=best)
    if lowest.cost >= best.cost:
        return best
    return lowest if lowest.converged else problem.minimise(lowest.theta)


def _from_starts(problem: PredictionError) -> Ends:
    """Return where each start led, best first; the most promising start goes first."""
    starts = sorted(start_values(problem), key=lambda start: problem.cost(start[1]))
    ends: Ends = []
    for name, theta in starts:
        known = min((end.cost for _, end in ends), default=float("nan"))
        ends.append((name, problem.minimise(theta, known=known)))
    return sorted(ends, key=lambda end: end[1].cost)


def _through(part: PredictionError, problem: PredictionError) -> Ends:
    """Return where the ends that the starts have on a part lead on the whole, best first."""
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


def rounding_floor(problem: PredictionError) -> float:
    """Return the cost below which nothing is left but rounding noise."""
    return ROUNDING * sum(float(np.sum(x.y[x.rows] ** 2)) for x in problem.experiments)


def same_minimum(problem: PredictionError, lower: float, higher: float) -> bool:
    """Tell whether two costs are those of one minimum."""
    return higher <= lower * (1 + SAME_MINIMUM) + rounding_floor(problem)


def _doubtful(problem: PredictionError, ends: Ends, *, strict: bool) -> bool:
    n = problem.structure
    if not 0 < n.nc + n.nd + n.nf <= _MOST_MOVED:
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
    return noise > _MUCH_NOISE * variance
