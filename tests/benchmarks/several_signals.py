"""Coverage and deviations of models with several inputs and outputs, in many simulated runs.

The quantities are the coefficients (not of `ss` and `n4sid`), the real and imaginary parts of the
poles, and those of G of each channel at five frequencies. For each of them the summary gives the
coverage of 95 % intervals, the reported deviation divided by the scatter of the estimates, and the
bias in deviations of the mean. The cases are ::

    arx     two outputs that affect each other, two inputs
    bj      one output, two inputs, noise C/D
    shared  a drawn chassis with an integrator and an arm: one input, two outputs, one denominator
    arm     the handout's arm with drawn inertias and stiffness, 5 mrad of noise on both angles
    ss      two inputs, two outputs, order 3
    n4sid   the plants of ss

Each plant is drawn by the seed. Runs are appended to the file, so that a study can be resumed. Run
it with the project's environment::

    python -m tests.benchmarks.several_signals FILE [--case ss] [--seed 1] [--runs 1000] [--N 500]
        [--missing 0.2]
    python -m tests.benchmarks.several_signals FILE --summary
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import armrig
import control
import numpy as np
from armrig import Fit, MultivariableFit, Signals
from armrig.models.uncertainty import frequency_responses
from armrig.numerics.polynomial import filtered
from armrig.numerics.recursion import recursion
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.signal import ss2tf

from tests.benchmarks.several_greybox import STD, TS, drawn_parameters

Array = NDArray[Any]
_FREQUENCIES = np.array([0.05, 0.2, 0.6, 1.5, 2.8])  # rad per sample
_SETTLING = 200  # samples before the data
_LAMBDA = np.array([[1.0, 0.5], [0.5, 1.0]])
_SNR = 0.1  # noise variance relative to the output's


class Plant:
    """A drawn plant: the truth, its data, and its estimate."""

    def __init__(self, case: str, seed: int) -> None:
        rng = np.random.default_rng([seed, _DRAWS[case]])
        self.case = case
        self.make, self.fit, self.theta, self.poles, self.G = _CASES[case](rng)

    def signals(self, N: int, missing: float, run: tuple[int, ...]) -> Signals:
        """Return the data of one run."""
        rng = np.random.default_rng(run)
        u, y, names = self.make(rng, N + _SETTLING)
        y = y[_SETTLING:]
        valid = rng.random(y.shape) >= missing
        return Signals(u=u[_SETTLING:], y=y, Ts=1.0, valid=valid, **names)

    @property
    def truth(self) -> Array:
        """The quantities of the plant."""
        upper = self.poles[self.poles.imag >= 0]
        G = self.G.transpose(1, 2, 0).ravel()
        return np.concatenate([self.theta, upper.real, upper.imag, G.real, G.imag])

    def quantities(self, fit: MultivariableFit) -> tuple[Array, Array]:
        """Return the estimated quantities and their deviations."""
        found = fit.poles()
        upper = np.flatnonzero(self.poles.imag >= 0)
        cost = np.abs(self.poles[upper][:, None] - found.values[None])
        _, at = linear_sum_assignment(cost)
        std = np.sqrt(np.maximum(np.diagonal(found.covariance, axis1=1, axis2=2), 0.0))
        answers = [_parts_of_response(channel) for _, _, channel in fit.channels()]
        G, G_std = (np.concatenate(x, axis=1) for x in zip(*answers, strict=True))
        theta = fit.theta if self.theta.size else np.zeros(0)
        theta_std = fit.std if self.theta.size else np.zeros(0)
        values = [theta, found.values[at].real, found.values[at].imag, G.ravel()]
        stds = [theta_std, std[at, 0], std[at, 1], G_std.ravel()]
        return np.concatenate(values), np.concatenate(stds)


def _parts_of_response(channel: Fit) -> tuple[Array, Array]:
    """Return Re G and Im G (2, 5) of one channel at the frequencies, and their deviations."""
    theta = channel.theta
    steps = 1e-6 * np.maximum(np.abs(theta), 1e-3)
    moved = np.vstack([theta + np.diag(steps), theta - np.diag(steps)])
    G = frequency_responses(channel, moved, _FREQUENCIES)
    J = (G[: theta.size] - G[theta.size :]) / (2 * steps[:, None])
    own = channel.frequency_response(_FREQUENCIES).G
    deviations = [
        np.sqrt(np.maximum(np.einsum("ik,ij,jk->k", part, channel.covariance_robust, part), 0.0))
        for part in (J.real, J.imag)
    ]
    return np.array([own.real, own.imag]), np.array(deviations)


Made = tuple[
    Callable[[np.random.Generator, int], tuple[Array, Array, dict[str, Any]]],
    Callable[[Signals], MultivariableFit],
    Array,
    Array,
    Array,
]


def _telegraph(rng: np.random.Generator, N: int, nu: int) -> Array:
    """Return inputs of ±1 that change with probability 0.3."""
    return np.where(np.cumsum(rng.random((N, nu)) < 0.3, axis=0) % 2, 1.0, -1.0)


def _drawn_poles(rng: np.random.Generator, n: int) -> Array:
    """Return n poles: pairs, and one real pole if n is odd."""
    z: list[complex] = []
    while len(z) + 1 < n:
        pole = rng.uniform(0.6, 0.92) * np.exp(1j * rng.uniform(0.2, 1.8))
        z += [pole, np.conj(pole)]
    return np.array([*z, *([rng.uniform(0.2, 0.85)] if len(z) < n else [])])


def _polynomial(z: Array) -> Array:
    return np.real(np.poly(z))


def _response(B: Array, F: Array) -> Array:
    x = np.exp(-1j * _FREQUENCIES)
    return np.asarray(np.polyval(B[::-1], x) / np.polyval(F[::-1], x))


def _arx(rng: np.random.Generator) -> Made:
    while True:
        A1, A2 = 0.4 * rng.standard_normal((2, 2, 2)) + [[[-0.9, 0], [0, -0.6]], [[0.2, 0], [0, 0]]]
        A2[[0, 1], [1, 0]] = 0.0
        F = np.block([[-A1, -A2], [np.eye(2), np.zeros((2, 2))]])
        if 0.5 < np.max(np.abs(np.linalg.eigvals(F))) < 0.9:
            break
    B1, B2 = rng.standard_normal((2, 2, 2))
    L = np.linalg.cholesky(_LAMBDA) * 0.5

    def make(rng: np.random.Generator, N: int) -> tuple[Array, Array, dict[str, Any]]:
        u = _telegraph(rng, N, 2)
        late = np.vstack([np.zeros((1, 2)), u[:-1]])
        w = u @ B1.T + late @ B2.T
        e = rng.standard_normal((N, 2)) @ L.T
        # y(t) = -A1 y(t-1) - A2 y(t-2) + w(t-1) + e(t)
        driven = np.vstack([np.zeros((1, 2)), w[:-1]]) + e
        x = recursion(F, np.hstack([driven, np.zeros((N, 2))]), np.zeros(4))[1:, :2]
        return u, x, {}

    theta = [A1[0, 0], A2[0, 0], A1[0, 1], B1[0, 0], B2[0, 0], B1[0, 1], B2[0, 1]]
    theta += [A1[1, 0], A1[1, 1], A2[1, 1], B1[1, 0], B2[1, 0], B1[1, 1], B2[1, 1]]
    x = np.exp(-1j * _FREQUENCIES)[:, None, None]
    G = np.linalg.solve(np.eye(2) + A1 * x + A2 * x**2, B1 * x + B2 * x**2)
    poles = np.linalg.eigvals(F)
    # A2 has rank 2 on the diagonal, so that there are four poles.
    return (
        make,
        lambda s: armrig.arx(s, na=[[2, 1], [1, 2]], nb=2),  # type: ignore[arg-type, return-value]
        np.array(theta),
        poles,
        G,
    )


def _bj(rng: np.random.Generator) -> Made:
    z = [_drawn_poles(rng, 2), _drawn_poles(rng, 1)]
    F = [_polynomial(p) for p in z]
    B = [np.append(0.0, rng.standard_normal(2)), np.append([0.0, 0.0], rng.standard_normal(1))]
    while True:
        c, d = rng.uniform(-0.7, 0.7), -rng.uniform(0.3, 0.9)
        if abs(c - d) > 0.4:  # C and D that nearly cancel are not determined
            break

    def make(rng: np.random.Generator, N: int) -> tuple[Array, Array, dict[str, Any]]:
        u = _telegraph(rng, N, 2)
        y = sum(filtered(b, f, x) for b, f, x in zip(B, F, u.T, strict=True))
        e = filtered([1, c], [1, d], rng.standard_normal(N))
        return u, (y + np.sqrt(_SNR) * np.std(y) * e / np.std(e))[:, None], {}

    theta = np.concatenate([B[0][1:], B[1][2:], [c], [d], F[0][1:], F[1][1:]])
    G = np.stack([_response(b, f) for b, f in zip(B, F, strict=True)], axis=1)[:, None]
    orders = {"nb": [[2, 1]], "nf": [[2, 1]], "nk": [[1, 2]], "nc": 1, "nd": 1}
    return (
        make,
        lambda s: armrig.bj(s, **orders),  # type: ignore[arg-type, return-value]
        theta,
        np.concatenate(z),
        G,
    )


def _shared(rng: np.random.Generator) -> Made:
    z = _drawn_poles(rng, 3)
    F = _polynomial(z)
    whole = np.convolve([1.0, -1.0], F)
    B = [np.append(0.0, rng.standard_normal(4)), np.append(0.0, rng.standard_normal(3))]

    def make(rng: np.random.Generator, N: int) -> tuple[Array, Array, dict[str, Any]]:
        u = _telegraph(rng, N, 1)
        clean = np.column_stack([filtered(B[0], whole, u[:, 0]), filtered(B[1], F, u[:, 0])])
        size = [np.std(filtered(B[0], F, u[:, 0])), np.std(clean[:, 1])]
        e = rng.standard_normal((N, 2)) @ np.linalg.cholesky(_LAMBDA).T
        return u, clean + np.sqrt(_SNR) * e * size, {"outputs": ["chassis", "arm"]}

    return make, *_one_denominator(B, F, "chassis")


def _one_denominator(B: list[Array], F: Array, integrator: str) -> Any:
    """Return the estimate with one denominator F, and the true coefficients, poles and G."""
    whole = np.convolve([1.0, -1.0], F)
    theta = np.concatenate([B[0][1:], whole[1:], B[1][1:], F[1:]])
    G = np.stack([_response(B[0], whole), _response(B[1], F)], axis=1)[:, :, None]
    orders = {"nb": [[4], [3]], "nf": 3, "integrator": integrator, "shared": "denominator"}
    return (
        lambda s: armrig.oe(s, **orders),  # type: ignore[arg-type]
        theta,
        np.roots(F),
        G,
    )


def _arm(rng: np.random.Generator) -> Made:
    system = armrig.arm(drawn_parameters(rng))[["theta_1", "alpha"], :]
    sampled = control.c2d(system, TS)
    numerators, whole = ss2tf(sampled.A, sampled.B, sampled.C, sampled.D)
    # The integrator divides the denominator, and the numerator of alpha.
    F = np.cumsum(whole)[:-1]
    B = [np.append(0.0, numerators[0][1:]), np.append(0.0, np.cumsum(numerators[1])[1:-1])]

    def make(rng: np.random.Generator, N: int) -> tuple[Array, Array, dict[str, Any]]:
        u = armrig.telegraph(N, 0.05, 0.0, 5.0, seed=rng)
        _, y = control.forced_response(sampled, inputs=u)
        y = y.T + STD * rng.standard_normal((N, 2))
        return u[:, None], y, {"outputs": ["theta_1", "alpha"]}

    return make, *_one_denominator(B, F, "theta_1")


def _ss(rng: np.random.Generator) -> Made:
    z = _drawn_poles(rng, 3)
    A = np.zeros((3, 3))
    A[:2, :2] = [[z[0].real, z[0].imag], [-z[0].imag, z[0].real]]
    A[2, 2] = z[2].real
    B, C = rng.standard_normal((2, 3, 2))
    C = C.T
    while True:
        K = 0.4 * rng.standard_normal((3, 2))
        if np.max(np.abs(np.linalg.eigvals(A - K @ C))) < 0.9:
            break
    clean = recursion(A, _telegraph(rng, 4000, 2) @ B.T, np.zeros(3)) @ C.T
    L = np.linalg.cholesky(_LAMBDA) * np.sqrt(_SNR) * np.std(clean, axis=0).mean()

    def make(rng: np.random.Generator, N: int) -> tuple[Array, Array, dict[str, Any]]:
        u = _telegraph(rng, N, 2)
        e = rng.standard_normal((N, 2)) @ L.T
        return u, recursion(A, u @ B.T + e @ K.T, np.zeros(3))[:-1] @ C.T + e, {}

    points = np.exp(1j * _FREQUENCIES)[:, None, None]
    G = C @ np.linalg.solve(points * np.eye(3) - A, np.broadcast_to(B, (5, 3, 2)).astype(complex))
    return make, lambda s: armrig.ss(s, order=3), np.zeros(0), z, G


def _n4sid(rng: np.random.Generator) -> Made:
    make, _, theta, z, G = _ss(rng)
    return make, lambda s: armrig.n4sid(s, 3), theta, z, G  # type: ignore[return-value]


_CASES: dict[str, Callable[[np.random.Generator], Made]] = {
    "arx": _arx,
    "bj": _bj,
    "shared": _shared,
    "arm": _arm,
    "ss": _ss,
    "n4sid": _n4sid,
}
_DRAWS = {"arx": 0, "bj": 1, "shared": 2, "ss": 3, "n4sid": 3, "arm": 4}
"""Second number of the seed that draws the plant of each case."""


def study(path: Path, case: str, seed: int, runs: int, N: int, missing: float) -> None:
    """Append the runs that are not in the file yet."""
    done = {
        row["run"]
        for row in _rows(path)
        if (row["case"], row["seed"], row["N"], row["missing"]) == (case, seed, N, missing)
    }
    plant = Plant(case, seed)
    with path.open("a", encoding="utf-8") as file:
        for run in range(runs):
            if run in done:
                continue
            head = {"case": case, "seed": seed, "N": N, "missing": missing, "run": run}
            try:
                fit = plant.fit(plant.signals(N, missing, (seed, N, run)))
                values, stds = plant.quantities(fit)
            except (ValueError, np.linalg.LinAlgError) as err:
                print(json.dumps(head | {"failed": str(err)}), file=file, flush=True)
                continue
            row = head | {"values": values.tolist(), "std": stds.tolist()}
            row |= {"converged": fit.converged}
            print(json.dumps(row), file=file, flush=True)


def _rows(path: Path) -> list[dict[str, Any]]:
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def summary(path: Path) -> None:
    """Print coverage, ratio and bias of each study."""
    studies: dict[tuple[Any, ...], list[dict[str, Any]]] = defaultdict(list)
    for row in _rows(path):
        studies[row["case"], row["seed"], row["N"], row["missing"]].append(row)
    print("case    seed     N  missing  runs  failed  coverage: least mean most   ratio: …   bias")
    for (case, seed, N, missing), rows in sorted(studies.items()):
        truth = Plant(case, seed).truth
        good = [row for row in rows if "values" in row and row["converged"]]
        values, stds = (np.array([row[name] for row in good]) for name in ("values", "std"))
        used = np.ptp(values, axis=0) > 0  # the imaginary part of a real pole is 0
        values, stds, truth = values[:, used], stds[:, used], truth[used]
        covered = np.mean(np.abs(values - truth) <= 1.96 * stds, axis=0) * len(good) / len(rows)
        ratio = np.sqrt(np.mean(stds**2, axis=0)) / np.std(values, axis=0, ddof=1)
        bias = (values.mean(axis=0) - truth) / np.std(values, axis=0, ddof=1) * len(good) ** 0.5
        print(
            f"{case:7} {seed:4} {N:5} {missing:8} {len(rows):5} {len(rows) - len(good):7}   "
            f"{100 * covered.min():.1f} {100 * covered.mean():.1f} {100 * covered.max():.1f}   "
            f"{ratio.min():.3f} {ratio.mean():.3f} {ratio.max():.3f}   {np.abs(bias).max():.1f}"
        )


def main() -> None:
    """Run a study, or print the summary of a file."""
    parser = argparse.ArgumentParser()
    parser.add_argument("file", type=Path)
    parser.add_argument("--case", choices=list(_CASES))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--N", type=int, default=500)
    parser.add_argument("--missing", type=float, default=0.0)
    parser.add_argument("--summary", action="store_true")
    given = parser.parse_args()
    if not given.summary:
        for case in [given.case] if given.case else list(_CASES):
            study(given.file, case, given.seed, given.runs, given.N, given.missing)
    summary(given.file)


if __name__ == "__main__":
    main()
