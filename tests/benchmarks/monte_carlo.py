"""Do the reported standard deviations hold? Monte Carlo of ARX, ARMAX, OE and BJ.

For each structure and N there are two numbers, lowest and highest over the parameters, of the
classic and of the robust form. One is the ratio of the mean reported deviation to the scatter of
the estimates (wanted 0.85-1.15). The second is the share of 95 % intervals that contain the truth
(wanted 0.92-0.98). In addition there is the share of false alarms of the tests at 5 %.

The systems, input ±1 V that switches with probability 0.3, e white and normal, sd 0.5 ::

    ARX    A = 1 - 1.2 q^-1 + 0.6 q^-2,  B = q^-1 + 0.5 q^-2
    ARMAX  the same, C = 1 - 0.5 q^-1 + 0.2 q^-2
    OE     F = 1 - 1.2 q^-1 + 0.6 q^-2,  B = q^-1 + 0.5 q^-2
    BJ     the same, C = 1 + 0.5 q^-1, D = 1 - 0.7 q^-1

No pole is near a zero, of G or of H. Run it with the project's environment::

    python -m tests.benchmarks.monte_carlo [runs]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from armrig import Dataset, Fit, armax, arx, bj, oe, residuals, telegraph
from armrig.numerics.polynomial import apply_filter
from numpy.typing import NDArray

B, F = [0.0, 1.0, 0.5], [1.0, -1.2, 0.6]
STD = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class System:
    """A true system and the estimator of its structure."""

    name: str
    C: list[float]
    D: list[float]
    theta: list[float]
    estimate: Callable[[Dataset], Fit]

    def dataset(self, N: int, rng: np.random.Generator) -> Dataset:
        """Return N samples from a state of long ago."""
        u = telegraph(N + 200, 0.3, 1.5, 3.5, seed=rng) - 2.5
        v = apply_filter(self.C, self.D, STD * rng.standard_normal(N + 200))
        return Dataset(u=u[200:], y=(apply_filter(B, F, u) + v)[200:], Ts=1.0)


SYSTEMS = [
    System(
        name="ARX",
        C=[1.0],
        D=F,
        theta=[-1.2, 0.6, 1.0, 0.5],
        estimate=lambda data: arx(data, na=2, nb=2),
    ),
    System(
        name="ARMAX",
        C=[1.0, -0.5, 0.2],
        D=F,
        theta=[-1.2, 0.6, 1.0, 0.5, -0.5, 0.2],
        estimate=lambda data: armax(data, na=2, nb=2, nc=2),
    ),
    System(
        name="OE",
        C=[1.0],
        D=[1.0],
        theta=[1.0, 0.5, -1.2, 0.6],
        estimate=lambda data: oe(data, nb=2, nf=2),
    ),
    System(
        name="BJ",
        C=[1.0, 0.5],
        D=[1.0, -0.7],
        theta=[1.0, 0.5, 0.5, -0.7, -1.2, 0.6],
        estimate=lambda data: bj(data, nb=2, nc=1, nd=1, nf=2),
    ),
]


def main() -> None:
    """Print the table."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    print(f"{runs} runs each; lowest-highest over the parameters")
    print("         N   ratio       coverage    ratio rob.  cover. rob.  alarms white dyn. feedb.")
    for system in SYSTEMS:
        for N in (500, 2000):
            begun = time.perf_counter()
            error, std, robust, p, failed = _runs(system, N, runs)
            scatter = error.std(axis=0, ddof=1)
            cells = []
            for s in (std, robust):
                cells.append(_range(s.mean(axis=0) / scatter))
                cells.append(_range((np.abs(error) < 1.96 * s).mean(axis=0)))
            alarms = " ".join(f"{x:.3f}" for x in (p < 0.05).mean(axis=0))
            took = time.perf_counter() - begun
            print(
                f"{system.name:6} {N:5} {'  '.join(cells)}   {alarms}   "
                f"not converged {failed}, {took:.0f} s",
                flush=True,
            )


def _runs(system: System, N: int, runs: int) -> tuple[NDArray[np.float64], ...]:
    error, std, robust, p, failed = [], [], [], [], 0
    for seed in range(runs):
        data = system.dataset(N, np.random.default_rng([seed, N]))
        fit = system.estimate(data)
        tests = residuals(fit, data)
        error.append(fit.theta - system.theta)
        std.append(fit.std)
        robust.append(fit.std_robust)
        p.append([tests.white.p_value, tests.missing_dynamics, tests.feedback])
        failed += not fit.search.converged
    return np.array(error), np.array(std), np.array(robust), np.array(p), np.array(failed)


def _range(x: NDArray[np.float64]) -> str:
    return f"{x.min():.3f}-{x.max():.3f}"


if __name__ == "__main__":
    main()
