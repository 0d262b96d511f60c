"""Standard deviations predicted before an experiment against their scatter in Monte Carlo.

Each case plays one fixed input RUNS times with fresh noise, estimates, and prints predicted /
scatter for every parameter. The scatter of n runs is itself uncertain by 1/sqrt(2 n): 3.5 % for
400. Usage: python -m tests.benchmarks.experiment_design [RUNS]
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import NamedTuple

import armrig
import numpy as np
from armrig.data.dataset import Dataset
from armrig.excitation.experiment_design import PredictedStd
from armrig.models.fit import Fit
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import filtered
from armrig_core.arm import arm_matrices, chassis_matrices, zero_order_hold
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import ss2tf

Vector = NDArray[np.float64]
A, B = np.array([1, -1.2, 0.6]), np.array([0, 1, 0.5])


class Case(NamedTuple):
    """A prediction, and the estimate of one run."""

    name: str
    predicted: PredictedStd
    run: Callable[[np.random.Generator], Vector]


def output_error(N: int) -> Case:
    """Return B/F u + e with white e."""
    u, std = armrig.telegraph(N, 0.3), 0.3
    model = armrig.PlannedModel(B=B, F=A, noise_variance=std**2, Ts=1.0)

    def run(rng: np.random.Generator) -> Vector:
        noisy = filtered(B, A, u) + std * rng.standard_normal(N)
        return armrig.oe(Dataset(u=u, y=noisy, Ts=1), nb=2, nf=2).theta

    return Case(f"OE, N {N}", armrig.predicted_std(model, u), run)


def equation_error(N: int) -> Case:
    """Return A y = B u + e with white e, which adds information."""
    u, std = armrig.telegraph(N, 0.3), 1.0
    model = armrig.PlannedModel(A=A, B=B, noise_variance=std**2, Ts=1.0)

    def run(rng: np.random.Generator) -> Vector:
        noisy = filtered(B, A, u) + filtered([1], A, std * rng.standard_normal(N))
        return armrig.arx(Dataset(u=u, y=noisy, Ts=1), na=2, nb=2).theta

    return Case(f"ARX, N {N}", armrig.predicted_std(model, u), run)


def arm_with_gaps(N: int) -> Case:
    """Return the handout's arm, u to theta_1, 5 mrad noise, 10 ms, a sample in ten missing."""
    matrices = arm_matrices(armrig.ArmParameters())
    Phi, Gamma = zero_order_hold(*matrices[:2], 0.01)
    numerator, F = ss2tf(Phi, Gamma, matrices[2][:1], np.zeros((1, 1)))
    numerator = np.append(0.0, numerator[0][1:])
    F[-1] -= F.sum()  # the root at 1, exactly
    u, std = armrig.telegraph(N, 0.05, 0.0, 5.0), 5e-3
    valid = np.arange(N) % 70 >= 7
    model = armrig.PlannedModel(B=numerator, F=F, noise_variance=std**2, Ts=0.01, integrator=True)
    gaps = Dataset(u=u, y=np.zeros(N), Ts=0.01, valid=valid)

    def run(rng: np.random.Generator) -> Vector:
        y = filtered(numerator, F, u) + std * rng.standard_normal(N)
        data = Dataset(u=u, y=y, Ts=0.01, valid=valid)
        fit: Fit = armrig.oe(data, nb=4, nf=4, integrator=True)
        return fit.theta

    return Case(f"arm, OE with integrator and gaps, N {N}", armrig.predicted_std(model, gaps), run)


def inertia(N: int) -> Case:
    """Return J_1 of the chassis, its initial state and the input's offset estimated along."""
    p, Ts, std = armrig.ArmParameters(), 0.01, 5e-3
    u = armrig.telegraph(N, 0.05)

    def response(J_1: float, x: Vector) -> Vector:
        A, B, C = chassis_matrices(armrig.ArmParameters(J_1=J_1))
        b, f = ss2tf(*zero_order_hold(A, B, Ts), C, np.zeros((1, 1)))
        return filtered(b[0], f, x)

    def errors(J_1: float, y: Vector) -> Vector:
        pole = np.exp(-armrig.ArmParameters(J_1=J_1).damping / J_1 * Ts)
        states = (np.ones(N), pole ** np.arange(N), response(J_1, np.ones(N)))
        return orthonormal(np.column_stack(states)).without(y - response(J_1, u))

    def run(rng: np.random.Generator) -> Vector:
        y = response(p.J_1, u) + std * rng.standard_normal(N)
        answer = least_squares(lambda x: errors(np.exp(x[0]), y), [np.log(p.J_1 * 1.1)])
        return np.exp(answer.x)

    predicted = armrig.predicted_parameter_std(
        armrig.chassis, u, Ts=Ts, noise_variance=std**2, free=("J_1",)
    )
    return Case(f"chassis, J_1, N {N}", predicted, run)


def cases() -> Iterator[Case]:
    """Yield the cases."""
    yield output_error(500)
    yield equation_error(500)
    yield arm_with_gaps(3000)
    yield inertia(3000)


def main(runs: int) -> int:
    """Print predicted over scatter; return 1 if one is beyond 15 %."""
    worst = 0.0
    for number, case in enumerate(cases()):
        seeds = np.random.default_rng(number).spawn(runs)
        theta = np.array([case.run(rng) for rng in seeds])
        ratio = case.predicted.std / theta.std(axis=0, ddof=1)
        worst = max(worst, float(np.abs(ratio - 1).max()))
        told = "  ".join(f"{n} {r:.3f}" for n, r in zip(case.predicted.names, ratio, strict=True))
        print(f"{case.name}, {runs} runs, predicted / scatter: {told}")
    print(f"worst: {100 * worst:.1f} % off (15 % allowed)")
    return int(worst > 0.15)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 400))
