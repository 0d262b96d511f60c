"""Prediction-error problem of y_i = sum of B_ij/F_ij u_j + C_i/D_i e_i, for one output or several.

For given C, D and F the prediction errors are linear in B and in the unknown quantities. These
quantities are the state of each 1/F, the state of each C/D, and the trend of an integrating output.
The search is therefore over the coefficients of C, D and F only. This method is variable
projection, as in `armrig.estimation.prediction_error`.

Several of these polynomials may be identical. In an ARMAX model, all F of a row equal the D of the
row. With a shared denominator, all F of all rows are equal. The rows are then whitened by the
covariance of their noise.

After a missing sample the prediction error has a larger variance, s(t) times the variance of e; see
`NoiseFilter`. The cost is the sum of e(t)²/s(t), times the geometric mean of s(t). The minimum of
this cost maximises the likelihood that is concentrated with respect to the variance of e.

References
----------
.. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 3.2, 7.2 and 10.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag

from armrig.estimation.multivariable.whitening import spread, spread_apart
from armrig.models.innovations import summed_input
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.levenberg_marquardt import MAX_STEPS, Optimum, levenberg_marquardt
from armrig.numerics.noise_filter import NoiseFilter
from armrig.numerics.polynomial import (
    Array,
    drawn_to_edge,
    filtered,
    impulse,
    lagged,
    monic,
    outward_normals,
    stable,
)
from armrig.numerics.stretches import Mask

ONE = 0
"""Index of the polynomial 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """Orders of the equation of one output; polynomials are given by their index."""

    nb: tuple[int, ...]
    """Number of coefficients of B for each input; 0 if the input does not affect the output."""
    nk: tuple[int, ...]
    """Samples before each input reaches the output."""
    f: tuple[int, ...]
    """Index of the polynomial F of each input."""
    c: int = ONE
    """Index of the polynomial C."""
    d: int = ONE
    """Index of the polynomial D."""
    integrator: bool = False
    """True if each F of the row has the additional factor 1 - q^-1."""
    integrated_noise: bool = False
    """True if D of the row has the additional factor 1 - q^-1, as in an ARMAX model."""
    at_rest: bool = False
    """True if each experiment begins with all signals at zero."""

    def lags(self, j: int) -> range:
        """Return the lags of input j."""
        return range(self.nk[j], self.nk[j] + self.nb[j])

    def groups(self) -> dict[int, tuple[int, ...]]:
        """Return a mapping from the index of each polynomial F to the inputs that use F."""
        used = dict.fromkeys(f for f, n in zip(self.f, self.nb, strict=True) if n)
        return {g: tuple(j for j, n in enumerate(self.nb) if n and self.f[j] == g) for g in used}

    def pulses(self, sizes: Sequence[int]) -> dict[int, int]:
        """Return the number of pulses that represent the state of 1/F, by the index of F."""
        if self.at_rest:
            return dict.fromkeys(self.groups(), 0)
        inside = int(self.integrator)
        return {
            g: max(sizes[g] + inside, *(self.lags(j)[-1] for j in of)) - inside
            for g, of in self.groups().items()
        }

    @property
    def without_noise(self) -> Row:
        """Equation of this row with white noise (C = D = 1)."""
        return replace(self, c=ONE, d=ONE, integrated_noise=False)

    @property
    def trend(self) -> int:
        """Number of columns of the trend: level and ramp of an integrating output."""
        return 2 * int(self.integrator and not self.at_rest)


@dataclass(frozen=True, slots=True, kw_only=True)
class RowData:
    """Signals of one experiment for the equation of one output."""

    u: Array
    """Inputs (N, nu); running sums of the inputs if the output integrates."""
    y: Array
    """Output (N,), 0 where it is missing."""
    rows: Mask
    """Mask (N,), False where the output is missing."""


def row_data(u: Array, y: Array, row: Row) -> RowData:
    """Return the signals of one experiment for one row; a missing y is NaN."""
    if row.integrator:
        u = np.column_stack([summed_input(x, centred=not row.at_rest) for x in u.T])
    rows = np.isfinite(y)
    return RowData(u=u, y=np.where(rows, y, 0.0), rows=rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Equation:
    """Linear equation of the errors of one row and experiment: y = X b + Z z + e."""

    X: Array
    """Derivatives of the prediction with respect to b, (N, sum of nb)."""
    Z: Array
    """Responses to the unknown state, (N, r): state of each 1/F, trend, past of the noise."""
    y: Array
    """Output filtered by D/C, (N,)."""
    noise: NoiseFilter
    """Filter from the noise of the row to e."""
    log_scale: float
    """Sum of log s(t); s(t) is the variance of the error at t divided by the variance of e."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RowSolution:
    """Solution of one row and experiment."""

    e: Array
    """Errors (N,), 0 where the output is missing."""
    Psi: Array
    """Derivatives of the prediction with respect to (b of all rows, theta), (N, d)."""
    Z: Array
    """Responses to the unknown state (N, r)."""
    by_scale: Array
    """Derivative of the sum of log s(t) with respect to theta."""
    trend: Array
    """Level and ramp; empty if the output does not integrate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """Least-squares solution for given C, D and F."""

    b: tuple[Array, ...]
    """Coefficients of B of all inputs, for each row, (sum of nb,)."""
    rank: int
    """Number of b's that the data determine."""
    experiments: tuple[tuple[RowSolution, ...], ...]
    """Solution of each experiment and row."""
    states: tuple[Basis, ...]
    """Basis of the whitened responses to the unknown state, for each experiment."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PolynomialProblem:
    """Minimisation of e^T inv(Lambda) e, summed over all samples of all experiments."""

    rows: tuple[Row, ...]
    """Equation of each output."""
    sizes: tuple[int, ...]
    """Number of coefficients of each polynomial after the leading 1; the size of `ONE` is 0."""
    bounded: tuple[bool, ...]
    """True for each polynomial that must be stable: each C and F."""
    experiments: tuple[tuple[RowData, ...], ...]
    """Signals of each experiment and row."""
    weights: tuple[Array, ...]
    """Whitening matrices of each experiment, (N, ny, ny), from `whitening`."""

    @property
    def slices(self) -> list[slice]:
        """Slice of theta with the coefficients of each polynomial."""
        return [slice(a, b) for a, b in pairwise([0, *np.cumsum(self.sizes).tolist()])]

    @property
    def row_slices(self) -> list[slice]:
        """Slice of b with the coefficients of each row."""
        widths = np.cumsum([sum(row.nb) for row in self.rows]).tolist()
        return [slice(a, b) for a, b in pairwise([0, *widths])]

    def polynomials(self, theta: Array) -> list[Array]:
        """Return all polynomials with the coefficients theta."""
        return [monic(theta[part]) for part in self.slices]

    def solve(self, theta: Array) -> Solution:
        """Return B and the unknown states by least squares for given C, D and F."""
        equations = self._equations(theta)
        states, X, y = self._without_states(equations, [1.0] * len(self.rows))
        basis = orthonormal(X)
        return self._solution(theta, equations, states, basis.coefficients(y), basis.rank)

    def cost(self, theta: Array) -> float:
        """Return the sum of squared scaled errors at theta."""
        equations = self._equations(theta)
        _, X, y = self._without_states(equations, self._scales(equations))
        e = orthonormal(X).without(y)
        return float(e @ e)

    def linearise(self, theta: Array) -> tuple[Array, Array]:
        """Return the scaled errors e and their negative derivatives J; |e|² is the cost."""
        equations = self._equations(theta)
        scales = self._scales(equations)
        states, X, y = self._without_states(equations, scales)
        basis = orthonormal(X)
        found = self._solution(theta, equations, states, basis.coefficients(y), basis.rank)
        d = X.shape[1]
        changes = [
            sum(of[i].by_scale for of in found.experiments) / (2 * self._errors(i))
            for i in range(len(self.rows))
        ]
        J = [
            state.without(
                spread(
                    G,
                    [
                        scale * (part.Psi[:, d:] - part.e[:, None] * change)
                        for part, scale, change in zip(of, scales, changes, strict=True)
                    ],
                )
            )
            for of, state, G in zip(found.experiments, states, self.weights, strict=True)
        ]
        return basis.without(y), basis.without(np.vstack(J))

    def minimise(self, theta: Array, most: int = MAX_STEPS, known: float = np.nan) -> Optimum:
        """Return the minimum that a search from theta reaches with stable C and F."""
        return levenberg_marquardt(
            self.linearise, theta, admissible=self.admissible, most=most, known=known, walls=self
        )

    def admissible(self, theta: Array) -> bool:
        """Return whether all C and F are stable."""
        pairs = zip(self.polynomials(theta), self.bounded, strict=True)
        return all(stable(p) for p, bounded in pairs if bounded)

    def inside(self, theta: Array, previous: Array) -> Array:
        """Move the roots of C and F that are outside the unit circle inside; return theta."""
        triples = zip(
            self.polynomials(theta), self.polynomials(previous), self.bounded, strict=True
        )
        return np.concatenate(
            [(drawn_to_edge(p, before) if bounded else p)[1:] for p, before, bounded in triples]
        )

    def normals(self, theta: Array) -> Array:
        """Return the gradient d|z|/dtheta for each root z of C and F on the unit circle."""
        found = [np.zeros((0, theta.size))]
        for p, bounded, part in zip(
            self.polynomials(theta), self.bounded, self.slices, strict=True
        ):
            if bounded and p.size > 1:
                rows = outward_normals(p)
                whole = np.zeros((len(rows), theta.size))
                whole[:, part] = rows
                found.append(whole)
        return np.vstack(found)

    def _equations(self, theta: Array) -> list[list[_Equation]]:
        polynomials = self.polynomials(theta)
        return [
            [_equation(row, x, polynomials) for row, x in zip(self.rows, of, strict=True)]
            for of in self.experiments
        ]

    def _scales(self, equations: list[list[_Equation]]) -> list[float]:
        """Return the square root of the geometric mean of the variances of e, for each row."""
        return [
            float(np.exp(sum(of[i].log_scale for of in equations) / (2 * self._errors(i))))
            for i in range(len(self.rows))
        ]

    def _errors(self, i: int) -> int:
        """Return the number of errors of row i."""
        return sum(int(np.count_nonzero(of[i].rows)) for of in self.experiments)

    def _without_states(
        self, equations: list[list[_Equation]], scales: list[float]
    ) -> tuple[list[Basis], Array, Array]:
        """Return the basis of each experiment's states; X and y with the states projected out."""
        states, whole = [], []
        for of, G in zip(equations, self.weights, strict=True):
            state = orthonormal(spread_apart(G, [s * g.Z for g, s in zip(of, scales, strict=True)]))
            X = spread_apart(G, [s * g.X for g, s in zip(of, scales, strict=True)])
            y = spread(G, [s * g.y[:, None] for g, s in zip(of, scales, strict=True)])
            states.append(state)
            whole.append(state.without(np.hstack([X, y])))
        both = np.vstack(whole)
        return states, both[:, :-1], both[:, -1]

    def _solution(
        self,
        theta: Array,
        equations: list[list[_Equation]],
        states: list[Basis],
        b: Array,
        rank: int,
    ) -> Solution:
        polynomials = self.polynomials(theta)
        scales = self._scales(equations)
        found = []
        for x, of, state, G in zip(self.experiments, equations, states, self.weights, strict=True):
            left = [g.y - g.X @ b[part] for g, part in zip(of, self.row_slices, strict=True)]
            z = state.coefficients(
                spread(G, [s * v[:, None] for v, s in zip(left, scales, strict=True)])[:, 0]
            )
            ends = np.cumsum([g.Z.shape[1] for g in of])[:-1]
            found.append(
                tuple(
                    self._row_solution(i, x[i], of[i], polynomials, b, left[i], own)
                    for i, own in enumerate(np.split(z, ends))
                )
            )
        return Solution(
            b=tuple(b[part] for part in self.row_slices),
            rank=rank,
            experiments=tuple(found),
            states=tuple(states),
        )

    def _row_solution(
        self,
        i: int,
        x: RowData,
        g: _Equation,
        polynomials: list[Array],
        b: Array,
        left: Array,
        z: Array,
    ) -> RowSolution:
        row, part = self.rows[i], self.row_slices[i]
        counts = row.pulses(self.sizes)
        responses, trend, past = np.split(z, np.cumsum([sum(counts.values()), row.trend]))
        Psi = np.zeros((x.y.size, b.size + sum(self.sizes)))
        Psi[:, part] = g.X
        v = x.y - _trend(row, x.y.size) @ trend
        begins = np.cumsum([0, *row.nb])
        for k, (f, inputs) in enumerate(row.groups().items()):
            w = filtered([1.0], polynomials[f], _padded(responses, counts, k, x.y.size))
            for j in inputs:
                B = np.append(np.zeros(row.nk[j]), b[part][begins[j] : begins[j + 1]])
                w += filtered(B, polynomials[f], x.u[:, j])
            v -= w
            at = self.slices[f]
            moved = lagged(filtered([1.0], polynomials[f], w), range(1, at.stop - at.start + 1))
            Psi[:, b.size + at.start : b.size + at.stop] -= g.noise.columns(moved)[0]
        by_noise, by_scale = g.noise.derivatives(np.where(x.rows, v, 0.0), -past)
        if row.integrated_noise:
            nd = polynomials[row.d].size - 1
            by = block_diag(np.eye(g.noise.C.size - 1), integrated(np.eye(nd)))
            by_noise, by_scale = by_noise @ by, by_scale @ by
        scale = np.zeros(sum(self.sizes))
        nc = polynomials[row.c].size - 1
        for p, these in ((row.c, slice(0, nc)), (row.d, slice(nc, None))):
            at = self.slices[p]
            if at.stop > at.start:
                Psi[:, b.size + at.start : b.size + at.stop] -= by_noise[:, these]
                scale[at] += by_scale[these]
        return RowSolution(
            e=np.where(x.rows, left - g.Z @ z, 0.0), Psi=Psi, Z=g.Z, by_scale=scale, trend=trend
        )


def _equation(row: Row, x: RowData, polynomials: list[Array]) -> _Equation:
    """Return the linear equation of one row and experiment."""
    N = x.y.size
    D = polynomials[row.d]
    D = np.convolve([1.0, -1.0], D) if row.integrated_noise else D
    noise = NoiseFilter(C=polynomials[row.c], D=D, rows=x.rows)
    inputs = [
        lagged(filtered([1.0], polynomials[f], u), row.lags(j))
        for j, (f, u) in enumerate(zip(row.f, x.u.T, strict=True))
    ]
    counts = row.pulses([p.size - 1 for p in polynomials])
    pulses = [lagged(impulse(polynomials[f], N), range(n)) for f, n in counts.items()]
    whole = np.hstack([*inputs, *pulses, _trend(row, N), x.y[:, None]])
    columns, past, log_scale = noise.columns(whole)
    b = sum(row.nb)
    states = columns[:, b:-1] if row.at_rest else np.hstack([columns[:, b:-1], past])
    return _Equation(X=columns[:, :b], Z=states, y=columns[:, -1], noise=noise, log_scale=log_scale)


def integrated(M: Array) -> Array:
    """Return the derivatives of (1 - q^-1) F from the derivatives of F."""
    n = M.shape[0]
    return np.asarray((np.eye(n + 1, n) - np.eye(n + 1, n, k=-1)) @ M)


def _padded(responses: Array, counts: dict[int, int], k: int, N: int) -> Array:
    """Return the initial pulses that represent the state of the k-th 1/F, as a signal (N,)."""
    begins = np.cumsum([0, *counts.values()])
    x = np.zeros(N)
    own = responses[begins[k] : begins[k + 1]][:N]
    x[: own.size] = own
    return x


def _trend(row: Row, N: int) -> Array:
    return np.column_stack([np.ones(N), np.arange(1.0, N + 1.0)])[:, : row.trend]
