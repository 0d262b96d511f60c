"""Share of right models that the tests of their residuals reject at the level 5 %.

Each cell has a structure, a colour of the noise and N; the estimation data and others are judged.
The last columns count "cannot tell". Three cells also count the wrong answers of `open_loop` (level
5 %) and, with the argument `delay`, of `delay`::

    python -m tests.benchmarks.verdict_levels [runs] [delay]
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable

import armrig
import numpy as np
from armrig.numerics.polynomial import apply_filter

B, F = [0, 0.4, 0.25], np.poly([0.82 * np.exp(0.7j), 0.82 * np.exp(-0.7j)]).real
NOISE = {
    "white": ([1.0], [1.0]),
    "resonant": ([1.0], [1, -1.7, 0.8]),
    "drifting": ([1.0], [1, -0.98]),
    "nearly integrated": ([1, -0.6], [1, -0.998]),
}
CELLS = (
    *(("oe", "white", 100), ("oe", "resonant", 200), ("oe", "drifting", 500)),
    *(("oe", "nearly integrated", 2000), ("bj", "white", 2000), ("bj", "resonant", 200)),
    *(("bj", "drifting", 300), ("bj", "nearly integrated", 1000), ("armax", "resonant", 100)),
    *(("armax", "drifting", 500), ("ss", "white", 200), ("ss", "resonant", 1000)),
)
LEVEL, START = 0.05, 400


def drawn(kind: str, noise: str, N: int, rng: np.random.Generator) -> armrig.Dataset:
    """Return N samples of the plant; the noise of ARMAX passes through 1/A."""
    C, D = NOISE[noise]
    u = np.cumprod(np.where(rng.random(N + START) < 0.25, -1.0, 1.0))
    e = 0.05 * rng.standard_normal(N + START)
    if kind == "armax":
        A = D if noise == "resonant" else np.convolve(F, D)
        y = apply_filter(B, A, u) + apply_filter([1, 0.5], A, e)
    else:
        y = apply_filter(B, F, u) + apply_filter(C, D, e)
    return armrig.Dataset(u=u[START:], y=y[START:], Ts=1.0)


def estimated(kind: str, noise: str, data: armrig.Dataset) -> armrig.Fit:
    """Return the model with the orders of the plant."""
    nc, nd = (len(part) - 1 for part in NOISE[noise])
    na = 2 if noise == "resonant" else 2 + nd
    fits: dict[str, Callable[[], armrig.Fit]] = {
        "oe": lambda: armrig.oe(data, nb=2, nf=2, starts="few"),
        "bj": lambda: armrig.bj(data, nb=2, nc=nc, nd=nd, nf=2, starts="few"),
        "armax": lambda: armrig.armax(data, na=na, nb=2, nc=1, starts="few"),
        "ss": lambda: armrig.ss(data, order=2 + max(nc, nd)),
    }
    return fits[kind]()


def main() -> None:
    """Print the share of the runs, in percent, in which each test rejects."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 300
    warnings.simplefilter("ignore")
    print("own data: white, dynamics, feedback; other data: the same, larger errors; cannot tell")
    for number, (kind, noise, N) in enumerate(CELLS):
        found = []
        for k in range(runs):
            rng = np.random.default_rng([number, k])
            data = drawn(kind, noise, N, rng)
            fit = estimated(kind, noise, data)
            own = armrig.residuals(fit, data)
            other = armrig.residuals(fit, drawn(kind, noise, N, rng))
            p = [own.white.p_value, own.missing_dynamics, own.feedback]
            p += [other.white.p_value, other.missing_dynamics, other.feedback, other.larger_errors]
            unclear = bool(other.powerless or other.blind), own.white.unclear, other.white.unclear
            found.append([*(value < LEVEL for value in p), *unclear])
        shares = " ".join(f"{100 * x:5.1f}" for x in np.mean(found, axis=0))
        print(f"{f'{kind}, {noise}, N {N}':28} {shares}", flush=True)
    for number in (1, 6, 11):
        wrong = np.zeros(2)
        for k in range(100):
            data = drawn(*CELLS[number], np.random.default_rng([100 + number, k]))
            wrong[0] += armrig.open_loop(data).p_value < LEVEL
            if "delay" in sys.argv:
                low, high = armrig.delay(data).interval
                wrong[1] += not low <= 1 <= high
        print(f"{CELLS[number]}: feedback found in {wrong[0]} %, delay wrong in {wrong[1]} %")


if __name__ == "__main__":
    main()
