"""Share of drawn plants for which `ss` reaches the minimum that a search from the truth reaches.

The plants are drawn: 2 or 3 inputs and outputs, orders 2 to 8, poles damped and resonant, a noise
model K, signal-to-noise ratios of 10 to 40 dB, N 1000. A run counts if det Lambda is at most
1 + 1e-4 times that of the search from the truth. The search from the truth replaces the starts of
the estimator. Run it with the project's environment::

    python -m tests.benchmarks.ss_optimum [--first 0] [--plants 100] [--N 1000]
"""

from __future__ import annotations

import argparse
from typing import Any
from unittest.mock import patch

import armrig
import numpy as np
from armrig import MultivariableFit, Signals
from armrig.estimation.multivariable import ss as module
from armrig.numerics.recursion import recursion
from numpy.typing import NDArray

Array = NDArray[Any]
_TOLERANCE = 1e-4


def drawn(seed: int, N: int) -> tuple[Signals, Array, Array, Array]:
    """Return the data of a drawn plant, and its A, K and C."""
    rng = np.random.default_rng([77, seed])
    nu, ny = rng.integers(2, 4, 2)
    n = int(rng.integers(2, 9))
    A = np.zeros((n, n))
    k = 0
    while k < n:
        if k + 1 < n and rng.random() < 0.7:
            modulus = rng.uniform(0.5, 0.9) if rng.random() < 0.5 else rng.uniform(0.9, 0.985)
            z = modulus * np.exp(1j * rng.uniform(0.1, 2.6))
            A[k : k + 2, k : k + 2] = [[z.real, z.imag], [-z.imag, z.real]]
            k += 2
        else:
            A[k, k] = rng.uniform(-0.4, 0.95)
            k += 1
    B, C = rng.standard_normal((n, nu)), rng.standard_normal((ny, n))
    K = rng.standard_normal((n, ny))
    while np.max(np.abs(np.linalg.eigvals(A - K @ C))) > 0.99:
        K *= 0.8
    u = np.where(np.cumsum(rng.random((N + 200, nu)) < 0.3, axis=0) % 2, 1.0, -1.0)
    clean = recursion(A, u @ B.T, np.zeros(n))[:-1] @ C.T
    e = rng.standard_normal((N + 200, ny)) @ np.linalg.cholesky(0.6 * np.eye(ny) + 0.4).T
    e *= np.std(clean, axis=0) * 10 ** (-rng.uniform(10, 40) / 20)
    y = recursion(A, u @ B.T + e @ K.T, np.zeros(n))[:-1] @ C.T + e
    return Signals(u=u[200:], y=y[200:], Ts=1.0), A, K, C


def _from_truth(signals: Signals, A: Array, K: Array, C: Array) -> MultivariableFit:
    """Return the model that the search from the truth leads to."""

    def starts(problem: Any, scaled: Any) -> dict[str, tuple[Array, Array]]:
        return {"truth": (A - K @ C, C / np.std(signals.y, axis=0)[:, None])}

    with (
        patch.object(module, "starts", starts),
        patch.object(module, "moved_modes", lambda *_: {}),
    ):
        return armrig.ss(signals, order=A.shape[0])


def main() -> None:
    """Draw the plants, and count."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--plants", type=int, default=100)
    parser.add_argument("--N", type=int, default=1000)
    given = parser.parse_args()
    reached = 0
    for seed in range(given.first, given.first + given.plants):
        signals, A, K, C = drawn(seed, given.N)
        n, ny = A.shape[0], C.shape[0]
        best, own = _from_truth(signals, A, K, C), armrig.ss(signals, order=n)
        losses = [np.linalg.slogdet(fit.noise_covariance)[1] for fit in (best, own)]
        excess = float(np.exp((losses[1] - losses[0]) / ny) - 1)
        reached += excess <= _TOLERANCE
        if excess > _TOLERANCE:
            print(f"seed {seed}: order {n}, {signals.nu} x {ny}, excess {excess:.2g}", flush=True)
    print(f"{reached} of {given.plants} reached the minimum")


if __name__ == "__main__":
    main()
