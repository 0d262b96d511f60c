"""Multiple shooting: the least-squares problem of own equations, segment by segment.

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
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.rig.equations import Ode, Parameter
from armrig_core.rig.integration import Course, integrated, steps_and_error
from scipy.linalg import solve_triangular

from armrig.data.columns import Matrix, Vector
from armrig.data.dataset import Signals
from armrig.physics.grey_box.least_squares_problem import (
    Linearised,
    without_free_responses,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

COLUMNS = 1500
"""Number of trajectories at which the time of an array operation equals its overhead."""
MIN_SEGMENT = 10  # least number of samples of a segment
_STEP = 1e-5  # step of a central difference, as a share of the coordinate's scale
_JOINED = 1e-5  # largest defect of joined segments, as a share of the state's magnitude
_MAX_JOINS = 12
_MAX_BEGINNINGS = 4
_WEIGHTS = (0.01, 0.1, 1.0, 1e2, 1e4, 1e7)
"""Weights of the defects of the relaxed problem, for each sample of a segment."""
_MAX_RELAXED = 12
_RELAXED_CHANGE = 1e-2  # relative change of the cost at which the relaxed problem is solved
_PRIOR = 1e-4  # weight of the simulated states in the start of the segments


@dataclass(frozen=True, slots=True, kw_only=True)
class Segments:
    """Data of an experiment in segments of equal length; the last segment may exceed the data."""

    course: Course
    y: NDArray[np.float64]
    """Outputs at the samples of each segment, (L, ny, S); NaN where there is none."""
    N: int

    @classmethod
    def of(cls, data: Signals, length: int) -> Segments:
        """Cut an experiment."""
        S = max(1, -(-(data.N - 1) // length))
        index = np.minimum(np.arange(length + 1)[:, None] + length * np.arange(S), data.N - 1)
        own = np.arange(length)[:, None] + length * np.arange(S)
        # The last sample begins no interval: it is the end of the last segment.
        y = np.full((length + 1, data.ny, S), np.nan)
        inside = own < data.N
        y[:length][inside.nonzero()[0], :, inside.nonzero()[1]] = data.y[own[inside]]
        if length * S < data.N:
            y[length, :, S - 1] = data.y[length * S]
        Ts = data.equidistant()
        return cls(
            course=Course(
                u=np.moveaxis(data.u[index], 1, 2),
                t=np.asarray(Ts * (np.arange(length + 1)[:, None] + length * np.arange(S))),
                Ts=Ts,
                linear=tuple(x == "foh" for x in data.intersample),
            ),
            y=y,
            N=data.N,
        )

    def in_order(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (L + 1, ny, …, S) as (N, ny, …), in the order of time."""
        body = np.moveaxis(values[:-1], -1, 0).reshape(-1, *values.shape[1:-1])[: self.N]
        return body if body.shape[0] == self.N else np.concatenate([body, values[-1:, ..., -1]])


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """Outputs and derivatives of the segments of an experiment, by eta and by their own states.

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
    """End of each segment minus the start of the next, (S - 1, n)."""
    largest: Vector
    """Largest magnitude of each state, (n,)."""

    def states_by(self) -> NDArray[np.float64]:
        """Return the derivatives of joined s with respect to (eta, x0), (S, n, d + n)."""
        S, n, d = *self.end_by.shape[:2], self.end_by.shape[2] - self.end_by.shape[1]
        found = np.zeros((S, n, d + n))
        found[0, :, d:] = np.eye(n)
        for i in range(S - 1):
            found[i + 1] = self.end_by[i, :, d:] @ found[i]
            found[i + 1, :, :d] += self.end_by[i, :, :d]
        return found

    def joining(self) -> Matrix:
        """Return the change of s that removes the defects, (S, n)."""
        S, n, d = *self.end_by.shape[:2], self.end_by.shape[2] - self.end_by.shape[1]
        found = np.zeros((S, n))
        for i in range(S - 1):
            found[i + 1] = self.end_by[i, :, d:] @ found[i] + self.defects[i]
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Coordinates:
    """Coordinates of the free parameters, in which the search has no bounds.

    With a lower bound p = low + exp(eta); with an upper one p = high - exp(-eta). With both bounds
    eta = ln((p - low)/(high - p)). Without bounds p = eta |start|, or p = eta if the start is 0.
    """

    parameters: tuple[Parameter, ...]

    def of(self, values: Sequence[float]) -> Vector:
        """Return the coordinates of values."""
        return np.array([_coordinate(p, v) for p, v in zip(self.parameters, values, strict=True)])

    def values(self, eta: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return the values at coordinates (d, …)."""
        return [_value(p, x) for p, x in zip(self.parameters, eta, strict=True)]

    def slopes(self, eta: Vector) -> Vector:
        """Return the derivative of each value with respect to its coordinate."""
        up, down = self.values(eta + _STEP), self.values(eta - _STEP)
        return np.array([(a - b) / (2 * _STEP) for a, b in zip(up, down, strict=True)])

    def bounded(self) -> NDArray[np.bool_]:
        """Return True for each parameter with a bound."""
        return np.array([np.isfinite(p.low) or np.isfinite(p.high) for p in self.parameters])


def _coordinate(p: Parameter, value: float) -> float:
    if np.isfinite(p.low) and np.isfinite(p.high):
        return float(np.log((value - p.low) / (p.high - value)))
    if np.isfinite(p.low):
        return float(np.log(value - p.low))
    if np.isfinite(p.high):
        return float(-np.log(p.high - value))
    return value / (abs(p.value) or 1.0)


def _value(p: Parameter, x: NDArray[np.float64]) -> NDArray[np.float64]:
    if np.isfinite(p.low) and np.isfinite(p.high):
        return np.asarray(p.low + (p.high - p.low) / (1 + np.exp(-x)))
    if np.isfinite(p.low):
        return np.asarray(p.low + np.exp(x))
    if np.isfinite(p.high):
        return np.asarray(p.high - np.exp(-x))
    return np.asarray(x * (abs(p.value) or 1.0))


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

    ode: Ode
    names: tuple[str, ...]
    """Free parameters."""
    fixed: dict[str, float]
    """Values of all other parameters."""
    experiments: tuple[Signals, ...]
    std: Vector
    """Standard deviation of the noise of each output, (ny,)."""
    length: int
    """Samples of a segment."""
    steps: int = 1
    """Runge-Kutta steps of an interval."""
    scale: Vector
    """Magnitude of each state, (n,)."""
    segments: tuple[Segments, ...] = ()
    box: Box
    """Walls of the coordinates of the parameters."""
    best: tuple[float, Vector, tuple[Point, ...]] | None = field(default=None, init=False)
    """Cost, coordinates and points of the best joined trajectories so far."""

    @property
    def coordinates(self) -> Coordinates:
        """Coordinates of the free parameters."""
        own = [self.ode.parameters[name] for name in self.names]
        return Coordinates(parameters=tuple(p for p in own if isinstance(p, Parameter)))

    def changed(self, **fields: Any) -> Shooting:
        """Return the problem with other fields; the trajectories found so far remain its start."""
        new = replace(self, **fields)
        if self.best is not None:
            new.best = (np.inf, *self.best[1:])
        return new

    def values(self, z: Vector) -> dict[str, float]:
        """Return the values of the free parameters."""
        found = self.coordinates.values(z[: len(self.names)])
        return {k: float(v) for k, v in zip(self.names, found, strict=True)}

    def initial(self, z: Vector) -> list[Vector]:
        """Return the initial state of each experiment."""
        return list((z[len(self.names) :].reshape(len(self.experiments), -1)) * self.scale)

    def packed(self, eta: Vector, initial: Sequence[Vector]) -> Vector:
        """Return the coordinates of parameters and initial states."""
        return np.concatenate([eta, *(x / self.scale for x in initial)])

    def point(self, eta: Vector, part: Segments, s: Matrix) -> Point:
        """Integrate the segments of an experiment, with all derivatives."""
        d, n, h = eta.size, s.shape[0], _STEP
        points = 1 + 2 * (d + n)
        grid = np.repeat(eta[:, None], points, axis=1)
        x = np.repeat(s[:, None, :], points, axis=1)
        for j in range(d):
            grid[j, 1 + 2 * j] += h
            grid[j, 2 + 2 * j] -= h
        for i in range(n):
            x[i, 1 + 2 * (d + i)] += h * self.scale[i]
            x[i, 2 + 2 * (d + i)] -= h * self.scale[i]
        values = self.coordinates.values(grid)
        all_values = self.fixed | {k: v[:, None] for k, v in zip(self.names, values, strict=True)}
        found = integrated(self.ode, part.course, x, all_values, self.steps)
        end_by = (found.end[:, 1::2] - found.end[:, 2::2]) / (2 * h) / self.scale[:, None, None]
        return Point(
            s=s,
            y=found.y[:, :, 0],
            y_by=(found.y[:, :, 1::2] - found.y[:, :, 2::2]) / (2 * h),
            end_by=np.moveaxis(end_by, 2, 0),
            defects=((found.end[:, 0, :-1] - s[:, 1:]) / self.scale[:, None]).T,
            largest=found.largest / self.scale,
        )

    def relaxed(self, eta: Vector, starts: Sequence[Matrix]) -> Vector:
        """Return coordinates near the minimum of the relaxed problem.

        The trajectories found there are the start of the joined ones.
        """
        points = [self.point(eta, p, s) for p, s in zip(self.segments, starts, strict=True)]
        for weight in _WEIGHTS:
            eta, points = self._relaxed(eta, points, weight * self.length)
        z = self.packed(eta, [p.s[:, 0] for p in points])
        self.best = np.inf, z, tuple(points)
        return z

    def _relaxed(
        self, eta: Vector, points: list[Point], weight: float
    ) -> tuple[Vector, list[Point]]:
        """Return coordinates and points of a lower cost for one weight of the defects."""
        cost, damping, d = self._relaxed_cost(points, weight), 1e-4, eta.size
        for _ in range(_MAX_RELAXED):
            A, b = self._relaxed_equations(points, weight)
            if not np.all(np.isfinite(A)):
                break
            size = np.linalg.norm(A, axis=0)
            size[size == 0] = 1.0
            damped = np.vstack([A / size, np.sqrt(damping) * np.eye(size.size)])
            Q, R = np.linalg.qr(damped)
            move = solve_triangular(R, Q[: b.size].T @ b) / size
            states, begin = [], d
            for p in points:
                own = move[begin : begin + p.s.size].reshape(p.s.shape[::-1])
                states.append(p.s + own.T * self.scale[:, None])
                begin += p.s.size
            new = self.box.inside(eta + move[:d], eta)
            found = [self.point(new, p, s) for p, s in zip(self.segments, states, strict=True)]
            value = self._relaxed_cost(found, weight)
            if np.isfinite(value) and value < cost:
                fell, eta, points, cost = cost - value, new, found, value
                damping /= 10
                if fell < _RELAXED_CHANGE * cost:
                    break
            else:
                damping *= 8
        return eta, points

    def _relaxed_cost(self, points: Sequence[Point], weight: float) -> float:
        """Return the sum of the squares of the errors and of the weighted defects."""
        cost = 0.0
        for point, part in zip(points, self.segments, strict=True):
            e = (part.y - point.y) / self.std[:, None]
            cost += float(np.nansum(e**2)) + weight * float(np.sum(point.defects**2))
            if not np.all(np.isfinite(point.y)):
                return np.inf
        return cost

    def _relaxed_equations(self, points: Sequence[Point], weight: float) -> tuple[Matrix, Vector]:
        """Return matrix and right side of the linear equations for eta and all s."""
        d, n = len(self.names), self.scale.size
        columns, begin = d + sum(p.s.size for p in points), d
        rows, right = [], []
        for point, part in zip(points, self.segments, strict=True):
            for i in range(point.s.shape[1]):
                known = np.isfinite(part.y[..., i])
                J = point.y_by[..., i] / self.std[:, None]
                e = (part.y - point.y)[..., i] / self.std
                # The triangular factor has the same normal equations with fewer rows.
                R: Matrix = np.asarray(np.linalg.qr(np.column_stack([J[known], e[known]]), "r"))
                own = slice(begin + n * i, begin + n * (i + 1))
                block = np.zeros((R.shape[0], columns))
                block[:, :d], block[:, own] = R[:, :d], R[:, d:-1]
                rows.append(block)
                right.append(R[:, -1])
                if i + 1 < point.s.shape[1]:
                    join = np.zeros((n, columns))
                    join[:, :d], join[:, own] = point.end_by[i, :, :d], point.end_by[i, :, d:]
                    join[:, own.stop : own.stop + n] = -np.eye(n)
                    rows.append(np.sqrt(weight) * join)
                    right.append(-np.sqrt(weight) * point.defects[i])
            begin += point.s.size
        return np.vstack(rows), np.concatenate(right)

    def _condensed(self, points: Sequence[Point]) -> tuple[Vector, Matrix]:
        """Return errors of joined segments, and their derivatives with respect to z."""
        d, n = len(self.names), self.scale.size
        errors, blocks = [], []
        for i, (point, part, data) in enumerate(
            zip(points, self.segments, self.experiments, strict=True)
        ):
            along = np.einsum("ljis,sik->ljks", point.y_by[:, :, d:], point.states_by())
            along[:, :, :d] += point.y_by[:, :, :d]
            J = np.zeros((*data.y.shape, d + n * len(points)))
            ordered = part.in_order(along)
            J[..., :d], J[..., d + n * i : d + n * (i + 1)] = ordered[..., :d], ordered[..., d:]
            # The last, small defects are removed to first order.
            left = np.einsum("ljis,si->ljs", point.y_by[:, :, d:], point.joining())
            e = (data.y - part.in_order(point.y + left)) / self.std
            errors.append(e.T[data.valid.T])
            blocks.append((J / self.std[:, None])[data.valid.T.nonzero()[::-1]])
        return np.concatenate(errors), np.vstack(blocks)

    def joined(self, z: Vector) -> tuple[Point, ...] | None:
        """Return the points of trajectories without defects, or None if there are none."""
        eta, initial = z[: len(self.names)], self.initial(z)
        near = self.best
        found = []
        for i, (part, x0) in enumerate(zip(self.segments, initial, strict=True)):
            if near is None:
                s = self.simulated(eta, part, x0)
            else:
                _, at, points = near
                n = x0.size
                own = slice(eta.size + n * i, eta.size + n * (i + 1))
                move = np.append(eta - at[: eta.size], z[own] - at[own])
                s = points[i].s + (points[i].states_by() @ move).T * self.scale[:, None]
                s[:, 0] = x0
            point = self._joined(eta, part, s)
            if point is None and near is None:
                point = self._joined(eta, part, self.simulated(eta, part, x0))
            if point is None:
                return None
            found.append(point)
        return tuple(found)

    def _joined(self, eta: Vector, part: Segments, s: Matrix) -> Point | None:
        for _ in range(_MAX_JOINS):
            if not np.all(np.isfinite(s)):
                return None
            point = self.point(eta, part, s)
            if not np.all(np.isfinite(point.y)):
                return None
            worst = np.max(np.abs(point.defects) / point.largest, initial=0.0)
            if worst <= _JOINED:
                return point
            s = s + point.joining().T * self.scale[:, None]
        return None

    def simulated(self, eta: Vector, part: Segments, x0: Vector) -> Matrix:
        """Return the states at the start of each segment, integrated one after another."""
        values = self.fixed | {
            k: float(v) for k, v in zip(self.names, self.coordinates.values(eta), strict=True)
        }
        x, course = x0[:, None, None], part.course
        states = [x0]
        for i in range(course.u.shape[2] - 1):
            own = Course(
                u=course.u[:, :, [i]], t=course.t[:, [i]], Ts=course.Ts, linear=course.linear
            )
            x = integrated(self.ode, own, x, values, self.steps).end
            states.append(x[:, 0, 0])
        return np.array(states).T

    def linearise(self, z: Vector) -> tuple[Vector, Matrix]:
        """Return residuals and derivatives of the joined trajectories."""
        points = self.joined(z)
        if points is None:
            M = sum(int(np.count_nonzero(data.valid)) for data in self.experiments)
            return np.full(M, np.inf), np.zeros((M, z.size))
        e, J = self._condensed(points)
        cost = float(e @ e)
        if self.best is None or cost <= self.best[0]:
            self.best = cost, z.copy(), points
        return e, J

    def at(self, z: Vector) -> Linearised:
        """Return residuals, and derivatives without the parts that the initial states explain."""
        e, J = self.linearise(z)
        d, n = len(self.names), len(self.ode.states)
        return without_free_responses(
            e,
            J,
            d,
            self.experiments,
            [slice(d + n * i, d + n * (i + 1)) for i in range(len(self.experiments))],
            [np.append(x0, 0.0) for x0 in self.initial(z)],
        )

    def starts(self, eta: Vector) -> list[Matrix]:
        """Return states at the start of each segment, from the segment's own data.

        The states minimise the errors of the segment, plus a small multiple of their squared
        distance from the end of the segment before, if that starts at 0.
        """
        found = []
        n = self.scale.size
        for part, data in zip(self.segments, self.experiments, strict=True):
            S = part.course.u.shape[2]
            values = self.fixed | self.values(eta)
            # A segment that starts at 0 ends near the states of the next, unless they integrate.
            ends = integrated(self.ode, part.course, np.zeros((n, 1, S)), values, self.steps).end[
                :, 0
            ]
            prior = np.nan_to_num(np.column_stack([np.zeros(n), ends[:, :-1]]), posinf=0, neginf=0)
            s = prior
            weight = np.sqrt(_PRIOR * part.y.shape[0]) * np.eye(n)
            for _ in range(3):
                x = np.repeat(s[:, None, :], 1 + 2 * n, axis=1)
                for i in range(n):
                    x[i, 1 + 2 * i] += _STEP * self.scale[i]
                    x[i, 2 + 2 * i] -= _STEP * self.scale[i]
                y = integrated(self.ode, part.course, x, values, self.steps).y
                by = (y[:, :, 1::2] - y[:, :, 2::2]) / (2 * _STEP)
                spread = np.maximum(np.nanstd(data.y, axis=0), self.std)
                e = (part.y - y[:, :, 0]) / spread[:, None]
                moved = s.copy()
                for i in range(S):
                    known = np.isfinite(e[..., i])
                    J = (
                        np.moveaxis(by[..., i], 2, 0).reshape(n, -1).T
                        / np.tile(spread, by.shape[0])[:, None]
                    )
                    J, own = J[known.ravel()], e[..., i][known]
                    back = (prior[:, i] - s[:, i]) / self.scale
                    A, b = np.vstack([J, weight]), np.append(own, weight @ back)
                    if np.all(np.isfinite(A)) and np.all(np.isfinite(b)):
                        move = np.linalg.lstsq(A, b, rcond=None)[0]
                        moved[:, i] += self.scale * move
                s = moved
            found.append(s)
        return found

    def begun(self, eta: Vector) -> list[Matrix]:
        """Return states at the start of each segment; set enough steps and the states' scale."""
        values = self.fixed | self.values(eta)
        for _ in range(_MAX_BEGINNINGS):
            starts = self.starts(eta)
            sizes = np.max([np.max(np.abs(s), axis=1) for s in starts], axis=0)
            known = np.isfinite(sizes) & (sizes > 0)
            self.scale, before = np.where(known, sizes, 1.0), self.scale
            steps = self.steps
            for part, s in zip(self.segments, starts, strict=True):
                steps = max(steps, steps_and_error(self.ode, part.course, s, values)[0])
            settled = steps == self.steps and np.all(np.abs(np.log(self.scale / before)) < 1)
            self.steps = steps
            if settled:
                break
        return starts

    def solver_error(self, z: Vector, allowed: Vector) -> tuple[int, Vector]:
        """Return enough steps and the solver's error of each output at the coordinates z.

        With enough steps, their doubling changes the outputs by at most `allowed`.
        """
        values = self.fixed | self.values(z)
        steps, error = self.steps, np.zeros(self.std.size)
        for part, point in zip(self.segments, self.joined(z) or (), strict=False):
            m, change = steps_and_error(
                self.ode, part.course, point.s, values, least=self.steps, allowed=allowed
            )
            steps, error = max(steps, m), np.maximum(error, change)
        return steps, error
