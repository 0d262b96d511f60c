"""Minima of the search, compared with a search from the truth, on a bank of any plants.

Each seed draws a structure's orders (1 to 6), poles (slow and fast, real and resonant), zeros on
both sides, and a delay. It also draws an input of seven kinds, a length, 0 to 40 dB, and noise of
any colour that the structure has. A success is a loss of at most (1 + 1e-4) times that reached from
the truth:
`python -m tests.benchmarks.lowest_minimum [--n 200] [--first 0] [--kinds ARMAX BJ OE] [--tell]`.
Seeds 0 to 199 served to choose the starts.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable

import armrig
import numpy as np
from armrig.estimation.prediction_error import PredictionErrorProblem
from armrig.models.innovations import prepared
from armrig.models.structure import Structure
from armrig.numerics.polynomial import filtered
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Draw = np.random.Generator
TOLERANCE = 1e-4
LENGTHS = (300, 500, 1000, 2000, 4000)


def polynomial(rng: Draw, order: int, *, slow: bool = True) -> Vector:
    """Return a monic polynomial whose roots are stable: resonant, slow real and fast real ones."""
    roots: list[complex] = []
    while len(roots) < order:
        kind = rng.choice(["pair", "slow", "fast"] if slow else ["pair", "fast"])
        if kind == "pair" and order - len(roots) >= 2:
            root = rng.uniform(0.5, 0.98) * np.exp(1j * rng.uniform(0.05, 2.9))
            roots += [root, root.conjugate()]
        elif kind == "slow":
            roots.append(1 - 10 ** rng.uniform(-2.3, -1))
        else:
            roots.append(rng.uniform(-0.7, 0.9))
    return np.real(np.poly(roots[:order])) if order else np.ones(1)


def coloured(N: int, rng: Draw) -> Vector:
    """Return noise through a random filter with poles and zeros."""
    B, A = polynomial(rng, int(rng.integers(0, 3))), polynomial(rng, int(rng.integers(1, 4)))
    return filtered(B, A, rng.standard_normal(N))


def twelve_sines(N: int, rng: Draw) -> Vector:
    """Return twelve sines of drawn frequencies and phases, of no common period."""
    w, phase = np.sort(rng.uniform(0.02, 3.0, 12)), rng.uniform(0, 2 * np.pi, 12)
    return np.asarray(np.cos(np.outer(np.arange(N), w) + phase).sum(axis=1))


def periodic(N: int, rng: Draw) -> Vector:
    """Return a multisine of some thirty lines, repeated."""
    period = int(rng.integers(100, 400))
    lines = rng.choice(np.arange(1, period // 2), min(30, period // 2 - 1), replace=False)
    t = np.arange(N)[:, None]
    phase = rng.uniform(0, 2 * np.pi, lines.size)
    return np.asarray(np.cos(2 * np.pi * t * lines / period + phase).sum(axis=1))


def chirped(N: int, rng: Draw) -> Vector:
    """Return a sine whose frequency rises all the while."""
    low, high = rng.uniform(0.005, 0.1), rng.uniform(0.5, 2.5)
    return np.asarray(np.cos(np.cumsum(np.linspace(low, high, N))))


INPUTS: dict[str, Callable[[int, Draw], Vector]] = {
    "telegraph": lambda N, rng: armrig.telegraph(N, rng.uniform(0.02, 0.4), 1.0, 4.0, seed=rng),
    "white": lambda N, rng: rng.standard_normal(N),
    "ARMA": coloured,
    "multisine": periodic,
    "12 sines": twelve_sines,
    "chirp": chirped,
    "steps": lambda N, rng: np.repeat(rng.uniform(0, 5, N // 25 + 1), 25)[:N],
}


def drawn(kind: str, rng: Draw) -> tuple[armrig.Dataset, Structure, Vector, str]:
    """Return data, their structure, the true (c, d, f), and a description of the draw."""
    name = str(rng.choice([*INPUTS]))
    N = int(rng.choice(LENGTHS))
    u = INPUTS[name](N, rng)
    n, nb, nk = int(rng.integers(1, 7)), int(rng.integers(1, 6)), int(rng.integers(0, 4))
    nc, nd = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    F, B = polynomial(rng, n), np.append(np.zeros(nk), rng.standard_normal(nb))
    C, D = polynomial(rng, nc), polynomial(rng, nd, slow=False)
    clean = filtered(B, F, u)
    noise = {"OE": ([1.0], [1.0]), "ARMAX": (C, F), "BJ": (C, D)}[kind]
    v = filtered(*noise, rng.standard_normal(N))
    level_db = float(rng.choice([0, 10, 20, 35, 40]))
    v *= np.std(clean) / np.std(v) * 10 ** (-level_db / 20)
    data = armrig.Dataset(u=u, y=clean + v, Ts=float(rng.choice([0.01, 0.1, 1.0])))
    truth = {"OE": F[1:], "ARMAX": C[1:], "BJ": np.concatenate([C[1:], D[1:], F[1:]])}[kind]
    orders = {
        "OE": Structure(nb=nb, nf=n, nk=nk),
        "ARMAX": Structure(na=n, nb=nb, nc=nc, nk=nk),
        "BJ": Structure(nb=nb, nc=nc, nd=nd, nf=n, nk=nk),
    }[kind]
    return data, orders, truth, f"{name}, N {N}, {level_db:g} dB"


def estimated(kind: str, data: armrig.Dataset, n: Structure) -> armrig.Fit:
    """Return the library's estimate."""
    if kind == "OE":
        return armrig.oe(data, nb=n.nb, nf=n.nf, nk=n.nk)
    if kind == "ARMAX":
        return armrig.armax(data, na=n.na, nb=n.nb, nc=n.nc, nk=n.nk)
    return armrig.bj(data, nb=n.nb, nc=n.nc, nd=n.nd, nf=n.nf, nk=n.nk)


def main() -> None:
    """Print the successes of each structure."""
    asked = argparse.ArgumentParser()
    asked.add_argument("--n", type=int, default=200)
    asked.add_argument("--first", type=int, default=0)
    asked.add_argument("--kinds", nargs="+", default=["ARMAX", "BJ", "OE"])
    asked.add_argument("--tell", action="store_true", help="each miss as it comes")
    given = asked.parse_args()
    warnings.simplefilter("error", RuntimeWarning)
    for kind in given.kinds:
        missed: list[str] = []
        refused = unsaid = tried = 0
        seconds = 0.0
        for seed in range(given.first, given.first + given.n):
            data, n, truth, words = drawn(kind, np.random.default_rng([seed, 3]))
            begun = time.process_time()
            try:
                fit = estimated(kind, data, n)
            except ValueError as err:
                refused += 1
                if given.tell:
                    print(f"  {seed}: {words}: refused: {err}", flush=True)
                continue
            seconds += time.process_time() - begun
            tried += 1
            problem = PredictionErrorProblem(experiments=(prepared(data, n),), structure=n)
            least = problem.minimise(truth).cost / fit.N
            excess = fit.loss / least - 1
            if excess > TOLERANCE:
                missed.append(f"{seed} ({words}, {excess:.1e})")
                unsaid += fit.agreed and fit.converged
                if given.tell:
                    print(f"  {missed[-1]}, {n}", flush=True)
        print(
            f"{kind:6} {tried - len(missed)} of {tried} ({refused} refused), "
            f"{1e3 * seconds / max(tried, 1):.0f} ms a fit; {unsaid} missed without a word: "
            f"{'; '.join(missed)}",
            flush=True,
        )


if __name__ == "__main__":
    main()
