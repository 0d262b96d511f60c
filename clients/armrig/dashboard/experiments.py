"""Experiments that a person requests on the page, and the plans that `collect` plays."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from armrig_core.commands.commands import LONGEST_TS, Rehearsal, StatusReport, rehearsal_sentence
from armrig_core.commands.rehearsal import rehearse, rehearse_outputs
from armrig_core.control.control_law import Reference
from armrig_core.errors import InputError, ParameterError
from armrig_core.process.printable import with_degrees
from armrig_core.rig.description import Description
from armrig_core.rig.volts import U_MAX_V
from msgspec import Meta
from msgspec.structs import replace
from numpy.typing import NDArray

from armrig.dashboard.laws import check_fits, read_law
from armrig.dashboard.study_of_one import drawn
from armrig.excitation.from_file import from_text
from armrig.excitation.named_signals import (
    check_step_time,
    details_of,
    signal_by_name,
    step_at,
    up_and_down,
)
from armrig.excitation.pace import pace_inside
from armrig.excitation.physical_experiment_design import arm_deviations
from armrig.excitation.reference import profile_of, reference_input
from armrig.rig.collection import Plan, make_input

_SECONDS = {"step": 5.0}  # default lengths of experiments that do not have `_DEFAULT_S`
_DEFAULT_S = 30.0
_SHARE = 0.9  # of a lower limit of the voltage, the upper level
_DEAD_MAN_S = 1.0  # if the dashboard ends, the motor must stop, as with `armrig collect`

UNMONITORED = "unmonitored"
"""Word with which a person allows a law without a monitor, as with `armrig collect control`."""

# Suggestions for each rig so far.
_known: dict[tuple[bytes, bool, float], dict[str, Any]] = {}

_Name = Annotated[str, Meta(pattern=r"^[a-z0-9-]{0,20}\Z", description="a-z, 0-9 and -")]


class ExperimentRequest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Request for an experiment; the fields are the options of `armrig collect`."""

    kind: Literal["step", "blackbox", "greybox", "staircase", "csv", "control"]
    seconds: Annotated[float, Meta(gt=0, le=86_400)] | None = None
    Ts: Annotated[float, Meta(gt=0, le=LONGEST_TS)] | None = None
    low: Annotated[float, Meta(ge=0, le=5)] = 0.5
    high: Annotated[float, Meta(ge=0, le=5)] = 4.5
    at: Annotated[float, Meta(ge=0)] = 1.0
    levels: Annotated[int, Meta(ge=2, le=1000)] = 6
    input: Literal["telegraph", "prbs", "white", "multisine", "chirp"] = "telegraph"
    a: Annotated[float, Meta(gt=0, le=1)] = 0.05
    seed: Annotated[int, Meta(ge=0, le=2**53)] = 1
    named: bool = False
    """True if a person gave the levels as values of the input, from which these voltages are."""
    name: _Name = ""
    file: Annotated[str, Meta(max_length=200)] = ""
    """Name of the user's CSV file."""
    text: str = ""
    """Contents of the CSV file."""
    law: Annotated[str, Meta(max_length=300)] = ""
    """Name of the file with the law of a run in control, in the folder of the recordings."""
    law_sha256: str = ""
    """Hash of the law that the page has shown; "" for any law in the file."""
    reference: Literal["step", "staircase"] = "step"
    r_low: float | None = None
    r_high: float | None = None
    word: Annotated[str, Meta(max_length=20)] = ""
    """The word `unmonitored` allows a law without a monitor."""


def plan_of(experiment: ExperimentRequest, owner: str, folder: Path | None = None) -> Plan:
    """Return the plan that `armrig collect` would make for an experiment.

    `folder` contains the law of a run in control.

    Raises ValueError if a setting is invalid, whatever the sampling time.
    """
    if experiment.kind == "control":
        return _control_plan(experiment, owner, folder or Path())
    make, details = _input_of(experiment)
    seconds = experiment.seconds or _SECONDS.get(experiment.kind, _DEFAULT_S)
    if experiment.kind == "step":
        check_step_time(experiment.at, seconds)
    kind = "blackbox" if experiment.kind == "csv" else experiment.kind
    return Plan(
        experiment=f"{kind}-{experiment.name}" if experiment.name else kind,
        make=make,
        details=details,
        seconds=None if experiment.kind == "csv" else seconds,
        Ts=experiment.Ts,
        pacing="scheduled",
        owner=owner,
        dead_man=_DEAD_MAN_S,
        without_arm=experiment.kind == "greybox",
        is_bare=not experiment.named,
    )


def _control_plan(experiment: ExperimentRequest, owner: str, folder: Path) -> Plan:
    e, law = experiment, read_law(folder, experiment.law)
    Ts = law.Ts_us / 1e6
    if e.law_sha256 not in ("", law.sha256):
        raise InputError(f"{e.law} has changed since it was shown: choose the law again")
    if e.Ts not in (None, Ts):
        raise ParameterError("Ts", f"{e.Ts:g}", f"the law has Ts = {Ts:g} s")
    if law.monitor is None and e.word != UNMONITORED:
        raise InputError(
            "the law has no monitor, so a stuck sensor drives the rig to full input: type "
            f"{UNMONITORED} to allow this law"
        )
    profile = profile_of(law, e.reference, low=e.r_low, high=e.r_high, levels=e.levels)
    return Plan(
        experiment=f"control-{e.name}" if e.name else "control",
        **reference_input(law, profile, e.seconds)._asdict(),
        Ts=Ts,
        pacing="exchange",
        owner=owner,
        dead_man=_DEAD_MAN_S,
        law=law,
        unmonitored=e.word == UNMONITORED,
    )


def _input_of(
    experiment: ExperimentRequest,
) -> tuple[Callable[[int, float], NDArray[np.float64]], dict[str, Any]]:
    """Return a function that computes u from N and Ts, and the details for the recording."""
    e, levels = experiment, {"low": experiment.low, "high": experiment.high}
    if e.kind == "csv":
        name = PurePosixPath(e.file).name or "input.csv"
        return (
            lambda _, Ts: from_text(e.text, Ts, name=name),
            {"input": "csv", "file": name},
        )
    if e.kind == "step":
        return (
            lambda N, Ts: step_at(N, Ts, at=e.at, **levels),
            {"input": "step", **levels, "at": e.at},
        )
    if e.kind == "staircase":
        return (
            lambda N, _: up_and_down(N, levels=e.levels, **levels),
            {"input": "staircase", **levels, "levels": e.levels},
        )
    figures: dict[str, Any] = {"a": e.a, "seed": e.seed, **levels}
    return (
        lambda N, Ts: signal_by_name(e.input, N, Ts, **figures),
        details_of(e.input, **figures),
    )


def suggest_experiments(described: Description, u_max: float) -> dict[str, Any]:
    """Return sampling time, lengths and levels of experiments that suit a rig; {} for the arm."""
    key = described.text, described.system is not None, u_max
    if key not in _known:
        _known[key] = _suggestion(described, u_max)
    return _known[key]


def _suggestion(described: Description, u_max: float) -> dict[str, Any]:
    pace = pace_inside(described, u_max)
    if pace is None:
        high = float(f"{_SHARE * u_max:.2g}")
        return {"low": float(f"{high / 9:.2g}"), "high": high} if u_max < U_MAX_V else {}
    seconds = {"blackbox": pace.seconds, "step": pace.step_s, "staircase": 11 * pace.step_s}
    levels = {"low": pace.low, "high": pace.high}
    rounded = {name: float(f"{volts:.3g}") for name, volts in levels.items()}
    more = {"Ts": pace.Ts, "at": float(f"{pace.step_s / 6:.3g}"), "a": float(f"{pace.switch:.2g}")}
    return {"seconds": seconds, **rounded, **more}


class Preview(msgspec.Struct, frozen=True, kw_only=True):
    """Preview of an experiment."""

    experiment: str
    N: int
    seconds: float
    Ts: float
    curve: list[list[float | None]]
    """Points of the drawn input: t in s, and the least and the largest u, in V, or r."""
    reference: Reference | None = None
    """Reference of the law; None for an experiment without a law."""
    rehearsal: str
    """Sentence about the rehearsal, a simulation of the input with the handout's parameters."""
    deviations: list[str]
    """Text for each estimated parameter: its predicted standard deviation in percent."""
    notes: list[str]


def previewed(
    experiment: ExperimentRequest,
    status: StatusReport,
    described: Description | None = None,
    folder: Path | None = None,
) -> Preview:
    """Return the preview of an experiment: its input, and the response of the rig's model.

    A description that was read on this machine may have a model in a file. `folder` contains the
    law of a run in control.

    Raises ValueError if the experiment is not possible; the message contains the allowed values.
    """
    notes, described = list[str](), described or status.described
    plan = plan_of(experiment, "preview", folder)
    Ts = plan.Ts or status.Ts
    u = make_input(plan, Ts, notes.append)
    told = "not rehearsed: the description of this rig has no [model]"
    if plan.law:
        check_fits(plan.law, status)
        r = plan.law.reference
        later = "not rehearsed here: the daemon rehearses the closed loop at the start"
        return Preview(
            experiment=plan.experiment,
            N=u.size,
            seconds=u.size * Ts,
            Ts=Ts,
            curve=drawn(Ts * np.arange(u.size, dtype=np.float64), u),
            reference=replace(r, unit=with_degrees(r.unit)),
            rehearsal=later if described.model else told,
            deviations=[],
            notes=[*notes, f"the law's limits are {plan.law.lo:g} to {plan.law.hi:g} V"],
        )
    outside = (u < status.u_min) | (u > status.u_max)
    if outside.any():
        k = int(np.argmax(outside))
        raise InputError(
            f"u[{k}] = {u[k]:g} V is outside {status.u_min:g} … {status.u_max:g} V, the range of "
            f"rig {status.rig}"
        )
    if plan.without_arm and not (status.arm_removed and described.arm):
        body = described.channels[0].body or "arm's first part"
        text = f"this experiment needs the {body} alone, but the rig has its arm: the experiment "
        notes.append(f"{text}will be refused")
    alone = status.arm_removed or plan.without_arm
    found, deviations = Rehearsal(), list[str]()
    if described.arm:
        found, deviations = rehearse(u, Ts, arm_removed=alone), arm_deviations(u, Ts, alone=alone)
    elif described.system or described.equations:
        found = rehearse_outputs(u, Ts, described)
    elif described.model:
        told = "not rehearsed here: only the daemon reads the file of the model, at the start"
    is_rehearsed = described.arm or described.system or described.equations
    return Preview(
        experiment=plan.experiment,
        N=u.size,
        seconds=u.size * Ts,
        Ts=Ts,
        curve=drawn(Ts * np.arange(u.size, dtype=np.float64), u),
        rehearsal=rehearsal_sentence(found) if is_rehearsed else told,
        deviations=deviations,
        notes=notes,
    )
