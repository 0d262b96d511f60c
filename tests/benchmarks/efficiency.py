"""Does the output-error estimate attain the Cramér-Rao bound? Monte Carlo at N = 2000.

The system is that of `monte_carlo`: F = 1 - 1.2 q^-1 + 0.6 q^-2, B = q^-1 + 0.5 q^-2, input ±1 V
that switches with probability p = 0.3, e white and normal of sd 0.5. The bound is analytic: with
the input's autocovariance (1 - 2 p)^k the information matrix of N samples is

    N / 0.25 E psi psi^T,   psi = (q^-k u / F by b_k, -q^-k B u / F² by f_k)

and E is a sum over impulse responses from the white noise that u has the spectrum of. Efficiency
is the bound over the variance, of each parameter and of all (d-th root of the determinants'
ratio); its own standard deviation is sqrt(2 / runs). Run it with the project's environment::

    python -m tests.benchmarks.efficiency [runs]
"""

from __future__ import annotations

import sys

import numpy as np
from armrig import oe
from armrig.numerics.polynomial import filtered, impulse
from numpy.typing import NDArray

from tests.benchmarks.monte_carlo import STD, SYSTEMS, B, F

N, P = 2000, 0.3
LONG = 2000  # samples, after which an impulse response is over


def main() -> None:
    """Print the efficiencies."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 5000
    system = next(s for s in SYSTEMS if s.name == "OE")
    estimates = []
    for seed in range(runs):
        fit = oe(system.dataset(N, np.random.default_rng([seed, N])), nb=2, nf=2)
        estimates.append(fit.theta)
    error = np.array(estimates) - system.theta
    mean_square = error.T @ error / runs
    bound = cramer_rao()
    each = np.diag(bound) / np.diag(mean_square)
    whole = (np.linalg.det(bound) / np.linalg.det(mean_square)) ** (1 / each.size)
    print(f"OE, N = {N}, {runs} runs: bound over mean square error of b1 b2 f1 f2:")
    print(
        f"  {' '.join(f'{x:.3f}' for x in each)}; all {whole:.3f}; each ± {(2 / runs) ** 0.5:.3f}"
    )


def cramer_rao() -> NDArray[np.float64]:
    """Return the bound of (b1, b2, f1, f2), (4, 4)."""
    rho = 1 - 2 * P
    u = impulse([1.0, -rho], LONG) * np.sqrt(1 - rho**2)  # input of variance 1
    by_b, by_f = filtered([1.0], F, u), -filtered(B, np.convolve(F, F), u)
    Psi = np.column_stack([_later(by_b, 1), _later(by_b, 2), _later(by_f, 1), _later(by_f, 2)])
    return np.linalg.inv(N / STD**2 * Psi.T @ Psi)


def _later(x: NDArray[np.float64], k: int) -> NDArray[np.float64]:
    return np.append(np.zeros(k), x[:-k])


if __name__ == "__main__":
    main()
