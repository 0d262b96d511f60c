"""Coverage and deviations of models with several inputs and outputs, in many simulated runs.

The quantities are the coefficients (not of `ss` and `n4sid`), the real and imaginary parts of the
poles, and those of G of each channel at five frequencies. The benchmark prints the least, the mean
and the greatest coverage of 95 % intervals and ratio of reported deviation to scatter. The bias is
in deviations of the mean. The cases are ::

    arx     two outputs that affect each other, two inputs
    bj      one output, two inputs, noise C/D
    shared  a drawn chassis with an integrator and an arm: one input, two outputs, one denominator
    arm     the handout's arm with drawn inertias and stiffness, 5 mrad of noise on both angles
    ss      two inputs, two outputs, order 3
    n4sid   the plants of ss

The seed draws each plant. Run it with the project's environment::

    python -m tests.benchmarks.several_signals [--case ss] [--seed 1] [--runs 1000] [--N 500]
        [--missing 0.2]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import armrig
import control
import numpy as np
from armrig import Fit
from armrig.models.uncertainty import frequency_responses
from armrig.numerics.polynomial import apply_filter
from armrig.numerics.recursion import recursion
from scipy.optimize import linear_sum_assignment
from scipy.signal import ss2tf

from tests.plants import (
    ARM_TS,
    FREQUENCIES,
    NOISE_COVARIANCE,
    NOISE_SHARE,
    THETA_1_STD,
    Array,
    Draw,
    MultivariablePlant,
    chassis_and_arm,
    drawn_arm,
    drawn_poles,
    response,
    telegraphs,
    with_one_denominator,
)

Simulated = tuple[Array, Array, dict[str, Any]]


def true_quantities(plant: MultivariablePlant) -> Array:
    """Return the true values of all quantities."""
    upper = plant.poles[plant.poles.imag >= 0]
    G = plant.G.transpose(1, 2, 0).ravel()
    return np.concatenate([plant.theta, upper.real, upper.imag, G.real, G.imag])


def quantities(plant: MultivariablePlant, fit: Fit) -> tuple[Array, Array]:
    """Return the estimates of all quantities, and their deviations."""
    found = fit.poles()
    upper = np.flatnonzero(plant.poles.imag >= 0)
    cost = np.abs(plant.poles[upper][:, None] - found.values[None])
    _, at = linear_sum_assignment(cost)
    std = np.sqrt(np.maximum(np.diagonal(found.covariance, axis1=1, axis2=2), 0.0))
    answers = [_parts_of_response(channel) for _, _, channel in fit.channels()]
    G, G_std = (np.concatenate(x, axis=1) for x in zip(*answers, strict=True))
    theta, theta_std = (fit.theta, fit.std) if plant.theta.size else (np.zeros(0),) * 2
    values = [theta, found.values[at].real, found.values[at].imag, G.ravel()]
    return np.concatenate(values), np.concatenate(
        [theta_std, std[at, 0], std[at, 1], G_std.ravel()]
    )


def _parts_of_response(channel: Fit) -> tuple[Array, Array]:
    """Return Re G and Im G (2, 5) of one channel at the frequencies, and their deviations."""
    theta = channel.theta
    steps = 1e-6 * np.maximum(np.abs(theta), 1e-3)
    moved = np.vstack([theta + np.diag(steps), theta - np.diag(steps)])
    G = frequency_responses(channel, moved, FREQUENCIES)
    J = (G[: theta.size] - G[theta.size :]) / (2 * steps[:, None])
    own = channel.frequency_response(FREQUENCIES).G
    deviations = [
        np.sqrt(np.maximum(np.einsum("ik,ij,jk->k", part, channel.covariance_robust, part), 0.0))
        for part in (J.real, J.imag)
    ]
    return np.array([own.real, own.imag]), np.array(deviations)


def _arx(seed: int) -> MultivariablePlant:
    rng = np.random.default_rng([seed, 0])
    while True:
        A1, A2 = 0.4 * rng.standard_normal((2, 2, 2)) + [[[-0.9, 0], [0, -0.6]], [[0.2, 0], [0, 0]]]
        A2[[0, 1], [1, 0]] = 0.0
        F = np.block([[-A1, -A2], [np.eye(2), np.zeros((2, 2))]])
        if 0.5 < np.max(np.abs(np.linalg.eigvals(F))) < 0.9:
            break
    B1, B2 = rng.standard_normal((2, 2, 2))
    L = np.linalg.cholesky(NOISE_COVARIANCE) * 0.5

    def simulate(rng: Draw, N: int) -> Simulated:
        u = telegraphs(rng, N, 2)
        late = np.vstack([np.zeros((1, 2)), u[:-1]])
        w = u @ B1.T + late @ B2.T
        e = rng.standard_normal((N, 2)) @ L.T
        # y(t) = -A1 y(t-1) - A2 y(t-2) + w(t-1) + e(t)
        driven = np.vstack([np.zeros((1, 2)), w[:-1]]) + e
        return u, recursion(F, np.hstack([driven, np.zeros((N, 2))]), np.zeros(4))[1:, :2], {}

    theta = [A1[0, 0], A2[0, 0], A1[0, 1], B1[0, 0], B2[0, 0], B1[0, 1], B2[0, 1]]
    theta += [A1[1, 0], A1[1, 1], A2[1, 1], B1[1, 0], B2[1, 0], B1[1, 1], B2[1, 1]]
    x = np.exp(-1j * FREQUENCIES)[:, None, None]
    na: Any = [[2, 1], [1, 2]]
    return MultivariablePlant(
        simulate=simulate,
        fit=lambda s: armrig.arx(s, na=na, nb=2),
        theta=np.array(theta),
        poles=np.linalg.eigvals(F),  # A2 has rank 2 on the diagonal: there are four poles.
        G=np.linalg.solve(np.eye(2) + A1 * x + A2 * x**2, B1 * x + B2 * x**2),
    )


def _bj(seed: int) -> MultivariablePlant:
    rng = np.random.default_rng([seed, 1])
    z = [drawn_poles(rng, 2), drawn_poles(rng, 1)]
    F = [np.real(np.poly(p)) for p in z]
    B = [np.append(0.0, rng.standard_normal(2)), np.append([0.0, 0.0], rng.standard_normal(1))]
    while True:
        c, d = rng.uniform(-0.7, 0.7), -rng.uniform(0.3, 0.9)
        if abs(c - d) > 0.4:  # C and D that nearly cancel are not determined
            break

    def simulate(rng: Draw, N: int) -> Simulated:
        u = telegraphs(rng, N, 2)
        y = sum(apply_filter(b, f, x) for b, f, x in zip(B, F, u.T, strict=True))
        e = apply_filter([1, c], [1, d], rng.standard_normal(N))
        return u, (y + np.sqrt(NOISE_SHARE) * np.std(y) * e / np.std(e))[:, None], {}

    orders: Any = {"nb": [[2, 1]], "nf": [[2, 1]], "nk": [[1, 2]], "nc": 1, "nd": 1}
    return MultivariablePlant(
        simulate=simulate,
        fit=lambda s: armrig.bj(s, **orders),
        theta=np.concatenate([B[0][1:], B[1][2:], [c], [d], F[0][1:], F[1][1:]]),
        poles=np.concatenate(z),
        G=np.stack([response(b, f) for b, f in zip(B, F, strict=True)], axis=1)[:, None],
    )


def _arm(seed: int) -> MultivariablePlant:
    system = armrig.physics.arm(drawn_arm(np.random.default_rng([seed, 4])))[
        ["theta_1", "alpha"], :
    ]
    sampled = control.c2d(system, ARM_TS)
    numerators, whole = ss2tf(sampled.A, sampled.B, sampled.C, sampled.D)
    # The integrator divides the denominator, and the numerator of alpha.
    F = np.cumsum(whole)[:-1]
    B = [np.append(0.0, numerators[0][1:]), np.append(0.0, np.cumsum(numerators[1])[1:-1])]

    def simulate(rng: Draw, N: int) -> Simulated:
        u = armrig.telegraph(N, 0.05, 0.0, 5.0, seed=rng)
        _, y = control.forced_response(sampled, inputs=u)
        y = y.T + THETA_1_STD * rng.standard_normal((N, 2))
        return u[:, None], y, {"outputs": ["theta_1", "alpha"]}

    return with_one_denominator(simulate, B, F, "theta_1")


def _ss(seed: int, estimate: Any = lambda s: armrig.ss(s, order=3)) -> MultivariablePlant:
    rng = np.random.default_rng([seed, 3])
    z = drawn_poles(rng, 3)
    A = np.zeros((3, 3))
    A[:2, :2] = [[z[0].real, z[0].imag], [-z[0].imag, z[0].real]]
    A[2, 2] = z[2].real
    B, C = rng.standard_normal((2, 3, 2))
    C = C.T
    while True:
        K = 0.4 * rng.standard_normal((3, 2))
        if np.max(np.abs(np.linalg.eigvals(A - K @ C))) < 0.9:
            break
    clean = recursion(A, telegraphs(rng, 4000, 2) @ B.T, np.zeros(3)) @ C.T
    L = np.linalg.cholesky(NOISE_COVARIANCE) * np.sqrt(NOISE_SHARE) * np.std(clean, axis=0).mean()

    def simulate(rng: Draw, N: int) -> Simulated:
        u = telegraphs(rng, N, 2)
        e = rng.standard_normal((N, 2)) @ L.T
        return u, recursion(A, u @ B.T + e @ K.T, np.zeros(3))[:-1] @ C.T + e, {}

    points = np.exp(1j * FREQUENCIES)[:, None, None]
    G = C @ np.linalg.solve(points * np.eye(3) - A, np.broadcast_to(B, (5, 3, 2)).astype(complex))
    return MultivariablePlant(simulate=simulate, fit=estimate, theta=np.zeros(0), poles=z, G=G)


CASES: dict[str, Callable[[int], MultivariablePlant]] = {
    "arx": _arx,
    "bj": _bj,
    "shared": chassis_and_arm,
    "arm": _arm,
    "ss": _ss,
    "n4sid": lambda seed: _ss(seed, lambda s: armrig.n4sid(s, 3)),
}


def study(case: str, seed: int, runs: int, N: int, missing: float) -> None:
    """Print coverage, ratio and bias of one case."""
    plant = CASES[case](seed)
    found = []
    for run in range(runs):
        try:
            fit = plant.fit(plant.signals(N, missing, (seed, N, run)))
            if fit.search.converged:
                found.append(quantities(plant, fit))
        except (ValueError, np.linalg.LinAlgError) as err:
            print(f"{case}, run {run}: {err}", flush=True)
    values, stds = (np.array(x) for x in zip(*found, strict=True))
    used = np.ptp(values, axis=0) > 0  # the imaginary part of a real pole is 0
    values, stds, truth = values[:, used], stds[:, used], true_quantities(plant)[used]
    scatter = np.std(values, axis=0, ddof=1)
    covered = 100 * np.sum(np.abs(values - truth) <= 1.96 * stds, axis=0) / runs
    ratio = np.sqrt(np.mean(stds**2, axis=0)) / scatter
    bias = np.abs(values.mean(axis=0) - truth) / scatter * len(found) ** 0.5
    print(
        f"{case:7} {len(found):5} of {runs:5}   {covered.min():.1f} {covered.mean():.1f} "
        f"{covered.max():.1f}   {ratio.min():.3f} {ratio.mean():.3f} {ratio.max():.3f}   "
        f"{bias.max():.1f}",
        flush=True,
    )


def main() -> None:
    """Print a line for each case."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--case", choices=list(CASES), nargs="+", default=list(CASES))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--N", type=int, default=500)
    parser.add_argument("--missing", type=float, default=0.0)
    given = parser.parse_args()
    print("case    converged runs   coverage in %      std / scatter        bias")
    for case in given.case:
        study(case, given.seed, given.runs, given.N, given.missing)


if __name__ == "__main__":
    main()
