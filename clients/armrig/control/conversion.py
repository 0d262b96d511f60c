"""Conversion of a linear controller of python-control into a control law.

The controller C(z) has the inputs r, Δu and y, and the output v - u0. Its states are x_c. If
C has a direct term from y, u[k] would depend on y[k], which the device samples in the moment in
which it latches u[k]. The law is then z^-1 C(z) on y, with y_d[k] = y[k-1] as states; r is not
delayed ::

    x_c[k+1] = A x_c + B_r r[k] + B_y y_d[k] + K (Δu[k] - C x_c - D_r r[k] - D_y y_d[k])
    v[k] = C x_c + D_r r[k] + D_y y_d[k] + u0

K is the gain of the anti-windup in Åström's observer form: if the voltage is not limited, the term
is 0. With a model, the law has a monitor, which also predicts a missing output.

References
----------
.. [1] K. J. Åström, B. Wittenmark, *Computer-Controlled Systems*, 3rd ed., 1997, section 9.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log
from typing import Any

import msgspec
import numpy as np
from armrig_core.control.control_law import (
    MAX_STATES,
    MAX_TS_US,
    MIN_TS_US,
    ControlLaw,
    LawOutput,
    Reference,
)
from armrig_core.errors import InputError, InputTypeError
from armrig_core.process.calls import with_argument_checks
from armrig_core.rig.description import Description, builtin
from armrig_core.telemetry.channels import SYMBOLS
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, eigvals, schur

from armrig.control.law_monitor import monitor_of, rows_of
from armrig.control.law_monitor import most_blind as blind_samples
from armrig.control.loop import LawMatrices
from armrig.control.plant import DesignModel, PlantModel, design_model
from armrig.models.state_space import Matrix, Vector
from armrig.numerics.quantities import digits, plural

_EXACT = 1e-9
"""Largest difference of sampling times, in s, and of voltages that count as equal."""
_ROUNDING = 1e-9
"""Share of the largest number that is rounding."""
_PART_US = 1e-3
"""Largest part of 1 µs in a sampling time that is rounding."""
_TRACKING_SAMPLES = 10
"""Tracking time of a controller without a zero, in samples."""
_LEAST_SAMPLES = 2
"""Least tracking time by default, in samples."""


@with_argument_checks
def control_law(
    C: Any,
    *,
    outputs: str | Sequence[str],
    reference: tuple[float, float] | Reference,
    rig: Description | None = None,
    Ts: float | None = None,
    unit: str | None = None,
    u0: float | None = None,
    y0: float | Sequence[float] = 0.0,
    lo: float | None = None,
    hi: float | None = None,
    slew: float = 0.0,
    model: PlantModel | None = None,
    tracking_time: float | None = None,
    K: ArrayLike | None = None,
    most_blind: int | None = None,
    most_limited: int = 0,
) -> ControlLaw:
    """Return a controller of python-control as a control law, with anti-windup.

    A controller of one input acts on r - y. The inputs of any other controller are r and the
    outputs, in this order or by their names, "r" and "u", the latched voltage. A controller with a
    direct term from an output acts on the newest sample y[k-1]: design it on P(z)/z. Any other
    controller is designed on P(z).

    Parameters
    ----------
    C : python-control system
        Controller in discrete time, with at most 8 states in all.
    outputs : str or sequence of str
        Names of the one or two outputs that the controller uses, as the rig has them.
    reference : tuple of float or Reference
        Lowest and highest r that a run may request, in the unit of the first output; or another
        quantity.
    rig : Description, optional
        Description of the rig, `armrig_core.rig.description.read_description`; by default the arm
        for its outputs.
    Ts : float, optional
        Sampling time of a controller without one, in s.
    unit : str, optional
        Unit of the controller's output, V or that of the rig's input. It is required for a rig
        whose input is not in V. `u0`, `lo`, `hi` and `slew` have the same unit.
    u0, y0 : float, default rest and 0
        Operating point: with r and the outputs at y0, a controller at rest gives u0. For a
        `Reference` of another quantity than the first output, r is 0 there. `y0` is a sequence for
        two outputs, and 0 for a turning one.
    lo, hi : float, optional
        Lowest and highest value of the input; by default the limits of the rig.
    slew : float, default 0
        Largest change of the input in one sample; 0 is no limit.
    model : Fit, GreyFit or python-control system, optional
        Model of the outputs, for the law's monitor. The monitor also predicts an output if a sample
        is missing, so a turning output requires a model.
    tracking_time : float, optional
        Time constant, in s, with which slow modes of the controller follow the latched voltage. The
        default is the time constant of the controller's slowest zero.
    K : array_like, shape (n,), optional
        Gain of the anti-windup, in place of `tracking_time`.
    most_blind, most_limited : int, optional
        Fields of the law. The defaults are the samples in 0.2 s, or 10 samples and 0.1 s if that is
        longer, and no limit.

    Raises
    ------
    InputError
        The controller is in continuous time, its inputs are not those of a law, it has too many
        states, or its anti-windup is unstable.

    References
    ----------
    .. [1] K. J. Åström, B. Wittenmark, *Computer-Controlled Systems*, 3rd ed., 1997, section 9.4.

    Examples
    --------
    A PI controller of a heater, in V, designed on P(z)/z:

    >>> import control
    >>> from armrig_core.rig.description import builtin
    >>> C = control.tf([0.2, -0.199], [1, -1], 1.0)
    >>> law = armrig.control.control_law(C, outputs="T1", reference=(23, 60), rig=builtin("heater"),
    ...                          unit="V", u0=0.5, y0=28)
    >>> law.order, law.x0, law.u0
    (2, (0.0, 28.0), 0.5)
    """
    law_outputs, rig = _outputs(outputs, rig)
    names = [o.name for o in law_outputs]
    scale, offset = _scale(rig, unit)
    controller = _controller(C, Ts, names).scaled(scale)
    operating = _operating_outputs(y0, law_outputs)
    design = monitor = None
    if model is not None:
        design = _design_of(model, rig, controller.Ts, names)
    elif turning := [o.name for o in law_outputs if o.turning]:
        raise InputError(
            f"{turning[0]} turns through a dead band, so the law needs a prediction of it: give a "
            f"model of {turning[0]}, model="
        )
    r = reference
    if not isinstance(r, Reference):
        low, high = r
        unit_y = law_outputs[0].unit
        r = Reference(name=names[0], unit=unit_y, low=float(low), high=float(high))
    is_output = (r.name, r.unit) == (names[0], law_outputs[0].unit)
    x0, v0 = controller.equilibrium(operating[0] if is_output else 0.0, operating)
    at_rest = rig.input.rest_v if design is None else design.u0
    u0_v = (at_rest if u0 is None else (u0 - offset) / scale) - v0
    if design is not None and abs(u0_v - design.u0) > _EXACT:
        raise InputError(
            f"with model=, the law has the operating point of the model, {design.u0:g} V at y = 0, "
            f"and not {u0_v:g} V: leave out u0 and y0, and give the controller integral action"
        )
    gain = _gain(controller, tracking_time, K, scale)
    parts = _with_anti_windup(controller, gain, operating, x0)
    if parts.x0.size > MAX_STATES:
        raise InputError(
            f"the law would have {plural(parts.x0.size, 'state')}, {x0.size} of them of C; at most "
            f"{MAX_STATES} are allowed: reduce the order of C"
        )
    limits = sorted(
        default if value is None else (value - offset) / scale
        for value, default in ((lo, 0.0), (hi, rig.input.u_max_v))
    )
    if not 0 <= limits[0] < limits[1] <= rig.input.u_max_v:
        raise InputError(
            f"lo and hi are {limits[0]:g} and {limits[1]:g} V at the pin: the rig allows 0 to "
            f"{rig.input.u_max_v:g} V"
        )
    if design is not None:
        used = [[o.name for o in design.outputs].index(name) for name in names]
        matrices = LawMatrices.of_arrays(parts.A, parts.B, parts.C, parts.D, 0, used)
        monitor = monitor_of(design, matrices)
    law = ControlLaw(
        Ts_us=round(controller.Ts * 1e6),
        input=rig.input.name,
        outputs=law_outputs,
        reference=r,
        A=rows_of(parts.A),
        B=rows_of(parts.B),
        C=tuple(parts.C.tolist()),
        D=float(parts.D),
        x0=tuple(parts.x0.tolist()),
        u0=float(u0_v),
        lo=float(limits[0]),
        hi=float(limits[1]),
        slew=float(abs(slew / scale)),
        most_blind=blind_samples(controller.Ts) if most_blind is None else most_blind,
        most_limited=most_limited,
        monitor=monitor,
        design={"method": "conversion", "anti_windup": gain.tolist()},
    )
    return ControlLaw.of(msgspec.json.encode(law))  # with the checks of a file


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Controller:
    """C(z) from r, Δu and y to Δv."""

    A: Matrix
    B_r: Vector
    B_u: Vector
    B_y: Matrix
    """(n, ny)."""
    C: Vector
    D_r: float
    D_y: Vector
    Ts: float
    """Sampling time, in s."""

    def scaled(self, scale: float) -> Controller:
        """Return the controller in V; 1 V is `scale` in the unit of its output."""
        return replace(
            self,
            B_u=self.B_u * scale,
            C=self.C / scale,
            D_r=self.D_r / scale,
            D_y=self.D_y / scale,
        )

    def equilibrium(self, r: float, y: Vector) -> tuple[Vector, float]:
        """Return x and Δv at rest with r and y; refuse a controller that does not rest there."""
        direct = self.D_r * r + float(self.D_y @ y)
        M = np.eye(self.C.size) - self.A - np.outer(self.B_u, self.C)
        drive = self.B_r * r + self.B_y @ y + self.B_u * direct
        x = np.asarray(np.linalg.lstsq(M, drive, rcond=None)[0], np.float64)
        size = np.abs(drive).max(initial=0.0)
        if np.abs(M @ x - drive).max(initial=0.0) > _ROUNDING * size:
            raise InputError(
                f"C does not rest with r = {r:g} and y = {', '.join(f'{x:g}' for x in y)}: its "
                "integral part goes on; give a y0 at which it rests"
            )
        return x, float(self.C @ x) + direct


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LawParts:
    """Matrices of a law."""

    A: Matrix
    B: Matrix
    C: Vector
    D: float
    x0: Vector


def _outputs(
    outputs: str | Sequence[str], rig: Description | None
) -> tuple[tuple[LawOutput, ...], Description]:
    """Return the outputs of the law, and the description of their rig."""
    names = [outputs] if isinstance(outputs, str) else [*outputs]
    if not 1 <= len(names) <= 2:
        raise InputError(f"outputs={names}: a law uses one or two outputs")
    if rig is None:
        if not {*names} <= {*SYMBOLS}:
            raise InputError(
                f"outputs={names}: these are no outputs of the arm; give the description of their "
                "rig, rig="
            )
        rig = builtin("arm")
    if unknown := [name for name in names if name not in rig.outputs]:
        raise InputError(
            f"outputs: the rig {rig.rig.name} has no {unknown[0]}; it has {', '.join(rig.outputs)}"
        )
    described = [rig.outputs[name] for name in names]
    return tuple(
        LawOutput(name=name, unit=o.unit, turning=o.turning)
        for name, o in zip(names, described, strict=True)
    ), rig


def _scale(rig: Description, unit: str | None) -> tuple[float, float]:
    """Return the value of 1 V and of 0 V in the unit of the controller's output."""
    u = rig.input
    if unit is None and u.is_scaled:
        raise InputError(
            f"the input {u.name} is in {u.unit}, {u.per_volt:g} {u.unit} per volt at the "
            f"pin: give the unit of the output of C, unit='V' or unit='{u.unit}'"
        )
    if unit not in (None, "V", u.unit):
        raise InputError(f"unit={unit!r}: allowed are 'V' and '{u.unit}', that of {u.name}")
    return (u.per_volt, u.offset) if u.is_scaled and unit == u.unit else (1.0, 0.0)


def _operating_outputs(y0: float | Sequence[float], outputs: Sequence[LawOutput]) -> Vector:
    """Return the outputs at the operating point."""
    values = np.atleast_1d(np.asarray(y0, np.float64))
    if values.shape not in ((1,), (len(outputs),)) or not np.isfinite(values).all():
        raise InputError(
            f"y0={y0}: give a finite number for each of {plural(len(outputs), 'output')}"
        )
    values = np.broadcast_to(values, len(outputs))
    for output, value in zip(outputs, values, strict=True):
        if output.turning and value:
            raise InputError(f"{output.name} turns, so its y0 must be 0, not {value:g}")
    return values


def _design_of(model: Any, rig: Description, Ts: float, names: list[str]) -> DesignModel:
    """Return a model whose outputs include those of the law."""
    design = design_model(model, rig=rig, Ts=Ts)
    outputs = [o.name for o in design.outputs]
    if unknown := [name for name in names if name not in outputs]:
        raise InputError(
            f"the model predicts {', '.join(outputs)}, and not {unknown[0]}: give a model of the "
            "law's outputs"
        )
    return design


def _controller(C: Any, Ts: float | None, names: list[str]) -> Controller:
    """Return a system of python-control as a controller."""
    if not (hasattr(C, "dt") and (hasattr(C, "A") or hasattr(C, "num"))):
        raise InputTypeError(
            f"C is a {type(C).__name__}: give a controller of python-control, such as "
            "control.tf([0.2, -0.19], [1, -1], 0.01)"
        )
    if C.noutputs != 1:
        raise InputError(f"C has {plural(C.noutputs, 'output')}; a law drives one input")
    has_time = C.dt is not None and C.dt is not True
    if has_time and C.dt == 0:
        raise InputError(
            "C is in continuous time: sample it, control.sample_system(C, Ts, method='tustin') "
            f"with Ts = {Ts or 0.01:g} s, and look at the margins again"
        )
    time = C.dt if has_time else Ts
    if time is None:
        raise InputError("C has no sampling time: give Ts=, in s")
    if Ts is not None and abs(time - Ts) > _EXACT:
        raise InputError(
            f"Ts={Ts:g} s, and C has {time:g} s: sample the controller again for this Ts"
        )
    if not MIN_TS_US <= round(time * 1e6) <= MAX_TS_US:
        low, high = MIN_TS_US / 1e6, MAX_TS_US / 1e6
        raise InputError(f"C has Ts={time:g} s; a law runs at {low:g} to {high:g} s: sample again")
    if abs(time * 1e6 - round(time * 1e6)) > _PART_US:
        raise InputError(f"C has Ts={time!r} s; a law needs a whole number of µs: sample again")
    A, B, row, D = _state_space(C)
    if not all(np.isfinite(M).all() for M in (A, B, row, D)):
        raise InputError("C has a number that is not finite: repeat its design")
    columns = _columns(C, names)
    B, D = B @ columns, D @ columns
    if D[1]:
        raise InputError("the output of C depends on u at once, but u is its own limited output")
    return Controller(
        A=A,
        B_r=B[:, 0],
        B_u=B[:, 1],
        B_y=B[:, 2:],
        C=row,
        D_r=float(D[0]),
        D_y=D[2:],
        Ts=float(time),
    )


def _columns(C: Any, names: list[str]) -> Matrix:
    """Return the matrix (nu, 2 + ny) from r, Δu and y to the inputs of C."""
    labels, signals = [*C.input_labels], ["r", "u", *names]
    unnamed = all(label in (f"u[{i}]", "e") for i, label in enumerate(labels))
    if unnamed and len(labels) == 1:
        if len(names) > 1:
            raise InputError(
                f"C has one input and acts on r - {names[0]}: give one output, or a controller "
                f"with the inputs r, {', '.join(names)}"
            )
        return np.array([[1.0, 0.0, -1.0]])
    if unnamed and len(labels) == 1 + len(names):
        labels = ["r", *names]
    if len({*labels}) < len(labels) or not {*labels} <= {*signals}:
        raise InputError(
            f"C has the inputs {', '.join(labels)}: allowed are one input, r - y; r and then "
            f"{' and '.join(names)}; or the names r, u, {', '.join(names)}, each at most once"
        )
    if unused := [name for name in names if name not in labels]:
        raise InputError(f"C has no input {unused[0]}: leave {unused[0]} out of outputs")
    return np.array([[float(label == signal) for signal in signals] for label in labels])


def _state_space(C: Any) -> tuple[Matrix, Matrix, Vector, Vector]:
    """Return A, B, the row C and the row D; transfer functions need one denominator."""
    if hasattr(C, "A"):
        n, nu = C.nstates, C.ninputs
        A, B, row, D = (np.asarray(M, np.float64) for M in (C.A, C.B, C.C, C.D))
        return A.reshape(n, n), B.reshape(n, nu), row.reshape(n), D.reshape(nu)
    numerators = [np.trim_zeros(np.atleast_1d(x), "f") for x in C.num[0]]
    denominators = [np.trim_zeros(np.atleast_1d(x), "f") for x in C.den[0]]
    monic = [den / den[0] for den in denominators]
    F = monic[0]
    if any(den.size != F.size or np.abs(den - F).max() > _ROUNDING for den in monic):
        raise InputError(
            "the transfer functions of C have different denominators, and would count their states "
            "apart: bring them to one denominator, or give a state space"
        )
    n = F.size - 1
    if max(num.size for num in numerators) > n + 1:
        raise InputError(
            "C is not proper: its numerator has a higher degree than its denominator, so it would "
            "know the future"
        )
    b = np.zeros((n + 1, len(numerators)))
    for j, (num, den) in enumerate(zip(numerators, denominators, strict=True)):
        b[n + 1 - num.size :, j] = num / den[0]
    # Observer form: v = x_1 + b_0 w, x_j(t+1) = -f_j x_1 + x_(j+1) + (b_j - f_j b_0) w.
    A = np.eye(n, k=1)
    A[:, :1] -= F[1:, None]
    return A, b[1:] - np.outer(F[1:], b[0]), np.eye(1, n)[0], b[0]


def _gain(
    controller: Controller, tracking_time: float | None, K: ArrayLike | None, scale: float
) -> Vector:
    """Return K of the anti-windup in 1/V."""
    A, C, Ts = controller.A, controller.C, controller.Ts
    n = C.size
    if K is not None and tracking_time is not None:
        raise InputError("K and tracking_time are two ways of anti-windup: give one")
    if controller.B_u.any():
        if K is not None or tracking_time is not None:
            raise InputError("C has the input u, its own anti-windup: leave out K, tracking_time")
        gain = np.zeros(n)
    elif K is not None:
        gain = np.asarray(K, np.float64) * scale
        if gain.shape != (n,) or not np.isfinite(gain).all():
            raise InputError(f"K has the shape {gain.shape}; C has {plural(n, 'state')}")
    else:
        if tracking_time is not None and not Ts <= tracking_time < np.inf:
            raise InputError(f"tracking_time={tracking_time:g} s must be at least Ts, {Ts:g} s")
        gain = _tracking_gain(
            controller, np.exp(-Ts / (tracking_time or _tracking_time(controller)))
        )
    poles = np.abs(np.linalg.eigvals(A - np.outer(gain, C)))
    if poles.max(initial=0.0) >= 1:
        raise InputError(
            f"the anti-windup is unstable: A - K C has a pole at |z| = {digits(poles.max(), 4)}, "
            "so that the states of a limited law would grow; give another K or tracking_time"
        )
    return gain


def _tracking_time(controller: Controller) -> float:
    """Return the time constant of the slowest zero from y1, in s."""
    n = controller.C.size
    pencil = np.zeros((n + 1, n + 1))
    pencil[:n, :n], pencil[:n, n] = controller.A, controller.B_y[:, 0]
    pencil[n, :n], pencil[n, n] = controller.C, controller.D_y[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        zeros = np.abs(eigvals(pencil, block_diag(np.eye(n), 0.0)))
    zeros = zeros[(zeros > 0) & (zeros < 1 - _ROUNDING)]
    samples = -1 / log(zeros.max()) if zeros.size else _TRACKING_SAMPLES
    return controller.Ts * max(samples, _LEAST_SAMPLES)


def _tracking_gain(controller: Controller, pole: float) -> Vector:
    """Return K that moves the modes of C that are slower than a pole to it."""
    import control

    A, C = controller.A, controller.C
    T, Z, count = schur(A, sort=lambda x, y=0.0: np.hypot(x, y) > pole) if C.size else (A, A, 0)
    if not count:
        return np.zeros(C.size)
    # A maps the first columns of Z into themselves, so the other modes stay where they are.
    row = C @ Z[:, :count]
    seen = np.array([row @ np.linalg.matrix_power(T[:count, :count], k) for k in range(count)])
    if np.linalg.cond(seen) > 1 / _ROUNDING:
        raise InputError(
            "C has a slow mode that its output does not show, so that no anti-windup holds it: "
            "remove the mode, control.minreal(C)"
        )
    k = control.place_acker(T[:count, :count].T, row[:, None], [pole] * count)
    return np.asarray(Z[:, :count] @ np.ravel(k))


def _with_anti_windup(controller: Controller, K: Vector, y: Vector, x0: Vector) -> LawParts:
    """Return the law of a controller; with a direct term from y, its newest y are states."""
    n, ny, C = controller.C.size, y.size, controller.C
    A, drive = controller.A - np.outer(K, C), controller.B_u + K
    B_r, B_y = controller.B_r - K * controller.D_r, controller.B_y - np.outer(K, controller.D_y)
    if not controller.D_y.any():
        B = np.column_stack([B_r, drive, B_y])
        return LawParts(A=A, B=B, C=C, D=controller.D_r, x0=x0)
    B = np.zeros((n + ny, 2 + ny))
    B[:n, 0], B[:n, 1], B[n:, 2:] = B_r, drive, np.eye(ny)
    return LawParts(
        A=np.block([[A, B_y], [np.zeros((ny, n + ny))]]),
        B=B,
        C=np.concatenate([C, controller.D_y]),
        D=controller.D_r,
        x0=np.concatenate([x0, y]),
    )
