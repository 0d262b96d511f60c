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
from armrig_core.rig.equations import Course, Ode, Parameter, integrated, steps_and_error
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
    spread: Vector
    """Standard deviation of each output, (ny,)."""
    length: int
    """Samples of a segment."""
    steps: int = 1
    """Runge-Kutta steps of an interval."""
    scale: Vector
    """Magnitude of each state, (n,)."""
    segments: tuple[Segments, ...] = ()
    box: Box
    """Walls of the coordinates of the parameters."""
    best: tuple[float, Vector, tuple[Point, ...]] = field(
        default=(np.inf, _NOTHING, ()), init=False
    )
    """Cost, coordinates and points of the best joined trajectories so far."""

    @property
    def coordinates(self) -> Coordinates:
        """Coordinates of the free parameters."""
        own = [self.ode.parameters[name] for name in self.names]
        return Coordinates(parameters=tuple(p for p in own if isinstance(p, Parameter)))

    def changed(self, **fields: Any) -> Shooting:
        """Return the problem with other fields; the trajectories found so far remain its start."""
        new = replace(self, **fields)
        new.best = (np.inf, *self.best[1:])
        return new

    def values(self, z: Vector) -> dict[str, float]:
        """Return the values of the free parameters."""
        found = self.coordinates.values(z[: len(self.names)])
        return {k: float(v) for k, v in zip(self.names, found, strict=True)}

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
        )

    def relaxed(self, eta: Vector, starts: Sequence[Matrix]) -> Vector:
        """Return coordinates near the minimum of the relaxed problem.

        The trajectories found there are the start of the joined ones.
        """
        points = [self.point(eta, p, s) for p, s in zip(self.segments, starts, strict=True)]
        for weight in _WEIGHTS:
            eta, points = self.relax(eta, points, weight * self.length)
        z = np.concatenate([eta, *(p.s[:, 0] / self.scale for p in points)])
        self.best = np.inf, z, tuple(points)
        return z

    def relax(self, eta: Vector, points: list[Point], weight: float) -> tuple[Vector, list[Point]]:
        """Return coordinates and points of a lower cost for one weight of the defects."""
        cost, damping = self._relaxed_cost(points, weight), 1e-4
        for _ in range(_MAX_RELAXED):
            move, moves = self._relaxed_step(points, weight, damping)
            if not moves:
                break
            new = self.box.inside(eta + move, eta)
            found = [
                self.point(new, part, p.s + of_states.T * self.scale[:, None])
                for part, p, of_states in zip(self.segments, points, moves, strict=True)
            ]
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

    def _relaxed_step(
        self, points: Sequence[Point], weight: float, damping: float
    ) -> tuple[Vector, list[Matrix]]:
        """Return the damped change of eta, and of s (S, n) of each experiment; [] without any.

        The states of a segment occur only in its errors and in its two defects. The least-squares
        problem is therefore solved by an orthogonal elimination of the states, segment by segment.
        """
        d, n, join = len(self.names), self.scale.size, np.sqrt(weight)
        blocks, rows, sizes = [], [], np.zeros(d)
        for point, part in zip(points, self.segments, strict=True):
            e, J = (part.y - point.y) / self.std[:, None], point.y_by / self.std[:, None, None]
            known = np.isfinite(e)
            whole = np.concatenate([J * known[:, :, None], np.where(known, e, 0.0)[:, :, None]], 2)
            # Columns: the states, eta, and the right side.
            stacked = np.moveaxis(whole.reshape(-1, *whole.shape[2:]), 2, 0)
            order = [*range(d, d + n), *range(d), d + n]
            own = np.asarray(np.linalg.qr(stacked[..., order], "r"))
            ends = join * np.concatenate([point.end_by[..., d:], point.end_by[..., :d]], 2)
            squares = np.sum(own[..., :-1] ** 2, axis=1)
            squares[:-1] += np.sum(ends[:-1] ** 2, axis=1)
            squares[1:, :n] += weight
            sizes += np.sum(squares[:, n:], axis=0)
            carry, eliminated = np.zeros((0, n + d + 1)), []
            for i, (R, end) in enumerate(zip(own, ends, strict=True)):
                above = np.vstack([R, carry, np.zeros((n, n + d + 1))])
                above[-n:, :n] = np.diag(np.sqrt(damping * np.maximum(squares[i, :n], 1e-300)))
                # A column block for the states of the next segment.
                above = np.insert(above, [n] * n, 0.0, axis=1)
                if i + 1 < own.shape[0]:
                    defect = np.concatenate(
                        [end[:, :n], -join * np.eye(n), end[:, n:], -join * point.defects[[i]].T], 1
                    )
                    above = np.vstack([above, defect])
                R = np.asarray(np.linalg.qr(above, "r"))
                eliminated.append(R[:n])
                carry = R[n:, n:]
            blocks.append(eliminated)
            rows.append(carry[:, n:])
        sizes[sizes == 0] = 1.0
        A = np.vstack([*rows, np.pad(np.diag(np.sqrt(damping * sizes)), ((0, 0), (0, 1)))])
        if not np.all(np.isfinite(A)):
            return np.zeros(d), []
        move = np.linalg.lstsq(A[:, :d], A[:, d], rcond=None)[0]
        moves = []
        for eliminated in blocks:
            after, of_states = np.zeros(n), []
            for R in reversed(eliminated):
                right = R[:, -1] - R[:, n : 2 * n] @ after - R[:, 2 * n : -1] @ move
                after = solve_triangular(R[:, :n], right)
                of_states.append(after)
            moves.append(np.array(of_states[::-1]))
        return move, moves

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
        eta, n, found = z[: len(self.names)], self.scale.size, []
        _, at, points = self.best
        for i, (part, near) in enumerate(zip(self.segments, points, strict=True)):
            own = slice(eta.size + n * i, eta.size + n * (i + 1))
            move = np.append(eta - at[: eta.size], z[own] - at[own])
            s = near.s + (near.states_by() @ move).T * self.scale[:, None]
            s[:, 0] = z[own] * self.scale
            point = self._joined(eta, part, s)
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
            if np.max(np.abs(point.defects), initial=0.0) <= _JOINED:
                return point
            s = s + point.joining().T * self.scale[:, None]
        return None

    def linearise(self, z: Vector) -> tuple[Vector, Matrix]:
        """Return residuals and derivatives of the joined trajectories."""
        points = self.joined(z)
        if points is None:
            M = sum(int(np.count_nonzero(data.valid)) for data in self.experiments)
            return np.full(M, np.inf), np.zeros((M, z.size))
        e, J = self._condensed(points)
        cost = float(e @ e)
        if cost <= self.best[0]:
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
            [np.append(x0 * self.scale, 0.0) for x0 in z[d:].reshape(-1, n)],
        )

    def starts(self, eta: Vector) -> list[Matrix]:
        """Return states at the start of each segment, from the data near the segment.

        The states minimise the relaxed problem for given parameters. The search begins with the
        states that a segment from 0 reaches in one segment's time.
        """
        values, nothing = self.fixed | self.values(eta), np.zeros(0)
        alone = replace(self, names=(), fixed=values, box=Box(low=nothing, high=nothing))
        n, points = self.scale.size, []
        for part in self.segments:
            S = part.course.u.shape[2]
            # A segment that starts at 0 ends near the states of the next, unless they integrate.
            ends = integrated(self.ode, part.course, np.zeros((n, 1, S)), values, self.steps).end
            s = np.column_stack([np.zeros(n), ends[:, 0, :-1]])
            points.append(alone.point(nothing, part, np.nan_to_num(s, posinf=0, neginf=0)))
        return [p.s for p in alone.relax(nothing, points, _WEIGHTS[0] * self.length)[1]]

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
