"""Monte Carlo of the tests for feedback and for delay on the handout's arm.

Sections: `level`, `power`, `delays`, `read`; all of them without an argument.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from time import perf_counter

import armrig
import numpy as np
from armrig.data.dataset import Dataset
from armrig.validation.feedback_and_delay.granger import granger
from armrig_core.arm import ArmParameters, arm_matrices, zero_order_hold
from numpy.typing import NDArray

Vector = NDArray[np.float64]
LEVEL, RUNS, CLOSED, SEEDS = 0.05, 5000, 200, 100
NOISE, N, P = 5e-3, 3000, 0.05
RANGE = np.deg2rad(352.0)  # of the potentiometer; the other 8° are its dead band
Rule = Callable[[int, float], float]


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


def closed(
    rng: np.random.Generator,
    K: float,
    *,
    dither: float,
    setpoint: Rule,
    bounds: tuple[float, float],
) -> tuple[Dataset, float]:
    """Return data under u = clip(K (r - y) + d, bounds), and std(K (r - y)) / std(d).

    d is a telegraph of ± `dither` about the voltage that the setpoint's own speed needs.
    """
    A, B, C = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, 0.01)
    d = armrig.telegraph(N, P, 0.0, 2 * dither, seed=rng) - dither
    noise = NOISE * rng.standard_normal(N)
    x, u, y, fed = np.zeros(4), np.empty(N), np.empty(N), np.empty(N)
    for k in range(N):
        y[k] = C[0] @ x + noise[k]
        fed[k] = K * (setpoint(k, 0.0) - y[k])
        needed = setpoint(k, 1.0)
        u[k] = np.clip(needed + fed[k] + d[k], *bounds)
        x = Phi @ x + Gamma[:, 0] * u[k]
    data = Dataset(u=u, y=y, Ts=0.01, output="theta_1", unit="rad")
    return data, float(fed.std() / d.std())


def held(k: int, voltage: float) -> float:
    """Return a setpoint of 0 rad, and the 0 V that it needs."""
    return 0.0


def turning(k: int, voltage: float) -> float:
    """Return a setpoint that turns as 2.5 V make the chassis turn, and the 2.5 V."""
    return 2.5 if voltage else 2.5 * 1.8623 * 0.01 * k


def level() -> None:
    """Print the false alarms of the test for feedback."""
    print(f"open loop, telegraph 0/5 V, p {P}, {N} samples at 10 ms, noise 5 mrad, level 5 %")
    for name, runs, make in (
        ("whole data", RUNS, driven),
        ("10 bits, dead band, 2 % lost", RUNS // 5, _read),
        ("three experiments of 1000", RUNS // 5, _thirds),
    ):
        p = np.array([granger(make(np.random.default_rng([7, s]))).p_value for s in range(runs)])
        told = ", ".join(f"{100 * np.mean(p < a):.2f} % below {a:g}" for a in (0.01, 0.05, 0.1))
        print(f"  {name:30} {runs} runs: {told}", flush=True)


def _read(rng: np.random.Generator) -> Dataset:
    return through_potentiometer(driven(rng), rng)


def _thirds(rng: np.random.Generator) -> Dataset:
    return armrig.merge(driven(rng).split(3))


def power() -> None:
    """Print how often feedback is found."""
    print(f"closed loop u = K (r - y) + d, d a telegraph, {CLOSED} runs each, level 5 %")
    for name, dither, setpoint, bounds in (
        ("r held, d ±2.5 V, no limit", 2.5, held, (-np.inf, np.inf)),
        ("r turns, d ±1.25 V, u in 0 to 5 V", 1.25, turning, (0.0, 5.0)),
    ):
        print(f"  {name}")
        for K in (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 4.0, 8.0):
            runs = [
                closed(
                    np.random.default_rng([11, s]),
                    K,
                    dither=dither,
                    setpoint=setpoint,
                    bounds=bounds,
                )
                for s in range(CLOSED)
            ]
            found = np.mean([granger(data).p_value < LEVEL for data, _ in runs])
            ratio = np.mean([share for _, share in runs])
            print(
                f"    K {K:4} V/rad, fed back/dither {ratio:.2f}: {100 * found:.1f} %", flush=True
            )


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
    sections = {"level": level, "power": power, "delays": delays, "read": read}
    for section in sys.argv[1:] or sections:
        sections[section]()
