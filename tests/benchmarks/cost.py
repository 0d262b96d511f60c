"""Processor time and peak memory of what looks at data, against their length.

Each case runs in a process of its own, on one thread; the memory is the greatest resident size less
that after the data were made. `python -m tests.benchmarks.cost [case …]`, all by default.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from time import process_time

import armrig
import numpy as np
from armrig.numerics.polynomial import apply_filter

LENGTHS = (10_000, 100_000, 1_000_000)
B, F = [0.0, 1.0, 0.5], [1.0, -1.2, 0.6]


def dataset(N: int, seed: int = 1, missing: float = 0.0) -> armrig.Dataset:
    """Return a system of second order under a binary input, with coloured noise on its output."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], N // 5 + 1), 5)[:N]
    y = apply_filter(B, F, u) + apply_filter([1.0], [1.0, -0.7], 0.5 * rng.standard_normal(N))
    return armrig.Dataset(u=u, y=y, Ts=0.01, valid=rng.random(N) >= missing)


def oe(data: armrig.Dataset) -> armrig.Fit:
    """Return a model to test."""
    return armrig.oe(data, nb=2, nf=2)


def bj(data: armrig.Dataset) -> armrig.Fit:
    """Return a model with noise to test."""
    return armrig.bj(data, nb=2, nc=1, nd=1, nf=2)


Action = Callable[[], object]
CASES: dict[str, Callable[[int], Action]] = {
    "impulse_response": lambda N: _with(N, lambda d: armrig.impulse_response(d, integrator=False)),
    "impulse_response, plain": lambda N: _with(
        N, lambda d: armrig.impulse_response(d, kernel=None, integrator=False)
    ),
    "residuals of OE, own data": lambda N: _tested(N, oe, 1),
    "residuals of OE, other data": lambda N: _tested(N, oe, 2),
    "residuals of BJ, other data": lambda N: _tested(N, bj, 2),
    "spa": lambda N: _with(N, lambda d: armrig.spa(d, integrator=False)),
    "arx": lambda N: _with(N, lambda d: armrig.arx(d, na=2, nb=2)),
    "oe": lambda N: _with(N, oe),
    "hampel": lambda N: _with(N, armrig.hampel),
}


def _with(N: int, action: Callable[[armrig.Dataset], object]) -> Action:
    data = dataset(N)
    return lambda: action(data)


def _tested(N: int, estimate: Callable[[armrig.Dataset], armrig.Fit], seed: int) -> Action:
    # Estimated from few samples, or that memory would be the peak; seed 1 passes for its own data.
    data = dataset(N, seed)
    fit = estimate(dataset(10_000))
    fit = replace(fit, digest=data.digest) if seed == 1 else fit
    return lambda: armrig.residuals(fit, data)


def measured(case: str, N: int) -> None:
    """Print seconds and MiB of one case."""
    action = CASES[case](N)
    before = getrusage(RUSAGE_SELF).ru_maxrss
    begin = process_time()
    action()
    seconds = process_time() - begin
    print(seconds, (getrusage(RUSAGE_SELF).ru_maxrss - before) / 1024)


def main() -> None:
    """Print a table, or one case where a length is given."""
    if len(sys.argv) == 3 and sys.argv[2].isdigit():
        measured(sys.argv[1], int(sys.argv[2]))
        return
    one_thread = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    print("| | " + " | ".join(f"N = {N:.0e}: s, MiB" for N in LENGTHS) + " |")
    for case in sys.argv[1:] or CASES:
        cells = []
        for N in LENGTHS:
            told = subprocess.run(
                [sys.executable, Path(__file__), case, str(N)],
                check=True,
                capture_output=True,
                text=True,
                env=one_thread,
            )
            seconds, mib = map(float, told.stdout.split())
            cells.append(f"{seconds:.2g}, {mib:.0f}")
        print(f"| `{case}` | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
