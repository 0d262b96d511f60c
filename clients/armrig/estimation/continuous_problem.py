"""Prediction-error problem of a transfer function in s: the sampled problem on a manifold.

The search is over C, D, F(s) and the delay. Each point is sampled exactly, and `PolynomialProblem`
gives the errors of the sampled model and their derivatives by its coefficients. The derivatives by
the coefficients in s follow by the chain rule. The numerator in s is linear and is projected out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from armrig.estimation.problem import PolynomialProblem, Solution
from armrig.models.structure import Structure
from armrig.numerics.exact_sampling import Hold, SampledSystem, sample_system
from armrig.numerics.levenberg_marquardt import Optimum, levenberg_marquardt
from armrig.numerics.polynomial import Array, monic, roots, stable

MAX_RATE = 12.0
"""Largest modulus of a pole in a search, in 1/sample. A faster pole is a direct path."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SampledPoint:
    """Sampled model at one point of the search."""

    problem: PolynomialProblem
    """Sampled problem, with the sampled numerators as `combination`."""
    theta: Array
    """Coefficients c, d, f of the sampled model, (k,)."""
    by_theta: Array
    """Derivatives of `theta` by the searched parameters, (k, n)."""
    by_combination: Array
    """Derivatives of `combination` (L, m, n) by the searched parameters."""

    def derivatives(self, solution: Solution) -> Array:
        """Return the derivatives of the prediction by the searched parameters, (M, n)."""
        moved = np.einsum("lpn,p->ln", self.by_combination, solution.linear)
        blocks = [
            past.without(signals[0].X @ moved)
            for past, signals in zip(solution.past, solution.given, strict=True)
        ]
        return np.asarray(solution.by_theta @ self.by_theta + np.vstack(blocks))


@dataclass(frozen=True, slots=True, kw_only=True)
class ContinuousProblem:
    """Minimisation of the prediction errors over c, d, f and the delay, with s in 1/sample.

    theta contains c, d, f_1 …, and the delay in samples if it is searched. With an integrator f_n
    is 0 and no parameter.
    """

    sampled_problem: PolynomialProblem
    """Signals, and the orders of the sampled model; the delay of the row is replaced."""
    poles: int
    """Number of poles, including the integrator."""
    zeros: int
    """Degree of the numerator in s."""
    hold: Hold = "zoh"
    """Course of u between the samples."""
    delay: float | None = None
    """Delay in samples; None if the delay is searched."""
    longest: float = 0.0
    """Longest delay of a search, in samples."""

    @property
    def N(self) -> int:
        """Number of errors."""
        return self.sampled_problem.N

    @property
    def row(self) -> Structure:
        """Orders of the sampled model."""
        return self.sampled_problem.rows[0]

    @property
    def noise_size(self) -> int:
        """Number of coefficients of C and D."""
        return self.row.nc + self.row.nd

    @property
    def integrates(self) -> bool:
        """True if F has the factor s."""
        return bool(self.row.integrator)

    @property
    def size(self) -> int:
        """Number of searched parameters."""
        return self.noise_size + self.poles - self.integrates + (self.delay is None)

    def parts_of(self, theta: Array) -> tuple[Array, Array, float]:
        """Return (c, d), the searched f_1 …, and the delay."""
        delay = float(theta[-1]) if self.delay is None else self.delay
        k = self.noise_size
        return theta[:k], theta[k : k + self.poles - self.integrates], delay

    def joined(self, noise: Array, f: Array, delay: float) -> Array:
        """Return theta from (c, d), the searched f_1 … and the delay."""
        return np.concatenate([noise, f, [delay] if self.delay is None else []])

    def with_root(self, f: Array) -> Array:
        """Return f_1 … f_n from the searched f_1 …; f_n is 0 if F has the factor s."""
        return np.append(f, 0.0) if self.integrates else f

    def reaching(self, delay: float) -> ContinuousProblem:
        """Return the problem with the pulses of an unknown past for this delay, in samples."""
        row = replace(self.row, reach=int(delay) + self.poles + 2)
        return replace(self, sampled_problem=replace(self.sampled_problem, rows=(row,)))

    def at(self, theta: Array) -> SampledPoint:
        """Return the sampled model at theta, with its derivatives."""
        noise, f, delay = self.parts_of(theta)
        exact = sample_system(self.with_root(f), delay, self.hold, fraction=self.delay is None)
        used = slice(0, self.zeros + 1)
        k, n = noise.size, f.size
        F, F_by_f = _without_root(exact) if self.integrates else (exact.F, exact.F_by_f)
        by_theta = np.zeros((k + F.size - 1, theta.size))
        by_theta[:k, :k] = np.eye(k)
        by_theta[k:, k : k + n] = F_by_f[1:, :n]
        by_combination = np.zeros((exact.B.shape[0], self.zeros + 1, theta.size))
        by_combination[:, :, k : k + n] = exact.B_by_f[:, used, :n]
        if self.delay is None:
            by_combination[:, :, -1] = exact.B_by_delay[:, used]
        row = replace(self.row, nk=(exact.nk,), nb=(exact.B.shape[0],), nf=(F.size - 1,))
        columns = np.array(exact.B[:, used])
        return SampledPoint(
            problem=replace(self.sampled_problem, rows=(row,), combination=columns),
            theta=np.append(noise, F[1:]),
            by_theta=by_theta,
            by_combination=by_combination,
        )

    def linearise(self, theta: Array) -> tuple[Array, Array]:
        """Return e and J at theta, scaled so that |e|² is the cost."""
        point = self.at(theta)
        solution, scale = point.problem.solve_scaled(point.theta)
        J = point.derivatives(solution)
        # Kaufman's Jacobian: the derivatives without their projection on those by b.
        basis = np.linalg.qr(solution.by_ab)[0]
        return scale * solution.e, scale * (J - basis @ (basis.T @ J))

    def cost(self, theta: Array) -> float:
        """Return the sum of squared errors at theta."""
        point = self.at(theta)
        return point.problem.cost(point.theta)

    def admits(self, theta: Array) -> bool:
        """Return whether C and the poles are stable, no pole is too fast, and the delay allowed."""
        noise, f, delay = self.parts_of(theta)
        if not np.isfinite(theta).all() or not 0 <= delay <= self.longest:
            return False
        s = roots(monic(f))
        inside = np.all(s.real < 0) and np.all(np.abs(s) < MAX_RATE) and np.all(s.imag < np.pi)
        return bool(inside) and stable(monic(noise[: self.row.nc]))

    @property
    def circle(self) -> ContinuousProblem:
        """The problem itself, which admits or refuses a point."""
        return self

    def minimise(self, theta: Array, **limits: Any) -> Optimum:
        """Return the minimum that a search from an admissible theta reaches."""
        return levenberg_marquardt(self.linearise, theta, admissible=self.admits, **limits)


def _without_root(exact: SampledSystem) -> tuple[Array, Array]:
    """Return the sampled denominator without its root 1, and its derivatives by f."""
    return np.cumsum(exact.F)[:-1], np.cumsum(exact.F_by_f, axis=0)[:-1]


def continuous_denominator(F: Array) -> Array:
    """Return f_1 … f_n with the poles ln z of a sampled F, and a fast pole for a negative z."""
    z = roots(F).astype(np.complex128)
    z[(z.real <= 0) & (np.abs(z.imag) < _REAL)] = _FAST
    s = np.log(z)
    s.real = np.clip(s.real, -_START_RATE, -_SLOWEST)
    return np.atleast_1d(np.real(np.poly(s)))[1:]


_REAL = 1e-9
_FAST = 0.05  # z of a fast real pole
_START_RATE = 5.0  # 1/sample
_SLOWEST = 1e-5  # 1/sample
