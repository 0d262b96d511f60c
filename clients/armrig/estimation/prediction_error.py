"""Prediction-error problem: residuals and their derivatives for given C, D and F."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armrig.models.innovations import Errors, Experiment, LinearPart, errors, regression
from armrig.models.structure import Structure
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.levenberg_marquardt import MAX_STEPS, Optimum, levenberg_marquardt
from armrig.numerics.polynomial import Array, drawn_to_edge, monic, outward_normals, stable


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """Least-squares solution for given C, D and F."""

    ab: Array
    """Coefficients of A and B, (na + nb,)."""
    parts: tuple[Errors, ...]
    """Errors of each experiment."""
    given: tuple[LinearPart, ...]
    """Linear equation for A, B and the unknown past of each experiment."""
    e: Array
    """Residuals of all experiments, (M,); 0 in rows without a residual."""
    by_ab: Array
    """Derivatives of the prediction with respect to (a, b), (M, na + nb). Their projection on the
    effects of the unknown past is subtracted."""
    by_cdf: Array
    """Derivatives of the prediction with respect to (c, d, f), (M, nc + nd + nf). Their projection
    on the effects of the unknown past is subtracted."""
    J: Array
    """Derivatives `by_cdf` minus their projection on `by_ab`, (M, nc + nd + nf)."""
    rank: int
    """Number of a's and b's that the data determine."""

    @property
    def Psi(self) -> Array:
        """Derivatives `by_ab` and `by_cdf` side by side, (M, d)."""
        return np.hstack([self.by_ab, self.by_cdf])


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictionErrorProblem:
    """Minimisation of |(D/C) (A y - (B/F) u) - effect of the unknown past|² over the polynomials.

    The unknown past is the signals before the first sample of each experiment. The errors are
    linear in A, B and the unknown past, which are therefore projected out. The search is over the
    coefficients of C, D and F only. This method is variable projection with Kaufman's Jacobian. The
    gradient from this Jacobian is exact.

    After each gap, pulses with estimated heights represent the unknown past of the noise. The
    pulses also fit part of the noise itself, so that many gaps bias C. If 3 % of 2000 samples are
    missing, the bias is 0.7 standard deviations. Therefore the pulses are integrated out with a
    flat prior. The cost is then |e|² |Z^T Z|^(1/M). The columns of Z are the pulses, and M is the
    number of errors minus the number of pulses. Z excludes the pulses at the beginning of the data,
    so that data without gaps are fitted by plain least squares. The factor |Z^T Z|^(1/M) corrects C
    but not D. If 3 % of 2000 samples are missing, the bias of D remains 0.4 standard deviations.

    References
    ----------
    .. [1] G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10 (1973) 413-432.
    .. [2] L. Kaufman, BIT 15 (1975) 49-57.
    """

    experiments: tuple[Experiment, ...]
    """Signals of each experiment."""
    structure: Structure
    """Orders of the polynomials and dimension of the unknown past."""

    def polynomials(self, theta: Array) -> tuple[Array, Array, Array]:
        """Return C, D and F for theta = (c, d, f)."""
        n = self.structure
        begin_f = n.nc + n.nd
        return monic(theta[: n.nc]), monic(theta[n.nc : begin_f]), monic(theta[begin_f:])

    def _linear(self, theta: Array) -> tuple[list[LinearPart], Basis, Array, Array]:
        C, D, F = self.polynomials(theta)
        given = [regression(x, self.structure, C=C, D=D, F=F) for x in self.experiments]
        whole = _stacked([g.unknown.without(np.column_stack([g.X, g.y])) for g in given])
        return given, orthonormal(whole[:, :-1]), whole[:, :-1], whole[:, -1]

    def solve(self, theta: Array) -> Solution:
        """Return the least-squares solution for A, B and the unknown past at theta = (c, d, f)."""
        given, basis, by_ab, y = self._linear(theta)
        ab = basis.coefficients(y)
        parts = [
            errors(x, self.structure, g, **self.named(ab, theta))
            for x, g in zip(self.experiments, given, strict=True)
        ]
        by_cdf = _stacked([p.Psi for p in parts])
        return Solution(
            ab=ab,
            parts=tuple(parts),
            given=tuple(given),
            e=basis.without(y),
            by_ab=by_ab,
            by_cdf=by_cdf,
            J=basis.without(by_cdf),
            rank=basis.rank,
        )

    def named(self, ab: Array, theta: Array) -> dict[str, Array]:
        """Return all polynomials by name, without the factor of an integrator."""
        n = self.structure
        C, D, F = self.polynomials(theta)
        A, B = monic(ab[: n.na]), np.append(np.zeros(n.nk), ab[n.na :])
        return {"A": A, "B": B, "C": C, "D": D, "F": F}

    def linearise(self, theta: Array) -> tuple[Array, Array]:
        """Return e and J at theta, scaled so that |e|² is the cost."""
        solution = self.solve(theta)
        log_scale, by_c = self._scale(solution.given)
        if log_scale == 0.0:
            return solution.e, solution.J
        J = solution.J.copy()
        J[:, : by_c.size] -= np.outer(solution.e, by_c)
        scale = np.exp(log_scale)
        return scale * solution.e, scale * J

    def cost(self, theta: Array) -> float:
        """Return |e|² |Z^T Z|^(1/M) at theta."""
        given, basis, _, y = self._linear(theta)
        e = basis.without(y)
        return float(e @ e) * float(np.exp(2 * self._scale(given)[0]))

    def _scale(self, given: Sequence[LinearPart]) -> tuple[float, Array]:
        """Return log |Z^T Z| / (2 M) without the first stretch, and d/dc of this number."""
        volumes = [v() for v in [v for g in given for v in g.unknown.volumes][1:]]
        none = np.zeros(self.structure.nc)
        if not volumes:
            return 0.0, none
        errors = sum(int(np.count_nonzero(x.rows)) for x in self.experiments)
        M = errors - sum(Q.shape[1] for g in given for _, Q in g.unknown.noise)
        log_volume = sum(volume for volume, _ in volumes)
        return log_volume / (2 * M), sum((by_c for _, by_c in volumes), none) / (2 * M)

    def admissible(self, theta: Array) -> bool:
        """Return whether the predictor is stable, that is, whether C and F are stable."""
        C, _, F = self.polynomials(theta)
        return stable(C) and stable(F)

    def inside(self, theta: Array, previous: Array) -> Array:
        """Move the roots of C and F that are outside the unit circle inside; return theta."""
        C, D, F = self.polynomials(theta)
        C_0, _, F_0 = self.polynomials(previous)
        return np.concatenate([drawn_to_edge(C, C_0)[1:], D[1:], drawn_to_edge(F, F_0)[1:]])

    def normals(self, theta: Array) -> Array:
        """Return the gradient d|z|/dtheta for each root z of C and F on the unit circle."""
        C, D, F = self.polynomials(theta)
        by_c, by_f = outward_normals(C), outward_normals(F)
        rows = np.zeros((len(by_c) + len(by_f), theta.size))
        rows[: len(by_c), : C.size - 1] = by_c
        rows[len(by_c) :, C.size + D.size - 2 :] = by_f
        return rows

    def minimise(self, theta: Array, most: int = MAX_STEPS, known: float = np.nan) -> Optimum:
        """Return the minimum that a search from theta = (c, d, f) reaches with stable C and F."""
        return levenberg_marquardt(
            self.linearise, theta, admissible=self.admissible, most=most, known=known, walls=self
        )


def _stacked(blocks: list[Array]) -> Array:
    return blocks[0] if len(blocks) == 1 else np.vstack(blocks)
