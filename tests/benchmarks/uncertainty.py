"""Coverage of the 95 % regions of poles, |G| and step response, by both methods.

The regions are those of the complex pole pair and of the real pole. The ranges are those of |G| at
three frequencies and of the step response at three times. The methods are linearisation, draws of
the parameters, and armrig's choice, with the share of runs in which it chose the draws.

Coverage of 0.95 has a standard deviation of 0.010 at 500 runs.

All are OE models of third order, input ±1 V, e white and normal; its size is relative to the
output's deviation for a white input. Poles 0.9 exp(±0.4 i) and 0.7, but for the second and third ::

    plain      zeros -0.4 ± 0.2 i, switching 0.2, noise 0.1, N = 1000
    near real  poles 0.85 ± 0.02 i and 0.5: the pair is hardly a pair; noise 0.1, N = 1000
    merging    the same with noise 0.3: the third pole merges with them, too
    cancelling zeros 0.74 and -0.4: one nearly cancels the real pole; noise 0.3, N = 1000
    starved    as plain, switching 0.01, noise 0.3: the input hardly moves, N = 1000

Run it with the project's environment::

    python -m tests.benchmarks.uncertainty [runs] [system]
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

import numpy as np
from armrig import Dataset, Fit, oe, telegraph
from armrig.models.parameter_draws import drawn, roots_of
from armrig.models.uncertainty import frequency_responses, step_responses
from armrig.numerics.confidence_regions import (
    Band,
    Region,
    band,
    linearised_band,
    linearised_region,
    regions,
    root_draws,
    sampled_band,
    sampled_region,
)
from armrig.numerics.polynomial import evaluate, filtered
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

OMEGA = np.array([0.05, 0.4, 1.5])
TIMES = np.array([3, 10, 40])
METHODS = ("linearised", "sampled", "chosen")


@dataclass(frozen=True, slots=True, kw_only=True)
class System:
    """A true system and its experiment."""

    name: str
    poles: tuple[complex, ...]
    zeros: tuple[complex, ...]
    switching: float
    noise: float
    N: int = 1000

    @property
    def B(self) -> NDArray[np.float64]:
        """Numerator of gain 1 at rest, two samples long."""
        B = np.real(np.poly(self.zeros))
        return np.append(0.0, B / B.sum() * self.F.sum())

    @property
    def F(self) -> NDArray[np.float64]:
        """Denominator."""
        return np.real(np.poly(self.poles))

    def dataset(self, seed: int) -> Dataset:
        """Return N samples from a state of long ago."""
        rng = np.random.default_rng([seed, self.N])
        u = telegraph(self.N + 200, self.switching, 1.5, 3.5, seed=rng) - 2.5
        y = filtered(self.B, self.F, u)
        e = self.noise * np.sqrt(self.power()) * rng.standard_normal(self.N + 200)
        return Dataset(u=u[200:], y=(y + e)[200:], Ts=1.0)

    def power(self) -> float:
        """Return the variance of the output for a white input of the same size."""
        pulse = np.zeros(1000)
        pulse[0] = 1.0
        return float(np.sum(filtered(self.B, self.F, pulse) ** 2))


PAIR = (0.9 * np.exp(0.4j), 0.9 * np.exp(-0.4j), 0.7)
SYSTEMS = (
    System(name="plain", poles=PAIR, zeros=(-0.4 + 0.2j, -0.4 - 0.2j), switching=0.2, noise=0.1),
    System(
        name="near real",
        poles=(0.85 + 0.02j, 0.85 - 0.02j, 0.5),
        zeros=(-0.4 + 0.2j, -0.4 - 0.2j),
        switching=0.2,
        noise=0.1,
    ),
    System(
        name="merging",
        poles=(0.85 + 0.02j, 0.85 - 0.02j, 0.5),
        zeros=(-0.4 + 0.2j, -0.4 - 0.2j),
        switching=0.2,
        noise=0.3,
    ),
    System(name="cancelling", poles=PAIR, zeros=(0.74, -0.4), switching=0.2, noise=0.3),
    System(name="starved", poles=PAIR, zeros=(-0.4 + 0.2j, -0.4 - 0.2j), switching=0.01, noise=0.3),
)


def main() -> None:
    """Print the tables."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    wanted = sys.argv[2] if len(sys.argv) > 2 else None
    head = " ".join(f"{t:>7}" for t in ("pair", "real", *(f"G{w:g}" for w in OMEGA)))
    head += " " + " ".join(f"{f's{k}':>7}" for k in TIMES)
    for system in SYSTEMS:
        if wanted not in (None, system.name):
            continue
        begun = time.perf_counter()
        held, sampled, left_out = zip(*(one(system, seed) for seed in range(runs)), strict=True)
        print(
            f"{system.name}, {runs} runs, {time.perf_counter() - begun:.0f} s; left out of draws "
            f"{100 * np.mean(left_out):.1f} % (mean), {100 * np.max(left_out):.0f} % (most)"
        )
        print(f"  {'':12}{head}")
        for name, row in zip(METHODS, np.mean(held, axis=0), strict=True):
            print(f"  {name:12}" + " ".join(f"{x:7.3f}" for x in row))
        print(
            f"  {'by draws':12}" + " ".join(f"{x:7.3f}" for x in np.mean(sampled, axis=0)),
            flush=True,
        )


def one(system: System, seed: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_], float]:
    """Return which method holds which truth, what was by draws, and the share left out."""
    fit = oe(system.dataset(seed), nb=3, nf=3)
    draws = drawn(fit)
    assert draws is not None
    longest = int(TIMES[-1]) + 1
    answer, steps = fit.frequency_response(OMEGA), fit.step_response(longest)
    x = np.exp(-1j * OMEGA)
    G = evaluate(system.B, x) / evaluate(system.F, x)
    true_steps = filtered(system.B, system.F, np.ones(longest))[TIMES]
    cases = (
        (
            np.abs(answer.G),
            answer.std_magnitude,
            np.abs(frequency_responses(fit, draws.theta, OMEGA)),
            np.abs(G),
            0.0,
        ),
        (
            steps.y[TIMES],
            steps.std[TIMES],
            step_responses(fit, draws.theta, longest)[:, TIMES],
            true_steps,
            -np.inf,
        ),
    )
    held: list[list[bool]] = []
    by_draws: list[bool] = []
    for way in METHODS:
        found = _poles(fit, draws.theta, system, way)[1:]  # one of the pair, and the real one
        rows = [r.contains(complex(z)) for r, z in zip(found, system.poles[1:], strict=True)]
        by_draws = [r.method == "sampled" for r in found]
        for value, std, samples, truth, least in cases:
            edges = _band(way, value, std, samples, least)
            rows += edges.contains(truth).tolist()
            by_draws += [edges.method == "sampled"] * len(TIMES)
        held.append(rows)
    return np.array(held), np.array(by_draws), 1 - draws.theta.shape[0] / draws.asked


def _band(
    way: str,
    value: NDArray[np.float64],
    std: NDArray[np.float64],
    samples: NDArray[np.float64],
    least: float,
) -> Band:
    if way == "linearised":
        return linearised_band(value, std, least=least)
    return sampled_band(samples) if way == "sampled" else band(value, std, samples, least=least)


def _poles(fit: Fit, theta: NDArray[np.float64], system: System, way: str) -> list[Region]:
    """Return the regions of the poles, each that of the nearest true one."""
    poles = fit.poles()
    samples = roots_of(fit, theta, "f")
    if way == "chosen":
        found = regions(poles.values, poles.covariance, samples)
    elif way == "sampled":
        found = [
            sampled_region(complex(z), P, of_root)
            for z, P, of_root in zip(
                poles.values, poles.covariance, root_draws(poles.values, samples), strict=True
            )
        ]
    else:
        found = [
            linearised_region(complex(z), P)
            for z, P in zip(poles.values, poles.covariance, strict=True)
        ]
    truth = np.array(system.poles)
    of, at = linear_sum_assignment(np.abs(truth[:, None] - poles.values[None, :]))
    return [found[at[np.flatnonzero(of == i)[0]]] for i in range(truth.size)]


if __name__ == "__main__":
    main()
