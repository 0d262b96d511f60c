"""Coverage of the interval of `delay`, on plants of any relative degree.

The plants are continuous, of first to sixth order, with real and resonant poles and a drawn
relative degree. They are sampled with a hold at a Ts of a fiftieth to half of the slowest time
constant. There are 0 to 5 samples of delay, seven kinds of input, and white or coloured noise at 10
to 40 dB. `python -m tests.benchmarks.delay_of_orders [--n 500] [--first 0]`. Seeds 0 to 499 served
to choose the rule.
"""

from __future__ import annotations

import argparse

import armrig
import control
import numpy as np
from armrig.numerics.polynomial import filtered

from tests.benchmarks.lowest_minimum import INPUTS, polynomial

Draw = np.random.Generator


def drawn(rng: Draw) -> tuple[armrig.Dataset, int, int, float]:
    """Return data, nk, the relative degree and dB."""
    n = int(rng.integers(1, 7))
    degree = int(rng.integers(1, n + 1))
    poles: list[complex] = []
    while len(poles) < n:
        if n - len(poles) >= 2 and rng.random() < 0.3:
            w, zeta = 10 ** rng.uniform(-0.3, 0.5), rng.uniform(0.1, 0.9)
            pole = w * complex(-zeta, np.sqrt(1 - zeta**2))
            poles += [pole, pole.conjugate()]
        else:
            poles.append(complex(-(10 ** rng.uniform(-0.1, 0.6))))
    zeros = -(10 ** rng.uniform(-0.3, 0.8, n - degree)) * rng.choice([1, 1, -1], n - degree)
    slowest = 1 / min(-p.real for p in poles)
    Ts = slowest * 10 ** rng.uniform(-1.7, -0.3)
    G = control.zpk(zeros, poles, 1.0)
    H = control.sample_system(control.ss(G), Ts, "zoh")
    d = int(rng.integers(0, 6))
    name = str(rng.choice([*INPUTS]))
    N = int(rng.choice([500, 1000, 2000]))
    u = INPUTS[name](N + 300, rng)
    _, clean = control.forced_response(H, U=u)
    clean = np.concatenate([np.full(d, clean[0]), clean])[: N + 300][300:]
    v = rng.standard_normal(N)
    if rng.random() < 0.5:
        v = filtered([1.0], polynomial(rng, 1, slow=False), v)
    db = float(rng.choice([10, 20, 30, 40]))
    v *= np.std(clean) / np.std(v) * 10 ** (-db / 20)
    return armrig.Dataset(u=u[300:], y=clean + v, Ts=Ts), d + 1, degree, db


def main() -> None:
    """Print coverage, and widths by relative degree at 40 dB."""
    asked = argparse.ArgumentParser()
    asked.add_argument("--n", type=int, default=500)
    asked.add_argument("--first", type=int, default=0)
    given = asked.parse_args()
    rows, refused = [], 0
    for seed in range(given.first, given.first + given.n):
        data, nk, degree, db = drawn(np.random.default_rng([seed, 5]))
        try:
            low, high = armrig.delay(data).interval
        except ValueError:
            refused += 1
            continue
        rows.append((low <= nk <= high, high - low + 1, degree, db, nk < low, nk > high))
    r = np.array(rows, float)
    print(
        f"{len(r)} plants, {refused} refused: the interval holds {r[:, 0].mean():.3f}; "
        f"too late {r[:, 4].mean():.3f}, too early {r[:, 5].mean():.3f}"
    )
    for degree in range(1, 7):
        of = r[r[:, 2] == degree]
        loud = of[of[:, 3] == 40]
        print(
            f"  relative degree {degree}: {len(of)}, holds {of[:, 0].mean():.3f}, median width "
            f"{np.median(of[:, 1]):g}; at 40 dB {len(loud)}, {loud[:, 0].mean():.3f}, "
            f"{np.median(loud[:, 1]):g}",
            flush=True,
        )


if __name__ == "__main__":
    main()
