"""Step response of the physical model, and the effect of each parameter on the response."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from armrig_core.errors import InputError
from armrig_core.rig.arm import ArmParameters
from armrig_core.rig.calibration import THETA_1
from numpy.typing import ArrayLike, NDArray

from armrig.data.columns import Vector
from armrig.numerics.recursion import recursion
from armrig.numerics.step_times import rise_time, slowest_time
from armrig.physics.grey_box.physical_models import NAMES, SIGNED, Model, Physics
from armrig.physics.systems import SPEED, arm

_SETTLING_TIMES = 30.0  # time constants of the slowest pole until the speed is steady
_STEPS_PER_TIME = 50.0  # steps per time constant 1/|p| of the fastest pole p
_POINTS, _WINDOW_GROWTH = 2001, 8.0
_STEP = 1e-4  # relative step of a central difference, whose error is about 1e-8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Characteristics:
    """Characteristic numbers of the step response (handout, assignment 2.2)."""

    parameters: ArmParameters
    """Physical parameters."""
    steady_speed: float
    """Steady speed of the chassis for one volt, in rad/(s V)."""
    initial_slope: float
    """Slope of the chassis' speed just after a step of one volt, in rad/(s² V)."""
    rigid_slope: float
    """Initial slope if the arm were rigidly attached to the chassis, in rad/(s² V)."""
    poles: NDArray[np.complex128]
    """Poles from u to theta_1, in 1/s, slowest first."""
    zeros: NDArray[np.complex128]
    """Zeros from u to theta_1, in 1/s."""
    rise_time: float
    """63 % time of the speed, in s, as defined in `armrig.numerics.step_times`."""
    equivalent_time: float
    """Time in s; for large t, the angle per volt is steady_speed (t - equivalent_time)."""
    slowest_time: float
    """1/|Re s| of the slowest pole except the integrator, in s."""

    def explain(self) -> str:
        """Return a text that explains each number."""
        p = self.parameters
        oscillating = self.poles[self.poles.imag > 0]
        lines = [
            f"Steady speed {self.steady_speed:.4f} rad/s per V = (N K_m / R_m) / "
            "((N K_m)² / R_m + b_1)"
            + (" = 1/(N K_m)" if p.b_1 == 0 else "")
            + ". At this speed nothing accelerates, the spring is at rest and the back-EMF leaves "
            "only the current that friction needs. The speed does not depend on inertias or spring"
            + (", nor on R_m." if p.b_1 == 0 else "."),
            f"Initial slope {self.initial_slope:.2f} rad/s² per V = N K_m / (R_m J_1). At t = 0 "
            "the chassis is at rest, so there is no back-EMF and the whole voltage drives current. "
            "The spring is not yet wound, so the torque accelerates J_1 only. With the arm "
            f"screwed to the chassis the slope would be {self.rigid_slope:.2f}, for J_1 + J_2.",
        ]
        if oscillating.size:
            w = abs(oscillating[0])
            lines.append(
                f"Poles {_roots(self.poles)} 1/s: an integrator (the angle is the integral of the "
                f"speed), the motor's decay, and the arm on its spring, {w:.1f} rad/s with "
                f"damping {-oscillating[0].real / w:.2f}."
            )
        else:
            lines.append(f"Poles {_roots(self.poles)} 1/s: no oscillation at these parameters.")
        lines.append(
            f"Zeros {_roots(self.zeros)} 1/s at ±i sqrt(K_lin/J_2): at this frequency the arm "
            "swings against the chassis and holds it still, whatever the motor does."
        )
        return "\n".join(lines)


def characteristics(p: ArmParameters | None = None) -> Characteristics:
    """Return steady speed, initial slope, times, poles and zeros of the whole rig.

    Parameters
    ----------
    p : ArmParameters, optional
        By default the values of the handout, which give a steady speed of 1.8623 rad/s per V and an
        initial slope of 98.40 rad/s² per V.

    Examples
    --------
    >>> import armrig
    >>> found = armrig.physics.characteristics()
    >>> print(f"{found.steady_speed:.4f} rad/s per V, {found.initial_slope:.2f} rad/s² per V")
    1.8623 rad/s per V, 98.40 rad/s² per V
    >>> abs(found.poles).round(1)
    array([ 0. , 18.9, 18.9, 36.7])
    """
    p = ArmParameters() if p is None else p
    system = arm(p)
    # The pole at 0 is exact: nothing depends on the angle of the chassis.
    poles = np.append(np.linalg.eigvals(np.asarray(system.A)[1:, 1:]), 0.0).astype(np.complex128)
    swing = 1j * np.sqrt(p.K_lin / p.J_2)
    steady_speed = p.torque_per_volt / p.damping
    dying = np.delete(poles, np.argmin(np.abs(poles)))
    return Characteristics(
        parameters=p,
        steady_speed=steady_speed,
        initial_slope=p.torque_per_volt / p.J_1,
        rigid_slope=p.torque_per_volt / (p.J_1 + p.J_2),
        poles=poles[np.argsort(np.abs(poles), kind="stable")],
        zeros=np.array([swing, -swing]),
        rise_time=_rise_time(p, dying, steady_speed),
        # The area above a step response is -sum 1/p + sum 1/z; the terms of the two zeros cancel.
        equivalent_time=-float(np.sum(1 / dying).real),
        slowest_time=slowest_time(dying.real),
    )


def _rise_time(p: ArmParameters, poles: NDArray[np.complex128], steady_speed: float) -> float:
    """Return the 63 % time of the speed; NaN if even the longest window does not contain it."""
    h = 1 / (_STEPS_PER_TIME * float(np.abs(poles).max()))
    settled = _SETTLING_TIMES * slowest_time(poles.real)
    while h * _POINTS < _WINDOW_GROWTH * settled:
        angle = step_response(p, h * np.arange(_POINTS), state=THETA_1) / steady_speed
        rise_s = rise_time(angle, h, integrated=True)
        if np.isfinite(rise_s):
            return rise_s
        h *= _WINDOW_GROWTH
    return float("nan")


def step_response(
    p: ArmParameters, t: ArrayLike, *, u: float = 1.0, model: Model = arm, state: str = SPEED
) -> Vector:
    """Return the exact response (N,) of the state with a label, from rest, to a step of u volts.

    The step is at t = 0. The times t (N,), in s, are equidistant from 0 on.
    """
    return _response({}, t, u, Physics(model=model, fixed=p, outputs=(THETA_1,)), state)


def step_sensitivities(
    p: ArmParameters,
    t: ArrayLike,
    *,
    names: Sequence[str] | None = None,
    u: float = 1.0,
    model: Model = arm,
    state: str = SPEED,
) -> dict[str, Vector]:
    """Return the derivatives of a step response with respect to the logarithm of each parameter.

    If a parameter is 1 % larger, the response changes by 0.01 times the derivative for this
    parameter. Since b_1 can be 0, its derivative is with respect to the ratio of b_1 to the damping
    of the back-EMF, (N K_m)² / R_m.

    Parameters
    ----------
    t : array_like, shape (N,)
        Equidistant times in s from 0 on.
    names : sequence of str, optional
        Names of parameters; all by default.

    Returns
    -------
    dict of str to ndarray, shape (N,)
        Derivatives by parameter, in the state's unit.

    Raises
    ------
    ValueError
        A name is unknown, or t is not equidistant or does not begin at 0.

    Examples
    --------
    The inertia J_1 has no effect on the steady speed.

    >>> import armrig, numpy as np
    >>> p, t = armrig.physics.ArmParameters(), np.linspace(0, 1, 101)
    >>> effect = armrig.physics.step_sensitivities(p, t, names=["J_1", "K_m"])
    >>> for name, derivative in effect.items():
    ...     print(f"{name}: {derivative[1]:.2f} rad/s at 0.01 s, {derivative[-1]:.2f} rad/s at 1 s")
    J_1: -0.56 rad/s at 0.01 s, 0.00 rad/s at 1 s
    K_m: 0.39 rad/s at 0.01 s, -1.86 rad/s at 1 s
    """
    names = NAMES if names is None else tuple(names)
    for name in names:
        if name not in NAMES:
            raise InputError(f"{name!r} is none of {', '.join(NAMES)}")
    physics, derivatives = Physics(model=model, fixed=p, outputs=(THETA_1,)), {}
    for name in names:
        size = (p.N * p.K_m) ** 2 / p.R_m if name in SIGNED else getattr(p, name)
        up, down = (
            _response({name: getattr(p, name) + h * size}, t, u, physics, state)
            for h in (_STEP, -_STEP)
        )
        derivatives[name] = (up - down) / (2 * _STEP)
    return derivatives


def _response(
    values: Mapping[str, float], t: ArrayLike, u: float, physics: Physics, state: str
) -> Vector:
    """Return the response of a state to a step of u volts with some values of parameters."""
    times = np.asarray(t, dtype=np.float64)
    even = times.ndim == 1 and times.size > 1 and times[0] == 0
    if not (even and np.ptp(np.diff(times)) < 1e-9 * max(1.0, float(times[-1]))):
        raise InputError(
            "t must be equidistant from 0, at least two times, such as np.linspace(0, 1, 501)"
        )
    states = physics.states[:-1]
    if state not in states:
        raise InputError(f"state={state!r} is none of {', '.join(states)}")
    (Phi, Gamma), _ = physics.sampled(values, float(times[1]))
    w = np.tile(u * Gamma[:, 0], (times.size - 1, 1))
    return np.asarray(recursion(Phi, w, np.zeros(len(states)))[:, states.index(state)])


def root_texts(roots: NDArray[np.complex128], decimals: int) -> list[str]:
    """Return roots as texts; a complex pair is one text."""
    texts = []
    for z in roots.tolist():
        real = f"{z.real:.{decimals}f}" if z.real else "0"
        if z.imag > 0:
            pair = f"±{' ' * bool(z.real)}{z.imag:.{decimals}f}i"
            texts.append(f"{real} {pair}" if z.real else pair)
        elif z.imag == 0:
            texts.append(real)
    return texts


def _roots(z: NDArray[np.complex128]) -> str:
    return ", ".join(root_texts(z, 3))
