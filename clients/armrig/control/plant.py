"""Plants for the design of a law: the sampled model from the pin's voltage, and its draws.

The plant of one input is ::

    x[k+1] = A x[k] + B u[k-d],    y[k] = C x[k]

u is in V, and d is the dead time beyond the sample that every held input needs. An integrator that
is fixed by construction is the first state: x_1[k+1] = x_1[k] + B_1 u[k-d], exactly.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from armrig_core.control.control_law import MAX_TS_US, MIN_TS_US, LawOutput
from armrig_core.errors import InputError, InputTypeError
from armrig_core.process.printable import printable
from armrig_core.rig.channels import COUNTS
from armrig_core.rig.description import Description, Output, builtin
from armrig_core.rig.volts import U_MAX_V
from armrig_core.telemetry.channels import INTEGRATING_OUTPUTS, SYMBOLS
from scipy.linalg import block_diag

from armrig.data.argument import HasDataset, as_dataset
from armrig.data.dataset import Dataset, Signals
from armrig.data.step import LINE, MEAN, codes_of
from armrig.models.fit import Fit
from armrig.models.matrices import Matrices
from armrig.models.polynomials import Polynomials
from armrig.models.state_space import Matrix, StateSpace, Vector, freeze
from armrig.models.transfer_function import TransferFunction
from armrig.numerics.quantities import digits, plural
from armrig.physics.grey_box.fit import GreyFit
from armrig.physics.grey_box.physical_models import Physics
from armrig.validation.residuals import residuals

if TYPE_CHECKING:
    import control

PlantModel: TypeAlias = "Fit | GreyFit | control.StateSpace | control.TransferFunction"
Validation: TypeAlias = Dataset | Signals | HasDataset
SEED = 1
_STEPS = 1024
"""Number of steps of the converter."""
_STEP = COUNTS // _STEPS
_EXACT = 1e-9
_MAX_DOUBT = 200  # characters of a doubt from a file
"""Largest distance from 1 of a pole that counts as exactly 1."""
_STDS = 3.0
"""Distance from 1, in standard deviations, of a free pole that may be an integrator."""
_NEAR = 0.01
"""Distance from 1 of a free pole that is an integrator if the output turns."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plant:
    """Matrices of one input in V, and its dead time."""

    A: Matrix
    """(n, n)."""
    B: Vector
    """(n,)."""
    C: Matrix
    """(ny, n)."""
    delay: int = 0
    """Dead time d, in samples."""
    integrator: bool = False
    """True if the first state is the integrator."""

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        freeze(self, ("A", "B", "C"))

    @property
    def order(self) -> int:
        """Number of states without the dead time."""
        return int(self.B.size)

    def gain(self, i: int) -> float:
        """Return the gain of output i, in its unit per V; of an integrator per V and sample."""
        if self.integrator:
            return float(self.C[i, 0] * self.B[0])
        return float(self.C[i] @ np.linalg.solve(np.eye(self.order) - self.A, self.B))

    def rescale(self, gain: float = 1.0, delay: int = 0) -> Plant:
        """Return the plant with another gain and a longer dead time."""
        return Plant(
            A=self.A,
            B=self.B,
            C=gain * self.C,
            delay=self.delay + delay,
            integrator=self.integrator,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DesignModel:
    """A model as the designs of laws need it."""

    plant: Plant
    draw: Callable[[int], list[Plant]]
    """Plants of n draws of the parameters; none without a covariance."""
    Ts: float
    """Sampling time, in s."""
    input: str
    outputs: tuple[LawOutput, ...]
    noise: Matrix
    """Covariance of the measurement noise, (ny, ny); that of e with a `noise_model`."""
    noise_model: StateSpace | None
    """Model of the noise from its innovations e by C and K; None if the noise is white."""
    reading_noise: Matrix
    """Covariance of the readings, with the steps of a converter of 10 bits, (ny, ny)."""
    u0: float
    """Voltage at which y is 0, or at which an integrating y rests, in V."""
    lo: float
    """Lowest voltage of the rig, in V."""
    hi: float
    """Highest voltage of the rig, in V."""
    rest: float
    """Voltage at which the actuator does nothing, in V."""
    ranges: tuple[tuple[float, float], ...]
    """Limits of each output on the rig, in its unit."""
    rates: tuple[str, ...]
    """Name of the rate of each output."""
    sha256: str
    """Hash of the parameters of the model."""
    rig: Description | None
    """Rig of the law; None if it is not known."""
    doubts: tuple[str, ...] = field(default=())
    """Reasons to distrust a law that is designed on this model."""

    @property
    def is_stable(self) -> bool:
        """True if all poles but the integrator are inside the unit circle."""
        first = int(self.plant.integrator)
        poles = np.linalg.eigvals(self.plant.A[first:, first:])
        return bool((np.abs(poles) < 1).all())


def design_model(
    model: PlantModel,
    *,
    rig: Description | None = None,
    Ts: float | None = None,
    u0: float | None = None,
    y0: float | Sequence[float] = 0.0,
    output: str | None = None,
    validation: Validation | None = None,
) -> DesignModel:
    """Return a model for design; refuse a model that no law can be designed on.

    The arguments are those of `armrig.control.pid`. With an operating point, the zeros of the other
    outputs are their values at the voltage at which `output` is 0.
    """
    if isinstance(model, Fit):
        facts = _of_fit(model, Ts, rig)
    elif isinstance(model, GreyFit):
        facts = _of_grey_box(model, Ts)
    elif hasattr(model, "dt"):
        facts = _of_system(model, Ts)
    else:
        raise InputTypeError(
            f"model is a {type(model).__name__}: give a Fit, a GreyFit or a python-control system"
        )
    if not MIN_TS_US / 1e6 <= facts["Ts"] <= MAX_TS_US / 1e6:
        raise InputError(
            f"Ts={facts['Ts']:g} s: a law runs at {MIN_TS_US / 1e6:g} to {MAX_TS_US / 1e6:g} s; "
            "give Ts= for a model in s, or identify at such a sampling time"
        )
    if Ts is not None and abs(Ts - facts["Ts"]) > _EXACT:
        raise InputError(
            f"Ts={Ts:g} s, and the model has {facts['Ts']:g} s; leave out Ts, or identify a model "
            "in s: armrig.tf, armrig.process"
        )
    return _on_rig(facts, rig, u0, y0, output, _validation_doubts(model, validation))


def _on_rig(
    facts: dict[str, Any],
    rig: Description | None,
    u0: float | None,
    y0: float | Sequence[float],
    output: str | None,
    doubts: list[str],
) -> DesignModel:
    """Return the model with the input in V and the limits of its rig."""
    names, units = facts["outputs"], facts["units"]
    if len(names) > 2:
        raise InputError(f"the model has {plural(len(names), 'output')}; a law uses at most two")
    if rig is None and {*names} <= {*SYMBOLS} and facts["input"] == "u":
        rig = builtin("arm")
    scale, offset, input = 1.0, facts["offset"], facts["input"]
    hi, rest_v = U_MAX_V, 0.0
    ranges, rates = [(-np.inf, np.inf)] * len(names), [f"{name}_rate" for name in names]
    turning = [False] * len(names)
    if rig is not None:
        _check_rig(facts, rig)
        hi, rest_v = rig.input.u_max_v, rig.input.rest_v
        if facts["input_unit"] == rig.input.unit:
            scale, offset = rig.input.per_volt, float(rig.input.volts(offset))
        described = [rig.outputs[name] for name in names]
        units = [o.unit for o in described]  # also of a system of python-control, without units
        ranges = [(o.low, o.high) for o in described]
        rates = [o.rate or rate for o, rate in zip(described, rates, strict=True)]
        turning = [o.turning for o in described]
    elif facts["input_unit"] not in ("", "V"):
        raise InputError(
            f"the input is in {facts['input_unit']}, and a law commands volts at the pin: name the "
            "rig, such as rig='tclab' (--rig-file tclab)"
        )
    plant: Plant = facts["plant"].rescale(scale)
    noise = np.asarray(facts["noise"])
    if rig is None:
        steps = [abs(plant.gain(i)) * hi / _STEPS for i in range(len(names))]
    else:
        steps = [_converter_step(o) for o in described]
    # Without data, the noise is that of a converter whose last bit is not sure.
    reading = noise + np.diag(np.square(steps)) * (1 / 12 if facts["covariance"] else 1)
    if not facts["covariance"]:
        doubts.insert(0, "the model has no covariance, so that nothing is known about its errors")
    if MEAN in facts["treatment"] or LINE in facts["treatment"]:
        offset = 0.0
        if u0 is None:
            doubts.append(
                "the model is of deviations from means: give the means as u0= (in V) and y0="
            )
    zeros = np.zeros(len(names))
    if u0 is not None:
        offset, zeros = _zeros(plant, u0, y0, names.index(output) if output in names else 0)
    design = DesignModel(
        plant=plant,
        draw=lambda n: [x.rescale(scale) for x in facts["draw"](n)] if facts["covariance"] else [],
        Ts=facts["Ts"],
        input=input,
        outputs=tuple(
            LawOutput(name=name, unit=unit, turning=turns, y0=0.0 if turns else float(zero))
            for name, unit, turns, zero in zip(names, units, turning, zeros, strict=True)
        ),
        noise=noise,
        noise_model=facts.get("noise_model"),
        reading_noise=reading,
        u0=offset,
        lo=0.0,
        hi=hi,
        rest=rest_v,
        ranges=tuple(ranges),
        rates=tuple(rates),
        sha256=facts["sha256"],
        rig=rig,
        doubts=tuple(doubts),
    )
    if not design.is_stable:
        doubts.append("the model is unstable")
    return DesignModel(
        **{name: getattr(design, name) for name in design.__slots__ if name != "doubts"},
        doubts=tuple(doubts),
    )


def _zeros(plant: Plant, u0: float, y0: float | Sequence[float], i: int) -> tuple[float, Vector]:
    """Return the voltage at which output i is 0 on the line of the model, and all outputs there.

    At u0 the outputs are y0; a single y0 is that of the first output.
    """
    outputs, ny = np.atleast_1d(np.asarray(y0, np.float64)), len(plant.C)
    if outputs.shape not in ((1,), (ny,)) or not np.isfinite(outputs).all():
        raise InputError(f"y0={y0}: give a finite number for each of {plural(ny, 'output')}")
    values = np.append(outputs, np.zeros(ny - outputs.size))
    if plant.integrator:
        return u0, np.where(plant.C[:, 0] != 0, 0.0, values)
    gains = np.array([plant.gain(j) for j in range(ny)])
    change = values[i] / gains[i]
    zeros = values - gains * change
    zeros[i] = 0.0
    return float(u0 - change), zeros


def _converter_step(output: Output) -> float:
    """Return the largest step of a reading of 10 bits, in the output's unit."""
    values = output.conversion.value
    return max(abs(values(c + _STEP) - values(c)) for c in range(0, COUNTS, _STEP))


def _check_rig(facts: dict[str, Any], rig: Description) -> None:
    """Refuse a model of another rig."""
    if facts["input"] != rig.input.name:
        raise InputError(
            f"the model's input is {facts['input']}, and that of the rig {rig.rig.name} is "
            f"{rig.input.name}: this is a model of another rig"
        )
    unit, rig_unit = facts["input_unit"], rig.input.unit
    if unit not in ("V", rig_unit) and not (unit == "" and rig_unit == "V"):
        raise InputError(
            f"the model's input is in {unit or 'no unit'}, and that of the rig {rig.rig.name} in "
            f"{rig_unit}: a law would have another gain; estimate the model from data in {rig_unit}"
        )
    for name, unit in zip(facts["outputs"], facts["units"], strict=True):
        if name not in rig.outputs or unit not in ("", rig.outputs[name].unit):
            rig_outputs = ", ".join(f"{key} in {o.unit}" for key, o in rig.outputs.items())
            raise InputError(
                f"the model's output is {name} in {unit or 'no unit'}, and the rig {rig.rig.name} "
                f"has {rig_outputs}: this is a model of another rig"
            )


def doubts_about(
    facts: Mapping[str, Any], design: DesignModel, validation: Validation | None
) -> tuple[str, ...]:
    """Return the doubts about a law that has the facts `facts` of its design, on a model.

    Without validation data, those of the law's design hold, if it has the same model.
    """
    if facts.get("model_sha256", design.sha256) != design.sha256:
        return (*design.doubts, "the law was designed on another model")
    doubts = facts.get("doubts")
    if validation is not None or not isinstance(doubts, list):
        return design.doubts
    return tuple(printable(str(doubt)[:_MAX_DOUBT]) for doubt in doubts)


def _validation_doubts(model: PlantModel, validation: Validation | None) -> list[str]:
    """Return why the model is in doubt after its validation, or without one."""
    if not isinstance(model, Fit) or not model.quality:
        return []
    if validation is None:
        return ["the model was not validated: give other data, validation= (--validate F)"]
    if not isinstance(validation, Signals):
        validation = as_dataset(validation)
    if model.estimated_from(validation):
        return ["the model was validated on its own estimation data"]
    if residuals(model, validation).rejects:
        return ["the validation data reject the model: its covariance is too small"]
    return []


def _of_fit(fit: Fit, Ts: float | None, rig: Description | None) -> dict[str, Any]:
    if fit.nu != 1:
        raise InputError(
            f"the model has {plural(fit.nu, 'input')}: choose one, such as "
            f"fit[{fit.outputs[0]!r}, {fit.inputs[0]!r}]"
        )
    form = fit.form
    time = (Ts or form.Ts) if isinstance(form, TransferFunction) else fit.Ts
    _require_integrator(fit, rig)
    P = fit.trusted_covariance

    def draw(n: int) -> list[Plant]:
        std = np.sqrt(np.maximum(np.diag(P), 0.0))
        by = np.where(std > 0, std, 1.0)
        # From the correlation matrix: the units of the parameters do not matter.
        value, vector = np.linalg.eigh(P / np.outer(by, by))
        W = by[:, None] * vector * np.sqrt(np.maximum(value, 0.0))
        theta = form.theta + np.random.default_rng(SEED).standard_normal((n, std.size)) @ W.T
        of_theta = _plants_of(form, time)
        return [of_theta(x) for x in theta]

    offset = fit.free[-1].offset if fit.offset and fit.free else 0.0
    return {
        "plant": _plant_of(form, time),
        "draw": draw,
        "Ts": time,
        "input": fit.inputs[0],
        "input_unit": fit.input_units[0],
        "outputs": fit.outputs,
        "units": fit.units,
        "noise": fit.noise_covariance,
        "noise_model": form.innovations_form() if form.innovations_form().K.any() else None,
        "offset": offset,
        "covariance": bool(P.any() and np.isfinite(P).all()),
        "treatment": codes_of(fit.history),
        "sha256": _hash([fit.outputs, time, *fit.theta.tolist()]),
    }


def _require_integrator(fit: Fit, rig: Description | None) -> None:
    """Refuse a model with a free pole that may be an integrator."""
    turns = INTEGRATING_OUTPUTS | {n for n, o in (rig.outputs if rig else {}).items() if o.turning}
    for i, _, channel in fit.channels():
        if fit.form.integrators[i]:
            continue
        try:
            sampled = channel.to_discrete() if channel.Ts == 0 else channel
            poles = sampled.poles()
        except InputError:
            continue
        for pole, std in zip(poles.values, poles.std, strict=True):
            near = 1 - pole.real
            if abs(pole.imag) < _EXACT and (
                abs(near) < max(_STDS * std, _EXACT)
                or (channel.output in turns and abs(near) < _NEAR)
            ):
                orders = {k: n for k, n in channel.orders.items() if k in ("nb", "nf")}
                if set(orders) != {"nb", "nf"}:
                    n = channel.denominator.size - 1
                    orders = {"nb": n, "nf": n}
                text = ", ".join(f"{k}={n}" for k, n in orders.items())
                flags = " ".join(f"--{k} {n}" for k, n in orders.items())
                raise InputError(
                    f"{channel.output} has a free pole at {digits(pole.real, 5)} ± "
                    f"{digits(std, 1)}, which may be 1: in draws of the model it is stable or "
                    "unstable by chance. Fix it: "
                    f"armrig.oe(data, {text}, integrator=True), or `armrig identify F --structure "
                    f"oe {flags} --integrator`; if the output settles, record longer"
                )


def _hash(values: Sequence[Any]) -> str:
    return hashlib.sha256(repr(values).encode()).hexdigest()


def _plant_of(form: Polynomials | Matrices | TransferFunction, Ts: float) -> Plant:
    """Return the plant of the parameters of a model."""
    if isinstance(form, TransferFunction):
        form = form.sampled(Ts)[0]
    if isinstance(form, Matrices):
        if form.nk[0] < 1:
            raise _direct()
        return _with_integrator(form.A, form.B[:, 0], form.C, form.nk[0] - 1)
    parts = []
    for i in range(len(form.A)):
        if not form.has(i, 0):
            raise InputError("the input does not affect every output; choose one by fit[NAME]")
        channel, _ = form.channel(i, 0)
        F = np.convolve(channel.A[0][0], channel.F[0][0])
        # A row may have the factor 1 - q^-1 in A or in F.
        is_fixed = channel.integrators[0]
        F = np.cumsum(F)[:-1] if is_fixed else F
        parts.append((np.trim_zeros(channel.B[0][0], "b"), np.trim_zeros(F, "b"), is_fixed))
    return _realisation(parts)


def _plants_of(form: Polynomials | Matrices | TransferFunction, Ts: float) -> Callable[..., Plant]:
    """Return the function of the parameters that gives a plant."""
    if not isinstance(form, Polynomials) or form.coupled:
        return lambda theta: _plant_of(form.replaced(theta), Ts)
    rows = [
        (
            form.nk[i][0],
            form.slice_of("b", i, 0),
            form.slice_of("a", i, i),
            form.slice_of("f", i, 0),
        )
        for i in range(len(form.A))
    ]

    def plant(theta: Vector) -> Plant:
        parts = []
        for (nk, b, a, f), is_fixed in zip(rows, form.integrators, strict=True):
            F = np.convolve(np.append(1.0, theta[a]), np.append(1.0, theta[f]))
            F = np.cumsum(F)[:-1] if is_fixed else F
            parts.append((np.append(np.zeros(nk), theta[b]), F, is_fixed))
        return _realisation(parts)

    return plant


def _direct() -> InputError:
    return InputError(
        "the model has nk=0, a direct term: u[k] of a law is latched with sample k, so y[k] cannot "
        "depend on it; estimate with nk=1"
    )


def _realisation(parts: list[tuple[Vector, Vector, bool]]) -> Plant:
    """Return the plant of B/F for each output, with one integrator for all outputs that have it.

    B/((1 - q^-1) F) = g q^-1/(1 - q^-1) + R/F with g = B(1)/F(1). Outputs of the same F share their
    states, in the controller form.
    """
    first = [int(np.flatnonzero(B)[0]) if B.any() else 1 for B, _, _ in parts]
    if min(first) < 1:
        raise _direct()
    delay = min(first) - 1
    gains = np.zeros(len(parts))
    groups: list[tuple[Vector, list[tuple[int, Vector]]]] = []
    for i, (full, F, is_fixed) in enumerate(parts):
        B = full[delay:]
        if is_fixed:
            gains[i] = B.sum() / F.sum()
            R = np.zeros(max(B.size, F.size + 1))
            R[: B.size] += B
            R[1 : F.size + 1] -= gains[i] * F
            B = np.cumsum(R)[:-1]
        same = (
            g for G, g in groups if G.size == F.size and (np.abs(G - F) <= 1e-6 * np.abs(F)).all()
        )
        if (members := next(same, None)) is not None:
            members.append((i, B))
        else:
            groups.append((F, [(i, B)]))
    integrates = bool(gains.any())
    blocks: list[Matrix] = [np.ones((1, 1))] if integrates else []
    columns: list[Matrix] = [gains[:, None]] if integrates else []
    drive = [np.ones(1)] if integrates else []
    for F, members in groups:
        n = max(F.size - 1, *(B.size - 1 for _, B in members))
        A = np.eye(n, k=-1)
        A[:1, : F.size - 1] = -F[1:]
        C = np.zeros((len(parts), n))
        for i, B in members:
            C[i, : B.size - 1] = B[1:]
        blocks.append(A)
        columns.append(C)
        drive.append(np.eye(1, n)[0])
    return Plant(
        A=block_diag(*(b for b in blocks if b.size)),
        B=np.concatenate(drive),
        C=np.hstack(columns),
        delay=delay,
        integrator=integrates,
    )


def _with_integrator(A: Matrix, B: Vector, C: Matrix, delay: int = 0) -> Plant:
    """Return the plant of matrices; a pole that is exactly 1 becomes the first state."""
    values, right = np.linalg.eig(A)
    at = np.flatnonzero(np.abs(values - 1) < _EXACT)
    if at.size != 1:
        return Plant(A=A, B=B, C=C, delay=delay)
    left = np.linalg.eig(A.T)
    w = left[1][:, np.argmin(np.abs(left[0] - 1))].real
    v = right[:, at[0]].real
    # Columns of T: the integrator's mode, and a basis of the other modes, which w does not see.
    basis = np.linalg.svd(w[None, :])[2][1:].T
    T = np.column_stack([v, basis])
    inverse = np.linalg.inv(T)
    A_, B_, C_ = inverse @ A @ T, inverse @ B, C @ T
    A_[0], A_[:, 0] = np.eye(1, A.shape[0])[0], np.eye(A.shape[0])[:, 0]
    return Plant(A=A_, B=B_, C=C_, delay=delay, integrator=True)


def _of_grey_box(fit: GreyFit, Ts: float | None) -> dict[str, Any]:
    physics = fit.physics
    if not isinstance(physics, Physics):
        raise InputError(
            "own equations may be nonlinear: give control.linearize(…) of them at the operating "
            "point, a python-control system"
        )
    time = Ts or fit.Ts

    def plant(values: dict[str, float]) -> Plant:
        (Phi, Gamma), (C, _) = physics.sampled(values, time)
        return _with_integrator(Phi, Gamma[:, 0], C)

    values = {name: fit.values[name] for name in fit.names}
    P = fit.covariance_robust if fit.whiteness < 0.01 else fit.covariance

    def draw(n: int) -> list[Plant]:
        theta = np.random.default_rng(SEED).multivariate_normal([*values.values()], P, n)
        return [plant(dict(zip(fit.names, x, strict=True))) for x in theta]

    noise = [fit.by_output[name].loss for name in physics.outputs] if fit.by_output else [fit.loss]
    return {
        "plant": plant(values),
        "draw": draw,
        "Ts": time,
        "input": "u",
        "input_unit": fit.input_unit,
        "outputs": physics.outputs,
        "units": ("rad",) * len(physics.outputs),
        "noise": np.diag(noise),
        "offset": fit.offset[-1] if fit.offset else 0.0,
        "covariance": bool(P.any() and np.isfinite(P).all()),
        "treatment": [],
        "sha256": _hash([physics.outputs, time, *fit.values.items()]),
    }


def _of_system(system: Any, Ts: float | None) -> dict[str, Any]:
    import control

    if system.dt in (0, None):
        if Ts is None:
            raise InputError("the model is in continuous time: give Ts=, the law's sampling time")
        system = control.sample_system(control.ss(system), Ts)
    system = control.ss(system)
    if system.ninputs != 1:
        raise InputError(f"the system has {plural(system.ninputs, 'input')}; a law drives one")
    if np.any(system.D):
        raise _direct()
    return {
        "plant": _with_integrator(system.A, system.B[:, 0], system.C),
        "draw": lambda n: [],
        "Ts": float(system.dt),
        "input": "u",
        "input_unit": "V",
        "outputs": tuple(_names(system.output_labels)),
        "units": ("",) * system.noutputs,
        "noise": np.eye(system.noutputs) * 1e-4,
        "offset": 0.0,
        "covariance": False,
        "treatment": [],
        "sha256": _hash([system.dt, system.A.tolist(), system.B.tolist(), system.C.tolist()]),
    }


def _names(labels: Sequence[str]) -> Iterator[str]:
    """Yield the names of outputs; python-control's y[0] is y, and y[1] is y1."""
    for label in labels:
        yield label.replace("[0]", "").replace("[", "").replace("]", "")


def require_finite(**values: float | None) -> None:
    """Refuse a number that is not finite."""
    for name, value in values.items():
        if value is not None and not isfinite(value):
            raise InputError(f"{name}={value} must be a finite number")
