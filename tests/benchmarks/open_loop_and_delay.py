"""Monte Carlo of the test for delay on the handout's arm; that for feedback has feedback.py.

Sections: `delays`, `read`; all of them without an argument.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from time import perf_counter

import armrig
import numpy as np
from armrig.data.dataset import Dataset
from armrig_core.arm import ArmParameters, arm_matrices, zero_order_hold
from numpy.typing import NDArray

Vector = NDArray[np.float64]
SEEDS = 100
NOISE, N, P = 5e-3, 3000, 0.05
RANGE = np.deg2rad(352.0)  # of the potentiometer; the other 8° are its dead band


def driven(rng: np.random.Generator, *, Ts: float = 0.01, extra: int = 0) -> Dataset:
    """Return 30 s of telegraph 0/5 V and of the angle, `extra` samples late, with white noise."""
    samples = round(N * 0.01 / Ts)
    u = armrig.telegraph(samples, P * Ts / 0.01, 0.0, 5.0, seed=rng)
    late = np.concatenate([np.zeros(extra), u[: samples - extra]])
    return observed(u, _angle(late, Ts), rng, Ts)


def observed(u: Vector, angle: Vector, rng: np.random.Generator, Ts: float = 0.01) -> Dataset:
    """Return the data with noise on the angle."""
    y = angle + NOISE * rng.standard_normal(u.size)
    return Dataset(u=u, y=y, Ts=Ts, output="theta_1", unit="rad")


def through_potentiometer(data: Dataset, rng: np.random.Generator) -> Dataset:
    """Return the data read with 10 bits, without the dead band and another 2 % of the samples."""
    turns, angle = np.divmod(data.y + rng.uniform(0, 2 * np.pi), 2 * np.pi)
    lsb = RANGE / 1024
    y = (np.floor(angle / lsb) + 0.5) * lsb + 2 * np.pi * turns
    valid = (angle < RANGE) & (rng.random(data.N) > 0.02)
    return Dataset(u=data.u, y=y, Ts=data.Ts, valid=valid, output="theta_1", unit="rad")


def delays() -> None:
    """Print what is found on the handout's arm with 0, 1, 2 and 5 samples of delay."""
    print(f"delay, 30 s, level 1 %, {SEEDS} seeds each")
    for Ts in (0.002, 0.005, 0.01, 0.02):
        for samples in (0, 1, 2, 5):
            _tell(f"Ts {1e3 * Ts:g} ms, {samples} extra", samples, _delayed(Ts, samples))


def read() -> None:
    """Print the same through the potentiometer, without a delay and with two samples."""
    print(f"delay, 10 bits, dead band, 2 % lost, 30 s, level 1 %, {SEEDS} seeds each")
    for Ts in (0.002, 0.01):
        for samples in (0, 2):
            data = (
                through_potentiometer(d, np.random.default_rng([19, s]))
                for s, d in enumerate(_delayed(Ts, samples))
            )
            _tell(f"Ts {1e3 * Ts:g} ms, {samples} extra", samples, data)


def _delayed(Ts: float, extra: int) -> Iterable[Dataset]:
    return (driven(np.random.default_rng([17, s]), Ts=Ts, extra=extra) for s in range(SEEDS))


def _tell(name: str, truth: int, data: Iterable[Dataset]) -> None:
    begin = perf_counter()
    found = [armrig.delay(d).interval for d in data]
    each = (perf_counter() - begin) / len(found)
    nk = truth + 1
    right = sum(low == high == nk for low, high in found)
    late, early = sum(low > nk for low, _ in found), sum(high < nk for _, high in found)
    print(
        f"  {name}: right {right} of {len(found)}, cannot be told "
        f"{len(found) - right - late - early}, too late {late}, too early {early}; "
        f"{each:.2f} s each",
        flush=True,
    )


def _angle(u: Vector, Ts: float) -> Vector:
    from armrig.numerics.recursion import recursion

    A, B, C = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, Ts)
    return np.asarray(recursion(Phi, u[:-1, None] * Gamma[:, 0], np.zeros(4)) @ C[0])


if __name__ == "__main__":
    sections = {"delays": delays, "read": read}
    for section in sys.argv[1:] or sections:
        sections[section]()
