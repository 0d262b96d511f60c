"""Start values of the search, from linear regressions alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from armrig.estimation.hannan_rissanen import armax_start, noise_start
from armrig.estimation.prediction_error import PredictionError
from armrig.estimation.steiglitz_mcbride import equation_error, high_order_output, steiglitz_mcbride
from armrig.numerics.polynomial import Array, filtered, reflected

_OE_STEPS = 12  # of the search for an output-error start; it need not end at the minimum


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
