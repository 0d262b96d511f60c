"""Drawn steps of P1D and P2D, and a judge of the numbers of the step analysis.

Half of the steps end within five time constants, half are read by a converter, and a tenth has no
dead time::

    python -m tests.drawn_steps --seed 1 --count 500

prints the share of the numbers within their 95 % interval, and beyond 4 standard deviations.
"""

from __future__ import annotations

import argparse
from collections import defaultdict

import armrig
import numpy as np
from armrig.data.dataset import Dataset
from scipy.optimize import brentq

Truth = dict[str, float]


def drawn_step(seed: int, i: int) -> tuple[Dataset, Truth, bool]:
    """Return the data of a step, the true numbers, and whether the step is held for 5 tau."""
    rng = np.random.default_rng((seed, i))
    settled = i // 2 % 2 == 0
    T = 10 ** rng.uniform(-1.5, 3)
    ratio = rng.uniform(0.1, 0.95) if i % 2 else 0.0
    dead = rng.uniform(0, 2) * T if rng.random() > 0.1 else 0.0
    gain = rng.choice([-1, 1]) * 10 ** rng.uniform(-1, 2)
    span = rng.choice([-1, 1]) * 10 ** rng.uniform(-1, 1.5)
    held = dead + T * (1 + ratio) * (rng.uniform(5, 12) if settled else rng.uniform(1, 5))
    Ts = float(f"{held / rng.integers(80, 900):.2g}")
    n = int(held / Ts)
    t = Ts * np.arange(-int(rng.uniform(0.15, 1) * n) - 10, n)

    def share(t: np.ndarray | float) -> np.ndarray:
        x = np.maximum(t, 0) / T
        fast = ratio * np.exp(-x / ratio) if ratio else 0.0
        return np.asarray(1 - (np.exp(-x) - fast) / (1 - ratio))

    def reached(level: float) -> float:
        return float(brentq(lambda t: share(t) - level, 0.0, 40 * T))

    noise = abs(gain * span) * 10 ** rng.uniform(-3, -1.4)
    y = gain * span * (rng.uniform(-5, 5) + share(t - dead)) + noise * rng.standard_normal(t.size)
    if rng.random() < 0.5:
        quantum = noise * 10 ** rng.uniform(-0.5, 1)
        y = quantum * np.round(y / quantum)
    truth = {
        "gain": gain,
        "dead_time": dead,
        "tau": reached(1 - np.exp(-1)),
        "equivalent_time": T * (1 + ratio),
        "settling": dead + reached(0.95),
        "time constant 1": T,
        "time constant 2": ratio * T,
    }
    return Dataset(u=rng.uniform(-2, 2) + span * (t >= 0), y=y, Ts=Ts), truth, settled


def judged_step(seed: int, i: int) -> tuple[dict[str, tuple[float, bool]], bool]:
    """Return error/std and whether the truth is in the 95 % interval, of the given numbers."""
    data, truth, settled = drawn_step(seed, i)
    found = armrig.step_analysis(data)
    values = {
        x: (getattr(found, x), getattr(found, f"{x}_std"))
        for x in truth
        if hasattr(found, f"{x}_std")
    }
    constants = zip(found.time_constants, found.time_constants_std, strict=True)
    values |= {f"time constant {k}": value for k, value in enumerate(constants, 1)}
    off = {x: (value - truth[x]) / std for x, (value, std) in values.items() if np.isfinite(value)}
    low, high = found.dead_time_interval
    dead = truth["dead_time"]
    off_dead = 4 * (found.dead_time - dead) / max(high - low, 1e-12)
    judged = {x: (z, abs(z) <= 1.96) for x, z in off.items()}
    return judged | {"dead_time": (off_dead, low <= dead <= high)}, settled


def main() -> None:
    """Print the shares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=500)
    arguments = parser.parse_args()
    cases = [judged_step(arguments.seed, i) for i in range(arguments.count)]
    numbers = defaultdict(list)
    for judged, settled in cases:
        for name, (off, inside) in judged.items():
            numbers[name].append((abs(off) > 4, inside, settled))
    of_settled = sum(settled for _, settled in cases)
    for name, rows in numbers.items():
        beyond, inside, settled = np.array(rows, dtype=float).T
        print(
            f"{name:16s} given {len(rows)} of {len(cases)}, {settled.sum():.0f} of {of_settled} "
            f"settled; inside {100 * inside.mean():.1f} %, beyond 4 std {100 * beyond.mean():.1f} %"
        )


if __name__ == "__main__":
    main()
