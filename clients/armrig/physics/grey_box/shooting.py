"""Multiple shooting: the least-squares problem of physical parameters, segment by segment.

An experiment is cut into segments, which are integrated at once from states s_i of their own. The
search begins with a relaxed problem, in which the segments need not join ::

    min |e(eta, s)|² + rho |defects|²,    defect_i = end of segment i - s_(i+1)

with a weight rho that grows, and ends with joined segments: for each point of the search, Newton's
method finds the s_i without defects. The linear equations of joined segments are condensed: the
change of each s_i follows from the changes of the parameters and of the initial state.

References
----------
.. [1] H. G. Bock, "Recent advances in parameter identification techniques for O.D.E.", in P.
   Deuflhard, E. Hairer (eds.), *Numerical Treatment of Inverse Problems*, Birkhäuser, 1983.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.errors import InputError
from armrig_core.rig.equations import Course, Parameter
from scipy.linalg import LinAlgError, solveh_banded

from armrig.data.columns import Matrix, Vector
from armrig.data.dataset import Signals
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.levenberg_marquardt import MAX_STEPS, Optimum, levenberg_marquardt
from armrig.physics.grey_box.physical_models import OFFSET, PhysicalModel

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_LOG_FACTOR = 12.0
"""Logarithm of the largest ratio of a parameter to its start value; e^12 is 160 000."""
_COLUMNS = (1500, 6000)  # trajectories that are integrated at once, in short and in long records
_SEGMENT = (10, 40)  # least number of samples of a segment, in short and in long records
_STEP = 3e-5  # step of a central difference, as a share of the coordinate's scale
DERIVATIVE_ERROR = 1e-7
"""Largest relative error of a derivative, with a margin."""
_JOINED = 1e-5  # largest defect of joined segments, as a share of the state's scale
_MAX_JOINS = 12
_NOTHING = np.zeros(0)
_MAX_BEGINNINGS = 4
_WEIGHTS = (0.01, 0.1, 1.0, 1e2, 1e4, 1e7)
"""Weights of the defects of the relaxed problem, for each sample of a segment."""
_MAX_RELAXED = 12
_RELAXED_CHANGE = 1e-2  # relative change of the cost at which the relaxed problem is solved


@dataclass(frozen=True, slots=True, kw_only=True)
class Segments:
    """Data of experiments in S segments of L samples; the last of each may exceed its data."""

    course: Course
    y: Matrix
    """Outputs (N, ny), NaN where there is none."""
    place: tuple[NDArray[np.int_], NDArray[np.int_]]
    """Interval and segment of each sample."""
    experiment: NDArray[np.int_]
    """Experiment of each segment, (S,)."""
    rows: tuple[slice, ...]
    """Samples of each experiment."""

    @classmethod
    def of(cls, model: PhysicalModel, experiments: Sequence[Signals], length: int) -> Segments:
        """Cut the experiments."""
        Ts, indices, inputs, before, places, first = experiments[0].Ts, [], [], [], [], 0
        whole, share = model.delay_in_samples(Ts)
        for data in experiments:
            S = max(1, -(-(data.N - 1) // length))
            index = np.arange(length + 1)[:, None] + length * np.arange(S)
            u, late = model.inputs(data), np.minimum(index, data.N - 1) - whole
            inputs.append(u[np.maximum(late, 0)])
            before.append(u[np.maximum(late - 1, 0)])
            # The last sample begins no interval: it may be the end of the last segment.
            segment = np.minimum(np.arange(data.N) // length, S - 1)
            places.append((np.arange(data.N) - length * segment, first + segment))
            indices.append(index)
            first += S
        edges = np.cumsum([0, *(data.N for data in experiments)]).tolist()
        interval, segment = (np.concatenate(part) for part in zip(*places, strict=True))
        return cls(
            course=Course(
                u=np.moveaxis(np.concatenate(inputs, 1), 1, 2),
                before=np.moveaxis(np.concatenate(before, 1), 1, 2),
                t=np.asarray(Ts * np.concatenate(indices, 1)),
                Ts=Ts,
                linear=tuple(x == "foh" for x in experiments[0].intersample),
                share=share,
            ),
            y=np.vstack([_outputs_with_gaps(data, ceil(whole + share)) for data in experiments]),
            place=(interval, segment),
            experiment=np.repeat(np.arange(len(indices)), [index.shape[1] for index in indices]),
            rows=tuple(slice(a, b) for a, b in pairwise(edges)),
        )

    @property
    def first(self) -> NDArray[np.bool_]:
        """True for the first segment of each experiment, (S,)."""
        return np.diff(self.experiment, prepend=-1) > 0

    def in_order(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (L + 1, ny, …, S) as (N, ny, …), in the order of time."""
        return np.asarray(values[self.place[0], ..., self.place[1]])


def _outputs_with_gaps(data: Signals, late: int) -> Matrix:
    """Return the outputs (N, ny), NaN where there is none, and while the input is not known."""
    y = np.where(data.valid, data.y, np.nan)
    y[:late] = np.nan
    return y


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """Outputs and derivatives of all segments, by eta and by their own states.

    The states are divided by their scale.
    """

    s: Matrix
    """States at the start of each segment, (n, S)."""
    y: NDArray[np.float64]
    """Outputs (L + 1, ny, S); the last belongs to the next segment."""
    y_by: NDArray[np.float64]
    """Their derivatives with respect to (eta, s), (L + 1, ny, d + n, S)."""
    end_by: NDArray[np.float64]
    """Derivatives of the end of each segment with respect to (eta, s), (S, n, d + n)."""
    defects: Matrix
    """End of each segment minus the start of the next of its experiment, (S, n); 0 for the last."""
    first: NDArray[np.bool_]
    """See `Segments.first`."""
    steps: int
    """Runge-Kutta steps of an interval."""

    def chain(self) -> tuple[NDArray[np.float64], Matrix]:
        """Return the derivatives of joined s with respect to (eta, x0), (S, n, d + n).

        The second result is the change of s that removes the defects, (S, n).
        """
        S, n, d = *self.end_by.shape[:2], self.end_by.shape[2] - self.end_by.shape[1]
        s_by = np.zeros((S, n, d + n + 1))
        s_by[self.first, :, d:-1] = np.eye(n)
        for i in np.flatnonzero(~self.first):
            s_by[i] = self.end_by[i - 1, :, d:] @ s_by[i - 1]
            s_by[i, :, :d] += self.end_by[i - 1, :, :d]
            s_by[i, :, -1] += self.defects[i - 1]
        return s_by[..., :-1], s_by[..., -1]


class Coordinates:
    """Coordinates of the free parameters, in which the search has no bounds.

    With a lower bound p = low + exp(eta); with an upper one p = high - exp(-eta). With both bounds
    eta = ln((p - low)/(high - p)). Without bounds p = eta |start|, or p = eta if the start is 0.
    """

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        """Take the bounds and the magnitudes of the parameters."""
        self._low, self._high, scale = (
            np.array([(p.low, p.high, p.value) for p in parameters]).reshape(-1, 3).T
        )
        self._scale = np.where(scale == 0, 1.0, np.abs(scale))
        lower, upper = np.isfinite(self._low), np.isfinite(self._high)
        self.bounded = lower | upper
        """True for each parameter with a bound."""
        self._kinds = [lower & upper, lower, upper]

    def of(self, values: Sequence[float]) -> Vector:
        """Return the coordinates of values."""
        low, high, p = self._low, self._high, np.array(values)
        with np.errstate(all="ignore"):
            ways = [np.log((p - low) / (high - p)), np.log(p - low), -np.log(high - p)]
        return np.select(self._kinds, ways, p / self._scale)

    def values(self, eta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values at coordinates (d,) or (points, d)."""
        low, high = self._low, self._high
        with np.errstate(all="ignore"):
            ways = [low + (high - low) / (1 + np.exp(-eta)), low + np.exp(eta), high - np.exp(-eta)]
        return np.select(self._kinds, ways, eta * self._scale)

    def slopes(self, eta: Vector) -> Vector:
        """Return the derivative of each value with respect to its coordinate."""
        return np.asarray((self.values(eta + _STEP) - self.values(eta - _STEP)) / (2 * _STEP))


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """Walls of the search: the largest change of each coordinate, infinite without a bound."""

    low: Vector
    high: Vector

    def inside(self, theta: Vector, previous: Vector) -> Vector:
        """Return theta, moved to the wall that it crossed."""
        return np.clip(theta, self.low, self.high)

    def normals(self, theta: Vector) -> Matrix:
        """Return the outward normals (k, n) of the walls that theta touches."""
        sides = (theta >= self.high).astype(float) - (theta <= self.low).astype(float)
        return np.asarray(np.diag(sides)[sides != 0])


@dataclass(slots=True, kw_only=True)
class Shooting:
    """Problem min |e|² over the free parameters and the initial state of each experiment.

    The vector of coordinates contains those of the parameters, then the initial states.
    """

    model: PhysicalModel
    names: tuple[str, ...]
    """Free parameters."""
    fixed: dict[str, float]
    """Values of all other parameters."""
    segments: Segments
    std: Vector
    """Standard deviation of the noise of each output, (ny,)."""
    length: int
    """Samples of a segment."""
    steps: int = 1
    """Runge-Kutta steps of an interval."""
    scale: Vector
    """Magnitude of each state, (n,)."""
    box: Box
    """Walls of the coordinates of the parameters."""
    best: tuple[float, Vector, Point | None] = field(default=(np.inf, _NOTHING, None), init=False)
    """Cost, coordinates and point of the best joined trajectories so far."""

    @classmethod
    def of(
        cls,
        model: PhysicalModel,
        names: tuple[str, ...],
        values: dict[str, float],
        experiments: Sequence[Signals],
    ) -> Shooting:
        """Return the problem of experiments, in segments of a suitable length."""
        space = Coordinates([model.parameters[name] for name in names])
        start = space.of([values[name] for name in names])
        reach = np.where(space.bounded, MAX_LOG_FACTOR, np.inf)
        n, N = len(model.states), max(part.N for part in experiments)
        few, many = (columns // (1 + 2 * (len(names) + n)) for columns in _COLUMNS)
        count = int(np.clip(np.clip(N // _SEGMENT[1], few, many), 1, max(N // _SEGMENT[0], 1)))
        length = max(-(-(N - 1) // count), 1)
        segments = Segments.of(model, experiments, length)
        spread = np.nanstd(segments.y, axis=0)
        return cls(
            model=model,
            names=names,
            fixed=values,
            segments=segments,
            std=np.where(spread > 0, spread, 1.0),
            length=length,
            scale=np.ones(n),
            box=Box(low=start - reach, high=start + reach),
        )

    @property
    def coordinates(self) -> Coordinates:
        """Coordinates of the free parameters."""
        return Coordinates([self.model.parameters[name] for name in self.names])

    def changed(self, **fields: Any) -> Shooting:
        """Return the problem with other fields; the trajectories found so far remain its start."""
        new = replace(self, **fields)
        new.best = (np.inf, *self.best[1:])
        return new

    def values(self, z: Vector) -> dict[str, float]:
        """Return the values of the free parameters."""
        theta = self.coordinates.values(z[: len(self.names)])
        return dict(zip(self.names, theta.tolist(), strict=True))

    def initial(self, z: Vector) -> Matrix:
        """Return the initial state of each experiment, (experiments, n)."""
        return np.asarray(z[len(self.names) :].reshape(-1, self.scale.size) * self.scale)

    def point(self, eta: Vector, s: Matrix) -> Point:
        """Integrate the segments, with all derivatives."""
        d, n, h = eta.size, s.shape[0], _STEP
        points = 1 + 2 * (d + n)
        grid = np.repeat(eta[None], points, axis=0)
        x = np.repeat(s[:, None, :], points, axis=1)
        for j in range(d):
            grid[1 + 2 * j, j] += h
            grid[2 + 2 * j, j] -= h
        for i in range(n):
            x[i, 1 + 2 * (d + i)] += h * self.scale[i]
            x[i, 2 + 2 * (d + i)] -= h * self.scale[i]
        values = self.coordinates.values(grid).T[:, :, None]
        all_values = self.fixed | dict(zip(self.names, values, strict=True))
        motion = self.model.integrate(self.segments.course, x, all_values, self.steps)
        end_by = (motion.end[:, 1::2] - motion.end[:, 2::2]) / (2 * h) / self.scale[:, None, None]
        first = self.segments.first
        defects = np.zeros((s.shape[1], n))
        defects[:-1] = ((motion.end[:, 0, :-1] - s[:, 1:]) / self.scale[:, None]).T
        defects[:-1][first[1:]] = 0.0
        return Point(
            s=s,
            y=motion.y[:, :, 0],
            y_by=(motion.y[:, :, 1::2] - motion.y[:, :, 2::2]) / (2 * h),
            end_by=np.moveaxis(end_by, 2, 0),
            defects=defects,
            first=first,
            steps=self.steps,
        )

    def solve_relaxed(self, eta: Vector, s: Matrix) -> Vector:
        """Return coordinates near the minimum of the relaxed problem.

        The trajectories found there are the start of the joined ones.
        """
        point = self.point(eta, s)
        for weight in _WEIGHTS:
            eta, point = self.relax(eta, point, weight * self.length)
        z = np.append(eta, (point.s[:, point.first].T / self.scale).ravel())
        self.best = np.inf, z, point
        return z

    def relax(self, eta: Vector, point: Point, weight: float) -> tuple[Vector, Point]:
        """Return coordinates and a point of a lower cost for one weight of the defects."""
        cost, damping = self._relaxing_cost(point, weight), 1e-4
        for _ in range(_MAX_RELAXED):
            try:
                move, moves = self._relaxing_step(point, weight, damping)
            except (LinAlgError, ValueError):  # not positive definite, or not finite
                break
            new = self.box.inside(eta + move, eta)
            trial = self.point(new, point.s + moves.T * self.scale[:, None])
            value = self._relaxing_cost(trial, weight)
            if np.isfinite(value) and value < cost:
                fell, eta, point, cost = cost - value, new, trial, value
                damping /= 10
                if fell < _RELAXED_CHANGE * cost:
                    break
            else:
                damping *= 8
        return eta, point

    def _errors(self, point: Point) -> NDArray[np.float64]:
        """Return the weighted errors at the samples of each segment, (L + 1, ny, S), or NaN."""
        e = np.full(point.y.shape, np.nan)
        interval, segment = self.segments.place
        e[interval, :, segment] = self.segments.y
        return np.asarray((e - point.y) / self.std[:, None])

    def _relaxing_cost(self, point: Point, weight: float) -> float:
        """Return the sum of the squares of the errors and of the weighted defects."""
        if not np.all(np.isfinite(point.y)):
            return np.inf
        return float(np.nansum(self._errors(point) ** 2) + weight * np.sum(point.defects**2))

    def _relaxing_step(self, point: Point, weight: float, damping: float) -> tuple[Vector, Matrix]:
        """Return the damped change of eta, and of s (S, n).

        The states of a segment occur only in its errors and in its two defects. Their normal
        equations are therefore banded, and eta follows from the Schur complement.
        """
        d, n, S = len(self.names), self.scale.size, point.s.shape[1]
        e, J = self._errors(point), point.y_by / self.std[:, None, None]
        finite = np.isfinite(e)
        A = np.moveaxis(J * finite[:, :, None], 3, 0).reshape(S, -1, d + n)
        right = np.moveaxis(np.where(finite, e, 0.0), 2, 0).reshape(S, -1, 1)
        weights = weight * np.append(~point.first[1:], False)[:, None]
        E, by = weights[:, :, None] * point.end_by, np.swapaxes(point.end_by, 1, 2)
        G = np.swapaxes(A, 1, 2) @ A + by @ E
        g = (np.swapaxes(A, 1, 2) @ right - by @ (weights * point.defects)[..., None])[..., 0]
        # The start of a segment occurs in the defect of the segment before.
        G[1:, range(d, d + n), range(d, d + n)] += weights[:-1]
        G[1:, d:, :d] -= E[:-1, :, :d]
        g[1:, d:] += (weights * point.defects)[:-1]
        band = np.zeros((2 * n, S * n))
        for p, q in np.ndindex(n, n):
            if p >= q:
                band[p - q, q::n] = G[:, d + p, d + q]
            band[n + p - q, q::n][:-1] = -E[:-1, p, d + q]
        band[0] = np.maximum((1 + damping) * band[0], 1e-300)
        cross = G[:, d:, :d].reshape(S * n, d)
        X = solveh_banded(band, np.column_stack([cross, g[:, d:].ravel()]), lower=True)
        H, sizes = np.sum(G[:, :d, :d], axis=0), np.einsum("sii->i", G[:, :d, :d])
        H += np.diag(damping * np.where(sizes > 0, sizes, 1.0)) - cross.T @ X[:, :d]
        move = np.linalg.lstsq(H, np.sum(g[:, :d], axis=0) - cross.T @ X[:, d], rcond=None)[0]
        return move, (X[:, d] - X[:, :d] @ move).reshape(S, n)

    def condense(self, point: Point) -> tuple[Matrix, NDArray[np.float64]]:
        """Return errors (N, ny) of nearly joined segments, and their derivatives by z (N, ny, …).

        An error is a measured minus a simulated output, NaN where an output is missing.
        """
        d, n, rows = len(self.names), self.scale.size, self.segments.rows
        by, joining = point.chain()
        along = np.einsum("ljis,sik->ljks", point.y_by[:, :, d:], by)
        along[:, :, :d] += point.y_by[:, :, :d]
        ordered = self.segments.in_order(along)
        J = np.zeros((*self.segments.y.shape, d + n * len(rows)))
        J[..., :d] = ordered[..., :d]
        for i, part in enumerate(rows):
            J[part, :, d + n * i : d + n * (i + 1)] = ordered[part, :, d:]
        # The last, small defects are removed to first order.
        left = np.einsum("ljis,si->ljs", point.y_by[:, :, d:], joining)
        return self.segments.y - self.segments.in_order(point.y + left), J

    def joined(self, z: Vector) -> Point | None:
        """Return the point of trajectories without defects, or None if there is none."""
        d, (_, at, near) = len(self.names), self.best
        if near is None:
            return None
        experiment = self.segments.experiment
        x0, before = (v[d:].reshape(-1, self.scale.size)[experiment] for v in (z, at))
        move = np.hstack([np.tile(z[:d] - at[:d], (experiment.size, 1)), x0 - before])
        s = near.s + (near.chain()[0] @ move[..., None])[..., 0].T * self.scale[:, None]
        s[:, near.first] = x0[near.first].T * self.scale[:, None]
        is_known = near.steps == self.steps and np.array_equal(z, at)
        point = near if is_known else self.point(z[:d], s)
        for _ in range(_MAX_JOINS):
            if not (np.all(np.isfinite(s)) and np.all(np.isfinite(point.y))):
                return None
            if np.max(np.abs(point.defects), initial=0.0) <= _JOINED:
                return point
            s = s + point.chain()[1].T * self.scale[:, None]
            point = self.point(z[:d], s)
        return None

    def _point_at(self, z: Vector) -> Point:
        point = self.joined(z)
        if point is None:
            raise InputError(
                "the search ended at parameters whose outputs are not finite, or so sensitive to "
                "the initial state that the record cannot be followed: begin nearer, or give "
                "shorter experiments"
            )
        self.best = self.best[0], z.copy(), point
        return point

    def residuals(self, z: Vector) -> Matrix:
        """Return measured minus simulated outputs (N, ny), NaN where an output is missing."""
        return self.condense(self._point_at(z))[0]

    def linearise(self, z: Vector) -> tuple[Vector, Matrix]:
        """Return residuals and derivatives of the joined trajectories."""
        point = self.joined(z)
        if point is None:
            M = int(np.count_nonzero(np.isfinite(self.segments.y)))
            return np.full(M, np.inf), np.zeros((M, z.size))
        errors, derivatives = self.condense(point)
        finite = np.isfinite(errors)
        e, J = (errors / self.std)[finite], (derivatives / self.std[:, None])[finite]
        cost = float(e @ e)
        if cost <= self.best[0]:
            self.best = cost, z.copy(), point
        return e, J

    def searched(self, z: Vector, most: int = MAX_STEPS) -> Optimum:
        """Return the minimum that a search from z finds, inside the box."""
        free = np.full(z.size - self.box.low.size, np.inf)
        walls = Box(low=np.append(self.box.low, -free), high=np.append(self.box.high, free))
        return levenberg_marquardt(
            self.linearise,
            walls.inside(z, z),
            admissible=lambda _: True,
            most=most,
            walls=walls,
            error=DERIVATIVE_ERROR,
        )

    def at(self, z: Vector, held: Sequence[str] = ()) -> tuple[Matrix, Vector, list[Matrix]]:
        """Return derivatives without the parts that the initial states explain, and two factors.

        The derivatives (M, d) of the M measured values, divided by `std`, are with respect to the
        coordinates of the free parameters and then of those in `held`. A derivative of which only
        rounding remains is 0. The factors are the derivative of each parameter with respect to its
        coordinate, and an orthonormal basis of each experiment's responses to its initial state.
        """
        values, n, point = self.fixed | self.values(z), self.scale.size, self._point_at(z)
        wide = replace(self, names=(*self.names, *held))
        eta = wide.coordinates.of([values[name] for name in wide.names])
        e, derivatives = wide.condense(wide.point(eta, point.s) if held else point)
        finite = np.isfinite(e)
        J = (derivatives / self.std[:, None])[finite]
        edges = np.cumsum([0, *(np.count_nonzero(finite[part]) for part in self.segments.rows)])
        Psi, spans = J[:, : eta.size].copy(), []
        for i, (a, b) in enumerate(pairwise(edges)):
            free = J[a:b, eta.size + n * i : eta.size + n * (i + 1)]
            basis = orthonormal(free, DERIVATIVE_ERROR)
            Psi[a:b] = basis.without(Psi[a:b])
            spans.append(basis.Q)
        size = np.linalg.norm(J[:, : eta.size], axis=0)
        Psi[:, np.linalg.norm(Psi, axis=0) <= DERIVATIVE_ERROR * size] = 0.0
        return Psi, wide.coordinates.slopes(eta), spans

    def from_rest(self, eta: Vector) -> Vector:
        """Return coordinates of trajectories from the initial states 0, and begin with these."""
        n, experiments = self.scale.size, len(self.segments.rows)
        z = np.append(eta, np.zeros(n * experiments))
        self.best = np.inf, z, self.point(eta, np.zeros((n, self.segments.experiment.size)))
        return z

    def start_states(self, eta: Vector) -> Matrix:
        """Return states at the start of each segment; set enough steps and the states' scale.

        The states minimise the relaxed problem for given parameters. The search for them begins
        with the states that a segment from 0 reaches in one segment's time.
        """
        values, course = self.fixed | self.values(eta), self.segments.course
        for _ in range(_MAX_BEGINNINGS):
            alone = replace(self, names=(), fixed=values, box=Box(low=_NOTHING, high=_NOTHING))
            s = np.zeros((self.scale.size, self.segments.experiment.size))
            # A segment that starts at 0 ends near the states of the next, unless they integrate.
            ends = self.model.integrate(course, s[:, None], values, self.steps).end[:, 0]
            s[:, 1:] = np.where(self.segments.first[1:], 0.0, ends[:, :-1])
            point = alone.point(_NOTHING, np.nan_to_num(s, posinf=0, neginf=0))
            s = alone.relax(_NOTHING, point, _WEIGHTS[0] * self.length)[1].s
            sizes = np.max(np.abs(s), axis=1)
            # An offset of 0 would have no scale.
            has_scale = np.isfinite(sizes) & (sizes > 0) & [x != OFFSET for x in self.model.states]
            before, steps = self.scale, self.steps
            self.scale = np.where(has_scale, sizes, 1.0)
            self.steps, _ = self.model.steps_and_error(course, s, values, least=steps)
            if steps == self.steps and np.all(np.abs(np.log(self.scale / before)) < 1):
                break
        return s

    def solver_error(self, z: Vector, allowed: Vector) -> tuple[int, Vector]:
        """Return enough steps and the solver's error of each output at the coordinates z.

        With enough steps, their doubling changes the outputs by at most `allowed`.
        """
        course, s, values = self.segments.course, self._point_at(z).s, self.fixed | self.values(z)
        return self.model.steps_and_error(course, s, values, least=self.steps, allowed=allowed)
