"""Minima of the search on a bank of random resonant systems of fourth order.

N = 2000, telegraph input; two pole pairs of radius 0.7-0.98, normal numerator. The noise is white
(OE), filtered by a random C/D with radii 0.5-0.9 (BJ), or by C/A (ARMAX), 20 dB and 0 dB below the
clean output. A success is a loss of at most (1 + 1e-6) times the best that searches from 16 fixed
starts find: the truth, and the truth moved at random by up to 30 %. Run it with the project's
environment::

    python -m tests.benchmarks.random_bank [systems [first]]

The first hundred systems served to choose the starts; those from number 100 on did not.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from armrig import Dataset, Fit, armax, bj, oe, telegraph
from armrig.estimation.prediction_error import PredictionErrorProblem
from armrig.models.innovations import prepared
from armrig.models.structure import Structure
from armrig.numerics.polynomial import filtered, reflected
from numpy.typing import NDArray

Vector = NDArray[np.float64]
N, STARTS, TOLERANCE = 2000, 16, 1e-6
STRUCTURES = {
    "OE": Structure(nb=4, nf=4, nk=1),
    "ARMAX": Structure(na=4, nb=4, nc=2, nk=1),
    "BJ": Structure(nb=4, nc=2, nd=2, nf=4, nk=1),
}


def main() -> None:
    """Print the successes of each structure and noise level."""
    systems = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    for kind in STRUCTURES:
        for level_db in (20, 0):
            missed, seconds, unsaid = [], 0.0, 0
            for seed in range(first, first + systems):
                data, truth = _system(kind, level_db, np.random.default_rng([seed, 2026]))
                begun = time.process_time()
                fit = _estimated(kind, data)
                seconds += time.process_time() - begun
                excess = fit.loss / _best(kind, data, truth, np.random.default_rng(seed)) - 1
                if excess > TOLERANCE:
                    missed.append(f"{seed}: {excess:.1e}")
                    unsaid += fit.agreed and fit.converged
            print(
                f"{kind:6} {level_db:3} dB: {systems - len(missed)} of {systems}, "
                f"{1e3 * seconds / systems:.0f} ms a fit; missed {missed}, "
                f"{unsaid} of them without a warning",
                flush=True,
            )


def _system(kind: str, level_db: float, rng: np.random.Generator) -> tuple[Dataset, Vector]:
    """Return data, and the true (c, d, f)."""
    F = _resonant(rng, 2, 0.7, 0.98)
    B = np.append(0.0, rng.standard_normal(4))
    u = telegraph(N, 0.3, 1.5, 3.5, seed=rng) - 2.5
    clean = filtered(B, F, u)
    C, D = _resonant(rng, 1, 0.5, 0.9), _resonant(rng, 1, 0.5, 0.9)
    noise = {"OE": ([1.0], [1.0]), "ARMAX": (C, F), "BJ": (C, D)}[kind]
    v = filtered(*noise, rng.standard_normal(N))
    v *= np.std(clean) / np.std(v) * 10 ** (-level_db / 20)
    truth = {"OE": F[1:], "ARMAX": C[1:], "BJ": np.concatenate([C[1:], D[1:], F[1:]])}[kind]
    return Dataset(u=u, y=clean + v, Ts=1.0), truth


def _resonant(rng: np.random.Generator, pairs: int, low: float, high: float) -> Vector:
    roots = rng.uniform(low, high, pairs) * np.exp(1j * rng.uniform(0.1, 2.8, pairs))
    return np.real(np.poly([*roots, *roots.conj()]))


def _estimated(kind: str, data: Dataset) -> Fit:
    if kind == "OE":
        return oe(data, nb=4, nf=4)
    if kind == "ARMAX":
        return armax(data, na=4, nb=4, nc=2)
    return bj(data, nb=4, nc=2, nd=2, nf=4)


def _best(kind: str, data: Dataset, truth: Vector, rng: np.random.Generator) -> float:
    """Return the lowest loss that the fixed starts lead to."""
    n = STRUCTURES[kind]
    experiment = prepared(data, n)
    problem = PredictionErrorProblem(experiments=(experiment,), structure=n)
    costs = [problem.minimise(truth).cost]
    for k in range(STARTS - 1):
        size = (0.02, 0.1, 0.3)[k % 3] * np.abs(truth).max()
        moved = truth + size * rng.standard_normal(truth.size)
        C, D, F = problem.polynomials(moved)
        start = np.concatenate([reflected(C, 0.98)[1:], D[1:], reflected(F, 0.98)[1:]])
        costs.append(problem.minimise(start, most=100).cost)
    return min(costs) / int(np.count_nonzero(experiment.rows))


if __name__ == "__main__":
    main()
