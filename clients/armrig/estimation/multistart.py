"""The search from several start values, and from more where the minimum is in doubt.

Further start values have one mode of C, D or F at another place.

In strong noise the prediction error has minima of little difference, in which a weak mode has
settled on the noise of some frequency. Slow noise and slow inputs have others, in which a real root
has. So each mode is tried elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from armrig.estimation.hannan_rissanen import armax_start, noise_start
from armrig.estimation.prediction_error import PredictionError
from armrig.estimation.steiglitz_mcbride import equation_error, high_order_output, steiglitz_mcbride
from armrig.numerics.levenberg_marquardt import Optimum
from armrig.numerics.polynomial import Array, filtered, reflected, roots

Ends = list[tuple[str, Optimum]]
"""Name of each start and where it led."""

SAME_MINIMUM = 1e-6  # relative difference in cost up to which two searches agree
ROUNDING = 1e-18  # share of |y|² below which |e|² is rounding noise
_MUCH_NOISE = 0.2  # share of the output's variance from which a mode may settle on noise
_ROUNDS = 6
_MOST_MOVED = 30  # coefficients of C, D and F; of 60 each round takes a minute
_STAGES = ((10, 8), (40, 1))  # steps from each other start, how many of them go on
_RETURNED = 1e-7  # relative difference in cost up to which a search has come back
_ANGLES = np.linspace(0.1, 3.0, 15)  # of the moved mode, in rad a sample
_REAL = (0.99, 0.95, 0.8, 0.3, -0.3, -0.8)
_MOST_REAL = 0.998
_IS_REAL = 1e-9
_RADII = (0.98, 0.85, 0.6)
_EACH = 6  # starts of a kind
_OF_F = 2  # its place among the polynomials
_OE_STEPS = 12  # of the search for an output-error start; it need not end at the minimum


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


def moved_modes(
    problem: PredictionError, theta: Array, *, all_kinds: bool = True
) -> Iterator[Array]:
    """Yield start values in which one mode of C, D or F is moved; those of least cost of each kind.

    A complex pair, or the two smallest real roots, becomes a pair at another frequency, or two
    other real roots; a real root becomes another one.

    Parameters
    ----------
    all_kinds : bool
        Or only pairs of F at other frequencies.
    """
    polynomials = problem.polynomials(theta)
    kinds = (_other_pairs, _other_reals, _other_real) if all_kinds else (_other_pairs,)
    for which, polynomial in enumerate(polynomials):
        for kind in kinds if all_kinds or which == _OF_F else ():
            starts = []
            for moved in kind(roots(polynomial)):
                others = [*polynomials]
                others[which] = np.real(np.poly(moved))
                start = np.concatenate([other[1:] for other in others])
                starts.append((problem.cost(start), start))
            starts.sort(key=lambda start: start[0])
            yield from (start for _, start in starts[:_EACH])
    if all_kinds:
        yield from _moved_together(problem, theta)
        yield from _with_white_noise(problem, theta)


def _moved_together(problem: PredictionError, theta: Array) -> Iterator[Array]:
    """Yield starts in which a real root of C and one of D nearly cancel at another place."""
    C, D, F = problem.polynomials(theta)
    starts = []
    for z, w in product(_without_one_real(roots(C)), _without_one_real(roots(D))):
        for root, share in product(_REAL, (0.9, 1 / 0.9)):
            near = np.clip(root * share, -_MOST_REAL, _MOST_REAL)
            c, d = np.real(np.poly(np.append(z, near))), np.real(np.poly(np.append(w, root)))
            start = np.concatenate([c[1:], d[1:], F[1:]])
            starts.append((problem.cost(start), start))
    starts.sort(key=lambda start: start[0])
    yield from (start for _, start in starts[:_EACH])


def _with_white_noise(problem: PredictionError, theta: Array) -> Iterator[Array]:
    """Yield starts in which F is estimated again, from signals filtered by D/C."""
    n = problem.structure
    C, D, _ = problem.polynomials(theta)
    if n.nf == 0 or n.nc + n.nd == 0:
        return
    signals = [(filtered(D, C, x.u), filtered(D, C, x.y)) for x in problem.experiments]
    smooth = high_order_output(signals, n)
    for F, on in ((np.ones(1), smooth), (np.ones(1), signals)):
        for better in steiglitz_mcbride(on, F, n, iterations=5):
            yield np.concatenate([theta[: n.nc + n.nd], better[1:]])


def _other_pairs(z: Array) -> Iterator[Array]:
    for kept in _without_one_pair(z):
        for radius, angle in product(_RADII, _ANGLES):
            yield np.concatenate([kept, radius * np.exp(1j * np.array([angle, -angle]))])


def _other_reals(z: Array) -> Iterator[Array]:
    for kept in _without_one_pair(z):
        for pair in combinations(_REAL, 2):
            yield np.concatenate([kept, pair])


def _other_real(z: Array) -> Iterator[Array]:
    for kept in _without_one_real(z):
        for root in _REAL:
            yield np.append(kept, root)


def _without_one_real(z: Array) -> Iterator[Array]:
    for i in np.flatnonzero(np.abs(z.imag) <= _IS_REAL):
        yield np.delete(z, i)


def _without_one_pair(z: Array) -> Iterator[Array]:
    """Yield what is left without each complex pair, and without the two smallest real roots."""
    rest = np.arange(z.size)
    for i in np.flatnonzero(z.imag > _IS_REAL):
        partner = int(np.argmin(np.abs(z - np.conj(z[i]))))
        yield z[(rest != i) & (rest != partner)]
    real = np.flatnonzero(np.abs(z.imag) <= _IS_REAL)
    if real.size >= 2:
        smallest = real[np.argsort(np.abs(z[real]))[:2]]
        yield z[~np.isin(rest, smallest)]


def start_values(problem: PredictionError) -> Iterator[tuple[str, Array]]:
    """Yield named start values (c, d, f), C and F stable.

    F comes from output-error models, C and D then from the noise that is left. A Box-Jenkins
    search from the output-error model alone sticks in a poor minimum where the noise is strong.
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
        f = output_error.minimise(best[1:], most=_OE_STEPS).theta
        yield "OE", _with_noise(problem, np.append(1.0, f))


def denominators(problem: PredictionError) -> Iterator[tuple[str, Array]]:
    """Yield named stable F of an output-error problem.

    The starts, and only they, use interpolated values where y is missing.
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


def _without_denominator(problem: PredictionError) -> Iterator[tuple[str, Array]]:
    n = problem.structure
    plain = np.ones(1)
    if n.nc + n.nd == 0:
        yield "least squares", np.zeros(0)
        return
    if n.na and n.nc and not n.nd:
        C = armax_start(problem.experiments, na=n.na, nb=n.nb, nc=n.nc, nk=n.nk)
        yield "Hannan-Rissanen", C[1:]
    yield "ARX" if n.na else "FIR", _with_noise(problem, plain)


def _with_noise(problem: PredictionError, F: Array) -> Array:
    """Return (c, d, f) with C and D fitted to the noise that A and B/F leave."""
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
