"""Own equations of a plant: states, output and parameters with their units and bounds."""

from __future__ import annotations

import keyword
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armrig_core.errors import InputError, InputTypeError
from armrig_core.rig.integration import Course, enough_steps, integrated

Derivative = Callable[[Any, Any, Any, Any], Any]
"""Function f(t, x, u, p): x' of the states, or the output."""
Function = Callable[..., Any]

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

    Raises
    ------
    ValueError
        A name is not an identifier, or a parameter starts outside its bounds.

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

    f: Derivative
    output: Derivative
    states: Sequence[str]
    parameters: Mapping[str, Parameter | float]
    point: Function = field(init=False, repr=False, compare=False)
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
        for name in self.parameters:
            if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
                raise InputError(
                    f"parameter {name!r}: the equations read p.NAME, so a name has "
                    "letters, digits and _ and begins with a letter"
                )
        own = {
            k: v if isinstance(v, Parameter) else Parameter(float(v))
            for k, v in self.parameters.items()
        }
        for name, value in (
            ("states", tuple(self.states)),
            ("parameters", own),
            ("point", namedtuple("p", own)),
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
    ) -> NDArray[np.float64]:
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
        course = Course.of(inputs[:, None] if inputs.ndim == 1 else inputs, Ts)
        start = np.zeros(len(self.states)) if x0 is None else np.asarray(x0, np.float64)
        if start.shape != (len(self.states),):
            raise InputError(f"x0 has the shape {start.shape}; there are {len(self.states)} states")
        point = {**self.values, **(values or {})}
        m = enough_steps(self, course, start[:, None], point) if steps is None else steps
        return integrated(self, course, start[:, None, None], point, m).outputs()[:, 0]


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
