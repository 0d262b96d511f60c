"""Coverage of the grey box from both outputs, and its gain against one output.

Each run simulates the arm at drawn parameters with a telegraph, and estimates J_1, J_2 and K_lin
from theta_1 and alpha together and from each alone. The summary gives, for each parameter, the
coverage of 95 % intervals, the reported deviation divided by the scatter of the estimates, and
the scatter relative to that of theta_1 alone. Run it with the project's environment::

    python -m tests.benchmarks.several_greybox [--runs 200] [--N 1000] [--seed 1] [--alpha-std 5e-3]
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

import armrig
import control
import numpy as np
from armrig import ArmParameters, Signals

NAMES = ("J_1", "J_2", "K_lin")
TS = 0.01
STD = 5e-3  # of theta_1, in rad


def drawn_parameters(rng: np.random.Generator) -> ArmParameters:
    """Return the handout's arm with drawn inertias and stiffness."""
    p = ArmParameters()
    return replace(p, **{name: getattr(p, name) * rng.uniform(0.7, 1.4) for name in NAMES})


def simulated(rng: np.random.Generator, N: int, alpha_std: float) -> tuple[ArmParameters, Signals]:
    """Return drawn parameters, and signals of the arm with them."""
    p = drawn_parameters(rng)
    system = armrig.arm(p)
    u = armrig.telegraph(N, 0.05, 0.0, 5.0, seed=rng)
    sampled = control.c2d(system[["theta_1", "alpha"], :], TS)
    _, y = control.forced_response(sampled, inputs=u)
    y = y.T + rng.standard_normal((N, 2)) * [STD, alpha_std]
    return p, Signals(
        u=u[:, None], y=y, Ts=TS, inputs=["u"], outputs=["theta_1", "alpha"], units=["rad", "rad"]
    )


def main() -> None:
    """Run the study, and print its summary."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--N", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--alpha-std", type=float, default=STD)
    given = parser.parse_args()
    errors: dict[str, list[Any]] = {"both": [], "theta_1": [], "alpha": []}
    stds: dict[str, list[Any]] = {name: [] for name in errors}
    for run in range(given.runs):
        rng = np.random.default_rng([given.seed, run])
        p, signals = simulated(rng, given.N, given.alpha_std)
        truth = np.array([getattr(p, name) for name in NAMES])
        for what in errors:
            if what == "both":
                data: Any = signals
                fit = armrig.greybox(data, armrig.arm, NAMES)
            else:
                fit = armrig.greybox(signals.dataset(what, "u"), armrig.arm, NAMES, output=what)
            errors[what].append([fit.values[name] for name in NAMES] / truth - 1)
            stds[what].append([fit.std[name] for name in NAMES] / truth)
    reference = np.std(errors["theta_1"], axis=0)
    for what, found in errors.items():
        e, std = np.array(found), np.array(stds[what])
        covered = 100 * np.mean(np.abs(e) < 1.96 * std, axis=0)
        ratio = np.sqrt(np.mean(std**2, axis=0)) / np.sqrt(np.mean(e**2, axis=0))
        gain = np.std(e, axis=0) / reference
        for k, name in enumerate(NAMES):
            print(
                f"{what:8} {name:6} covered {covered[k]:5.1f} %  ratio {ratio[k]:.3f}  "
                f"scatter {gain[k]:.3f} of theta_1's"
            )


if __name__ == "__main__":
    main()
