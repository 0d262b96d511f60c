"""Monte Carlo of the test for feedback: false alarms in open loop, and what it finds.

`level`: nine inputs on three plants at Ts 5, 10, 20 ms and N 300, 1000, 3000, so many runs a cell.
The data are whole, or lack some outputs at random. The six cells with most alarms are repeated,
1000 runs each. `bank`: random plants, noises and inputs, one run of each. `closed`: a P controller
of the arm, and the open arm with the same input. `read`: the arm's angle through the potentiometer.
`cost`: 10^6 samples. Run one with the project's environment::

    python -m tests.benchmarks.feedback level RUNS [% MISSING]
    … bank RUNS SEED, closed RUNS, read RUNS, cost
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator
from itertools import product
from time import perf_counter
from typing import Literal

import numpy as np
from armrig import multisine, prbs, telegraph
from armrig.data.dataset import Dataset
from armrig.numerics.polynomial import filtered
from armrig.numerics.recursion import recursion
from armrig.validation.feedback_and_delay.sims import CannotTellError, sims
from armrig_core.arm import ArmParameters, arm_matrices, zero_order_hold
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Setpoint = Literal["held", "steps", "held, dither"]
LEVEL, ALARMING = 0.05, 6
RANGE = np.deg2rad(352.0)  # of the potentiometer; the other 8° are its dead band
SAMPLING, SIZES = (0.005, 0.01, 0.02), (300, 1000, 3000)
INPUTS = (
    *("telegraph", "prbs 1", "prbs 5", "prbs 12", "white", "low-pass", "held", "steps"),
    "multisine",
)
# Noise on the output: the potentiometer's, or 2 % of a volt's answer.
PLANTS = {"stable": 0.02, "slow": 0.02, "arm": 0.005}
Cell = tuple[str, str, float, int, float]


def drawn(name: str, N: int, rng: np.random.Generator) -> Vector:
    """Return an input between -2.5 and 2.5 V, or normal with 1 V."""
    kind, _, clock = name.partition(" ")
    if kind == "telegraph":
        return telegraph(N, 0.05, 0.0, 5.0, seed=rng) - 2.5
    if kind == "prbs":
        return prbs(N, int(clock), 0.0, 5.0, seed=rng) - 2.5
    if kind == "white":
        return rng.uniform(-2.5, 2.5, N)
    if kind == "low-pass":  # twice a pole at 0.8
        return filtered([0.2], [1.0, -1.6, 0.64], rng.standard_normal(N + 100))[100:]
    if kind == "multisine":  # all lines, one period
        return multisine(N, None, 0.0, 5.0, seed=rng) - 2.5
    length, values = (
        (7, rng.choice([-2.5, 2.5], N)) if kind == "held" else (50, rng.uniform(-2.5, 2.5, N))
    )
    return np.repeat(values, length)[:N]


def answer(plant: str, u: Vector, Ts: float) -> Vector:
    """Return the output for u, held, from rest."""
    if plant == "arm":
        return arm(u, Ts)
    slow, fast = (0.1, 0.03) if plant == "stable" else (2.0, 0.05)  # time constants, s
    poles = np.exp([-Ts / slow, -Ts / fast])
    F = np.poly(poles)
    return filtered(np.append(0.0, np.sum(F) * np.array([0.6, 0.4])), F, u)


def arm(u: Vector, Ts: float) -> Vector:
    """Return the handout's theta_1, which integrates u."""
    A, B, C = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, Ts)
    return np.asarray(recursion(Phi, u[:-1, None] * Gamma[:, 0], np.zeros(4)) @ C[0])


def p_value(u: Vector, y: Vector, missing: float, rng: np.random.Generator) -> float:
    """Return the p value of the test; NaN without a verdict."""
    valid = rng.random(u.size) >= missing
    try:
        return sims(Dataset(u=u, y=y, Ts=0.01, valid=valid)).p_value
    except CannotTellError:
        return float("nan")


def alarms(cell: Cell, runs: int, seed: int) -> Vector:
    """Return the p values of open-loop runs."""
    plant, name, Ts, N, missing = cell
    found = []
    for k in range(runs):
        rng = np.random.default_rng([seed, k, N, round(1e3 * Ts), INPUTS.index(name)])
        u = drawn(name, N, rng)
        y = answer(plant, u, Ts) + PLANTS[plant] * rng.standard_normal(N)
        found.append(p_value(u, y, missing, rng))
    return np.array(found)


def rejected(p: Vector) -> str:
    """Return the share of verdicts below the level."""
    told = p[np.isfinite(p)]
    unsaid = f", {p.size - told.size} not told" if told.size < p.size else ""
    return f"{100 * np.mean(told < LEVEL):.1f} % of {told.size}{unsaid}"


def level(runs: int, percent_missing: int = 0) -> None:
    """Print the false alarms of all cells and of each factor, and repeat the worst cells."""
    cells: list[Cell] = [
        (plant, name, Ts, N, percent_missing / 100)
        for plant, name, Ts, N in product(PLANTS, INPUTS, SAMPLING, SIZES)
    ]
    p = {cell: alarms(cell, runs, 41) for cell in cells}
    print(f"open loop, {percent_missing} % missing: {rejected(np.concatenate([*p.values()]))}")
    for i, names in enumerate((PLANTS, INPUTS, SAMPLING, SIZES)):
        of = ((v, np.concatenate([q for c, q in p.items() if c[i] == v])) for v in names)
        print("  " + "; ".join(f"{v}: {rejected(q)}" for v, q in of), flush=True)
    for cell in sorted(cells, key=lambda c: -float(np.mean(p[c] < LEVEL)))[:ALARMING]:
        first = 100 * np.mean(p[cell] < LEVEL)
        again = rejected(alarms(cell, 1000, 42))
        print(f"  {cell}: {first:.0f} % of {runs}; anew {again}", flush=True)


def bank(runs: int, seed: int) -> None:
    """Print the false alarms on random plants, noises and inputs, each drawn once."""
    found: dict[str, list[float]] = {}
    for k in range(runs):
        rng = np.random.default_rng([seed, k])
        N, missing = int(rng.choice(SIZES)), float(rng.choice([0.0, 0.3]))
        kind, u = _any_input(N, rng)
        y = _any_plant(u, rng)
        e = filtered([1.0], [1.0, -rng.choice([0.0, 0.6])], rng.standard_normal(N))
        y = y + e * np.std(y) / np.std(e) * 10 ** rng.uniform(-2, -0.5)  # 40 to 10 dB
        p = p_value(u, y, missing, rng)
        for key in ("all", kind, f"N {N}", f"{100 * missing:g} % missing"):
            found.setdefault(key, []).append(p)
    print(f"random plants, inputs and noises, seed {seed}")
    for key, p in sorted(found.items()):
        print(f"  {key}: {rejected(np.array(p))}", flush=True)


def _any_input(N: int, rng: np.random.Generator) -> tuple[str, Vector]:
    kind = str(rng.choice(["telegraph", "prbs", "low-pass", "held", "multisine", "steps"]))
    if kind == "telegraph":
        return kind, telegraph(N, rng.uniform(0.02, 0.3), 0.0, 5.0, seed=rng)
    if kind == "prbs":
        return kind, prbs(N, int(rng.integers(1, 16)), 0.0, 5.0, seed=rng)
    if kind == "low-pass":
        a = rng.uniform(0.5, 0.95)
        return kind, filtered([1 - a], [1.0, -a], rng.standard_normal(N))
    if kind == "multisine":
        return kind, multisine(N, range(1, int(N * rng.uniform(0.02, 0.5))), 0.0, 5.0, seed=rng)
    length = int(rng.integers(2, 16) if kind == "held" else rng.integers(20, 80))
    values = rng.choice([0.0, 5.0], N) if kind == "held" else rng.uniform(0.0, 5.0, N)
    return kind, np.repeat(values, length)[:N]


def _any_plant(u: Vector, rng: np.random.Generator) -> Vector:
    """Return the output of a random plant of order 2 to 5; each third one integrates."""
    order = int(rng.integers(2, 6))
    real = rng.uniform(0.3, 0.995, order % 2)
    pairs = rng.uniform(0.5, 0.98, order // 2) * np.exp(1j * rng.uniform(0.05, 1.5, order // 2))
    F = np.real(np.poly([*real, *pairs, *pairs.conj()]))
    y = filtered(np.append(0.0, rng.standard_normal(order)), F, u)
    return np.cumsum(y) * 0.05 if rng.random() < 1 / 3 else y


def closed(runs: int) -> None:
    """Print how often feedback is found, and how often in the open replay of the same input."""
    print(f"arm at 10 ms, u = K (r - y) + d, {runs} runs; replay: the same u on the open arm")
    setpoints: tuple[Setpoint, ...] = ("held", "steps", "held, dither")
    for setpoint in setpoints:
        for K, noise in product((1.0, 3.0), (0.005, 0.02, 0.05)):
            _tell(setpoint, K, noise, 1000, 0.0, runs)
        _tell(setpoint, 3.0, 0.05, 300, 0.0, runs)
        _tell(setpoint, 3.0, 0.05, 3000, 0.0, runs)
        _tell(setpoint, 3.0, 0.05, 1000, 0.3, runs)


def _tell(setpoint: Setpoint, K: float, noise: float, N: int, missing: float, runs: int) -> None:
    found, replays, shares = [], [], []
    for rng, u, y, share in _loops(setpoint, K, noise, N, runs):
        found.append(p_value(u, y, missing, rng))
        open_ = arm(u, 0.01) + noise * rng.standard_normal(N)
        replays.append(p_value(u, open_, missing, rng))
        shares.append(share)
    print(
        f"  {setpoint}, K {K:g} V/rad, noise {noise:g} rad, N {N}, {100 * missing:g} % missing: "
        f"share of noise in u {np.mean(shares):.2g}, found {rejected(np.array(found))}, replay "
        f"{rejected(np.array(replays))}",
        flush=True,
    )


def _loops(
    setpoint: Setpoint, K: float, noise: float, N: int, runs: int
) -> Iterator[tuple[np.random.Generator, Vector, Vector, float]]:
    """Yield u and y of the closed loop, all runs at once, and the share of u that is noise."""
    generators = [np.random.default_rng([43, k, N]) for k in range(runs)]
    e = noise * np.array([rng.standard_normal(N) for rng in generators])
    r, d = np.zeros((runs, N)), np.zeros((runs, N))
    if setpoint == "steps":
        r = np.array([np.repeat(rng.uniform(-1, 1, N), 100)[:N] for rng in generators])
    if setpoint == "held, dither":
        d = np.array([drawn("telegraph", N, rng) for rng in generators])
    u, y = _loop(r, d, e, K)
    quiet, _ = _loop(r, d, 0 * e, K)
    shares = np.var(u - quiet, axis=1) / np.var(u, axis=1)
    yield from zip(generators, u, y, shares.tolist(), strict=True)


def _loop(r: Vector, d: Vector, e: Vector, K: float) -> tuple[Vector, Vector]:
    """Return u and y (runs, N) of the arm under u = K (r - y) + d, e added to the angle."""
    A, B, C = arm_matrices(ArmParameters())
    Phi, Gamma = zero_order_hold(A, B, 0.01)
    x, u, y = np.zeros((e.shape[0], 4)), np.empty(e.shape), np.empty(e.shape)
    for k in range(e.shape[1]):
        y[:, k] = x @ C[0] + e[:, k]
        u[:, k] = K * (r[:, k] - y[:, k]) + d[:, k]
        x = x @ Phi.T + u[:, k, None] * Gamma[:, 0]
    return u, y


def read(runs: int) -> None:
    """Print the false alarms where the angle is read with 10 bits and has a dead band."""
    for name in ("telegraph", "prbs 5"):
        p = []
        for k in range(runs):
            rng = np.random.default_rng([44, k])
            u = drawn(name, 1500, rng) + 2.5
            turns, angle = np.divmod(arm(u, 0.01) + rng.uniform(0, 2 * np.pi), 2 * np.pi)
            lsb = RANGE / 1024
            counts = np.floor(angle / lsb + 0.5 * rng.standard_normal(u.size))
            valid = angle < RANGE
            y = counts * lsb + 2 * np.pi * turns
            p.append(sims(Dataset(u=u, y=y, Ts=0.01, valid=valid)).p_value)
        print(f"  {name}, 10 bits, 8° of dead band: {rejected(np.array(p))}", flush=True)


def cost() -> None:
    """Print time and peak memory of 10^5 and 10^6 samples."""
    rng = np.random.default_rng(1)
    for N in (100_000, 1_000_000):
        u = drawn("telegraph", N, rng)
        data = Dataset(u=u, y=answer("arm", u, 0.01) + 0.005 * rng.standard_normal(N), Ts=0.01)
        begin = perf_counter()
        sims(data)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        print(f"  N {N}: {perf_counter() - begin:.1f} s, peak of the process {peak:.2f} GB")


if __name__ == "__main__":
    section, *numbers = sys.argv[1:]
    sections = {"level": level, "bank": bank, "closed": closed, "read": read, "cost": cost}
    sections[section](*map(int, numbers))
