"""Drawn nonlinear rigs, and a judge of the kind that `linearity` names.

The judge shares no code with armrig::

    python -m tests.drawn_nonlinear --seed 1 --count 100

prints for each rig how often its kind is right, not known, and wrong, or not found at all, and how
often a number of the kind is wrong. "linear" counts the linear rigs that are called nonlinear.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable

import armrig
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import lfilter

Vector = NDArray[np.float64]
Truth = dict[str, float]
Drawn = tuple[Vector, Vector, Truth]
RIGHT = {
    "linear": "",
    "backlash": "backlash",
    "saturating coil": "speed by level",
    "friction": "friction",
    "dead zone": "dead zone",
    "quadratic": "gain by level",
    "Wiener": "gain by level",
}


def drawn_input(rng: Generator, N: int, low: float, high: float) -> Vector:
    """Return random levels of random lengths, or coloured noise, between two values."""
    if rng.random() < 0.6:
        lengths = rng.integers(4, int(rng.integers(8, 30)), N)
        u = np.repeat(rng.random(N), lengths)[:N]
    else:
        v = lfilter([1.0], [1.0, -rng.uniform(0.7, 0.95)], rng.standard_normal(N))
        u = 0.5 + np.clip(v / np.std(v), -2.5, 2.5) / 5
    return np.asarray(low + (high - low) * u)


def linear_response(rng: Generator, u: Vector) -> Vector:
    """Return the response of one or two poles with the gain 1; u acts one sample later."""
    poles = rng.uniform(0.5, 0.93, rng.integers(1, 3))
    A = np.real(np.poly(poles))
    return np.asarray(lfilter([0.0, np.sum(A)], A, u - u[0]) + u[0])


def play(x: Vector, half: float) -> Vector:
    """Return the load that follows a drive with a play of `half` to each side."""
    y = np.empty(x.size)
    y[0] = x[0]
    for t in range(1, x.size):
        y[t] = min(max(y[t - 1], x[t] - half), x[t] + half)
    return y


def linear(rng: Generator, N: int) -> Drawn:
    u = drawn_input(rng, N, -1.0, 1.0)
    return u, linear_response(rng, u), {}


def backlash(rng: Generator, N: int) -> Drawn:
    """Return a rig with a play before it, or between it and its output."""
    u = drawn_input(rng, N, -1.0, 1.0)
    share = rng.uniform(0.1, 0.4)
    if rng.random() < 0.5:
        return u, linear_response(rng, play(u, share * float(np.std(u)))), {}
    x = linear_response(rng, u)
    return u, play(x, share * float(np.std(x))), {}


def saturating_coil(rng: Generator, N: int) -> Drawn:
    """Return the voltage of C in a series R, L, C, or the current of R, L: L falls with |i|."""
    u, series = drawn_input(rng, N, -1.0, 1.0), rng.random() < 0.5
    L, floor, knee = rng.uniform(4, 12), rng.uniform(0.1, 0.3), rng.uniform(0.2, 0.5)
    R, C = rng.uniform(0.5, 1.0) if series else 1.0, rng.uniform(1.0, 4.0)
    i, v, y, parts = 0.0, 0.0, np.empty(N), 10
    for t in range(N):
        y[t] = v if series else i
        for _ in range(parts):
            inductance = L * (floor + (1 - floor) / (1 + (i / knee) ** 4))
            i += (u[t] - R * i - v) / inductance / parts
            v += i / C / parts if series else 0.0
    return u, y, {}


def friction(rng: Generator, N: int) -> Drawn:
    """Return a speed that Coulomb friction brakes, and holds at rest."""
    u, limit, rate = drawn_input(rng, N, -1.0, 1.0), rng.uniform(0.1, 0.4), rng.uniform(0.1, 0.5)
    x = np.zeros(N)
    for t in range(1, N):
        v = x[t - 1]
        pull = u[t - 1] - v
        pull -= limit * np.sign(v) if v else np.clip(pull, -limit, limit)
        x[t] = v + rate * pull
        if x[t] * v < 0:
            x[t] = 0.0
    return u, x, {}


def dead_zone(rng: Generator, N: int) -> Drawn:
    """Return a rig with a zone about 0 of a drive of two signs, or from the least input on."""
    if rng.random() < 0.5:
        u, end = drawn_input(rng, N, -1.0, 1.0), rng.uniform(0.15, 0.5)
        acts, begin = np.sign(u) * np.maximum(np.abs(u) - end, 0), -end
    else:
        u, end = drawn_input(rng, N, 0.0, 1.0), rng.uniform(0.15, 0.5)
        acts, begin = np.maximum(u - end, 0), 0.0
    return u, linear_response(rng, acts), {"from": begin, "to": end}


def quadratic(rng: Generator, N: int) -> Drawn:
    """Return u + c u² after a linear rig, a speed in a drag of x², or the level of a tank."""
    which = rng.integers(3)
    if which == 0:
        u, c = drawn_input(rng, N, -1.0, 1.0), rng.choice([-1, 1]) * rng.uniform(0.1, 0.4)
        return u, linear_response(rng, u + c * u**2), {"u 0": 1.0, "u 1": 2 * c}
    u, rate = drawn_input(rng, N, 0.15, 1.0), rng.uniform(0.05, 0.2)
    x = np.empty(N)
    power = 2.0 if which == 1 else 0.5
    x[0] = u[0] ** (1 / power)
    for t in range(1, N):
        x[t] = x[t - 1] + rate * (u[t - 1] - max(x[t - 1], 0.0) ** power)
    return u, x, {"power": power}


def wiener(rng: Generator, N: int) -> Drawn:
    """Return a linear rig with a sensor that bends as a square, a root or an arc tangent."""
    which = rng.integers(3)
    u = drawn_input(rng, N, 0.1, 1.0)
    x = linear_response(rng, u)
    c = rng.uniform(0.3, 1.5)
    if which == 0:
        return u, x + c * x**2, {"sensor": 0.0, "c": c}
    if which == 1:
        return u, np.sqrt(np.maximum(x, 0) + 0.02), {"sensor": 1.0, "c": c}
    return u, np.arctan(2 * c * x), {"sensor": 2.0, "c": c}


RIGS: dict[str, Callable[[Generator, int], Drawn]] = {
    "linear": linear,
    "backlash": backlash,
    "saturating coil": saturating_coil,
    "friction": friction,
    "dead zone": dead_zone,
    "quadratic": quadratic,
    "Wiener": wiener,
}


def true_gain(truth: Truth, of: str, level: float) -> float:
    """Return the gain at a level of u or y; NaN if the rig has none by this signal."""
    if "u 0" in truth and of == "u":
        return truth["u 0"] + truth["u 1"] * level
    if "power" in truth:
        p = truth["power"]
        y = level if of == "y" else level ** (1 / p)
        return 1 / (p * y ** (p - 1))
    if "sensor" in truth:
        c, kind = truth["c"], truth["sensor"]
        if kind == 0:
            x = (np.sqrt(1 + 4 * c * level) - 1) / (2 * c) if of == "y" else level
            return float(1 + 2 * c * x)
        if kind == 1:
            return float(0.5 / (level if of == "y" else np.sqrt(level + 0.02)))
        x = np.tan(level) / (2 * c) if of == "y" else level
        return float(2 * c / (1 + (2 * c * x) ** 2))
    return float("nan")


def drawn_rig(name: str, seed: int, i: int) -> tuple[armrig.Dataset, Truth]:
    """Return the data and the truth of case i."""
    rng = np.random.default_rng((seed, i, [*RIGS].index(name)))
    N = int(rng.choice([600, 1000, 2000]))
    u, y, truth = RIGS[name](rng, N)
    noise = float(np.std(y)) * 10 ** rng.uniform(-2.7, -1.7)
    return armrig.Dataset(u=u, y=y + noise * rng.standard_normal(N), Ts=1.0), truth


def judged_rig(name: str, seed: int, i: int) -> tuple[str, str, list[str]]:
    """Return the verdict on the kind, the kind, and the numbers that are wrong."""
    data, truth = drawn_rig(name, seed, i)
    found = armrig.linearity(data)
    wrong = []
    kind, numbers = found.kind, found.numbers
    if kind == "gain by level" and name != "linear":
        for k in (1, 2):
            if f"gain_{k}" in numbers:
                at, gain = numbers[f"level_{k}"], numbers[f"gain_{k}"]
                true = true_gain(truth, found.gain_of, at)
                if not abs(gain / true - 1) < 0.35:
                    wrong.append(f"gain {gain:.3g} for {true:.3g} at {found.gain_of} = {at:.3g}")
    if kind == "dead zone" and name == kind:
        span = float(np.ptp(data.u))
        for end in ("from", "to"):
            if abs(numbers[end] - truth[end]) > 0.1 * span:
                wrong.append(f"{end} {numbers[end]:.3g} for {truth[end]:.3g}")
    if found.linear:
        return ("right" if name == "linear" else "not found"), kind, wrong
    verdict = "right" if kind == RIGHT[name] else "not known" if kind == "not known" else "wrong"
    return verdict, kind, wrong


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--only", default="")
    arguments = parser.parse_args()
    for name in RIGS:
        if arguments.only not in name:
            continue
        begun = time.process_time()
        cases = [judged_rig(name, arguments.seed, i) for i in range(arguments.count)]
        verdicts = Counter(verdict for verdict, _, _ in cases)
        others = Counter(kind for verdict, kind, _ in cases if verdict == "wrong")
        numbers = sum(bool(wrong) for _, _, wrong in cases)
        seconds = time.process_time() - begun
        print(
            f"{name:16s} {dict(verdicts)}; wrong kinds {dict(others)}; "
            f"wrong numbers {numbers}; {seconds:.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
