"""Models with physical parameters: the rig's linear model, sampled exactly, and own equations."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from armrig_core.errors import InputError, InputTypeError
from armrig_core.rig.arm import ARM_UNITS, ArmParameters, zero_order_hold
from armrig_core.rig.equations import (
    Course,
    Ode,
    Parameter,
    Trajectories,
    integrate_ode,
    steps_and_error,
)
from numpy.typing import ArrayLike

from armrig.data.columns import Matrix, Vector
from armrig.data.dataset import Signals
from armrig.numerics.checks import column
from armrig.numerics.quantities import digits, plural
from armrig.numerics.recursion import recursion
from armrig.physics.systems import SPEED

if TYPE_CHECKING:
    import control
    from numpy.typing import NDArray

NAMES = tuple(f.name for f in fields(ArmParameters))
SIGNED = frozenset({"b_1"})
"""Parameters of the rig that may be 0."""
COULOMB = "T_c"
"""Name of the parameter for the Coulomb friction; its unit is Nm."""
UNITS = ARM_UNITS | {COULOMB: "Nm"}
OFFSET = "u0"
"""Last state of the rig's model: the constant input offset."""
Friction = Literal["viscous", "coulomb", "both"]
Model = Callable[[ArmParameters], "control.StateSpace"]

_MIN_REVERSED_SHARE = 0.05  # least share of samples of either sign in a bipolar input
_SOLVER_DOUBT = 0.2  # largest error of the solver, as a share of the noise's deviation


@dataclass(frozen=True, slots=True, kw_only=True)
class Equations:
    """Own equations, and the precision of their integration."""

    model: Ode
    output: str = ""
    steps: int = 1
    """Runge-Kutta steps in each interval."""
    solver_error: float = 0.0
    """Largest error of the output by the integration."""

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Parameters with units and bounds."""
        return {k: v for k, v in self.model.parameters.items() if isinstance(v, Parameter)}

    @property
    def states(self) -> Sequence[str]:
        """Names of the states."""
        return self.model.states

    def inputs(self, data: Signals) -> Matrix:
        """Return the inputs (N, nu) of an experiment: of a rig, the voltage at its pin."""
        return data.volts

    def delay_in_samples(self, Ts: float) -> tuple[int, float]:
        """Return the whole samples of the inputs' dead time, and the rest as a share of Ts."""
        return self.model.delay_in_samples(Ts)

    def integrate(
        self, course: Course, x: NDArray[np.float64], values: Mapping[str, Any], steps: int
    ) -> Trajectories:
        """Return the trajectories from the states x (n, points, S)."""
        return integrate_ode(self.model, course, x, values, steps)

    def steps_and_error(
        self, course: Course, x: Matrix, values: Mapping[str, float], **limits: Any
    ) -> tuple[int, Vector]:
        """Return enough steps of an interval, and the error of the outputs (ny,)."""
        return steps_and_error(self.model, course, x, values, **limits)

    def doubts(
        self, values: Mapping[str, float], std: Mapping[str, float], noise: float
    ) -> Iterable[str]:
        """Yield a warning if the integration is not exact enough."""
        if self.solver_error > _SOLVER_DOUBT * noise:
            yield (
                f"the integration is exact to {digits(self.solver_error, 1)}; the noise is "
                f"{digits(noise, 1)}"
            )

    def to_control(self, parameters: Any) -> control.StateSpace:
        """Refuse: own equations may be nonlinear."""
        raise InputError("own equations have no linear model; use fit.physics.simulate")

    def simulate(
        self, values: Mapping[str, float], u: ArrayLike, Ts: float, x0: ArrayLike | None = None
    ) -> Matrix:
        """Return the outputs (N, ny)."""
        return self.model.simulate(u, Ts=Ts, x0=x0, values=values, steps=self.steps)


@dataclass(frozen=True, slots=True, kw_only=True)
class Physics:
    """Linear model of the rig, sampled exactly, with or without Coulomb friction of the motor.

    Coulomb friction T_c acts on the motor against its motion. It is equivalent to a voltage V = T_c
    R_m / (N K_m) at the motor's terminals. The model is linear during slip and linear during
    stick::

        slip    x(k+1) = Phi x + Gamma (u - s V),    s = sign of the speed
        stick   x(k+1) = P (Phi x + Gamma u),        P = I - Gamma e' / (e' Gamma)

    e is the unit vector of the state that is the speed. During stick a friction of at most V keeps
    the speed at 0. If the motor turns back within a step, s is the mean of both signs, weighted by
    their durations.
    """

    model: Model
    """Function: parameters -> control.StateSpace, in continuous time."""
    fixed: ArmParameters
    """Values of all parameters that are not free."""
    outputs: tuple[str, ...]
    """Labels of the measured outputs."""
    friction: bool = False
    """True with Coulomb friction; u0 is then estimated only with a bipolar input."""

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Parameters with units and bounds."""
        values = asdict(self.fixed)
        bounded = {k: Parameter(v, UNITS[k], low=0) for k, v in values.items() if k not in SIGNED}
        return bounded | {
            "b_1": Parameter(self.fixed.damping, UNITS["b_1"]),
            COULOMB: Parameter(self.fixed.torque_per_volt, UNITS[COULOMB]),
        }

    @property
    def states(self) -> list[str]:
        """Names of the states; the input offset is last."""
        return [*self.model(self.fixed).state_labels, OFFSET]

    def check(self) -> None:
        """Refuse a model that is not continuous, has several inputs, or lacks an output."""
        if not callable(self.model) or hasattr(self.model, "dt"):
            raise InputTypeError(
                f"model is a {type(self.model).__name__}: give a function of the parameters, "
                "such as armrig.physics.arm, without parentheses"
            )
        system = self.model(self.fixed)
        if system.dt not in (0, None) or system.ninputs != 1:
            raise InputError(
                f"the model has dt={system.dt} and {plural(system.ninputs, 'input')}; it must be "
                "in continuous time with one input"
            )
        for output in self.outputs:
            if output not in system.output_labels:
                raise InputError(
                    f"output={output!r} is none of the model's outputs {system.output_labels}"
                )

    def delay_in_samples(self, Ts: float) -> tuple[int, float]:
        """Return 0: the rig has no dead time."""
        return 0, 0.0

    def inputs(self, data: Signals) -> Matrix:
        """Return the input, and 1 if its offset is free or 0 if not, (N, 2)."""
        u = data.u[:, 0]
        is_free = not self.friction or bipolar(u)
        return np.column_stack([u, np.full(u.size, float(is_free))])

    def integrate(
        self, course: Course, x: NDArray[np.float64], values: Mapping[str, Any], steps: int
    ) -> Trajectories:
        """Return the trajectories from the states x (n, points, S); `steps` has no effect."""
        of_points = [
            {name: float(np.broadcast_to(np.ravel(v), x.shape[1])[j]) for name, v in values.items()}
            for j in range(x.shape[1])
        ]
        matrices: dict[tuple[float, ...], Matrix] = {}
        for point in of_points:
            if (key := tuple(point.values())) not in matrices:
                matrices[key] = np.block(self.sampled(point, course.Ts))
        step = np.array([matrices[tuple(point.values())] for point in of_points])
        n, X, y = x.shape[0] - 1, np.swapaxes(x, 0, 1), []
        for k, (u, is_free) in enumerate(course.u):
            drive = u - is_free * X[:, n:]
            x_and_y = step @ np.concatenate([X[:, :n], drive], 1)
            y.append(x_and_y[:, n:])
            if k + 1 < course.u.shape[0]:
                ahead = x_and_y[:, :n]
                if self.friction:
                    ahead = self._brake(of_points, step, X[:, :n], ahead)
                X = np.concatenate([ahead, X[:, n:]], 1)
        return Trajectories(y=np.swapaxes(y, 1, 2), end=np.swapaxes(X, 0, 1))

    def _brake(
        self, of_points: Sequence[Mapping[str, float]], step: Matrix, x: Matrix, ahead: Matrix
    ) -> Matrix:
        """Return the next states (points, n, S) with friction, from those without friction."""
        speed, n = self.states.index(SPEED), x.shape[1]
        V = np.array([p[COULOMB] / self.all_values(p).torque_per_volt for p in of_points])[:, None]
        Gamma, pole = step[:, :n, n:], step[:, speed, speed, None]
        gain, v, free = Gamma[:, speed], x[:, speed], ahead[:, speed]
        pull = (free - pole * v) / gain  # the voltage at standstill
        sign = np.sign(np.where(v == 0, pull, v))
        end = free - gain * sign * V
        turns = (v != 0) & (end * sign <= 0)
        # If a search tries a V below 0, the motor never sticks.
        sticks = ((v == 0) | turns) & (np.abs(pull) <= V)
        # The motor turns back after the share f = v / (v - end); the mean friction is s V (2 f - 1)
        share = np.where(turns, 2 * v / np.where(turns, v - end, 1.0) - 1, 1.0)
        friction = np.where(sticks, free / gain, sign * V * share)
        braked = ahead - Gamma * friction[:, None]
        braked[:, speed][sticks] = 0.0
        return np.asarray(braked)

    def steps_and_error(
        self, course: Course, x: Matrix, values: Mapping[str, float], **limits: Any
    ) -> tuple[int, Vector]:
        """Return one step without an error: the solution is exact."""
        return 1, np.zeros(len(self.outputs))

    def doubts(
        self, values: Mapping[str, float], std: Mapping[str, float], noise: float
    ) -> Iterable[str]:
        """Yield a warning for each negative estimate of a friction."""
        for n, v in values.items():
            if n in SIGNED | {COULOMB} and v < 0 < std[n] < np.inf:
                yield (
                    f"{n} = {digits(v, 2)} is below 0, by {abs(v) / std[n]:.1f} standard "
                    "deviations: take it as 0"
                )

    def all_values(self, values: Mapping[str, float]) -> ArmParameters:
        """Return all parameters of the linear model; a viscous friction below 0 becomes 0."""
        changes = {k: max(v, 0.0) if k in SIGNED else v for k, v in values.items() if k != COULOMB}
        return replace(self.fixed, **changes)

    def to_control(self, parameters: ArmParameters) -> control.StateSpace:
        """Return the continuous model, without Coulomb friction."""
        return self.model(parameters)

    def simulate(self, values: Mapping[str, float], u: ArrayLike, Ts: float) -> Vector:
        """Return the output (N,) for a held input, from rest and without Coulomb friction."""
        (Phi, Gamma), (C, D) = self.sampled(values, Ts)
        held = column("u", u)[:, None]
        x = recursion(Phi, held[:-1] @ Gamma.T, np.zeros(Phi.shape[0]))
        return np.asarray((x @ C.T + held @ D.T)[:, 0])

    def sampled(self, values: Mapping[str, float], Ts: float) -> list[list[Matrix]]:
        """Return [[Phi, Gamma], [C, D]] of the model, sampled for a zero-order hold.

        A viscous friction below 0 changes the matrices by the opposite of what its opposite does.
        """
        parameters = asdict(self.fixed) | {k: v for k, v in values.items() if k != COULOMB}
        A, B, C, D = self._continuous(parameters | {name: abs(parameters[name]) for name in SIGNED})
        if any(parameters[name] < 0 for name in SIGNED):
            resting = self._continuous(parameters | dict.fromkeys(SIGNED, 0.0))
            A, B, C, D = (2 * M - N for M, N in zip(resting, (A, B, C, D), strict=True))
        Phi, Gamma = zero_order_hold(A, B, Ts)
        return [[Phi, Gamma], [C, D]]

    def _continuous(self, values: Mapping[str, float]) -> tuple[Matrix, ...]:
        system = self.model(ArmParameters(**values))
        rows = [list(system.output_labels).index(output) for output in self.outputs]
        return system.A, system.B, system.C[rows], system.D[rows]


PhysicalModel = Equations | Physics
"""Model with physical parameters."""


def bipolar(u: Vector) -> bool:
    """Return whether an input has both signs, so that friction can be distinguished from u0."""
    return bool(min(np.mean(u > 0), np.mean(u < 0)) >= _MIN_REVERSED_SHARE)


def free_names(free: Sequence[str], friction: Friction | None) -> tuple[str, ...]:
    """Return the names of the free parameters; the parameters of the friction are last."""
    if isinstance(free, str):
        free = (free,)
    if friction not in (None, "viscous", "coulomb", "both"):
        raise InputError(f'friction={friction!r} must be None, "viscous", "coulomb" or "both"')
    for name in free:
        if name not in NAMES:
            msg = f"free={name!r} is none of {', '.join(NAMES)}"
            msg += "; give several names as a sequence" if "," in name else ""
            raise InputError(msg)
    names = list(free)
    if friction in ("viscous", "both") and "b_1" not in names:
        names.append("b_1")
    if friction in ("coulomb", "both"):
        names.append(COULOMB)
    if not free or len(set(names)) < len(names):
        raise InputError(f"free={tuple(free)} must name at least one parameter, and none twice")
    return tuple(names)
