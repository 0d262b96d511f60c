"""Experiments as a person asks for them, and the plan that `collect` plays."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import PurePosixPath
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from armrig.excitation.from_file import from_text
from armrig.excitation.named_signals import (
    check_step_time,
    details_of,
    named_signal,
    step_at,
    up_and_down,
)
from armrig.rig.collection import Plan

_SECONDS = {"step": 5.0}  # length by default of those that have one of their own
_OTHERS_S = 30.0
_DEAD_MAN_S = 1.0  # whoever ends the dashboard expects the motor to stop, as of `armrig collect`

_Name = Annotated[str, Meta(pattern=r"^[a-z0-9-]{0,20}\Z", description="a-z, 0-9 and -")]


class Experiment(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a person asks for: names and meanings as of `armrig collect`."""

    kind: Literal["step", "blackbox", "greybox", "staircase", "csv"]
    seconds: Annotated[float, Meta(gt=0, le=86_400)] | None = None
    Ts: Annotated[float, Meta(gt=0, le=1)] | None = None
    low: Annotated[float, Meta(ge=0, le=5)] = 0.5
    high: Annotated[float, Meta(ge=0, le=5)] = 4.5
    at: Annotated[float, Meta(ge=0)] = 1.0
    levels: Annotated[int, Meta(ge=2, le=1000)] = 6
    input: Literal["telegraph", "prbs", "white", "multisine", "chirp"] = "telegraph"
    a: Annotated[float, Meta(gt=0, le=1)] = 0.05
    seed: Annotated[int, Meta(ge=0, le=2**53)] = 1
    name: _Name = ""
    file: Annotated[str, Meta(max_length=200)] = ""
    """Name of the person's own file."""
    text: str = ""
    """What stands in it."""


def plan_of(experiment: Experiment, owner: str) -> Plan:
    """Return the plan of an experiment, as `armrig collect` makes it.

    Raises
    ------
    ValueError
        A figure is not possible, whatever the sampling time.
    """
    make, details = _input_of(experiment)
    seconds = experiment.seconds or _SECONDS.get(experiment.kind, _OTHERS_S)
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
    )


def _input_of(
    experiment: Experiment,
) -> tuple[Callable[[int, float], NDArray[np.float64]], dict[str, Any]]:
    """Return what makes u of N and Ts, and what the recording keeps of it."""
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
        lambda N, Ts: named_signal(e.input, N, Ts, **figures),
        details_of(e.input, **figures),
    )
