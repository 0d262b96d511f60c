"""What is shown of an experiment before it runs: its input, and what the model of the rig does."""

from __future__ import annotations

from math import degrees

import msgspec
import numpy as np
from armrig_core.arm import ArmParameters
from armrig_core.commands import StatusReport
from armrig_core.errors import InputError
from armrig_core.rehearsal import rehearse, sentence
from numpy.typing import NDArray

from armrig.dashboard.experiments import Experiment, plan_of
from armrig.excitation.experiment_design import predicted_parameter_std
from armrig.numerics.quantities import number
from armrig.physics.systems import arm, chassis
from armrig.rig.collection import Plan, planned_input

_MOST_POINTS = 1200  # of the drawing
_MOST_DESIGN = 20_000  # samples from which deviations are predicted: a second's work
_NOISE_RAD = 2 * np.pi / 1024 / 12**0.5  # one step of a converter of 10 bit


class Preview(msgspec.Struct, frozen=True, kw_only=True):
    """An experiment before it is run."""

    experiment: str
    N: int
    seconds: float
    Ts: float
    t: list[float]
    """Of each point of the drawing, in s."""
    u: list[float]
    rehearsal: str
    """What the handout's model does, in a sentence."""
    revolutions: float
    alpha_deg: float
    deviations: list[str]
    """What the experiment would teach of the rig's parameters, each of them."""
    notes: list[str]


def previewed(experiment: Experiment, status: StatusReport) -> Preview:
    """Return what an experiment plays, and what the model of the rig does under it.

    Raises
    ------
    ValueError
        It is not possible; the message says what is.
    """
    notes: list[str] = []
    plan = plan_of(experiment, "preview")
    Ts = plan.Ts or status.Ts
    u = planned_input(plan, Ts, notes.append)
    outside = (u < status.u_min) | (u > status.u_max)
    if outside.any():
        k = int(np.argmax(outside))
        raise InputError(
            f"u[{k}] = {u[k]:g} V is outside {status.u_min:g} … {status.u_max:g} V, what rig "
            f"{status.rig} allows"
        )
    alone = status.arm_removed or plan.without_arm
    found = rehearse(u, Ts, arm_removed=alone)
    t, shown = _drawn(u, Ts)
    return Preview(
        experiment=plan.experiment,
        N=u.size,
        seconds=u.size * Ts,
        Ts=Ts,
        t=t,
        u=shown,
        rehearsal=sentence(found),
        revolutions=found.revolutions,
        alpha_deg=degrees(found.alpha_rad),
        deviations=_deviations(u, Ts, alone=alone),
        notes=[*notes, *_cautions(status, plan)],
    )


def _drawn(u: NDArray[np.float64], Ts: float) -> tuple[list[float], list[float]]:
    """Return points of the held input; of many samples a stretch's least and largest."""
    changes = np.flatnonzero(np.diff(u, prepend=np.nan) != 0)
    if changes.size <= _MOST_POINTS:
        at, values = [*changes.tolist(), u.size], [*u[changes].tolist(), float(u[-1])]
        return [round(k * Ts, 6) for k in at], values
    n = -(-u.size // (_MOST_POINTS // 2))
    first = np.arange(0, u.size, n)
    both = np.column_stack([np.minimum.reduceat(u, first), np.maximum.reduceat(u, first)])
    times = np.column_stack([first, first + n / 2]) * Ts
    return times.ravel().round(6).tolist(), both.ravel().tolist()


def _deviations(u: NDArray[np.float64], Ts: float, *, alone: bool) -> list[str]:
    """Return the predicted standard deviations of physical parameters, as shares of them."""
    if u.size > _MOST_DESIGN:
        return []
    model, free = (chassis, ("J_1",)) if alone else (arm, ("J_1", "J_2"))
    try:
        found = predicted_parameter_std(
            model, u, Ts=Ts, noise_variance=_NOISE_RAD**2, free=free, fixed=ArmParameters()
        )
    except ValueError:
        return [f"nothing of {' and '.join(free)}"]
    return [
        f"{name} to ± {number(100 * std / value)} %" if std < value else f"nothing of {name}"
        for name, value, std in zip(found.names, found.theta, found.std, strict=True)
    ]


def _cautions(status: StatusReport, plan: Plan) -> list[str]:
    """Return what a person should know before the motor turns."""
    told = []
    if plan.without_arm and not status.arm_removed:
        told.append("this is for the chassis alone, and the rig has its arm on: it will be refused")
    return told
