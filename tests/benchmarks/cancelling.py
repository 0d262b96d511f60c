"""Are the coefficients' deviations right where a fit says "trust std"? Two banks of drawn plants.

In the hard one a zero lies near a pole: 10^-2.5 to 10^-0.5 away in the z plane. In the ordinary one
poles and zeros lie anywhere, at 20 dB and more. Orders and delay are the true ones:
`python -m tests.benchmarks.cancelling [--n 500] [--first 0]`. Seeds 0 to 499 served to choose the
limit.
"""

from __future__ import annotations

import argparse
from collections import Counter

import armrig
import numpy as np
from armrig.numerics.polynomial import filtered
from numpy.typing import NDArray

from tests.benchmarks.lowest_minimum import INPUTS

Vector = NDArray[np.float64]
Draw = np.random.Generator
KINDS = ("oe", "arx", "armax", "bj")


def plant(rng: Draw, *, hard: bool) -> tuple[Vector, Vector]:
    """Return B (its first coefficient at lag 1) and F of second to fourth order."""
    n = int(rng.integers(2, 5))
    poles: list[complex] = []
    while len(poles) < n:
        if n - len(poles) >= 2 and rng.random() < 0.5:
            pole = rng.uniform(0.5, 0.95) * np.exp(1j * rng.uniform(0.1, 2.5))
            poles += [pole, pole.conjugate()]
        else:
            poles.append(complex(rng.uniform(0.2, 0.97)))
    zeros = list(rng.uniform(-1.5, 0.9, n - 1).astype(complex))
    if hard:
        near = 10 ** rng.uniform(-2.5, -0.5)
        real = [p.real for p in poles if p.imag == 0]
        if real:
            zeros[0] = complex(real[0] + near * rng.choice([-1, 1]))
        elif n >= 3:
            zeros[:2] = [poles[0] + near, poles[1] + near]
    F = np.real(np.poly(poles))
    B = np.real(np.poly(zeros)) * rng.uniform(0.5, 2.0) * rng.choice([-1, 1])
    return np.append(0.0, B), F


def one(seed: int, *, hard: bool) -> tuple[armrig.Fit, Vector]:
    """Return a fit and its normalised errors, of all coefficients."""
    rng = np.random.default_rng([seed, 4, hard])
    kind = str(rng.choice(KINDS))
    name = str(rng.choice(["telegraph", "white", "ARMA", "multisine"]))
    N = int(rng.choice([300, 1000, 3000]))
    u = INPUTS[name](N, rng)
    B, F = plant(rng, hard=hard)
    n, nb = F.size - 1, B.size - 1
    C, D = np.array([1.0, rng.uniform(-0.7, 0.7)]), np.array([1.0, rng.uniform(-0.9, 0.9)])
    clean = filtered(B, F, u)
    noise = {"oe": ([1.0], [1.0]), "arx": ([1.0], F), "armax": (C, F), "bj": (C, D)}[kind]
    v = filtered(*noise, rng.standard_normal(N))
    level_db = float(rng.choice([10, 20, 30, 40] if hard else [20, 30, 40]))
    v *= np.std(clean) / np.std(v) * 10 ** (-level_db / 20)
    data = armrig.Dataset(u=u, y=clean + v, Ts=1.0)
    if kind == "oe":
        fit, truth = armrig.oe(data, nb=nb, nf=n), [B[1:], F[1:]]
    elif kind == "arx":
        fit, truth = armrig.arx(data, na=n, nb=nb), [F[1:], B[1:]]
    elif kind == "armax":
        fit, truth = armrig.armax(data, na=n, nb=nb, nc=1), [F[1:], B[1:], C[1:]]
    else:
        fit, truth = armrig.bj(data, nb=nb, nc=1, nd=1, nf=n), [B[1:], C[1:], D[1:], F[1:]]
    return fit, (fit.theta - np.concatenate(truth)) / fit.std


def main() -> None:
    """Print coverage and how often each bank's fits may be trusted, by the limit."""
    asked = argparse.ArgumentParser()
    asked.add_argument("--n", type=int, default=500)
    asked.add_argument("--first", type=int, default=0)
    given = asked.parse_args()
    for hard in (True, False):
        inside: dict[bool, list[float]] = {True: [], False: []}
        curved: list[tuple[float, float]] = []
        said: Counter[str] = Counter()
        for seed in range(given.first, given.first + given.n):
            fit, z = one(seed, hard=hard)
            covered = float(np.mean(np.abs(z) < 1.96))
            if fit.trusts_robust:
                said["robust"] += 1
                continue
            trusts = fit.trusts_coefficients
            said["trust std" if trusts else "responses only"] += 1
            inside[trusts].append(covered)
            curved.append((fit.curvature, covered))
        print(
            "hard" if hard else "ordinary",
            dict(said),
            {f"trusts {k}": f"{np.mean(v):.3f} of {len(v)}" for k, v in inside.items() if v},
            flush=True,
        )
        found, covered_at = np.array(curved).T
        for limit in (0.2, 0.3, 0.4, 0.5, 0.7, 1.0, np.inf):
            flat = found <= limit
            print(
                f"  curvature up to {limit}: {flat.mean():.3f} of the fits, their coefficients are "
                f"covered in {covered_at[flat].mean() if flat.any() else np.nan:.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
