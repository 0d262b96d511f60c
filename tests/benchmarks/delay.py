"""Errors of the delay, on plants for which it was not tuned and on the handout's arm.

The bank has random stable plants of order 2-6 (poles of radius up to 0.97), nk 0-5, N 500 or 2000.
Signal over noise is uniform in 0-40 dB, and half of the noises pass a random C/D. The input is
white noise, a telegraph or random binary. The first coefficient of the impulse response
(`response`), or of B alone (`numerator`), is at least a quarter of the largest. In a `numerator`
bank the first coefficient of the response may be a hundredth of the largest. Run it with the
project's environment::

    python -m tests.benchmarks.delay [bank | inputs | arm | read] [seed [plants]]

The method was chosen with seeds 1, 2 and 3 in view; see docs/benchmarks.md for the others.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from time import process_time
from typing import Any

import armrig
import numpy as np
from armrig.data.dataset import Dataset
from armrig.numerics.polynomial import filtered, impulse
from armrig.numerics.recursion import recursion
from armrig_core.arm import ArmParameters, arm_matrices, zero_order_hold
from numpy.typing import NDArray

Vector = NDArray[np.float64]
SEED, PLANTS, RUNS = 2, 200, 20
SETTLED = 200  # samples left out before the data begin
NOISE = 5e-3  # rad, on the arm's angle
_SINES = {f"multisine to {share} of Nyquist": share for share in (0.95, 0.8, 0.7, 0.6, 0.3)}
RANGE = np.deg2rad(352.0)  # of the potentiometer; the other 8° are its dead band


def bank(seed: int, plants: int) -> None:
    """Print coverage, point, width and time of both banks, at 20 dB and more and below."""
    for of in ("response", "numerator"):
        rows = [_judged(np.random.default_rng([seed, s]), of) for s in range(plants)]
        for name, loud in (("20 dB and more", True), ("below 20 dB", False)):
            of_these = np.array([row for db, *row in rows if (db >= 20) == loud])
            inside, right, width, seconds = of_these.T
            print(
                f"first of the {of}, {name}: {len(of_these)} plants, interval holds "
                f"{100 * inside.mean():.1f} %, point {100 * right.mean():.1f} %, mean width "
                f"{width.mean():.2f}, {seconds.mean():.2f} s of a processor each, "
                f"{seconds.max():.2f} at most",
                flush=True,
            )


def _judged(rng: np.random.Generator, of: str) -> tuple[float, bool, bool, int, float]:
    """Return dB, interval holds, point right, width and seconds of a processor."""
    data, nk, db = _drawn(rng, of)
    begin = process_time()
    found = armrig.delay(data)
    seconds = process_time() - begin
    low, high = found.interval
    return db, low <= nk <= high, found.nk == nk, high - low, seconds


def _drawn(rng: np.random.Generator, of: str) -> tuple[Dataset, int, float]:
    """Return data, nk and signal over noise in dB."""
    B, F = _plant(rng, of)
    nk, N, db = int(rng.integers(0, 6)), int(rng.choice([500, 2000])), rng.uniform(0, 40)
    u = _input(rng, N + SETTLED)
    y, e = filtered(np.append(np.zeros(nk), B), F, u), rng.standard_normal(N + SETTLED)
    if rng.random() < 0.5:
        z = rng.uniform(0.5, 0.95) * np.exp(1j * rng.uniform(0, 3))
        D = np.real(np.poly([z, z.conjugate()]))
        e = filtered(np.poly([rng.uniform(-0.8, 0.8)]), D, e)
    u, y, e = u[SETTLED:], y[SETTLED:], e[SETTLED:]
    return Dataset(u=u, y=y + e * np.std(y) / np.std(e) * 10 ** (-db / 20), Ts=1.0), nk, db


def _plant(rng: np.random.Generator, of: str) -> tuple[Vector, Vector]:
    n = int(rng.integers(2, 7))
    while True:
        poles: list[complex] = []
        while len(poles) < n:
            if n - len(poles) >= 2 and rng.random() < 0.6:
                z = rng.uniform(0.3, 0.97) * np.exp(1j * rng.uniform(0.05, 3.0))
                poles += [z, z.conjugate()]
            else:
                poles.append(rng.uniform(-0.5, 0.97))
        F, B = np.real(np.poly(poles)), rng.standard_normal(n)
        x = filtered(B, [1.0], impulse(F, 400)) if of == "response" else B
        if abs(x[0]) >= 0.25 * np.abs(x).max():
            return B, F


def _input(rng: np.random.Generator, N: int) -> Vector:
    kind = rng.choice(["white", "telegraph", "binary"])
    if kind == "telegraph":
        return armrig.telegraph(N, float(rng.choice([0.3, 0.1])), 1.5, 3.5, seed=rng) - 2.5
    noise = rng.standard_normal(N)
    return noise if kind == "white" else np.sign(noise)


def inputs(seed: int, plants: int) -> None:
    """Print the same for inputs that excite less, N 1000, white noise at 0-40 dB."""
    for kind in ("held 5", "held 12", "held 100", "low-pass", "period 31", *_SINES):
        rows, refused = [], 0
        for s in range(plants):
            rng = np.random.default_rng([seed, s])
            (B, F), nk, u = _plant(rng, "response"), int(rng.integers(0, 6)), _poor(rng, kind, 1000)
            y = filtered(np.append(np.zeros(nk), B), F, u)
            y += rng.standard_normal(1000) * np.std(y) * 10 ** (-rng.uniform(0, 40) / 20)
            try:
                found = armrig.delay(Dataset(u=u, y=y, Ts=1.0))
            except ValueError:
                refused += 1
                continue
            low, high = found.interval
            rows.append((low <= nk <= high, found.nk == nk, high - low))
        inside, right, width = np.mean(rows, axis=0) if rows else (np.nan,) * 3
        print(
            f"{kind}: {plants} plants, {refused} refused, interval holds {100 * inside:.1f} %, "
            f"point {100 * right:.1f} %, mean width {width:.2f}",
            flush=True,
        )


def _poor(rng: np.random.Generator, kind: str, N: int) -> Vector:
    if kind in _SINES:
        k = np.arange(1, int(_SINES[kind] * N / 2))
        phase = 2 * np.pi * np.outer(np.arange(N), k) / N + rng.uniform(0, 2 * np.pi, k.size)
        return np.cos(phase).sum(axis=1)
    if kind == "low-pass":
        return filtered([1.0], [1.0, -0.9], rng.standard_normal(N))
    number = int(kind.split()[1])
    if kind.startswith("period"):
        return np.resize(np.sign(rng.standard_normal(number)), N)
    return np.repeat(np.sign(rng.standard_normal(N // number + 1)), number)[:N]


def arm(seed: int, runs: int) -> None:
    """Print the delays of the handout's arm: by name, unnamed, and declared not to integrate."""
    for name, output, asked in (
        ("theta_1", "theta_1", {}),
        ("unnamed", "y", {}),
        ("integrator=False", "y", {"integrator": False}),
    ):
        for Ts in (0.002, 0.005, 0.01, 0.02):
            for extra in (0, 2):
                data = (_driven([seed, s], Ts, extra, output) for s in range(runs))
                _tell(f"{name}, Ts {1e3 * Ts:g} ms, {extra} extra", extra, data, asked)


def read(seed: int, runs: int) -> None:
    """Print the same through the potentiometer, without a delay and with two samples."""
    for Ts in (0.002, 0.01):
        for extra in (0, 2):
            data = (
                _through_potentiometer(
                    _driven([seed, s], Ts, extra, "theta_1"), np.random.default_rng([19, s])
                )
                for s in range(runs)
            )
            _tell(f"10 bits, dead band, 2 % lost, Ts {1e3 * Ts:g} ms, {extra} extra", extra, data)


def _driven(seed: list[int], Ts: float, extra: int, output: str) -> Dataset:
    """Return 30 s of telegraph 0/5 V and of the angle, `extra` samples late, with white noise."""
    rng = np.random.default_rng(seed)
    N = round(30 / Ts)
    u = armrig.telegraph(N, 5 * Ts, 0.0, 5.0, seed=rng)
    A, B, C = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, Ts)
    late = np.concatenate([np.zeros(extra), u[: N - extra]])
    angle = np.asarray(recursion(Phi, late[:-1, None] * Gamma[:, 0], np.zeros(4)) @ C[0])
    y = angle + NOISE * rng.standard_normal(N)
    return Dataset(u=u, y=y, Ts=Ts, output=output, unit="rad")


def _through_potentiometer(data: Dataset, rng: np.random.Generator) -> Dataset:
    """Return the data read with 10 bits, without the dead band and another 2 % of the samples."""
    turns, angle = np.divmod(data.y + rng.uniform(0, 2 * np.pi), 2 * np.pi)
    lsb = RANGE / 1024
    y = (np.floor(angle / lsb) + 0.5) * lsb + 2 * np.pi * turns
    valid = (angle < RANGE) & (rng.random(data.N) > 0.02)
    return Dataset(u=data.u, y=y, Ts=data.Ts, valid=valid, output="theta_1", unit="rad")


def _tell(
    name: str, extra: int, data: Iterable[Dataset], asked: dict[str, Any] | None = None
) -> None:
    found, seconds = [], []
    for part in data:
        begin = process_time()
        found.append(armrig.delay(part, **(asked or {})))
        seconds.append(process_time() - begin)
    inside = sum(f.interval[0] <= extra + 1 <= f.interval[1] for f in found)
    point = sum(f.nk == extra + 1 for f in found)
    width = np.mean([f.interval[1] - f.interval[0] for f in found])
    print(
        f"{name}: interval holds {inside} of {len(found)}, point {point}, mean width {width:.2f}; "
        f"{np.mean(seconds):.2f} s of a processor each, {max(seconds):.2f} at most",
        flush=True,
    )


if __name__ == "__main__":
    sections = {
        "bank": (bank, PLANTS),
        "inputs": (inputs, 40),
        "arm": (arm, RUNS),
        "read": (read, RUNS),
    }
    chosen = sys.argv[1:2] or list(sections)
    for section in chosen:
        run, most = sections[section]
        run(
            int(sys.argv[2]) if len(sys.argv) > 2 else SEED,
            int(sys.argv[3]) if len(sys.argv) > 3 else most,
        )
