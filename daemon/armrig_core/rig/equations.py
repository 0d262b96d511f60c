"""Own equations of a plant, and their integration by Runge and Kutta's method.

Many trajectories are integrated at once. A trajectory is a column: the segments of multiple
shooting, each at the nominal point and at each perturbed point. An array of states has the axes
state, point, segment.
"""

from __future__ import annotations

import keyword
from collections import namedtuple
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armrig_core.errors import InputError, InputTypeError
from armrig_core.process.printable import plural

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Derivative = Callable[[Any, Any, Any, Any], Any]
"""Function f(t, x, u, p): x' of the states, or the output."""

MAX_STEPS = 64
"""Largest number of Runge-Kutta steps in an interval."""
STEP_TOLERANCE = 1e-3
"""Largest change of the outputs if the steps are doubled, as a share of the outputs' deviation."""
_WHOLE = 1e-9  # share of Ts below which a dead time is a multiple of Ts
_SIMULATED = 1e-6  # the same for a simulation
_BOUNDED = 1e-12  # least distance of a start from its bound, as a share of the value


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of own equations, with the value at which the estimation starts.

    Examples
    --------
    >>> import armrig
    >>> armrig.Parameter(1.7e-3, "kg m²", low=0)
    Parameter(value=0.0017, unit='kg m²', low=0, high=inf)
    """

    value: float
    """Value, at which the estimation starts."""
    unit: str = ""
    """Unit, for texts."""
    low: float = -np.inf
    """Lower bound, which the parameter does not reach."""
    high: float = np.inf
    """Upper bound, which the parameter does not reach."""

    def __post_init__(self) -> None:
        """Refuse a value outside the bounds."""
        margin = _BOUNDED * abs(self.value)
        if not (np.isfinite(self.value) and self.low + margin < self.value < self.high - margin):
            raise InputError(
                f"a parameter starts at {self.value:g} and must be between {self.low:g} and "
                f"{self.high:g}, not at a bound: give another start, or other bounds"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Ode:
    """Model x' = f(t, x, u, p), y = output(t, x, u, p), of one's own equations.

    Parameters
    ----------
    f : callable
        Function (t, x, u, p) that returns the derivative of each state. x[i] and u[j] are arrays of
        one shape, because many trajectories are integrated at once. Use numpy's functions, and
        `numpy.where` in place of `if`. p has an attribute for each parameter.
    output : callable
        Function (t, x, u, p) that returns the measured output, or a list of outputs.
    states : sequence of str
        Names of the states, such as ``"angle [rad]"``.
    parameters : mapping of str to Parameter
        Parameters by name; a number is a parameter without unit and bounds.
    delay : float, default 0.0
        Dead time of the inputs in s, >= 0. If it is no multiple of Ts, the inputs change within an
        interval. Before the data the input is its first value, and an estimation leaves out the
        outputs of the first dead time.

    Raises
    ------
    ValueError
        A name is not an identifier, a parameter starts outside its bounds, or the dead time is
        negative.

    Examples
    --------
    An RC circuit with the time constant tau:

    >>> import armrig
    >>> rc = armrig.Ode(f=lambda t, x, u, p: [(u[0] - x[0]) / p.tau],
    ...                 output=lambda t, x, u, p: x[0], states=["voltage [V]"],
    ...                 parameters={"tau": armrig.Parameter(0.1, "s", low=0)})
    >>> rc.simulate([1, 1, 1], Ts=0.1).round(3)
    array([[0.   ],
           [0.632],
           [0.865]])
    """

    f: Derivative = field(kw_only=False)
    output: Derivative
    states: Sequence[str]
    parameters: Mapping[str, Parameter | float]
    delay: float = 0.0
    point: Callable[..., Any] = field(init=False, repr=False, compare=False)
    """Class of p, with an attribute for each parameter."""

    def __post_init__(self) -> None:
        """Check names and values."""
        for name, function in (("f", self.f), ("output", self.output)):
            if not callable(function):
                raise InputTypeError(
                    f"{name} is a {type(function).__name__}: give a function (t, x, u, p)"
                )
        if isinstance(self.states, str) or not self.states:
            raise InputError(f"states={self.states!r}: give a list of at least one name")
        if not 0 <= self.delay < np.inf:
            raise InputError(f"delay={self.delay!r} must be a dead time in s, 0 or more")
        for name in self.parameters:
            if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
                raise InputError(
                    f"parameter {name!r}: the equations read p.NAME, so a name has "
                    "letters, digits and _ and begins with a letter"
                )
        parameters = {
            k: v if isinstance(v, Parameter) else Parameter(float(v))
            for k, v in self.parameters.items()
        }
        for name, value in (
            ("states", tuple(self.states)),
            ("parameters", parameters),
            ("point", namedtuple("p", parameters)),
        ):
            object.__setattr__(self, name, value)  # the fields of a frozen dataclass

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters, by name."""
        return {k: v.value for k, v in self.parameters.items() if isinstance(v, Parameter)}

    @property
    def units(self) -> dict[str, str]:
        """Units of the parameters, by name."""
        return {k: v.unit for k, v in self.parameters.items() if isinstance(v, Parameter)}

    def simulate(
        self,
        u: ArrayLike,
        *,
        Ts: float,
        x0: ArrayLike | None = None,
        values: Mapping[str, float] | None = None,
        steps: int | None = None,
    ) -> Matrix:
        """Return the outputs (N, ny) for an input that is held between samples.

        Parameters
        ----------
        u : array_like, shape (N,) or (N, nu)
            Inputs.
        Ts : float
            Sampling time in s.
        x0 : array_like, shape (n,), optional
            Initial states; by default 0.
        values : mapping of str to float, optional
            Values of parameters, in place of those at which the estimation starts.
        steps : int, optional
            Runge-Kutta steps in each interval; by default as many as the equations need.

        Raises
        ------
        ValueError
            The states are not finite, or the equations are too stiff.

        Examples
        --------
        >>> import armrig
        >>> falling = armrig.Ode(f=lambda t, x, u, p: [x[1], -p.g + 0 * u[0]],
        ...                      output=lambda t, x, u, p: x[0], states=["height", "rate"],
        ...                      parameters={"g": 9.81})
        >>> falling.simulate([0, 0, 0], Ts=1.0, x0=[20, 0]).ravel().round(3)
        array([20.   , 15.095,  0.38 ])
        """
        inputs = np.asarray(u, np.float64)
        inputs = inputs[:, None] if inputs.ndim == 1 else inputs
        whole, share = self.delay_in_samples(Ts)
        course = Course.of(inputs, Ts, whole, share)
        start = np.zeros(len(self.states)) if x0 is None else np.asarray(x0, np.float64)
        if start.shape != (len(self.states),):
            raise InputError(
                f"x0 has the shape {start.shape}; the model has {plural(len(self.states), 'state')}"
            )
        point = {**self.values, **(values or {})}
        m = steps or steps_and_error(self, course, start[:, None], point, share=_SIMULATED)[0]
        y = integrate_ode(self, course, start[:, None, None], point, m).y
        return np.asarray(y[:, :, 0, 0])

    def delay_in_samples(self, Ts: float) -> tuple[int, float]:
        """Return the whole samples of the dead time, and the rest as a share of Ts.

        Examples
        --------
        >>> import armrig
        >>> late = armrig.Ode(f=lambda t, x, u, p: [u[0]], output=lambda t, x, u, p: x[0],
        ...                   states=["level"], parameters={}, delay=0.25)
        >>> late.delay_in_samples(0.1)
        (2, 0.5)
        >>> late.simulate([1.0, 1.0, 2.0, 2.0, 2.0, 2.0], Ts=0.1).round(3).ravel()
        array([0.  , 0.1 , 0.2 , 0.3 , 0.4 , 0.55])
        """
        samples = self.delay / Ts
        whole = int(samples + _WHOLE)
        return whole, samples - whole if samples - whole > _WHOLE else 0.0


def friction(
    rate: Any,
    *,
    coulomb: Any = 0.0,
    viscous: Any = 0.0,
    static: Any = None,
    stribeck_rate: Any = 1.0,
    width: float = 0.01,
) -> Any:
    """Return the friction against a rate: viscous, Coulomb, and Stribeck's curve.

    With the static friction T_s and the rate v_s of Stribeck's curve ::

        T = b v + (T_c + (T_s - T_c) exp(-(v/v_s)²)) tanh(v/w)

    The sign of v is smooth: the friction reaches 76 % of its value at the rate w = `width`. A body
    that stands creeps at a rate below w. A smaller width needs shorter steps.

    Parameters
    ----------
    rate : array_like
        Rate v of the body, in rad/s or m/s.
    coulomb, viscous : float, default 0.0
        T_c, in Nm or N, and b, per unit of the rate.
    static : float, optional
        T_s; by default T_c, without a Stribeck effect.
    stribeck_rate : float, default 1.0
        Rate v_s.
    width : float, default 0.01
        Rate w, in the unit of v.

    References
    ----------
    .. [1] B. Armstrong-Hélouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994) 1083-1138.

    Examples
    --------
    >>> import armrig
    >>> armrig.friction(2.0, coulomb=0.5, viscous=0.1)
    np.float64(0.7)
    """
    level = coulomb
    if static is not None:
        level = coulomb + (static - coulomb) * np.exp(-((rate / stribeck_rate) ** 2))
    return viscous * rate + level * np.tanh(rate / width)


def saturation(x: Any, low: Any, high: Any) -> Any:
    """Return x, limited to [low, high].

    Examples
    --------
    >>> import armrig
    >>> armrig.saturation([-1.0, 2.0, 7.0], 0, 5)
    array([0., 2., 5.])
    """
    return np.minimum(np.maximum(x, low), high)


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """Inputs of segments of equal length, after the whole samples of their dead time."""

    u: Matrix
    """Input at each sample and at the end of the last interval, (L + 1, nu, S)."""
    before: Matrix
    """Input one sample earlier, (L + 1, nu, S)."""
    t: Matrix
    """Time of each sample, (L + 1, S)."""
    Ts: float
    linear: tuple[bool, ...]
    """True for an input that is a straight line between samples, False if it is held."""
    share: float = 0.0
    """Rest of the dead time, as a share of Ts: the inputs change so long after each sample."""

    @classmethod
    def of(cls, u: Matrix, Ts: float, whole: int = 0, share: float = 0.0) -> Course:
        """Return the course of held inputs (N, nu) as a single segment."""
        index = np.arange(u.shape[0])
        now, before = (u[np.maximum(index - whole - d, 0)][:, :, None] for d in (0, 1))
        t = Ts * index[:, None].astype(np.float64)
        held = (False,) * u.shape[1]
        return cls(u=now, before=before, t=t, Ts=Ts, linear=held, share=share)

    def at(self, k: int) -> Matrix:
        """Return the inputs (nu, S) at sample k."""
        if not self.share:
            return np.asarray(self.u[k])
        between = self.u[k] + self.share * (self.before[k] - self.u[k])
        return np.asarray(np.where(np.array(self.linear)[:, None], between, self.before[k]))

    def pieces(self, k: int) -> Iterator[tuple[float, float, Matrix, Matrix]]:
        """Yield the stretches of interval k in which the inputs are smooth.

        A stretch is its begin after sample k and its duration in s, the inputs (nu, S) at its
        begin, and their slopes.
        """
        linear, edges = np.array(self.linear)[:, None], (0.0, self.share * self.Ts, self.Ts)
        values = (self.at(k), self.u[k], self.at(k + 1))
        for i in (0, 1) if self.share else (1,):
            duration = edges[i + 1] - edges[i]
            yield edges[i], duration, values[i], (values[i + 1] - values[i]) * linear / duration


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectories:
    """Outputs of all trajectories, and their last states."""

    y: NDArray[np.float64]
    """Outputs at each sample, (L + 1, ny, points, S); the last belongs to the next segment."""
    end: NDArray[np.float64]
    """States after the last interval, (n, points, S)."""


def integrate_ode(
    ode: Ode, course: Course, x: NDArray[np.float64], point: Mapping[str, Any], steps: int
) -> Trajectories:
    """Return the trajectories from the states x (n, points, S).

    A value of `point` is a number, or an array (points, 1). The method has the order 4. No step
    contains a jump of an input.
    """
    L = course.u.shape[0] - 1
    p = ode.point(**point)
    shape = x.shape[1:]
    linear = any(course.linear)
    recorded = []
    derivative = derivative_function(ode, shape)
    for k in range(L + 1):
        recorded.append(evaluate_outputs(ode, course.t[k], x, course.at(k)[:, None, :], p, shape))
        if k == L:
            break
        for begin, duration, first, slope in course.pieces(k):
            t, u = course.t[k] + begin, first[:, None, :]
            n = max(1, int(np.ceil(steps * duration / course.Ts - _WHOLE)))
            h = duration / n
            for i in range(n):
                a, b, c = t + i * h, t + (i + 0.5) * h, t + (i + 1) * h
                ua = ub = uc = u
                if linear:
                    ua, ub, uc = (u + (s - t) * slope[:, None, :] for s in (a, b, c))
                k1 = derivative(a, x, ua, p)
                k2 = derivative(b, x + 0.5 * h * k1, ub, p)
                k3 = derivative(b, x + 0.5 * h * k2, ub, p)
                k4 = derivative(c, x + h * k3, uc, p)
                x = x + (h / 6) * (k1 + 2 * (k2 + k3) + k4)
    return Trajectories(y=np.array(recorded), end=x)


def steps_and_error(
    ode: Ode,
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
        y = integrate_ode(ode, course, x[:, None, :], point, steps).y
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


def _where_not_finite(ode: Ode, y: Any, course: Course, point: Mapping[str, float]) -> None:
    """Refuse equations whose output is not finite, with the time at which it happens."""
    k, *_, s = (int(i[0]) for i in np.nonzero(~np.isfinite(y)))
    values = ", ".join(f"{name} = {float(value):.4g}" for name, value in point.items())
    raise InputError(
        f"the output is not finite from t = {course.t[k, s]:g} s on, with {values}. The equations "
        "are unstable there, divide by 0, take the root of a negative number (use numpy.maximum), "
        f"or have a time constant far below Ts/{MAX_STEPS}: check their signs, or start nearer"
    )


def derivative_function(ode: Ode, shape: tuple[int, ...]) -> Any:
    """Return f as a function to an array (n, points, S), with sentences for its errors."""
    n, f = len(ode.states), ode.f

    def derivative(t: Any, x: Any, u: Any, p: Any) -> Any:
        x.flags.writeable = False
        try:
            rates = f(t, x, u, p)
            if len(rates) != n:
                raise InputError(
                    f"f returns {plural(len(rates), 'value')}; the model has {plural(n, 'state')}: "
                    f"{', '.join(ode.states)}"
                )
            out = np.empty((n, *shape))
            for i in range(n):
                out[i] = rates[i]
        except InputError:
            raise
        except (Exception, SystemExit) as err:
            raise InputError(_sentence("f", err)) from err
        return out

    return derivative


def evaluate_outputs(ode: Ode, t: Any, x: Any, u: Any, p: Any, shape: tuple[int, ...]) -> Any:
    """Return the outputs (ny, points, S), with sentences for errors of `output`."""
    try:
        outputs = ode.output(t, x, u, p)
        several = isinstance(outputs, list | tuple) or np.ndim(outputs) > len(shape)
        rows = outputs if several else [outputs]
        out = np.empty((len(rows), *shape))
        for i, row in enumerate(rows):
            if np.ndim(row) > len(shape):
                raise InputError(
                    f"output {i + 1} of {len(rows)} has the shape {np.shape(row)}, and each must "
                    f"have that of a state, {shape}: return a list of outputs, such as [x[0], x[1]]"
                )
            out[i] = row
    except InputError:
        raise
    except (Exception, SystemExit) as err:
        raise InputError(_sentence("output", err)) from err
    return out


def _sentence(name: str, err: BaseException) -> str:
    text = f"{name} raised {type(err).__name__}: {err}"
    if "ambiguous" in str(err):
        return f"{text}; x[i] are arrays of many trajectories: use numpy.where in place of if"
    if "read-only" in str(err):
        return f"{text}; {name} must not change its arguments: return new values"
    if isinstance(err, AttributeError):
        return f"{text}; the parameters are given by `parameters`"
    return text
