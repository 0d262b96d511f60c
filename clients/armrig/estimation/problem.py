"""Prediction-error problem: residuals and their derivatives for given C, D and F."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from armrig.estimation.projected_errors import project_errors
from armrig.models.innovations import (
    Errors,
    Experiment,
    LinearPart,
    UnknownPast,
    errors,
    regression,
    volume,
)
from armrig.models.structure import Structure
from armrig.numerics.covariance import spread, spread_apart
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.levenberg_marquardt import (
    TOLERANCE,
    Jacobian,
    Optimum,
    levenberg_marquardt,
)
from armrig.numerics.polynomial import (
    INSIDE_MODULUS,
    Array,
    monic,
    move_to_edge,
    outward_normals,
    stable,
)

_TOLERANCE_WITH_GAPS = 3e-5  # of a search: theta is off by 3e-5 sqrt(N) deviations


@dataclass(frozen=True, slots=True, kw_only=True)
class CoefficientLayout:
    """Places of the coefficients of all rows in the linear parameters and in theta."""

    letters: tuple[str, ...]
    """Letter of each searched polynomial, in the order of theta."""
    slices: tuple[slice, ...]
    """Slice of theta with the coefficients of each polynomial."""
    polynomials: tuple[tuple[int, ...], ...]
    """Polynomials of each row: (a), c, d, and f of each group; (a) if A is searched."""
    searched: tuple[Any, ...]
    """Indices into theta of the searched coefficients of each row."""
    linear: tuple[Any, ...]
    """Indices into the linear parameters of the coefficients (a), b of each row."""


@lru_cache
def _layout(rows: tuple[Structure, ...], searches_a: bool) -> CoefficientLayout:
    letters: list[str] = []
    sizes: list[int] = []
    shared: dict[str, int] = {}
    polynomials, linear = [], []
    common = rows[0].na if len(rows) > 1 and not searches_a else 0
    begin = common

    def add_polynomial(letter: str, size: int) -> int:
        if len(rows) > 1 and letter in shared:
            return shared[letter]
        letters.append(letter)
        sizes.append(size)
        if letter in "af":
            shared[letter] = len(letters) - 1
        return len(letters) - 1

    for n in rows:
        indices = [add_polynomial("a", n.na)] if searches_a else []
        indices += [
            add_polynomial("c", n.nc),
            add_polynomial("d", n.nd),
            *(add_polynomial("f", size) for size in n.sizes),
        ]
        polynomials.append(tuple(indices))
        a = 0 if searches_a else n.na
        if common:
            linear.append(np.r_[:common, begin : begin + sum(n.nb)])
            begin += sum(n.nb)
        else:
            linear.append(np.arange(begin, begin + a + sum(n.nb)))
            begin += a + sum(n.nb)
    slices = [slice(a, b) for a, b in pairwise(np.cumsum([0, *sizes]).tolist())]
    return CoefficientLayout(
        letters=tuple(letters),
        slices=tuple(slices),
        polynomials=tuple(polynomials),
        searched=tuple(
            np.concatenate([np.r_[slices[k]] for k in indices]) for indices in polynomials
        ),
        linear=tuple(linear),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """Least-squares solution for given C, D and F."""

    ab: Array
    """Linear parameters: coefficients of A and B of each row; of B alone if A is searched."""
    parts: tuple[tuple[Errors, ...], ...]
    """Errors of each experiment and row."""
    given: tuple[tuple[LinearPart, ...], ...]
    """Linear equation of each experiment and row."""
    past: tuple[UnknownPast, ...]
    """Basis of the unknown past of each experiment, whitened if there are several rows."""
    scales: tuple[float, ...]
    """Factor of the errors of each row before they are whitened; 1 for one row."""
    e: Array
    """Residuals of all experiments, (M,); 0 in rows without a residual."""
    by_ab: Array
    """Derivatives of the prediction with respect to `linear`, (M, n). Their projection on the
    effects of the unknown past is subtracted."""
    by_theta: Array
    """Derivatives of the prediction with respect to theta, (M, n), minus e times the derivatives of
    the logarithm of its scale in the cost. Their projection on the effects of the unknown past is
    subtracted."""
    J: Array
    """Derivatives `by_theta` minus their projection on `by_ab`."""
    rank: int
    """Number of linear parameters that the data determine."""
    linear: Array
    """Linear parameters: `ab`, or the weights of the columns of `PolynomialProblem.combination`."""

    @property
    def Psi(self) -> Array:
        """Derivatives `by_ab` and `by_theta` side by side, (M, d)."""
        return np.hstack([self.by_ab, self.by_theta])


@dataclass(frozen=True, slots=True, kw_only=True)
class PolynomialProblem:
    """Minimisation of |(D/C) (A y - (B/F) u) - effect of the unknown past|² over the polynomials.

    A problem has one row, the equation of one output. If outputs share the polynomial A or F, the
    problem has the rows of all these outputs, weighted by the inverse covariance of their noise.

    The errors are linear in A, B and the unknown past of each experiment, which are therefore
    projected out. The search is over the coefficients of C, D and F only. This method is variable
    projection with Kaufman's Jacobian, whose gradient is exact. In data with gaps and a noise
    model, the search is over A, too.

    After a missing sample the error has a larger variance, s(t) times the variance of e. The cost
    is then the sum of e(t)²/s(t), times the geometric mean of s(t). In the second and each further
    experiment the pulses z are integrated out with a flat prior, which multiplies the cost by
    |Z^T Z|^(1/M). The columns of Z are the pulses, and M is the number of errors minus the number
    of pulses.

    References
    ----------
    .. [1] G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10 (1973) 413-432.
    .. [2] L. Kaufman, BIT 15 (1975) 49-57.
    .. [3] L. Ljung, *System Identification*, 2nd ed., 1999, sections 3.2, 7.2 and 10.2.
    """

    rows: tuple[Structure, ...]
    """Orders of the polynomials of each output."""
    experiments: tuple[tuple[Experiment, ...], ...]
    """Signals of each experiment and row."""
    weights: tuple[Array, ...] = ()
    """Whitening matrices of each experiment, (N, ny, ny), from `whitening`; empty for one row."""
    combination: Array | None = None
    """Columns (n, m): the linear parameters are a combination of them. None if they are free."""
    layout: CoefficientLayout = field(init=False)
    """Places of the coefficients."""
    projects: bool = field(init=False)
    """True if `projected_errors` apply: one experiment of one input and one output, without gaps
    and a combination."""

    def __post_init__(self) -> None:
        """Find the places of the coefficients."""
        layout = _layout(self.rows, self.gaps and any(n.na for n in self.rows))
        n = self.rows[0]
        single = len(self.rows) == len(self.experiments) == len(n.nb) == 1
        projects = single and self.experiments[0][0].whole
        object.__setattr__(self, "layout", layout)  # a field of a frozen dataclass
        free = self.combination is None
        object.__setattr__(self, "projects", projects and free)

    @property
    def gaps(self) -> bool:
        """True if an output of a noise model has gaps."""
        return any(x.gaps for experiment in self.experiments for x in experiment)

    @property
    def N(self) -> int:
        """Number of errors of all experiments and rows."""
        return sum(
            int(np.count_nonzero(x.rows)) for experiment in self.experiments for x in experiment
        )

    @property
    def size(self) -> int:
        """Number of searched coefficients."""
        return int(self.layout.slices[-1].stop)

    @property
    def linear_size(self) -> int:
        """Number of linear parameters."""
        if self.combination is not None:
            return int(self.combination.shape[1])
        return 1 + max(int(columns.max(initial=-1)) for columns in self.layout.linear)

    @property
    def letters(self) -> tuple[str, ...]:
        """Letter of each searched coefficient."""
        pairs = zip(self.layout.letters, self.layout.slices, strict=True)
        return tuple(letter for letter, part in pairs for _ in range(part.start, part.stop))

    def columns_of(self, i: int) -> Array:
        """Return the columns of (a, b, c, d, f of each group) of row i in `Solution.Psi`."""
        n = self.rows[i]
        linear, searched = self.layout.linear[i], self.linear_size + self.layout.searched[i]
        if self.layout.letters[0] == "a":
            return np.concatenate([searched[: n.na], linear, searched[n.na :]])
        return np.concatenate([linear, searched])

    def slice_of(self, letter: str, i: int) -> slice:
        """Return the slice of theta with the coefficients of C, D or a searched A of row i."""
        for k in self.layout.polynomials[i]:
            if self.layout.letters[k] == letter:
                return self.layout.slices[k]
        return slice(0, 0)

    def polynomials(self, theta: Array) -> list[Array]:
        """Return the searched polynomials, such as C, D and F of one row."""
        return [monic(theta[part]) for part in self.layout.slices]

    def named(self, ab: Array, theta: Array, i: int = 0) -> dict[str, Any]:
        """Return the polynomials of row i by name, B and F of each input, without the root 1."""
        n, layout = self.rows[i], self.layout
        polynomials = self._of_row(theta, i)
        coefficients = ab[layout.linear[i]]
        b = coefficients[coefficients.size - sum(n.nb) :]
        if "A" not in polynomials:
            polynomials["A"] = monic(coefficients[: n.na])
        ends = np.cumsum(n.nb)[:-1]
        polynomials["B"] = [
            np.append(np.zeros(k), p) for k, p in zip(n.nk, np.split(b, ends), strict=True)
        ]
        return polynomials

    def _of_row(self, theta: Array, i: int) -> dict[str, Any]:
        """Return the searched polynomials of row i by name."""
        n, layout = self.rows[i], self.layout
        searched = [monic(theta[layout.slices[k]]) for k in layout.polynomials[i]]
        by_name: dict[str, Any] = {"A": searched.pop(0)} if layout.letters[0] == "a" else {}
        C, D, *of_groups = searched
        F = [np.ones(1)] * len(n.nb)
        for group, p in zip(n.groups, of_groups, strict=True):
            for j in group:
                F[j] = p
        return by_name | {"C": C, "D": D, "F": F}

    def solve(self, theta: Array, ab: Array | None = None) -> Solution:
        """Return the least-squares solution for A and B, if not given, and the unknown past."""
        return self._solve(theta, self._equations(theta, innovations=True), ab=ab)

    def linearise(self, theta: Array) -> tuple[Array, Array]:
        """Return e and J, maybe times one orthogonal matrix, scaled so that |e|² is the cost."""
        e, J = self._linearise_lazily(theta)
        return e, J() if callable(J) else J

    def solve_scaled(self, theta: Array) -> tuple[Solution, float]:
        """Return the solution at theta, and the scale of its errors and derivatives in the cost."""
        equations = self._equations(theta)
        return self._solve(theta, equations), equations.scale

    def cost(self, theta: Array) -> float:
        """Return the sum of squared errors at theta, scaled as the class describes."""
        if (projection := self._project(theta)) is not None:
            return float(projection[0][0]) ** 2
        equations = self._equations(theta)
        basis, _, y = equations.projected(self.combination)
        e = basis.without(y)
        return float(e @ e) * equations.scale**2

    def _linearise_lazily(self, theta: Array) -> tuple[Array, Jacobian]:
        """Return e and J, or e and a function that computes J."""
        if (projection := self._project(theta)) is not None:
            return projection
        equations = self._equations(theta)
        basis, _, y = equations.projected(self.combination)
        scale = equations.scale
        return scale * basis.without(y), lambda: scale * self._solve(theta, equations).J

    def _project(self, theta: Array) -> tuple[Array, Jacobian] | None:
        if not self.projects:
            return None
        C, D, F = self.polynomials(theta)
        return project_errors(self.experiments[0][0], self.rows[0], C=C, D=D, F=F)

    def _equations(self, theta: Array, *, innovations: bool = False) -> _ErrorEquations:
        polynomials = [self._of_row(theta, i) for i in range(len(self.rows))]
        innovations |= len(self.rows) > 1  # the weights are those of the measured outputs
        equations = [
            [
                regression(x, n, **p, innovations=innovations)
                for x, n, p in zip(experiment, self.rows, polynomials, strict=True)
            ]
            for experiment in self.experiments
        ]
        logs, by_theta = self._log_scales(equations, [p["C"] for p in polynomials])
        if len(self.rows) == 1:
            joined = [experiment[0] for experiment in equations]
            scale = float(np.exp(logs[0])) if logs[0] else 1.0
            return _ErrorEquations(
                given=equations, joined=joined, volumes=by_theta, scales=[1.0], scale=scale
            )
        scales = np.exp(logs).tolist()
        joined = [
            self._join(experiment, G, scales)
            for experiment, G in zip(equations, self.weights, strict=True)
        ]
        return _ErrorEquations(
            given=equations, joined=joined, volumes=by_theta, scales=scales, scale=1.0
        )

    def _log_scales(
        self, equations: list[list[LinearPart]], C: list[Array]
    ) -> tuple[list[float], list[Array]]:
        """Return half the mean log variance of e of each row, and derivatives of its part by c."""
        logs, by_c = [], []
        for i, n in enumerate(self.rows):
            volumes = [
                volume(experiment[i], n, C[i]) for experiment in self.experiments[1:] if n.nc
            ]
            log = sum(v for v, _ in volumes)
            log += sum(experiment[i].log_scale for experiment in equations)
            errors = self._errors(i, equations)
            logs.append(log / (2 * errors))
            by_c.append(sum((by for _, by in volumes), np.zeros(n.nc)) / (2 * errors))
        return logs, by_c

    def _errors(self, i: int, equations: Sequence[Sequence[LinearPart]]) -> int:
        """Return the number of errors of row i minus the number of pulses z."""
        errors = sum(int(np.count_nonzero(experiment[i].rows)) for experiment in self.experiments)
        return max(errors - sum(experiment[i].unknown.pulses for experiment in equations), 1)

    def _join(self, equations: list[LinearPart], G: Array, scales: list[float]) -> LinearPart:
        """Return one whitened equation for the errors of all rows."""
        linear = self.layout.linear
        d = self.linear_size
        blocks, spans = (
            [],
            [scale * g.unknown.span for g, scale in zip(equations, scales, strict=True)],
        )
        for g, scale, columns in zip(equations, scales, linear, strict=True):
            block = np.zeros((g.y.size, d + 1))
            block[:, columns], block[:, d] = scale * g.X, scale * g.y
            blocks.append(block)
        Xy = spread(G, blocks)
        past = UnknownPast(basis=orthonormal(spread_apart(G, spans)), pulses=0, N=Xy.shape[0])
        return LinearPart(X=Xy[:, :-1], y=Xy[:, -1], unknown=past)

    def _solve(
        self, theta: Array, equations: _ErrorEquations, *, ab: Array | None = None
    ) -> Solution:
        basis, by_ab, y = equations.projected(self.combination)
        e = basis.without(y) if ab is None else y - by_ab @ ab
        linear = ab = basis.coefficients(y) if ab is None else ab
        if self.combination is not None:
            ab = self.combination @ linear
        parts = self._parts(theta, equations, ab)
        by_theta = self._by_theta(parts, equations, theta.size)
        return Solution(
            ab=ab,
            parts=tuple(parts),
            given=tuple(tuple(row_equations) for row_equations in equations.given),
            past=tuple(g.unknown for g in equations.joined),
            scales=tuple(equations.scales),
            e=e,
            by_ab=by_ab,
            by_theta=by_theta,
            J=basis.without(by_theta),
            rank=basis.rank,
            linear=linear,
        )

    def _parts(
        self, theta: Array, equations: _ErrorEquations, ab: Array
    ) -> list[tuple[Errors, ...]]:
        named = [self.named(ab, theta, i) for i in range(len(self.rows))]
        if len(self.rows) == 1:
            pairs = zip(self.experiments, equations.given, strict=True)
            return [(errors(x, self.rows[0], g, **named[0]),) for (x,), (g,) in pairs]
        parts = []
        for k, (experiment, row_equations) in enumerate(
            zip(self.experiments, equations.given, strict=True)
        ):
            joined = equations.joined[k]
            raw = joined.y - joined.X @ ab
            ends = np.cumsum([g.unknown.rank for g in row_equations])[:-1]
            spans = np.split(joined.unknown.coefficients(raw), ends)
            parts.append(
                tuple(
                    errors(x, n, g, **p, along=along)
                    for x, n, g, p, along in zip(
                        experiment, self.rows, row_equations, named, spans, strict=True
                    )
                )
            )
        return parts

    def _by_theta(
        self, parts: list[tuple[Errors, ...]], equations: _ErrorEquations, size: int
    ) -> Array:
        """Return the derivatives by theta of the prediction, scaled as in the cost."""
        changes = self._scale_changes(parts, equations) if equations.scaled else None
        derivatives = []
        for k, row_errors in enumerate(parts):
            blocks = [p.Psi for p in row_errors]
            if changes is not None:
                blocks = [
                    block - np.outer(p.e, change) if change.any() else block
                    for block, p, change in zip(blocks, row_errors, changes, strict=True)
                ]
            if len(row_errors) > 1:
                padded = [np.zeros((block.shape[0], size)) for block in blocks]
                for i, block in enumerate(blocks):
                    padded[i][:, self.layout.searched[i]] = equations.scales[i] * block
                blocks = [spread(self.weights[k], padded)]
            derivatives.append(equations.joined[k].unknown.without(blocks[0]))
        return derivatives[0] if len(derivatives) == 1 else np.vstack(derivatives)

    def _scale_changes(
        self, parts: list[tuple[Errors, ...]], equations: _ErrorEquations
    ) -> list[Array]:
        """Return the derivatives of `_log_scales` by the searched coefficients of each row."""
        changes = []
        for i, n in enumerate(self.rows):
            total = np.sum([row_errors[i].by_scale for row_errors in parts], axis=0) / (
                2 * self._errors(i, equations.given)
            )
            begin = n.na if self.layout.letters[0] == "a" else 0
            total[begin : begin + n.nc] += equations.volumes[i]
            changes.append(total)
        return changes

    def minimise(self, theta: Array, **limits: Any) -> Optimum:
        """Return the minimum that a search from theta reaches with stable C and F."""
        circle = self.circle
        return levenberg_marquardt(
            self._linearise_lazily,
            theta,
            admissible=circle.admits,
            walls=circle,
            tolerance=_TOLERANCE_WITH_GAPS if self.gaps else TOLERANCE,
            **limits,
        )

    @property
    def circle(self) -> UnitCircle:
        """Boundary of the roots of each C and F, outside which the predictor is not stable."""
        pairs = zip(self.layout.letters, self.layout.slices, strict=True)
        return UnitCircle(tuple(p for letter, p in pairs if letter in "cf" and p.stop > p.start))


@dataclass(frozen=True, slots=True)
class UnitCircle:
    """Boundary of the roots of monic polynomials, whose coefficients are slices of theta."""

    parts: tuple[slice, ...]

    def admits(self, theta: Array) -> bool:
        """Return whether all roots are inside the circle."""
        return not self._outside(1.0, theta)

    def _outside(self, radius: float, theta: Array) -> list[slice]:
        """Return the slices of the polynomials with a root whose modulus is not below `radius`."""
        a = theta.tolist()
        return [part for part in self.parts if not stable([1.0, *a[part]], radius)]

    def inside(self, theta: Array, previous: Array) -> Array:
        """Move the roots that are outside the circle inside; return theta."""
        if not (outside := self._outside(INSIDE_MODULUS, theta)):
            return theta
        theta = theta.copy()
        for part in outside:
            theta[part] = move_to_edge(monic(theta[part]), monic(previous[part]))[1:]
        return theta

    def normals(self, theta: Array) -> Array:
        """Return the gradient d|z|/dtheta for each root z on the circle."""
        gradients = np.zeros((0, theta.size))
        for part in self._outside(INSIDE_MODULUS, theta):
            rows = outward_normals(monic(theta[part]))
            padded = np.zeros((len(rows), theta.size))
            padded[:, part] = rows
            gradients = np.vstack([gradients, padded])
        return gradients


@dataclass(frozen=True, slots=True, kw_only=True)
class _ErrorEquations:
    """Linear equations of all errors for given polynomials."""

    given: list[list[LinearPart]]
    """Equation of each experiment and row."""
    joined: list[LinearPart]
    """Equation of each experiment, whitened if there are several rows."""
    volumes: list[Array]
    """Derivatives of the share of the pulses in the scale of each row, by c."""
    scales: list[float]
    """Scale of each row in `joined`."""
    scale: float
    """Scale of all errors."""

    @property
    def scaled(self) -> bool:
        """True if a scale is not 1: after gaps, or with several experiments and a C."""
        return self.scale != 1.0 or any(scale != 1.0 for scale in self.scales)

    def projected(self, combination: Array | None) -> tuple[Basis, Array, Array]:
        """Return a basis of the linear derivatives, these derivatives, and y, without the past."""
        blocks = [g.unknown.without(np.column_stack([g.X, g.y])) for g in self.joined]
        Xy = blocks[0] if len(blocks) == 1 else np.vstack(blocks)
        columns = Xy[:, :-1] if combination is None else Xy[:, :-1] @ combination
        return orthonormal(columns), columns, Xy[:, -1]
