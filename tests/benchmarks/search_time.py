"""Processor time of `search` with its defaults, on one thread, and its choice.

The cases are drawn by seed: eight kinds of plant and noise, five kinds of input, output noise of 0
to 30 dB. A third have levels of u and y; N is 1000 (two of each) and 4000; each is halved. With a
FOLDER of DaISy's records (see daisy.py), these are searched, too. After a change the choices are
compared by this list, and times within one machine, in turn. Run it with the project's
environment::

    OPENBLAS_NUM_THREADS=1 python -m tests.benchmarks.search_time [FOLDER]
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from armrig import Dataset, search, telegraph
from armrig.numerics.polynomial import apply_filter

SETTLED = 300  # samples before the first one that is taken
KINDS = ("resonant", "integrating", "lags", "high order", "slow noise", "arx", "nonlinear", "loop")
INPUTS = ("telegraph", "white", "low-pass", "steps", "multisine")
RECORDS = {
    "exchanger": (1, 2, 1.0),
    "robot_arm": (0, 1, 1.0),
    "dryer": (0, 1, 0.08),
    "ballbeam": (0, 1, 0.1),
    "heating_system": (1, 2, 2.0),
    "dryer2": (1, 4, 10.0),
    "glassfurnace": (1, 4, 1.0),
}
"""Columns of u and y, and Ts in s."""


def main() -> None:
    """Print N, seconds, the choice and its rms error, a line each."""
    for kind in KINDS:
        for N, seed in ((1000, 100), (1000, 101), (4000, 7)):
            _say(f"{kind} {seed}", drawn(kind, N, np.random.default_rng(seed)))
    for name, (i, j, Ts) in (RECORDS if len(sys.argv) > 1 else {}).items():
        record = np.loadtxt(Path(sys.argv[1]) / f"{name}.dat")
        _say(name, Dataset(u=record[:, i], y=record[:, j], Ts=Ts))


def _say(name: str, data: Dataset) -> None:
    begin = time.process_time()
    found = search(data)
    spent = time.process_time() - begin
    chosen, rms = found.chosen.candidate.name, found.rms[found.chosen_index]
    print(f"{name:16} {data.N:5} {spent:6.1f} s  {chosen:16} {rms:.6g}", flush=True)


def drawn(kind: str, N: int, rng: np.random.Generator) -> Dataset:
    """Return data of one kind: poles, zeros, delay, input and noise are drawn."""
    u = _input(str(rng.choice(INPUTS)), N + SETTLED, rng)
    F = _poles(kind, rng)
    B = np.concatenate([np.zeros(rng.integers(1, 4)), rng.standard_normal(F.size - 1)])
    e = rng.standard_normal(u.size)
    share, levels = 10 ** (-rng.uniform(0, 30) / 20), rng.random() < 0.3
    if kind == "loop":  # u = r - K y with K |B/F| < 0.6, y = B/F u + 0.02 e: stable by its gain
        z = np.exp(-1j * np.linspace(0, np.pi, 2000))
        B *= 0.2 / np.max(np.abs(np.polyval(B[::-1], z) / np.polyval(F[::-1], z)))
        closed = np.append(F, np.zeros(B.size - F.size)) + 3.0 * B
        y = apply_filter(B, closed, u) + apply_filter(F, closed, 0.02 * e)
        u = u - 3.0 * y
    else:
        x = apply_filter(B, F, u)
        size = 5 * np.std(np.diff(x)) if kind == "integrating" else np.std(x)
        x = np.tanh(x / size) * size if kind == "nonlinear" else x
        colour = {"slow noise": np.array([1.0, -0.97]), "arx": F}.get(kind, np.ones(1))
        v = apply_filter([1.0], colour, e)
        y = x + share * size * v / np.std(v) + 3.0 * levels
        u = u + 2.5 * levels
    return Dataset(u=u[SETTLED:], y=y[SETTLED:], Ts=0.01)


def _pair(radius: float, angle: float) -> np.ndarray:
    return np.array([1.0, -2 * radius * np.cos(angle), radius**2])


def _poles(kind: str, rng: np.random.Generator) -> np.ndarray:
    F = np.ones(1)
    if kind == "resonant":
        for _ in range(rng.integers(1, 3)):
            F = np.convolve(F, _pair(rng.uniform(0.93, 0.995), rng.uniform(0.1, 1.5)))
    elif kind == "integrating":
        F = np.convolve([1.0, -1.0], [1.0, -rng.uniform(0.5, 0.95)])
    elif kind == "lags":
        for _ in range(rng.integers(1, 4)):
            F = np.convolve(F, [1.0, -rng.uniform(0.2, 0.97)])
    elif kind == "high order":
        for _ in range(3):
            F = np.convolve(F, _pair(rng.uniform(0.8, 0.98), rng.uniform(0.1, 2.5)))
    else:
        pair = _pair(rng.uniform(0.6, 0.95), rng.uniform(0.1, 1.5))
        F = np.convolve([1.0, -rng.uniform(0.5, 0.95)], pair)
    return F


def _input(kind: str, N: int, rng: np.random.Generator) -> np.ndarray:
    if kind == "telegraph":
        return telegraph(N, 0.1 + 0.3 * rng.random(), 1.5, 3.5, seed=rng) - 2.5
    if kind == "white":
        return rng.standard_normal(N)
    if kind == "low-pass":
        return apply_filter([0.2], [1.0, -0.8], rng.standard_normal(N))
    if kind == "steps":
        return np.repeat(rng.uniform(-1, 1, N // 40 + 1), 40)[:N]
    t = 2 * np.pi * np.arange(N) / 512
    return np.sum([np.sin(k * t + rng.uniform(0, 2 * np.pi)) for k in range(1, 60, 3)], axis=0) / 5


if __name__ == "__main__":
    main()
