"""Recommendations of `structure_hints`: shares of true structures and of false lines.

Each seed draws a plant of first to sixth order, half of them continuous and sampled with a hold,
half of them polynomials in q. It has real and resonant poles, zeros inside and outside, an
integrator in three of ten, and 0 to 20 samples of delay (none in half). The input is of eight
kinds, N 300 to 4000, the noise white or autoregressive. Each is recorded twice, at 40 dB and at 10
to 30 dB.

A mode is visible if the best model without it leaves at least `VISIBLE` noise variances more of the
clean output (sum of squares). That model has one pole and one coefficient less, or one pole less. A
coefficient is visible if the same holds without the first or the last b.

A line about the drawn plant is false in these cases:
- integrator: the line claims a missing integrator, or denies a present one;
- low slope, roll-off: further than `SLOPE` dB a decade, or 3 of its deviations, from the straight
  line through the plant's own |G| at the same frequencies;
- resonance, antiresonance: no pair of poles (zeros) and no extreme of |G| within `NEAR` of it;
- order: more singular values are significant than the plant has poles;
- phase: its delay is further than a sample from the plant's delay and half a sample;
- delay: the plant's is not in the interval given, or is not the one given.

`python -m tests.benchmarks.hints [--n 100] [--first 0] [--tell]`. Seeds 0 to 99, 1000 to
1099 and the first hundred from 2000, 3000 and 4000 served to choose the rules.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import armrig
import control
import numpy as np
from armrig.estimation.multistart import searched_minimum
from armrig.estimation.prediction_error import PredictionErrorProblem
from armrig.models.innovations import prepared
from armrig.models.structure import Structure
from armrig.numerics.polynomial import filtered
from numpy.typing import NDArray

from tests.benchmarks.lowest_minimum import INPUTS, polynomial

Vector = NDArray[np.float64]
Draw = np.random.Generator
VISIBLE = 100.0  # noise variances
SLOPE, NEAR = 5.0, 0.15
LENGTHS = (300, 500, 1000, 2000, 4000)
BEFORE = 300  # samples before the record, in which the plant comes to move
EXCITATIONS = {
    "PRBS": lambda N, rng: np.repeat(rng.choice([-1.0, 1.0], N), rng.integers(1, 5))[:N],
    **INPUTS,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Plant:
    """Polynomials B/F of the true orders, with the input and the noise."""

    B: Vector
    """After the nk zeros, (nb,)."""
    F: Vector
    """(nf + 1,), the integrator's factor included."""
    nk: int
    integrator: bool
    Ts: float
    u: Vector
    clean: Vector
    noise: Vector
    """Noise of the same power as `clean`."""
    D: Vector
    """The noise is 1/D e."""
    words: str

    @property
    def structure(self) -> tuple[int, int, int]:
        """nb, nf and nk."""
        return self.B.size, self.F.size - 1, self.nk

    def data(self, db: float) -> armrig.Dataset:
        """Return the record with noise so far below the output."""
        return armrig.Dataset(u=self.u, y=self.clean + self.noise * 10 ** (-db / 20), Ts=self.Ts)

    def G(self, omega: Vector, *, rate: bool) -> Vector:
        """Return |G|, or that of the rate."""
        z = np.exp(-1j * omega * self.Ts)
        value = np.polyval(self.B[::-1], z) / np.polyval(self.F[::-1], z)
        return np.abs(value * (1 - z if rate else 1.0))


def drawn(seed: int) -> Plant:
    """Return the plant of a seed and its record."""
    rng = np.random.default_rng([seed, 28])
    n, integrator = int(rng.integers(1, 7)), bool(rng.random() < 0.3)
    if rng.random() < 0.5:
        B, F, Ts = _sampled(rng, n, integrator=integrator)
        kind = "sampled"
    else:
        F = polynomial(rng, n - integrator)
        F = np.convolve(F, [1.0, -1.0]) if integrator else F
        B, Ts = rng.standard_normal(int(rng.integers(1, n + 1))), float(rng.choice([0.01, 0.1, 1]))
        kind = "polynomials"
    nk = 1 + int(rng.integers(1, 21)) * int(rng.random() < 0.5)
    name, N = str(rng.choice([*EXCITATIONS])), int(rng.choice(LENGTHS))
    u = EXCITATIONS[name](N + BEFORE, rng)
    u = u - np.mean(u) if integrator else u
    clean = filtered(np.append(np.zeros(nk), B), F, u)[BEFORE:]
    D = polynomial(rng, int(rng.integers(1, 3)), slow=False) if rng.random() < 0.5 else np.ones(1)
    v = filtered([1.0], D, rng.standard_normal(N + BEFORE))[BEFORE:]
    scale = float(np.std(clean) / np.std(v))
    return Plant(
        B=B,
        F=F,
        nk=nk,
        integrator=integrator,
        Ts=Ts,
        u=u[BEFORE:],
        clean=clean,
        noise=scale * v,
        D=D,
        words=f"{kind}, {name}, N {N}, {'coloured' if D.size > 1 else 'white'}",
    )


def _sampled(rng: Draw, n: int, *, integrator: bool) -> tuple[Vector, Vector, float]:
    """Return B, F and Ts of a continuous plant under a hold."""
    degree = int(rng.integers(1, n + 1))
    poles: list[complex] = [0j] * integrator
    while len(poles) < n:
        if n - len(poles) >= 2 and rng.random() < 0.4:
            w, zeta = 10 ** rng.uniform(-0.3, 0.5), 10 ** rng.uniform(-1.5, -0.05)
            pole = w * complex(-zeta, np.sqrt(1 - zeta**2))
            poles += [pole, pole.conjugate()]
        else:
            poles.append(complex(-(10 ** rng.uniform(-0.1, 0.6))))
    zeros = -(10 ** rng.uniform(-0.3, 0.8, n - degree)) * rng.choice([1, 1, -1], n - degree)
    slowest = 1 / min([-p.real for p in poles if p] or [1.0])
    Ts = min(slowest * 10 ** rng.uniform(-1.7, -0.3), 2.5 / max(abs(p) for p in [*poles, 0.1]))
    H = control.ss2tf(control.sample_system(control.ss(control.zpk(zeros, poles, 1.0)), Ts, "zoh"))
    B, F = H.num[0][0], H.den[0][0]
    if integrator:
        F = np.convolve(np.polydiv(F, [1.0, -1.0])[0], [1.0, -1.0])
    return B[-n:], np.asarray(F), Ts


def visible(plant: Plant, db: float) -> tuple[bool, bool]:
    """Return two bools: every mode is visible, every coefficient of B is visible."""
    nb, nf, nk = plant.structure
    u, y = (filtered(plant.D, [1.0], x)[plant.D.size - 1 :] for x in (plant.u, plant.clean))
    e = filtered(plant.D, [1.0], plant.noise)[plant.D.size - 1 :]
    variance = float(np.var(e)) * 10 ** (-db / 10)
    data = armrig.Dataset(u=u, y=y, Ts=plant.Ts)

    def left(nb: int, nf: int, nk: int) -> float:
        free = nf - plant.integrator
        if nb < 1 or free < 0:
            return np.inf
        n = Structure(
            nb=nb, nf=free, nk=nk, integrator="f" if plant.integrator else "", offset=True
        )
        problem = PredictionErrorProblem(experiments=(prepared(data, n),), structure=n)
        return searched_minimum(problem, thorough=False)[0][1].cost / variance

    modes = min(left(nb - 1, nf - 1, nk), left(nb, nf - 1, nk)) >= VISIBLE
    return modes, modes and min(left(nb - 1, nf, nk), left(nb - 1, nf, nk + 1)) >= VISIBLE


def slope(plant: Plant, omega: Vector, *, rate: bool) -> float:
    """Return that of the straight line through the plant's |G|, in dB a decade."""
    return float(np.polyfit(np.log10(omega), 20 * np.log10(plant.G(omega, rate=rate)), 1)[0])


def false_lines(plant: Plant, h: armrig.StructureHints) -> Iterator[tuple[str, bool]]:
    """Yield each printed line, and whether it is false."""
    if h.integrator_shown:
        yield "integrator", h.integrator != plant.integrator
    if h.low_slope is not None:
        off = abs(h.low_slope - slope(plant, h.low_band, rate=False))
        yield "low slope", off > max(SLOPE, 3 * h.low_slope_std)
    if h.high_slope is not None:
        off = abs(h.high_slope - slope(plant, h.high_band, rate=False))
        yield "roll-off", off > SLOPE
    for name, claimed, roots, sign in (
        ("resonance", h.resonances, np.roots(plant.F), 1),
        ("antiresonance", h.antiresonances, np.roots(plant.B), -1),
    ):
        for w in claimed:
            yield name, not _there(plant, w, roots, sign)
    yield "order", h.order > plant.F.size - 1
    if h.phase_delay is not None and h.phase_delay > plant.Ts / 2:
        yield "phase", abs(h.phase_delay - (plant.nk - 0.5) * plant.Ts) > plant.Ts
    if h.nk_interval is not None:
        low, high = h.nk_interval
        yield "delay", not low <= plant.nk <= high


def _there(plant: Plant, w: float, roots: Vector, sign: int) -> bool:
    pairs = roots[np.imag(roots) > 0]
    at = np.abs(np.log(pairs)) / plant.Ts, np.angle(pairs) / plant.Ts
    near = np.geomspace(w * (1 - NEAR), min(w * (1 + NEAR), np.pi / plant.Ts), 200)
    g = plant.G(near, rate=plant.integrator) ** sign
    inside = bool(0 < np.argmax(g) < g.size - 1)
    return inside or bool(np.any(np.abs(np.concatenate(at) / w - 1) < NEAR))


def main() -> None:
    """Print how often the truth is among the recommended, and how many lines are false."""
    asked = argparse.ArgumentParser()
    asked.add_argument("--n", type=int, default=100)
    asked.add_argument("--first", type=int, default=0)
    asked.add_argument("--tell", action="store_true", help="each miss as it comes")
    given = asked.parse_args()
    warnings.simplefilter("ignore", RuntimeWarning)
    held: dict[str, list[bool]] = {"every coefficient visible": [], "every mode visible": []}
    held["all at 40 dB"] = []
    said, false, refused, seconds, most = Counter[str](), Counter[str](), 0, 0.0, 0
    for seed in range(given.first, given.first + given.n):
        plant = drawn(seed)
        low = float(np.random.default_rng([seed, 29]).choice([10, 20, 30]))
        for db in (40.0, low):
            begun = time.process_time()
            try:
                hints = armrig.structure_hints(plant.data(db))
            except ValueError as err:
                refused += 1
                if given.tell:
                    print(f"  {seed}, {db:g} dB: {plant.words}: refused: {err}", flush=True)
                continue
            seconds += time.process_time() - begun
            for line, wrong in false_lines(plant, hints):
                said[line] += 1
                false[line] += wrong
                if wrong and given.tell:
                    print(f"  {seed}, {db:g} dB: {plant.words}: {line} is false", flush=True)
            if db == 40:
                most = max(most, len(hints.structures))
                found = (*plant.structure, plant.integrator) in [
                    (s.nb, s.nf, s.nk, s.integrator) for s in hints.structures
                ]
                modes, coefficients = visible(plant, db)
                held["all at 40 dB"].append(found)
                if modes:
                    held["every mode visible"].append(found)
                if coefficients:
                    held["every coefficient visible"].append(found)
                if given.tell and coefficients and not found:
                    truth = (*plant.structure, plant.integrator)
                    print(f"  {seed}: {plant.words}: {truth}, not in {hints.structures}")
    print(f"{2 * given.n} records, {refused} refused, {seconds / (2 * given.n):.2f} s each")
    print(f"at most {most} structures; the truth among them:")
    for name, found in held.items():
        print(f"  {name}: {sum(found)} of {len(found)} ({np.mean(found):.3f})")
    share = 1 - sum(false.values()) / max(sum(said.values()), 1)
    print(f"lines: {sum(said.values())}, true {share:.3f}; false by kind, of those said:")
    print("  " + ", ".join(f"{line} {false[line]}/{said[line]}" for line in said))


if __name__ == "__main__":
    main()
