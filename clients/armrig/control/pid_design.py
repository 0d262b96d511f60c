"""PID laws with two degrees of freedom, from a model: lambda tuning, or the largest integral gain.

With y[k-1] the newest output, the law is ::

    v[k] = u0 + k_p (b r[k] - y[k-1]) + I[k] - k_d (y[k-1] - f[k]) / (T_f + Ts)
    I[k+1] = I[k] + k_i Ts (r[k] - y[k]) + Ts/T_t (u[k] - v[k])
    f[k+1] = f[k] + Ts / (T_f + Ts) (y[k-1] - f[k])

f is the filtered output, and u[k] the voltage that the device latched. If the rate of an
integrating output follows r, the law is a PI of the filtered difference of y. C(z) is designed on
P(z)/z: the delay of the law is counted once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from armrig_core.control.control_law import ControlLaw
from armrig_core.errors import InputError
from armrig_core.process.calls import with_argument_checks
from armrig_core.rig.description import Description
from numpy.typing import NDArray

from armrig.control.loop import LawMatrices, frequency_grid, plant_response
from armrig.control.plant import DesignModel, PlantModel, Validation, design_model, require_finite
from armrig.control.state_feedback import Goal, make_law, require_margins
from armrig.models.state_space import Complex, Vector
from armrig.numerics.quantities import digits

MS = 1.6
"""Largest sensitivity by default."""
_LEAST_MS = 1.1
"""Smallest Ms that may be asked for."""
_FILTER_SHARE = 0.1
"""Time constant of the filter, as a share of that of the loop."""
_ROUNDS = 7
"""Number of times that the grid of the gains is made finer."""


@with_argument_checks
def pid(
    model: PlantModel,
    *,
    time_constant: float | None = None,
    ms: float | None = None,
    derivative: bool | None = None,
    filter_time: float | None = None,
    weight: float | None = None,
    output: str | None = None,
    rate: bool | None = None,
    reference: tuple[float, float] | None = None,
    u0: float | None = None,
    y0: float | Sequence[float] = 0.0,
    rig: Description | None = None,
    Ts: float | None = None,
    validation: Validation | None = None,
) -> ControlLaw:
    """Return a PI or PID law for a time constant of the closed loop, or for a largest sensitivity.

    With `time_constant` λ the gains are those whose loop is nearest to exp(-θ s)/(λ s + 1), with
    the dead time θ of model and law (lambda tuning). An integrating output gets the loop
    ((2 λ + θ) s + 1) exp(-θ s)/(λ s + 1)². Without it, the gains have the largest integral gain
    with Ms at most `ms`, and T_d at most T_i/4.

    Parameters
    ----------
    model : Fit, GreyFit or python-control system
        Model of one input; of two outputs, `output` is used alone.
    time_constant : float, optional
        Time constant λ of the closed loop, in s, at least two samples.
    ms : float, optional
        Largest sensitivity Ms, from 1.1; the default is 1.6.
    derivative : bool, optional
        True for a PID law. The default is True for a plant with two poles or more, and for the rate
        of an output it must be False.
    filter_time : float, optional
        Time constant T_f of the filter of y, in s. The default is a tenth of `time_constant`, or of
        the inverse of the frequency at which a P law oscillates, and at least one sample.
    weight : float, optional
        Weight b of r in the proportional part. The default is 1 with `time_constant`, otherwise
        0.5, which reduces the overshoot.
    output, rate, reference, u0, y0, rig, Ts, validation
        As in `armrig.control.place`.

    Raises
    ------
    InputError
        The model has a free integrator or is unstable, or no law meets the requirement.

    References
    ----------
    .. [1] K. J. Åström, T. Hägglund, *Advanced PID Control*, 2006, sections 6.5 and 7.3.

    Examples
    --------
    >>> import control
    >>> heater = control.tf([9.0], [175, 1])
    >>> law = armrig.control.pid(heater, time_constant=60.0, Ts=1.0)
    >>> law.order, law.design["gains"]["k_i"]
    (2, 0.00180...)
    """
    design = design_model(model, rig=rig, Ts=Ts, u0=u0, y0=y0, output=output, validation=validation)
    goal = Goal.of(design, output, rate, reference)
    require_finite(time_constant=time_constant, ms=ms, filter_time=filter_time, weight=weight)
    _check(design, time_constant, ms, filter_time)
    poles = np.abs(np.linalg.eigvals(design.plant.A))
    if derivative is None:
        derivative = not goal.is_rate and int((poles > _FILTER_SHARE).sum()) >= 2
    if derivative and goal.is_rate:
        raise InputError("derivative: a law for the rate of an output has no derivative part")
    w, P = _response(design, goal)
    if time_constant is not None:
        T_f = filter_time or max(design.Ts, _FILTER_SHARE * time_constant)
    else:
        T_f = filter_time or max(design.Ts, _FILTER_SHARE / _oscillation(w, P, design.Ts))
    parts = _parts(w, design.Ts, T_f, goal.is_rate)[: 3 if derivative else 2]
    if time_constant is not None:
        gains = _lambda_tuned(w, P * parts, time_constant, design, goal)
        settings: dict[str, Any] = {"method": "lambda", "time_constant": float(time_constant)}
    else:
        gains = _largest_integral(P * parts, MS if ms is None else ms)
        settings = {"method": "largest integral gain", "ms": float(MS if ms is None else ms)}
    b = weight if weight is not None else 1.0 if time_constant is not None else 0.5
    return require_margins(_pid_law(design, goal, gains, T_f, b, settings), design)


def _check(
    design: DesignModel, time_constant: float | None, ms: float | None, filter_time: float | None
) -> None:
    """Refuse requirements that no law meets."""
    if not design.is_stable:
        raise InputError(
            "the model is unstable: a PID law of these rules needs a stable plant; use "
            "armrig.control.lqg or armrig.control.place (`armrig design lqg`)"
        )
    if time_constant is not None and ms is not None:
        raise InputError("time_constant and ms are two ways to design a law: give one")
    if time_constant is not None and not time_constant >= 2 * design.Ts:
        raise InputError(
            f"time_constant={time_constant:g} s is below two samples of {design.Ts:g} s; at least "
            f"{2 * design.Ts:g} s can be met"
        )
    if ms is not None and not ms >= _LEAST_MS:
        raise InputError(
            f"ms={ms:g}: every loop that does something has a larger Ms; at least {_LEAST_MS} can "
            "be met"
        )
    if filter_time is not None and filter_time < 0:
        raise InputError(f"filter_time={filter_time:g} s must be 0 or above")


def _response(design: DesignModel, goal: Goal) -> tuple[Vector, Complex]:
    """Return a grid of frequencies, and the response of the plant from the voltage to y."""
    plant, row, outputs = (
        design.plant,
        np.zeros((1, len(design.outputs))),
        range(len(design.outputs)),
    )
    row[0, goal.i] = -design.Ts / plant.gain(goal.i)
    integral = LawMatrices(
        np.ones((1, 1)), np.ones(1), np.zeros(1), row, np.ones(1), 0.0, 0, tuple(outputs)
    )
    w = frequency_grid(integral, plant, design.Ts)
    return w, plant_response(plant, np.exp(1j * w * design.Ts))[:, goal.i]


def _oscillation(w: Vector, P: Complex, Ts: float) -> float:
    """Return the frequency at which the phase of P(z)/z passes -180°."""
    phase = np.unwrap(np.angle(P * np.exp(-1j * w * Ts)))
    phase -= 2 * np.pi * np.round((phase[0] + np.pi / 4) / (2 * np.pi))
    below = np.flatnonzero(phase < -np.pi)
    return float(w[below[0]]) if below.size else float(w[-1])


def _parts(w: Vector, Ts: float, T_f: float, is_rate: bool) -> Complex:
    """Return the responses from -y to the P, I and D part with unit gains, (3, nf)."""
    z = np.exp(1j * w * Ts)
    a = T_f / (T_f + Ts)
    if is_rate:
        return np.array([(1 - a) * (1 - 1 / z) / (Ts * (z - a)), 1 / z])
    return np.array([1 / z, Ts / (z - 1), (z - 1) / (z * (z - a) * (T_f + Ts))])


def _lambda_tuned(
    w: Vector, loops: Complex, time_constant: float, design: DesignModel, goal: Goal
) -> Vector:
    """Return the gains whose loop is nearest to that of the closed loop that is asked for."""
    s = 1j * w
    theta = (design.plant.delay + 1.5) * design.Ts  # with the law's sample and half a held one
    lag = time_constant * s + 1
    T = np.exp(-theta * s) / lag
    if design.plant.integrator and not goal.is_rate:
        T *= ((2 * time_constant + theta) * s + 1) / lag
    # The error of the closed loop is that of L, weighted by the sensitivity.
    weight = (1 - T) * (w < 2 / time_constant) * np.sqrt(np.gradient(np.log(w)))
    rows, target = (loops * weight).T, T * weight / (1 - T)
    gains, *_ = np.linalg.lstsq(
        np.vstack([rows.real, rows.imag]), np.concatenate([target.real, target.imag]), rcond=None
    )
    return np.asarray(gains)


def _largest_integral(loops: Complex, ms: float) -> Vector:
    """Return the gains with the largest k_i whose loop has at most this Ms.

    Along rising gains, the first loop beyond Ms ends the range: the loops before it are stable, for
    a loop on the way to instability passes through -1. The grid of the gains becomes finer around
    the best of them.
    """
    sign = np.sign(loops[1][0].real - loops[1][0].imag)
    loops = loops * sign
    scale = 1 / np.abs(loops[0]).max()
    k_p = scale * np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 61)])
    top = _feasible(k_p[:, None] * loops[0], ms)
    k_p = k_p[: max(int(top.argmin()) if not top.all() else k_p.size, 1)]
    T_d = np.zeros(1)
    k_i = np.geomspace(0.1 / np.abs(loops[1]).max(), 10 / np.abs(loops[1]).min(), 100)
    if len(loops) > 2:
        ratio = np.abs(loops[2] / loops[0])
        T_d = np.append(0.0, np.geomspace(0.3 / ratio.max(), 0.3 / np.median(ratio), 12))
    best = np.zeros(3)  # k_i, k_p, T_d
    for round_ in range(_ROUNDS):
        for t in T_d:
            proportional = loops[0] + (t * loops[2] if len(loops) > 2 else 0.0)
            for p in k_p:
                values = k_i[k_i <= p / (4 * t)] if t else k_i
                good = _feasible(p * proportional + values[:, None] * loops[1], ms)
                count = int(good.argmin()) if not good.all() else good.size
                if count and values[count - 1] > best[0]:
                    best = np.array([values[count - 1], p, t])
        step_p = best[1] * 0.5 if len(k_p) == 1 or best[1] == 0 else np.diff(k_p).max() / 3
        k_p = np.unique(np.clip(best[1] + step_p * np.linspace(-1, 1, 7), 0.0, None))
        if len(loops) > 2:
            step = (np.diff(T_d).max() if T_d.size > 1 else best[2]) / 3
            T_d = np.unique(np.clip(best[2] + step * np.linspace(-1, 1, 7), 0.0, None))
        k_i = np.linspace(best[0], (1.1 if round_ else 1.5) * best[0], 24)
    if not best[0]:
        raise InputError(f"no law meets Ms of {digits(ms, 3)}: ask for a larger ms")
    gains = np.array([best[1], best[0], best[1] * best[2]])[: len(loops)]
    return np.asarray(sign * gains)


def _feasible(L: Complex, ms: float) -> NDArray[np.bool_]:
    return np.asarray(np.abs(1 + L).min(axis=1) >= 1 / ms)


def _pid_law(
    design: DesignModel,
    goal: Goal,
    gains: Vector,
    T_f: float,
    b: float,
    settings: dict[str, Any],
) -> ControlLaw:
    """Return the law of the gains, with its anti-windup."""
    Ts, i = design.Ts, goal.i
    k_p, k_i, k_d = (float(x) for x in [*gains, 0.0][:3])
    share, slope = Ts / (T_f + Ts), k_d / (T_f + Ts)
    start = 0.0 if design.plant.integrator else design.plant.gain(i) * (design.rest - design.u0)
    I_0 = (design.rest - design.u0 if not design.plant.integrator else 0.0) + k_p * (1 - b) * start
    if goal.is_rate:  # I, the newest y, the filtered rate
        A = np.array([[1.0, k_i, 0.0], [0.0, 0.0, 0.0], [0.0, -share / Ts, 1 - share]])
        B_r, B_y = np.array([k_i * Ts, 0.0, 0.0]), np.array([-k_i, 1.0, share / Ts])
        C, x0 = np.array([1.0, 0.0, -k_p]), np.zeros(3)
    else:  # I, the newest y, the filtered y
        A = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, share, 1 - share]])
        B_r, B_y = np.array([k_i * Ts, 0.0, 0.0]), np.array([-k_i * Ts, 1.0, 0.0])
        C = np.array([1.0, -k_p - slope, slope])
        x0 = np.array([I_0, start, start])
    n = 3 if goal.is_rate or k_d else 2
    A, B_r, B_y, C, x0 = A[:n, :n], B_r[:n], B_y[:n], C[:n], x0[:n]
    D = b * k_p
    # The integral part follows the voltage that was applied (Åström's observer form).
    T_i = abs(k_p / k_i) if k_i else np.inf
    T_t = max(2 * Ts, np.sqrt(T_i * abs(k_d / k_p)) if k_d and k_p else T_i)
    K = np.zeros(n)
    K[0] = Ts / T_t
    named = {"k_p": k_p, "k_i": k_i, "k_d": k_d, "T_f": T_f, "b": b, "T_t": float(T_t)}
    return make_law(
        design,
        goal.law_reference,
        A=A - np.outer(K, C),
        B=np.column_stack([B_r - K * D, K, B_y]),
        C=C,
        D=D,
        F=None,
        x0=x0,
        outputs=(i,),
        settings=settings | {"gains": named},
    )
