"""Laws of state feedback with an observer that estimates a disturbance of the input in V.

With the estimate x of the plant's state and d of the input's disturbance, the law is ::

    v = u0 + N_u r - K (x - N_x r) - d

and the observer is in predictor form, on P(z): the delay of the law is counted once. Integral
action is the estimate d: a person can read it as friction in volts.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from armrig_core.control.control_law import MAX_STATES, ControlLaw, Reference
from armrig_core.errors import InputError
from armrig_core.process.calls import with_argument_checks
from armrig_core.rig.description import Description
from numpy.typing import ArrayLike
from scipy.linalg import schur, solve_discrete_lyapunov
from scipy.optimize import minimize

from armrig.control.law_monitor import (
    kalman_predictor,
    monitor_of,
    most_blind,
    rest_state,
    rows_of,
    with_disturbance,
)
from armrig.control.loop import (
    LawMatrices,
    are_stable,
    close_loop,
    count_hidden_modes,
    margins,
    plant_response,
)
from armrig.control.plant import (
    DesignModel,
    Plant,
    PlantModel,
    Validation,
    design_model,
    require_finite,
)
from armrig.models.state_space import Complex, Matrix, Vector
from armrig.numerics.quantities import digits, plural

_FAST = 0.02
"""Modulus below which a pole of the plant belongs to a dead time: it is not moved."""
_GAIN_DRAWS, _STDS, _EXACT = 100, 3.0, 1e-6
_MAX_MS = 10.0
"""Ms of the model above which a law is refused."""


@with_argument_checks
def place(
    model: PlantModel,
    poles: Sequence[complex],
    *,
    observer: Sequence[complex] | None = None,
    output: str | None = None,
    rate: bool | None = None,
    input_noise: float | None = None,
    drift: float | None = None,
    reference: tuple[float, float] | None = None,
    u0: float | None = None,
    y0: float | Sequence[float] = 0.0,
    rig: Description | None = None,
    Ts: float | None = None,
    validation: Validation | None = None,
) -> ControlLaw:
    """Return a law of state feedback that places the poles of the closed loop.

    The other poles are those of the observer, a Kalman predictor unless `observer` places them,
    too. If the rate of an integrating output follows r, the angle itself is not fed back, and the
    number of poles is one less than the number of states.

    Parameters
    ----------
    model : Fit, GreyFit or python-control system
        Model of one input and one or two outputs. A GreyFit or a system with one pole at exactly 1
        integrates; a Fit must have its integrator fixed.
    poles : sequence of complex
        Poles in s, in rad/s, such as [-18+18j, -18-18j, -42]. With a dead time that the law does
        not have as states, these are the poles that dominate; the others must be faster.
    observer : sequence of complex, optional
        Poles of the observer in s, one more than the states of the plant.
    output : str, optional
        Name of the output that follows r; the first by default.
    rate : bool, optional
        True if the rate of an integrating output follows r. The default is True for a turning
        output.
    input_noise, drift : float, optional
        Deviations, in V, of the noise of the input, and of the change of its disturbance in a
        sample. The defaults are 2 % and 0.2 % of the range of the input. A larger drift makes the
        integral action faster.
    reference : tuple of float, optional
        Lowest and highest r that a run may request; by default what the input's range reaches.
    u0, y0 : float, optional
        Operating point of a model of deviations: voltage in V, and the output there. `y0` is a
        sequence for two outputs.
    rig : Description, optional
        Description of the rig, `armrig_core.rig.description.read_description`. The default is the
        arm for models of its outputs, otherwise an input of 0 to 5 V.
    Ts : float, optional
        Sampling time of the law, in s, for a model in s.
    validation : Dataset or Signals, optional
        Data that the model was not estimated from; without them the law is in doubt.

    Raises
    ------
    InputError
        The model has a free integrator, or no law meets the poles.

    References
    ----------
    .. [1] K. J. Åström, B. Wittenmark, *Computer-Controlled Systems*, 3rd ed., 1997, chapters 4
       and 11.

    Examples
    --------
    >>> arm = armrig.physics.arm(armrig.physics.ArmParameters())
    >>> law = armrig.control.place(arm, [-18+18j, -18-18j, -42], rate=True, Ts=0.01)
    >>> law.order, law.reference.name
    (5, 'velocity')
    """
    design = design_model(model, rig=rig, Ts=Ts, u0=u0, y0=y0, output=output, validation=validation)
    goal = Goal.of(design, output, rate, reference)
    s = np.atleast_1d(np.asarray(poles, dtype=np.complex128))
    plant = _with_chain(design.plant)
    A, B, modes = goal.feedback_modes(plant)
    _check_poles("poles", s, B.size, design.Ts)
    K = _place_poles(A, B, np.exp(s * design.Ts), plant.delay)
    if plant.delay and not _dominate(A, B, K, s * design.Ts, plant.delay):
        slower = (0.9**k for k in range(1, 60))
        scale = next(
            (c for c in slower if _can_dominate(A, B, c * s * design.Ts, plant.delay)), 0.0
        )
        raise InputError(
            f"poles: with the dead time of {plural(plant.delay, 'sample')}, another pole would be "
            f"slower than these; at most {digits(scale * np.abs(s).max(), 2)} rad/s can be met"
        )
    K = K @ modes
    L = _observer(design, plant, input_noise, drift, observer)
    settings = {"method": "place", "poles": [[float(x.real), float(x.imag)] for x in s]}
    return _law(design, goal, plant, K, L, settings)


@with_argument_checks
def lqg(
    model: PlantModel,
    *,
    effort: float = 1.0,
    output: str | None = None,
    rate: bool | None = None,
    input_noise: float | None = None,
    drift: float | None = None,
    reference: tuple[float, float] | None = None,
    u0: float | None = None,
    y0: float | Sequence[float] = 0.0,
    rig: Description | None = None,
    Ts: float | None = None,
    validation: Validation | None = None,
) -> ControlLaw:
    """Return the law that minimises the sum of (z/g)² + effort · u², with a Kalman predictor.

    z is the output that follows r, or its rate, and g the gain from the voltage to z. For an output
    that integrates, g is the change of z in a second at 1 V.

    Parameters
    ----------
    model : Fit, GreyFit or python-control system
        As in `armrig.control.place`.
    effort : float
        Cost of the input; a larger value gives a slower law.
    output, rate, input_noise, drift, reference, u0, y0, rig, Ts, validation
        As in `armrig.control.place`.

    Raises
    ------
    InputError
        The model has a free integrator, or the law would have no margins.

    References
    ----------
    .. [1] K. J. Åström, B. Wittenmark, *Computer-Controlled Systems*, 3rd ed., 1997, chapter 11.

    Examples
    --------
    >>> arm = armrig.physics.arm(armrig.physics.ArmParameters())
    >>> law = armrig.control.lqg(arm, effort=0.1, rate=True, Ts=0.01)
    >>> law.order, law.design["method"]
    (5, 'lqg')
    """
    design = design_model(model, rig=rig, Ts=Ts, u0=u0, y0=y0, output=output, validation=validation)
    goal = Goal.of(design, output, rate, reference)
    require_finite(effort=effort)
    if not effort > 0:
        raise InputError(f"effort={effort:g} must be above 0")
    plant = _with_chain(design.plant)
    A, B, modes = goal.feedback_modes(plant)
    weight = goal.weight(plant, design.Ts) @ modes.T
    L = _observer(design, plant, input_noise, drift, None)

    K = _optimal(A, B, weight, effort)
    if plant.delay:
        K = _optimal_late(A, B, weight, effort, plant.delay, K)
    return _law(design, goal, plant, K @ modes, L, {"method": "lqg", "effort": float(effort)})


class Goal:
    """The variable z that follows r, and the part of the state that is fed back."""

    def __init__(
        self, design: DesignModel, i: int, is_rate: bool, reference: tuple[float, float] | None
    ) -> None:
        self.i, self.is_rate, self.design = i, is_rate, design
        self.range = reference

    @classmethod
    def of(
        cls,
        design: DesignModel,
        output: str | None,
        rate: bool | None,
        reference: tuple[float, float] | None,
    ) -> Goal:
        """Return the goal; refuse an output that the model does not have, or a rate of none."""
        names = [o.name for o in design.outputs]
        if output is not None and output not in names:
            raise InputError(f"output={output!r}: the model has {', '.join(names)}")
        i = names.index(output) if output else 0
        integrates = design.plant.integrator and bool(design.plant.C[i, 0])
        if rate and not integrates:
            raise InputError(f"{names[i]} does not integrate, so its rate cannot follow r: rate")
        is_rate = design.outputs[i].turning and integrates if rate is None else rate
        if design.plant.integrator and not integrates:
            raise InputError(
                f"{names[i]} does not integrate, but another output does: choose it by output=, or "
                f"a model of {names[i]} alone, such as fit[{names[i]!r}]"
            )
        goal = cls(design, i, is_rate, reference)
        goal.require_gain()
        return goal

    def require_gain(self) -> None:
        """Refuse an output that a constant voltage does not change, so that it cannot follow r."""
        plant, name = self.design.plant, self.design.outputs[self.i].name
        gain = plant.gain(self.i)
        drawn = [x.gain(self.i) for x in self.design.draw(_GAIN_DRAWS)]
        std = float(np.std(drawn)) if drawn else 0.0
        w = np.exp(1j * np.geomspace(1e-3, np.pi, 100))
        largest = np.abs(plant_response(plant, w)[:, self.i]).max()
        if abs(gain) < max(_STDS * std, _EXACT * largest):
            raise InputError(
                f"{name} has the steady gain {digits(gain, 2)} ± {digits(std, 1)} per V: it cannot "
                "follow r, for a constant voltage does not hold it; choose another output"
            )

    def feedback_modes(self, plant: Plant) -> tuple[Matrix, Vector, Matrix]:
        """Return A and B of the modes that are fed back, and the rows that give them from x.

        If the rate of the integrator follows r, the integrator is left out. The modes of a dead
        time, which are at 0 with every K, are left out, too.
        """
        first = int(self.is_rate)
        T, Z, count = schur(plant.A[first:, first:].T, sort=lambda x, y: np.hypot(x, y) > _FAST)
        modes = np.hstack([np.zeros((count, first)), Z[:, :count].T])
        return T[:count, :count].T, modes @ plant.B, modes

    def weight(self, plant: Plant, Ts: float) -> Vector:
        """Return the row of z, divided by its gain, over the states."""
        gain = plant.gain(self.i)
        if self.is_rate:
            return np.asarray(plant.C[self.i] @ (plant.A - np.eye(plant.order)) / gain)
        return np.asarray(plant.C[self.i] / (gain / (Ts if plant.integrator else 1.0)))

    def steady_state(self, plant: Plant, Ts: float) -> tuple[Vector, float]:
        """Return the state N_x of the plant and the voltage N_u that hold z = 1."""
        n = plant.order
        if self.is_rate:
            N_u = Ts / plant.gain(self.i)
            other_states = np.linalg.solve(np.eye(n - 1) - plant.A[1:, 1:], plant.B[1:] * N_u)
            return np.append(0.0, other_states), N_u
        pencil = np.block([[plant.A - np.eye(n), plant.B[:, None]], [plant.C[self.i], np.zeros(1)]])
        x = np.linalg.solve(pencil, np.append(np.zeros(n), 1.0))
        return x[:-1], float(x[-1])

    @property
    def law_reference(self) -> Reference:
        """Reference of the law: by default what the range of the input reaches."""
        design = self.design
        out = design.outputs[self.i]
        low_limit, high_limit = design.ranges[self.i]
        name = design.rates[self.i] if self.is_rate else out.name
        unit = f"{out.unit}/s" if self.is_rate else out.unit
        if self.range is not None:
            low, high = self.range
        elif design.plant.integrator and not self.is_rate:
            low, high = low_limit, high_limit
        else:
            gain = design.plant.gain(self.i) / (design.Ts if self.is_rate else 1.0)
            low, high = sorted(gain * (u - design.u0) for u in (design.lo, design.hi))
            step = 10 ** np.floor(np.log10(max(high - low, np.finfo(float).tiny))) / 10
            low, high = np.floor(low / step) * step, np.ceil(high / step) * step
            if not self.is_rate:
                low, high = max(low, low_limit), min(high, high_limit)
        if not (np.isfinite([low, high]).all() and low <= high):
            raise InputError(
                f"{name} has no limits: give reference=(lowest, highest) (--reference LOW,HIGH)"
            )
        return Reference(name=name, unit=unit, low=float(low) + 0.0, high=float(high) + 0.0)


def _with_chain(plant: Plant) -> Plant:
    """Return the plant with its dead time as states, if a law has room for them."""
    n, d = plant.order, plant.delay
    if not d or n + d + 1 > MAX_STATES:
        return plant
    A, B = np.zeros((n + d, n + d)), np.zeros(n + d)
    A[:n, :n], A[:n, n + d - 1] = plant.A, plant.B
    A[n:, n:] = np.eye(d, k=-1)
    B[n] = 1.0
    C = np.hstack([plant.C, np.zeros((len(plant.C), d))])
    if plant.integrator:  # it counts the voltages in the chain, too, so that it stays apart
        A[0], B[0] = np.eye(1, n + d)[0], plant.B[0]
        C[:, n:] = -plant.B[0] * plant.C[:, :1]
    return Plant(A=A, B=B, C=C, integrator=plant.integrator)


def _check_poles(name: str, s: Complex, wanted: int, Ts: float) -> None:
    """Refuse poles in a wrong number, unstable, not in pairs, or too fast for the sampling."""
    if s.size != wanted:
        raise InputError(f"{name}: {plural(s.size, 'pole')}, and the model needs {wanted}")
    if not np.isfinite(s).all() or not (s.real < 0).all():
        raise InputError(f"{name}: each pole in s needs a real part below 0, in rad/s")
    if not np.allclose(np.sort_complex(s), np.sort_complex(s.conj())):
        raise InputError(f"{name}: complex poles come in pairs, such as -18+18j and -18-18j")
    fastest = float(np.abs(s).max())
    if fastest * Ts > 0.5:
        raise InputError(
            f"{name}: a pole at {digits(fastest, 3)} rad/s has a time constant below two samples "
            f"of {Ts:g} s; at most {digits(0.5 / Ts, 3)} rad/s can be met"
        )


def _place_poles(A: Matrix, B: Vector, z: Complex, delay: int = 0) -> Vector:
    """Return K so that z are poles of the loop, exactly.

    Without dead time these are all poles of A - B K. With it, each z is a root of
    1 + z^-d K (z I - A)^-1 B, a linear equation in K.
    """
    import control

    if not delay:
        if len({complex(round(x.real, 9), round(x.imag, 9)) for x in z}) == z.size:
            return np.asarray(control.place(A, B[:, None], z)[0])
        return np.ravel(control.place_acker(A, B[:, None], z))
    rows = [np.linalg.solve(x * np.eye(B.size) - A, B) for x in z]
    try:
        K = np.linalg.solve(np.array(rows), -(z**delay))
    except np.linalg.LinAlgError:
        raise InputError("with a dead time, the poles must differ from each other") from None
    return np.asarray(K.real)


def _optimal(A: Matrix, B: Vector, weight: Vector, effort: float) -> Vector:
    """Return the gain K of the linear quadratic regulator."""
    import control

    try:
        K, _, _ = control.dlqr(A, B[:, None], np.outer(weight, weight), np.array([[effort]]))
    except (ValueError, np.linalg.LinAlgError) as err:
        raise InputError(f"there is no optimal law for this model: {err}") from None
    return np.asarray(K[0])


def _late(A: Matrix, B: Vector, K: Vector, delay: int) -> Matrix:
    """Return the matrix of x[k+1] = A x[k] - B K x[k-delay], with the past commands as states."""
    n = B.size
    M = np.zeros((n + delay, n + delay))
    M[:n, :n], M[:n, -1] = A, B
    M[n, :n] = -K
    M[n + 1 :, n:-1] = np.eye(delay - 1)
    return M


def _dominate(A: Matrix, B: Vector, K: Vector, s: Complex, delay: int) -> bool:
    """Return whether no pole of the loop with the dead time is slower than the poles s Ts."""
    poles = np.abs(np.linalg.eigvals(_late(A, B, K, delay)))
    return bool(poles.max() <= np.exp(s.real.max()) * (1 + 1e-9))


def _can_dominate(A: Matrix, B: Vector, s: Complex, delay: int) -> bool:
    return _dominate(A, B, _place_poles(A, B, np.exp(s), delay), s, delay)


def _optimal_late(
    A: Matrix, B: Vector, weight: Vector, effort: float, delay: int, start: Vector
) -> Vector:
    """Return the gain K on x[k-delay] with the least cost of a pulse at the input.

    The regulator without this structure feeds back the past commands, too, for which a law has no
    states. The search begins at the largest share of `start` that is stable.
    """
    n = B.size
    pulse = np.append(B, np.zeros(delay))

    def cost(K: Vector) -> float:
        M = _late(A, B, K, delay)
        if not np.abs(np.linalg.eigvals(M)).max() < 1:
            return float(np.inf)
        X = solve_discrete_lyapunov(M, np.outer(pulse, pulse))[:n, :n]
        return float(weight @ X @ weight + effort * (K @ X @ K))

    K = next((c * start for c in 0.5 ** np.arange(16) if np.isfinite(cost(c * start))), None)
    if K is None:
        raise InputError(
            f"no law of this structure holds the plant with {plural(delay, 'sample')} of dead time"
        )
    size = np.where(K == 0, 1.0, K)
    optimum = minimize(lambda x: cost(x * size), K / size, method="Nelder-Mead", tol=1e-9)
    return np.asarray(optimum.x * size)


def _observer(
    design: DesignModel,
    plant: Plant,
    input_noise: float | None,
    drift: float | None,
    poles: Sequence[complex] | None,
) -> Matrix:
    """Return the gain L (n + 1, ny) of the predictor of the state and the input's disturbance."""
    import control

    require_finite(input_noise=input_noise, drift=drift)
    if not all(x is None or x > 0 for x in (input_noise, drift)):
        raise InputError("input_noise and drift are deviations above 0, in V")
    if poles is not None:
        A, C = with_disturbance(plant)
        s = np.atleast_1d(np.asarray(poles, dtype=np.complex128))
        _check_poles("observer", s, design.plant.order + 1, design.Ts)
        z = np.append(np.exp(s * design.Ts), np.zeros(plant.order - design.plant.order))
        if len(C) > 1:
            return np.asarray(control.place(A.T, C.T, z)).T
        return _place_poles(A.T, C[0], z)[:, None]
    span = design.hi - design.lo
    return kalman_predictor(plant, design.noise, span, input_noise=input_noise, drift=drift)[0]


def _law(
    design: DesignModel,
    goal: Goal,
    plant: Plant,
    K: Vector,
    L: Matrix,
    settings: dict[str, Any],
) -> ControlLaw:
    """Return the law of the gains; refuse a law without margins on its own model."""
    n = plant.order
    if n + 1 > MAX_STATES:
        raise InputError(
            f"the law would have {plural(n + 1, 'state')}, at most {MAX_STATES} are allowed: lower "
            'the orders, or estimate with shared="denominator"'
        )
    A, C = with_disturbance(plant)
    N_x, N_u = goal.steady_state(plant, design.Ts)
    law = make_law(
        design,
        goal.law_reference,
        A=A - L @ C,
        B=np.column_stack([np.zeros(n + 1), np.append(plant.B, 0.0), L]),
        C=-np.append(K, 1.0),
        D=N_u + float(K @ N_x),
        F=C,
        x0=np.append(rest_state(design, plant), 0.0),
        input_delay=plant.delay,
        settings=settings,
    )
    return require_margins(law, design)


def make_law(
    design: DesignModel,
    reference: Reference,
    *,
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: float,
    F: Matrix | None,
    x0: ArrayLike,
    input_delay: int = 0,
    outputs: Sequence[int] | None = None,
    settings: dict[str, Any],
) -> ControlLaw:
    """Return the law of a design with the limits of the rig, and its monitor."""
    used = [*range(len(design.outputs))] if outputs is None else outputs
    matrices = LawMatrices.of_arrays(A, B, C, D, input_delay, used)
    return ControlLaw(
        Ts_us=round(design.Ts * 1e6),
        input=design.input,
        outputs=tuple(design.outputs[i] for i in used),
        reference=reference,
        A=rows_of(A),
        B=rows_of(B),
        C=tuple(np.asarray(C, np.float64).tolist()),
        D=float(D),
        F=None if F is None else rows_of(F),
        x0=tuple(np.asarray(x0, np.float64).tolist()),
        u0=design.u0,
        lo=design.lo,
        hi=design.hi,
        input_delay=input_delay,
        most_blind=most_blind(design.Ts),
        monitor=monitor_of(design, matrices),
        design=settings | {"model_sha256": design.sha256, "doubts": [*design.doubts]},
    )


def require_margins(law: ControlLaw, design: DesignModel) -> ControlLaw:
    """Return the law with its predicted margins; refuse a law that its own model makes unstable."""
    matrices = LawMatrices.of(law, [o.name for o in design.outputs])
    loop = close_loop(matrices, [design.plant])
    if not are_stable(loop, count_hidden_modes(loop))[0]:
        others = np.abs(loop.poles[0]).max()
        raise InputError(
            f"no law meets this: the loop would be unstable on its own model (a pole at |z| = "
            f"{others:.4g}); ask for a slower loop"
        )
    predicted = margins(matrices, design.plant, design.Ts)
    if predicted.Ms > _MAX_MS:
        raise InputError(
            f"no law meets this: Ms would be {digits(predicted.Ms, 3)} on the model itself; ask "
            "for a slower loop"
        )
    facts = {
        "Ms": predicted.Ms,
        "gain_margin": predicted.gain if np.isfinite(predicted.gain) else None,
        "phase_margin_deg": predicted.phase_deg if np.isfinite(predicted.phase_deg) else None,
        "delay_margin_s": predicted.delay_s if np.isfinite(predicted.delay_s) else None,
    }
    return ControlLaw(
        **{name: getattr(law, name) for name in law.__struct_fields__ if name != "design"},
        design=law.design | {"margins": facts},
    )
