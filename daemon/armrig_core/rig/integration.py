"""Integration of own equations: many trajectories at once, by Runge and Kutta's method.

A trajectory is a column: the segments of multiple shooting, each at the nominal point and at each
perturbed point. An array of states has the axes state, point, segment.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from armrig_core.errors import InputError

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
MAX_STEPS = 64
"""Largest number of Runge-Kutta steps in an interval."""
STEP_TOLERANCE = 1e-3
"""Largest change of the outputs if the steps are doubled, as a share of the outputs' deviation."""
SIMULATION_TOLERANCE = 1e-6
"""The same for a simulation."""


class System(Protocol):
    """Own equations, see `Ode`."""

    @property
    def f(self) -> Callable[..., Any]:
        """Function of (t, x, u, p)."""

    @property
    def output(self) -> Callable[..., Any]:
        """Function of (t, x, u, p)."""

    @property
    def states(self) -> Sequence[str]:
        """Names of the states."""

    @property
    def point(self) -> Callable[..., Any]:
        """Class of p."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """Inputs of segments of equal length."""

    u: Matrix
    """Input at each sample and at the end of the last interval, (L + 1, nu, S)."""
    t: Matrix
    """Time of each sample, (L + 1, S)."""
    Ts: float
    linear: tuple[bool, ...]
    """True for an input that is a straight line between samples, False if it is held."""

    @classmethod
    def of(cls, u: Matrix, Ts: float) -> Course:
        """Return the course of held inputs (N, nu) as a single segment."""
        t = Ts * np.arange(u.shape[0], dtype=np.float64)
        return cls(u=u[:, :, None], t=t[:, None], Ts=Ts, linear=(False,) * u.shape[1])


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectories:
    """Outputs of all trajectories, and their last states."""

    y: NDArray[np.float64]
    """Outputs at each sample, (L + 1, ny, points, S); the last belongs to the next segment."""
    end: NDArray[np.float64]
    """States after the last interval, (n, points, S)."""
    largest: Vector
    """Largest magnitude of each state, (n,)."""

    def outputs(self) -> Matrix:
        """Return the outputs (samples, points, ny) of one segment."""
        return np.moveaxis(self.y[..., 0], 1, 2)


def integrated(
    ode: System, course: Course, x: NDArray[np.float64], point: Mapping[str, Any], steps: int
) -> Trajectories:
    """Return the trajectories from the states x (n, points, S).

    A value of `point` is a number, or an array (points, 1). An input that is held jumps only at
    samples. The method has the order 4.
    """
    L = course.u.shape[0] - 1
    p = ode.point(**point)
    shape = x.shape[1:]
    h, linear = course.Ts / steps, any(course.linear)
    slope = np.zeros_like(course.u[0])
    largest, recorded = np.abs(x), []
    derivative = _checked(ode, shape)
    for k in range(L + 1):
        u, t = course.u[k][:, None, :], course.t[k]
        recorded.append(_outputs(ode, t, x, u, p, shape))
        if k == L:
            break
        if linear:
            slope = (course.u[k + 1] - course.u[k]) * np.array(course.linear)[:, None] / course.Ts
        for i in range(steps):
            a, b, c = t + i * h, t + (i + 0.5) * h, t + (i + 1) * h
            ua = ub = uc = u
            if linear:
                ua, ub, uc = (u + (s - t) * slope[:, None, :] for s in (a, b, c))
            k1 = derivative(a, x, ua, p)
            k2 = derivative(b, x + 0.5 * h * k1, ub, p)
            k3 = derivative(b, x + 0.5 * h * k2, ub, p)
            k4 = derivative(c, x + h * k3, uc, p)
            x = x + (h / 6) * (k1 + 2 * (k2 + k3) + k4)
        np.maximum(largest, np.abs(x), out=largest)
    return Trajectories(
        y=np.array(recorded), end=x, largest=np.max(largest.reshape(x.shape[0], -1), axis=1)
    )


def enough_steps(ode: System, course: Course, x: Matrix, point: Mapping[str, float]) -> int:
    """Return the smallest power of 2 of steps whose doubling does not change the outputs visibly.

    x (n, S) are the states at the start of each segment.
    """
    return steps_and_error(ode, course, x, point, share=SIMULATION_TOLERANCE)[0]


def steps_and_error(
    ode: System,
    course: Course,
    x: Matrix,
    point: Mapping[str, float],
    *,
    least: int = 1,
    share: float = STEP_TOLERANCE,
    allowed: Vector | None = None,
) -> tuple[int, Vector]:
    """Return the number of steps, and the change (ny,) of the outputs if the steps are doubled.

    The change is at most `share` of the outputs' deviation, or `allowed`; with the most steps a
    change of `STEP_TOLERANCE` is accepted.
    """
    steps, before = least, None
    while True:
        y = integrated(ode, course, x[:, None, :], point, steps).y
        if before is not None and np.all(np.isfinite(before)):
            change = np.max(np.abs(y - before), axis=(0, 2, 3))
            size = np.std(y, axis=(0, 2, 3)) + 1e-12 * np.max(np.abs(y), axis=(0, 2, 3)) + 1e-300
            limit = share * size if allowed is None else np.maximum(allowed, 1e-9 * size)
            if np.all(change <= limit):
                return steps // 2, change
            if steps > MAX_STEPS:
                if np.all(change <= STEP_TOLERANCE * size):
                    return MAX_STEPS, change
                raise InputError(
                    f"{MAX_STEPS} steps in each interval do not follow the equations: the output "
                    f"still changes by {np.max(change / size):.1g} of its deviation. A time "
                    "constant is much shorter than Ts, or a function jumps: make the width of the "
                    "friction larger, or replace the fast state by its steady value"
                )
        elif steps > MAX_STEPS:
            _where_not_finite(ode, y, course, point)
        before, steps = y, 2 * steps


def _where_not_finite(ode: System, y: Any, course: Course, point: Mapping[str, float]) -> None:
    """Refuse equations whose output is not finite, with the time at which it happens."""
    k, *_, s = (int(i[0]) for i in np.nonzero(~np.isfinite(y)))
    values = ", ".join(f"{name} = {float(value):.4g}" for name, value in point.items())
    raise InputError(
        f"the output is not finite from t = {course.t[k, s]:g} s on, with {values}: the equations "
        f"are unstable there, divide by 0, or have a time constant far below Ts/{MAX_STEPS}. Check "
        "their signs, or start nearer"
    )


def _checked(ode: System, shape: tuple[int, ...]) -> Any:
    """Return f as a function to an array (n, points, S), with sentences for its errors."""
    n, f = len(ode.states), ode.f

    def derivative(t: Any, x: Any, u: Any, p: Any) -> Any:
        x.flags.writeable = False
        try:
            found = f(t, x, u, p)
            if len(found) != n:
                raise InputError(
                    f"f returns {len(found)} values; there are {n} states: {', '.join(ode.states)}"
                )
            out = np.empty((n, *shape))
            for i in range(n):
                out[i] = found[i]
        except InputError:
            raise
        except Exception as err:
            raise InputError(_sentence("f", err)) from err
        return out

    return derivative


def _outputs(ode: System, t: Any, x: Any, u: Any, p: Any, shape: tuple[int, ...]) -> Any:
    try:
        found = ode.output(t, x, u, p)
        several = isinstance(found, list | tuple)
        rows = found if several else [found]
        out = np.empty((len(rows), *shape))
        for i, row in enumerate(rows):
            out[i] = row
    except Exception as err:
        raise InputError(_sentence("output", err)) from err
    return out


def _sentence(name: str, err: Exception) -> str:
    text = f"{name} raised {type(err).__name__}: {err}"
    if "ambiguous" in str(err):
        return f"{text}; x[i] are arrays of many trajectories: use numpy.where in place of if"
    if "read-only" in str(err):
        return f"{text}; {name} must not change its arguments: return new values"
    if isinstance(err, AttributeError):
        return f"{text}; the parameters are given by `parameters`"
    return text
