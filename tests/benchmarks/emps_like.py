"""Monte Carlo of the grey box with all frictions, as on the EMPS benchmark.

The chassis alone is driven both ways, with Coulomb and viscous friction and an offset of the input.
A record has 24 s at 1 kHz, voltages held for 20 to 300 ms, and white noise on the angle. Between
stops and reversals the simulation is exact, and their instants are exact, too. The simulation
shares nothing with the fitted model. `python -m tests.benchmarks.emps_like [runs]`, 100 by default.

References
----------
.. [1] A. Janot, M. Gautier, M. Brunot, Data set and reference models of EMPS, Nonlinear System
   Identification Benchmarks, Eindhoven, 2019.
"""

from __future__ import annotations

import sys
from math import copysign, exp, log
from time import perf_counter

import armrig
import numpy as np
from armrig.physics.systems import ArmParameters
from numpy.typing import NDArray

Vector = NDArray[np.float64]
N, Ts = 24_000, 1e-3
TRUTH = ArmParameters(b_1=5e-3)
COULOMB_NM, OFFSET_V = 0.02, 0.15
NAMES = {"J_1": TRUTH.J_1, "b_1": TRUTH.b_1, "T_c": COULOMB_NM}


def turned(u: Vector, p: ArmParameters, coulomb_nm: float, Ts: float) -> Vector:
    """Return theta_1 (N,) from rest for u held over Ts, exactly, stops and reversals included."""
    rate = p.damping / p.J_1
    x = v = 0.0
    y = np.empty(u.size)
    for k, volts in enumerate(u.tolist()):
        y[k] = x
        torque, left = p.torque_per_volt * volts, Ts
        while left > 0.0 and not (v == 0.0 and abs(torque) <= coulomb_nm):
            s = copysign(1.0, v or torque)
            last = (torque - s * coulomb_nm) / p.damping
            stops = log((v - last) / -last) / rate if s * last < 0 else left
            t = min(stops, left)
            x += last * t + (v - last) / rate * (1 - exp(-rate * t))
            v = 0.0 if stops < left else last + (v - last) * exp(-rate * t)
            left -= t
    return y


def driven(rng: np.random.Generator) -> Vector:
    """Return voltages of both signs, each held for 20 to 300 ms."""
    u = np.empty(0)
    while u.size < N:
        u = np.append(u, np.full(rng.integers(20, 300), rng.uniform(-2.5, 2.5)))
    return u[:N]


def recorded(seed: int, noise: float) -> armrig.Dataset:
    """Return one experiment; input and noise are the seed's."""
    rng = np.random.default_rng([seed, 9])
    u = driven(rng)
    y = turned(u - OFFSET_V, TRUTH, COULOMB_NM, Ts) + noise * rng.standard_normal(N)
    return armrig.Dataset(u=u, y=y, Ts=Ts, output="theta_1", unit="rad")


def study(runs: int, noise: float) -> None:
    """Print how often each parameter, and all of them, are within 3 reported deviations."""
    z, relative, offsets, seconds, warned = [], [], [], [], 0
    for seed in range(runs):
        data = recorded(seed, noise)
        begin = perf_counter()
        fit = armrig.greybox(data, friction="both")
        seconds.append(perf_counter() - begin)
        z.append([(fit.values[n] - truth) / fit.std[n] for n, truth in NAMES.items()])
        relative.append([fit.std[n] / truth for n, truth in NAMES.items()])
        offsets.append(fit.offset[0])
        warned += bool(fit.warnings)
    errors = np.array(z)
    inside = np.abs(errors) <= 3
    print(f"noise {1e3 * noise:g} mrad, n {runs}: all three within 3 sd {inside.all(axis=1).sum()}")
    for i, name in enumerate(NAMES):
        e = errors[:, i]
        print(
            f"  {name}: within 3 sd {inside[:, i].sum()}, mean {e.mean():+.2f} sd, sd ratio "
            f"{e.std(ddof=1):.2f}, 95 % interval covers {np.mean(np.abs(e) < 1.96):.2f}, sd "
            f"{100 * np.mean(relative, axis=0)[i]:.3f} %"
        )
    print(
        f"  u0 {np.mean(offsets):.5f} ± {np.std(offsets, ddof=1):.5f} V (truth {OFFSET_V}), "
        f"warned {warned}, {np.median(seconds):.2f} s a fit",
        flush=True,
    )


def main() -> None:
    """Print it for a potentiometer's noise and for less."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    for noise in (3e-3, 1e-3, 1e-4):
        study(runs, noise)


if __name__ == "__main__":
    main()
