"""Excess of the one-step loss of n4sid's and SLICOT's predictors on short data.

Input ±1 V that switches with probability 0.3, 300 settled samples left out, true order given,
everything else by default. The excess is the mean of (e_model - e)² over that of e², on 6000 fresh
samples, in percent; with d parameters d/N is the least that can be expected. Four systems ::

    ARMAX 2  A = 1 - 1.2 q^-1 + 0.6 q^-2, B = q^-1 + 0.5 q^-2, C = 1 - 0.5 q^-1 + 0.2 q^-2
    ARMAX 4  poles 0.9 exp(±0.4i), 0.8 exp(±1.5i), B = q^-1 + 0.5 q^-2 + 0.3 q^-3 - 0.2 q^-4,
             roots of C 0.5 exp(±0.8i), 0.6 exp(±2i)
    OE 4     the same A and B, white noise on the output, of sd 1
    BJ       F and B of ARMAX 2, C = 1 + 0.5 q^-1, D = 1 - 0.7 q^-1: three states

and e of sd 0.5. `bank` draws a random system for each run: ARMAX 2, 4 and 6, OE 4 and BJ 2. Two
thirds of the poles are in pairs; radii of A are 0.5-0.97, of C and D 0.2-0.9; B is normal, the
noise 0 to 25 dB below the clean output. `times` prints n4sid's processor time. Octave's n4sid is
SLICOT's; it is omitted if Octave is not installed. Run it with the project's environment::

    python -m tests.benchmarks.subspace [runs [seed]]
    python -m tests.benchmarks.subspace bank [runs [seed]]
    python -m tests.benchmarks.subspace times

The bank of seed 5 was worked on; that of seed 90731 was drawn once, at the end.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from armrig import Dataset, n4sid, telegraph
from armrig.numerics.polynomial import filtered
from numpy.typing import NDArray

from tests.benchmarks.octave_models import have_octave, octave_models

Vector = NDArray[np.float64]
SETTLED = 300  # samples before the first one that is taken
FRESH = 6000
LENGTHS = (300, 1000)
ONE = np.ones(1)


@dataclass(frozen=True, slots=True, kw_only=True)
class System:
    """y = B/F u + C/D e."""

    B: Vector
    F: Vector
    C: Vector
    D: Vector
    states: int
    std: float

    def record(self, N: int, rng: np.random.Generator) -> tuple[Vector, Vector, Vector]:
        """Return u, y and e."""
        u = telegraph(N, 0.3, 1.5, 3.5, seed=rng) - 2.5
        e = self.std * rng.standard_normal(N)
        return u, filtered(self.B, self.F, u) + filtered(self.C, self.D, e), e


def _pair(radius: float, angle: float) -> Vector:
    return np.array([1.0, -2 * radius * np.cos(angle), radius**2])


_F2, _B2 = np.array([1.0, -1.2, 0.6]), np.array([0.0, 1.0, 0.5])
_F4 = np.convolve(_pair(0.9, 0.4), _pair(0.8, 1.5))
_B4 = np.array([0.0, 1.0, 0.5, 0.3, -0.2])
_C4 = np.convolve(_pair(0.5, 0.8), _pair(0.6, 2.0))
_C2 = np.array([1.0, -0.5, 0.2])
SYSTEMS = {
    "ARMAX 2": System(B=_B2, F=_F2, C=_C2, D=_F2, states=2, std=0.5),
    "ARMAX 4": System(B=_B4, F=_F4, C=_C4, D=_F4, states=4, std=0.5),
    "OE 4": System(B=_B4, F=_F4, C=ONE, D=ONE, states=4, std=1.0),
    "BJ": System(B=_B2, F=_F2, C=np.array([1.0, 0.5]), D=np.array([1.0, -0.7]), states=3, std=0.5),
}


def main() -> None:
    """Print the excess of each system and length, or the times."""
    words = [x for x in sys.argv[1:] if not x.isdigit()]
    given = [int(x) for x in sys.argv[1:] if x.isdigit()]
    runs = given[0] if given else 100
    seed = given[1] if len(given) > 1 else 5 if "bank" in words else 1
    if "times" in words:
        _print_times()
        return
    if "bank" in words:
        kinds: dict[str, Callable[[np.random.Generator], System]] = {
            f"{kind} {n}": (lambda rng, kind=kind, n=n: _drawn(kind, n, rng))
            for kind, n in (("ARMAX", 2), ("ARMAX", 4), ("ARMAX", 6), ("OE", 4), ("BJ", 2))
        }
    else:
        kinds = {name: (lambda _, s=system: s) for name, system in SYSTEMS.items()}
    print(f"{runs} runs, seed {seed}: mean excess in % (median); n4sid at the horizons it chose")
    for k, (name, draw) in enumerate(kinds.items()):
        for N in LENGTHS:
            _print_excess(name, draw, N, runs, np.random.default_rng([seed, k, N]))


def _print_excess(
    name: str,
    draw: Callable[[np.random.Generator], System],
    N: int,
    runs: int,
    rng: np.random.Generator,
) -> None:
    systems = [draw(rng) for _ in range(runs)]
    records = [tuple(x[SETTLED:] for x in s.record(N + SETTLED, rng)[:2]) for s in systems]
    n = systems[0].states
    fits = [n4sid(Dataset(u=u, y=y, Ts=1.0), n) for u, y in records]
    found = {"armrig": [_excess(s, f.A, f.B, f.C) for s, f in zip(systems, fits, strict=True)]}
    horizons = sorted({f.horizon for f in fits})
    if have_octave():
        models = octave_models([(u, y) for u, y in records], [n], ["n4sid"])
        found["Octave"] = [
            _excess(systems[m.record], m.A, m.B, m.C) for m in models if not m.failed
        ]
    told = "; ".join(f"{who} {_mean(x)}" for who, x in found.items())
    print(f"  {name:8} N {N:5}: {told}; horizons {horizons[0]}-{horizons[-1]}", flush=True)


def _mean(shares: Sequence[float]) -> str:
    return f"{100 * np.mean(shares):.2f} ({100 * np.median(shares):.2f})"


def _excess(system: System, A: Vector, B: Vector, C: Vector) -> float:
    u, y, e = system.record(FRESH, np.random.default_rng(987))
    with np.errstate(all="ignore"):
        own = filtered(A, C, y) - filtered(B, C, u)
        return float(np.mean((own - e) ** 2) / np.mean(e**2))


def _drawn(kind: str, n: int, rng: np.random.Generator) -> System:
    F, B = _with_roots(n, 0.5, 0.97, rng), np.append(0.0, rng.standard_normal(n))
    C, c, d = (_with_roots(m, 0.2, 0.9, rng) for m in (n, 1, 1))
    C, D = {"ARMAX": (C, F), "OE": (ONE, ONE), "BJ": (c, d)}[kind]
    states = n + int(kind == "BJ")
    unit = System(B=B, F=F, C=C, D=D, states=states, std=1.0)
    _, y, e = unit.record(3000, rng)
    v = filtered(C, D, e)
    level = float(np.std(y - v) / np.std(v)) * 10 ** (-rng.uniform(0, 25) / 20)
    return System(B=B, F=F, C=C, D=D, states=states, std=level)


def _with_roots(n: int, low: float, high: float, rng: np.random.Generator) -> Vector:
    z: list[complex] = []
    while len(z) < n:
        radius = rng.uniform(low, high)
        if n - len(z) >= 2 and rng.random() < 2 / 3:
            root = radius * np.exp(1j * rng.uniform(0.1, 2.5))
            z += [root, root.conjugate()]
        else:
            z.append(radius * rng.choice([1, 1, 1, -1]))
    return np.real(reduce(np.convolve, [np.array([1.0, -root]) for root in z]))


def _print_times() -> None:
    print("processor time of n4sid in ms, least of 30")
    for name, system in SYSTEMS.items():
        for N in (300, 1000, 10_000):
            u, y, _ = system.record(N, np.random.default_rng(1))
            data, times = Dataset(u=u, y=y, Ts=1.0), []
            for _ in range(30):
                begun = time.process_time()
                n4sid(data, system.states)
                times.append(time.process_time() - begun)
            print(f"  {name:8} N {N:6}: {1e3 * min(times):.2f}", flush=True)


if __name__ == "__main__":
    main()
