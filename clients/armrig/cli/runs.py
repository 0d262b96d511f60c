"""The commands that make and publish recordings: collect, record, play."""

from __future__ import annotations

import os
import re
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from pathlib import Path
from select import select
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import typer
from armrig_core.commands.codes import COMPLETE, Ending, OutcomeCode
from armrig_core.errors import FileError, InputError, OperationError
from armrig_core.process.options import CommandGroup, argument, group, option, preset
from armrig_core.process.printable import printable
from armrig_core.process.signal_pipe import SignalPipe, until_signal
from msgspec import structs

import armrig
from armrig.cli.next_step import (
    OF_KIND,
    command_line_name,
    free_recording_name,
    option_for_rig,
    say_next,
    step_again,
)
from armrig.cli.options import Connect, From, Json, RigId, SamplingTime, To
from armrig.cli.printing import fields_of, inform, print_result, tell, tell_error
from armrig.cli.recorded_data import File
from armrig.cli.results import check_output
from armrig.numerics.quantities import digits, plural

if TYPE_CHECKING:
    from armrig_core.commands.commands import StatusReport
    from armrig_core.control.control_law import ControlLaw
    from armrig_core.rig.description import Input

    from armrig.excitation.pace import Pace
    from armrig.rig.remote_recording import RemoteRecording

collect = CommandGroup(
    "Play an input and record the response of the rig.\n\n"
    "The command prints the path of the recording and whether its data can be used. "
    "The exit code is 1 if the data cannot be used."
)
SECONDS = 30.0
STEP_S, STEP_AT_S, SWITCHING = 5.0, 1.0, 0.05
UNKNOWN_TS_S = 0.1
"""Sampling time in s of a step of a rig whose time constants are not known."""
MOST_UNASKED_S, MOST_ASKED_S = 3600.0, 21_600.0
"""Longest times in s for which a rig is held until it has settled, without and with --yes."""
DEFAULT_PERIOD_S = 5.0
DEAD_MAN_S = 1.0
"""Default time in s after which a closed terminal or a lost connection stops the motor."""
_MAX_NAME_LENGTH = 40  # characters of a kind of experiment that the daemon accepts
_MAX_SEED = 2**53
_MAX_LINE_BYTES = 1000
Seconds = Annotated[
    float | None,
    option(
        "--seconds",
        "Length of the run, in s; at most 4 000 000 samples.",
        "what suits the model of the rig; for the arm 5, and 30 for a staircase",
    ),
]


class Level(NamedTuple):
    """A level of the input, as a person typed it."""

    value: float
    name: str = ""
    """Name of the input, whose own value it is; empty for a voltage at the pin."""


def _level(text: str) -> Level:
    """Return a level such as 2.5, or power=60."""
    name, _, number = text.rpartition("=")
    try:
        return Level(float(number), name.strip())
    except ValueError:
        raise typer.BadParameter(
            f"{text!r} is no voltage, such as 2.5, and no value of the input, such as power=60"
        ) from None


Low = Annotated[
    Level | None,
    option(
        "--low",
        "Lowest voltage of the input, in V, at least 0; or its own value, such as power=10.",
        "0.5",
        metavar="LEVEL",
        parser=_level,
    ),
]
High = Annotated[
    Level | None,
    option(
        "--high",
        "Highest voltage of the input, in V, at most 5; or its own value, such as power=90.",
        "4.5, or the rig's limit if it is lower",
        metavar="LEVEL",
        parser=_level,
    ),
]


class _Levels(NamedTuple):
    low: float
    high: float
    are_default: bool
    """True if the rig's limits may change both."""
    are_bare: bool
    """True if a level has no name."""


def _levels(
    low: Level | None, high: Level | None, run: _ExperimentOptions, pace: Pace | None = None
) -> _Levels:
    """Return the voltages at the pin; by default those that suit the model of the rig."""
    levels = [level for level in (low, high) if level is not None]
    volts: list[float] = []
    defaults = (pace.low, pace.high) if pace else (0.5, 4.5)
    for level, default in zip((low, high), defaults, strict=True):
        if level is None or not level.name:
            volts.append(default if level is None else level.value)
            continue
        rig_input = _input_of(run)
        if level.name != rig_input.name:
            raise InputError(
                f"{level.name}={level.value:g}: the input of rig {run.rig} is {rig_input.name} in "
                f"{rig_input.unit}; a number without a name is a voltage at the pin"
            )
        volts.append(round(rig_input.volts(level.value), 12))
    if levels and all(level.name for level in levels) and volts[0] > volts[1]:
        volts.reverse()  # the value of an inverting amplifier falls with the voltage
    low_v, high_v = volts
    is_default = not levels and pace is None
    return _Levels(low_v, high_v, is_default, any(not level.name for level in levels))


def _input_of(run: _ExperimentOptions) -> Input:
    """Return the input of the rig's description."""
    with armrig.Rig(run.rig, connect=run.connect) as rig:
        return rig.status().described.input


def _rig_of(run: _ExperimentOptions) -> StatusReport | None:
    """Return the status of a rig that is not the arm; None for the arm, or without an answer."""
    with suppress(RuntimeError), armrig.Rig(run.rig, connect=run.connect) as rig:
        status = rig.status()
        return None if status.described.arm else status
    return None


def _set_pace(run: _ExperimentOptions, *, by_model: bool) -> tuple[_ExperimentOptions, Pace | None]:
    """Return the options and the pace that suit the matrices of a rig.

    The pace is None if the length is given (not `by_model`), for the arm, and without matrices.
    """
    from armrig.excitation.pace import pace_inside

    status = _rig_of(run) if by_model else None
    pace = pace_inside(status.described, status.u_max) if status else None
    if pace is None:
        return run, None
    if run.Ts is not None:
        switch = min(0.5, pace.switch * run.Ts / pace.Ts)
        pace = structs.replace(pace, Ts=run.Ts, switch=switch)
    inform(f"the model of the rig suggests {pace.row}")
    return replace(run, Ts=pace.Ts), pace


@dataclass(frozen=True, slots=True, kw_only=True)
class _ExperimentOptions:
    """Options common to all kinds of experiment."""

    Ts: SamplingTime = None
    name: str = preset("", "Name of the recording, for @NAME: a-z, 0-9 and -.", "no name")
    pacing: Literal["scheduled", "exchange"] = preset(
        "scheduled", "Clock of the samples: the device's timer (scheduled) or the host (exchange)."
    )
    owner: str | None = preset(
        None, "Name of the rig's owner, shown to other users.", "this user's name"
    )
    dead_man: float = preset(
        DEAD_MAN_S,
        "Time in s, 0.5 to 60, after which the daemon stops the run if this program is killed, "
        "frozen or disconnected; 0 plays the run to its end.",
        metavar="SECONDS",
    )
    rig: RigId = "1"
    connect: Connect = None
    json: Json = False


@dataclass(frozen=True, slots=True, kw_only=True)
class InputChoice:
    """Options of a random input, or of the user's own input."""

    seconds: float | None = preset(
        None,
        "Length of the run, in s; at most 4 000 000 samples; not with --file.",
        "what suits the model of the rig; for the arm 30",
    )
    input: Literal["telegraph", "prbs", "white", "multisine", "chirp", "csv"] | None = preset(
        None, "Input signal.", "telegraph"
    )
    file: Path | None = preset(
        None, "File with your own input: a row with u, or t and u, for each sample.", metavar="CSV"
    )
    a: float | None = preset(
        None,
        "Probability of a switch at each sample (telegraph, prbs).",
        "what suits the model of the rig; for the arm 0.05",
    )
    low: Low = None
    high: High = None
    seed: int = preset(
        1, "Seed of the random numbers (telegraph, prbs, white, multisine).", min=0, max=_MAX_SEED
    )
    validation: bool = preset(False, "Record a second run for validation, with the next seed.")


Run = Annotated[_ExperimentOptions, group(_ExperimentOptions)]
Choice = Annotated[InputChoice, group(InputChoice)]


@collect.add("collect blackbox --seconds 30 --validation")
def blackbox(choice: Choice, run: Run) -> None:
    """Play a random input, or your own input, to the complete rig."""
    run, pace = _set_pace(run, by_model=choice.seconds is None and choice.file is None)
    collect_each(plan_runs("blackbox", choice, run, pace), run)


@collect.add("collect greybox --seconds 30")
def greybox(choice: Choice, run: Run) -> None:
    """Play a random input, or your own input, to the chassis alone.

    Remove the rotating part first. The configuration must have [arm] removed = true.
    """
    collect_each(plan_runs("greybox", choice, run), run, without_arm=True)


@collect.add("collect step --Ts 0.002")
def step(
    *,
    seconds: Seconds = None,
    at: float | None = preset(None, "Time of the step, in s.", "1, or a sixth of the length"),
    low: Low = None,
    high: High = None,
    until: Literal["settled"] | None = preset(
        None,
        "settled: end when the output has settled, at the latest after --seconds.",
        "settled without --seconds, if the rig has no model",
    ),
    yes: bool = preset(False, "With --until settled, hold the rig for more than an hour."),
    run: Run,
) -> None:
    """Play a step, to measure time constant, delay and gain.

    The input steps from --low to --high.
    """
    from armrig_core.commands.commands import UNTIL

    from armrig.excitation.named_signals import check_step_time, step_at

    run, pace = _set_pace(run, by_model=seconds is None)
    volts = _levels(low, high, run, pace)
    low_v, high_v = volts.low, volts.high
    step_at(1, 1.0, low=low_v, high=high_v, at=0.0)
    if seconds is None and pace is None and (until or _rig_of(run)):
        until, seconds = "settled", (MOST_ASKED_S if yes else MOST_UNASKED_S)
        run = replace(run, Ts=UNKNOWN_TS_S if run.Ts is None else run.Ts)
    if until and (seconds or 0) > MOST_UNASKED_S and not yes:
        raise InputError(f"--seconds {seconds:g}: give --yes, too, to hold the rig for so long")
    if seconds is None:
        seconds = pace.step_s if pace else STEP_S
    at = at if at is not None else pace.step_s / 6 if pace else STEP_AT_S
    check_step_time(at, seconds)
    details = {"input": "step", "low": low_v, "high": high_v, "at": at}
    details |= {UNTIL: until} if until else {}
    make = partial(step_at, low=low_v, high=high_v, at=at)
    collect_each([Played("step", make, details, seconds, volts.are_default, volts.are_bare)], run)


@collect.add("collect staircase --levels 6")
def staircase(
    *,
    seconds: Seconds = None,
    levels: int = preset(6, "Number of levels of the staircase.", min=2),
    low: Low = None,
    high: High = None,
    run: Run,
) -> None:
    """Play a staircase of levels up and down, to measure the static curve."""
    from armrig.excitation.named_signals import step_at, up_and_down

    run, pace = _set_pace(run, by_model=seconds is None)
    volts = _levels(low, high, run, pace)
    low_v, high_v = volts.low, volts.high
    step_at(1, 1.0, low=low_v, high=high_v, at=0.0)
    if seconds is None:
        seconds = (2 * levels - 1) * pace.step_s if pace else SECONDS
    details = {"input": "staircase", "low": low_v, "high": high_v, "levels": levels}

    def make(N: int, _: float) -> Any:
        return up_and_down(N, low=low_v, high=high_v, levels=levels)

    collect_each(
        [Played("staircase", make, details, seconds, volts.are_default, volts.are_bare)], run
    )


@collect.add("collect bla --realisations 4")
def bla(
    *,
    seconds: float | None = preset(
        None, "Length of each recording, in s; use it instead of --period."
    ),
    period: float | None = preset(None, "Length of a period, in s.", "5"),
    periods: int = preset(5, "Number of periods in each recording.", min=2),
    count: int = preset(
        4, "Number of recordings, each with different phases.", names="--realisations", min=1
    ),
    low: Low = None,
    high: High = None,
    seed: int = preset(1, "Seed of the random phases.", min=0, max=_MAX_SEED),
    run: Run,
) -> None:
    """Play multisines for `armrig.bla`, the best linear approximation.

    Each recording has different random phases.
    """
    from armrig.excitation.named_signals import realisations

    run, pace = _set_pace(run, by_model=seconds is None and period is None)
    volts = _levels(low, high, run, pace)
    low_v, high_v = volts.low, volts.high
    realisations(3, 1, low_v, high_v, seed, periods=1)
    if seconds is not None and period is not None:
        raise InputError(
            f"--seconds {seconds:g} with --period {period:g}: give only one of these two options, "
            f"because a recording has {plural(periods, 'period')} (--periods)"
        )
    if period is not None and not period > 0:  # also refuses NaN
        raise InputError(f"--period {period:g}: must be a number of seconds, more than 0")
    if seconds is None:
        usual = pace.step_s if pace else DEFAULT_PERIOD_S
        seconds = periods * (usual if period is None else period)
    details = {"input": "multisine", "low": low_v, "high": high_v, "periods": periods}
    details |= {"realisations": count, "seed": seed}

    def make(r: int, N: int, _: float) -> Any:
        return realisations(N - N % periods, count, low_v, high_v, seed, periods=periods)[r]

    collect_each(
        (
            Played(
                "bla",
                partial(make, r),
                details | {"realisation": r},
                seconds,
                volts.are_default,
                volts.are_bare,
            )
            for r in range(count)
        ),
        run,
    )


@collect.add("collect control law.json --reference step")
def control(
    *,
    law_file: Annotated[
        Path, argument("LAW", "File of the law, such as of `armrig design place`.")
    ],
    reference: str = preset(
        "step", "step, staircase, or a CSV with a row of r, or t and r, for each sample."
    ),
    seconds: float | None = preset(
        None,
        "Length of the run, in s; not with a file.",
        "five time constants of the law's model for each level, at least 150 samples",
    ),
    low: float | None = preset(
        None, "Lowest level of r, in its unit.", "a quarter of the law's range"
    ),
    high: float | None = preset(
        None, "Highest level of r, in its unit.", "half of the law's range"
    ),
    levels: int = preset(4, "Number of levels of a staircase.", min=2),
    dither: float = preset(
        0.0,
        "Amplitude of a random square wave on r, in its unit, so that a model can be identified.",
        "0",
    ),
    seed: int = preset(1, "Seed of the dither.", min=0, max=_MAX_SEED),
    unstable: bool = preset(
        False, "Allow a loop that is unstable on the rig's model, inside the outputs' limits."
    ),
    unmonitored: bool = preset(
        False, "Allow a law without a monitor. A stuck sensor then drives the rig to full input."
    ),
    run: Run,
) -> None:
    """Control the rig by a law, and record the run.

    The reference holds its first level until the outputs have settled. Sampling time and pacing are
    those of the law. During the run, type a number and Enter for another reference, between the
    lowest and the highest level.
    """
    from armrig.excitation.reference import profile_of, reference_input

    law = armrig.control.load_law(law_file)
    Ts = law.Ts_us / 1e6
    if run.Ts is not None and round(run.Ts * 1e6) != law.Ts_us:
        raise InputError(f"--Ts {run.Ts:g}: the law has Ts = {Ts:g} s; leave --Ts out")
    if not run.dead_man:
        raise InputError("--dead-man 0: control stops if this program dies; give 0.5 to 60 s")
    profile = profile_of(
        law, reference, low=low, high=high, levels=levels, dither=dither, seed=seed
    )
    of_law = Played(
        "control",
        *reference_input(law, profile, seconds),
        law=law,
        unstable=unstable,
        unmonitored=unmonitored,
        new_reference=None if run.json else _read_number,
    )
    collect_each([of_law], replace(run, Ts=Ts, pacing="exchange"))


def _read_number() -> float | None:
    """Return the number in the line that a person has typed in this terminal; None without one."""
    terminal = sys.stdin.fileno()
    # A program in the background would be stopped if it read from its terminal.
    if not os.isatty(terminal) or os.tcgetpgrp(terminal) != os.getpgrp():
        return None
    if not select([terminal], [], [], 0)[0]:
        return None
    line = os.read(terminal, _MAX_LINE_BYTES).decode(errors="replace").strip()
    try:
        return float(line) if line else None
    except ValueError:
        inform(f"{printable(line)} is no number: type a number and Enter for another reference")
        return None


class Played(NamedTuple):
    """One recording of `armrig collect`."""

    experiment: str
    make: Callable[[int, float], Any]
    """Function of N and Ts, in s, that returns u, in V."""
    details: dict[str, Any]
    seconds: float | None
    default_levels: bool = False
    """True if the user chose neither --low nor --high."""
    is_bare: bool = False
    """True if the user gave voltages without the name of the input."""
    is_validation: bool = False
    """True if the recording validates the models of the previous recording."""
    law: ControlLaw | None = None
    """Law of a run in control; `make` then returns the reference."""
    unstable: bool = False
    """As in `Rig.control`."""
    unmonitored: bool = False
    """As in `Rig.control`."""
    new_reference: Callable[[], float | None] | None = None
    """As in `armrig.rig.collection.Plan`."""


def plan_runs(
    experiment: str, choice: InputChoice, run: _ExperimentOptions, pace: Pace | None = None
) -> list[Played]:
    """Return the runs to play; refuse wrong options before the connection to a rig."""
    from armrig.excitation.named_signals import SEEDED, details_of, signal_by_name

    file = choice.file
    name = choice.input or ("telegraph" if file is None else "csv")
    if (name == "csv") != (file is not None):
        msg = f"--input {name} with --file {file}: " if file else f"--input {name}: "
        msg += "--file CSV plays a file; leave out --input, or give --input csv"
        raise InputError(msg)
    if choice.validation and name not in SEEDED:
        raise InputError(
            f"--validation: {name} would repeat the same input; choose an input with a seed "
            f"({', '.join(SEEDED)}), or collect twice"
        )
    if file is not None:
        return [_from_file(experiment, file, choice.seconds, run)]
    volts = _levels(choice.low, choice.high, run, pace)
    a, usual = (pace.switch, pace.seconds) if pace else (SWITCHING, SECONDS)
    figures = {"a": a if choice.a is None else choice.a, "low": volts.low, "high": volts.high}
    # A wrong value is refused here, before the rig is armed.
    signal_by_name(name, 3, 0.01, seed=choice.seed, **figures)

    def play_of(kind: str, seed: int) -> Played:

        return Played(
            kind,
            lambda N, Ts: signal_by_name(name, N, Ts, seed=seed, **figures),
            details_of(name, seed=seed, **figures),
            usual if choice.seconds is None else choice.seconds,
            volts.are_default,
            volts.are_bare,
        )

    first = play_of(experiment, choice.seed)
    second = play_of(f"{experiment}-validation", choice.seed + 1)._replace(is_validation=True)
    return [first, second] if choice.validation else [first]


def _from_file(
    experiment: str, file: Path, seconds: float | None, run: _ExperimentOptions
) -> Played:
    from armrig.excitation.from_file import has_named_columns

    if seconds is not None:
        raise InputError(f"--seconds {seconds:g}: a file has its own length; leave out --seconds")
    file.stat()  # a missing file is refused here
    named = has_named_columns(file)
    arguments: Any = {"input": _input_of(run)} if named else {}
    if run.Ts is not None:
        armrig.input_from_file(file, run.Ts, **arguments)
    details = {"input": "csv", "file": file.name}

    def make(_: int, Ts: float) -> Any:
        return armrig.input_from_file(file, Ts, **arguments)

    return Played(experiment, make, details, None, is_bare=not named)


def experiment_name(experiment: str, name: str) -> str:
    """Return an experiment's kind with the name that a person chose; refuse other names."""
    full_name = f"{experiment}-{name}" if name else experiment
    if not re.fullmatch(r"[a-z0-9-]*", name) or len(full_name) > _MAX_NAME_LENGTH:
        most = _MAX_NAME_LENGTH - len(experiment) - 1
        raise InputError(f"--name {name}: at most {most} of a-z, 0-9 and - are allowed")
    if name == "last" or re.match(r"validation\b", name):
        meant = "@last is the newest recording" if name == "last" else "--validation adds this name"
        raise InputError(f"--name {name}: {meant}; give another name")
    return full_name


def check_name_is_free(name: str) -> None:
    """Refuse the name of a complete recording; otherwise the name would become ambiguous."""
    if name and (free := free_recording_name(name)) != name:
        msg = f"--name {name}: @{name} is already a complete recording; give another name, "
        raise InputError(f"{msg}such as --name {free}")


def collect_each(
    played: Iterable[Played], run: _ExperimentOptions, *, without_arm: bool = False
) -> None:
    """Record each run and print its result; stop if the data cannot be used.

    If `without_arm` is True, the experiment needs the rig without its arm, and a rig with an
    arm is refused.
    """
    from armrig.recordings.files.recording_summary import VALIDATION_OF
    from armrig.rig.collection import Plan
    from armrig.rig.collection import collect as collected
    from armrig.rig.replies import this_user

    each = list(played)
    plans = [
        Plan(
            experiment=experiment_name(p.experiment, run.name),
            **fields_of(p, "make details seconds default_levels is_bare"),
            **fields_of(p, "law unstable unmonitored new_reference"),
            **fields_of(run, "Ts pacing"),
            owner=this_user() or "armrig collect" if run.owner is None else run.owner,
            dead_man=run.dead_man or None,
            without_arm=without_arm,
        )
        for p in each
    ]
    check_name_is_free(run.name)
    estimation, first = "", None  # id of the previous run; path of the first readable recording
    for p, plan in zip(each, plans, strict=True):
        details = {**plan.details, VALIDATION_OF: estimation} if p.is_validation else plan.details
        done = collected(
            replace(plan, details=details), rig=run.rig, connect=run.connect, tell=inform
        )
        verdict, estimation = done.verdict, done.run_id
        first = first or (done.path if verdict else None)
        facts = {"recording": done.path} | fields_of(done, "samples Ts synced rehearsal")
        facts["verdict"] = verdict.facts() if verdict else None
        print_result(facts, str(done.path), json=run.json)
        kept = (
            f"{plural(done.synced, 'sample is', 'samples are')} on the disk; "
            if done.synced
            else ""
        )
        if verdict is None:
            where = "the recording is on the daemon's machine; run `armrig info` there to show its"
            inform(f"{kept}{where} contents")
        elif not verdict.usable:
            raise OperationError(verdict.summary)
        else:
            inform(f"{kept}{verdict.summary}", bold=True)
            if done.shares:
                inform(done.shares)
    if first is not None and not run.json:
        _say_next(each[0].experiment, first, option_for_rig(run.rig, run.connect))


def _say_next(kind: str, first: Path, rig: str) -> None:
    from armrig.recordings.files.origin import Origin

    again, origin = "", None
    if kind == "step":
        with suppress(FileError, OSError):  # the verdict is printed already: this is only a hint
            recording = armrig.load(first)
            again = step_again(recording)
            origin = Origin.of_run(first, recording.manifest)
    if again:
        say_next("collect step again", origin, rig=rig, again=again)
    else:
        say_next(OF_KIND.get(kind, "plot"), file=command_line_name(first))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Remote:
    """Rigs to record, and the files to write."""

    source: str | None = preset(
        None,
        "zenoh endpoint of the daemon or a router, such as tls/HOST:7447.",
        "the configuration's [client] connect, otherwise the daemon on this machine (one rig only)",
        names="--from --connect ENDPOINT",
    )
    rigs: list[str] | None = preset(None, "Id of a rig; repeatable.", "1", names="--rig")
    every: bool = preset(False, "Record every rig, including rigs that start later.", names="--all")
    out: Path | None = preset(
        None,
        "File to write; for several rigs, folder for the files.",
        "RIG-remote-TIME.mcap in this folder",
        names="-o FILE",
    )
    seconds: float | None = preset(None, "Length of the recording, in s.", "no limit", metavar="S")
    json: Json = False

    def __post_init__(self) -> None:
        """Refuse a wrong length, wrong ids, and --all with --rig."""
        from armrig_core.telemetry.topics import check_own_id

        if self.seconds is not None and not self.seconds > 0:
            raise InputError(f"--seconds {self.seconds:g}: must be more than 0")
        for name in self.rigs or ():
            check_own_id(name)
        if self.every and self.rigs:
            raise InputError(
                f"--all with --rig {self.rigs[0]}: give only one; --all records every rig"
            )


def record(remote: Annotated[_Remote, group(_Remote)]) -> None:
    """Record all that a rig publishes, until Ctrl-C.

    The connection to the rig's daemon may be a socket or a network.

    With --all or several --rig the command records many rigs, each into its own files. Rigs that
    start later are included. A failure of one rig does not affect the other rigs.

    The recording begins with the samples that the daemon keeps: at 1 kHz, the last 24 s. If the
    connection is interrupted for less than this time, no sample is lost. A longer interruption
    leaves a gap in the file.

    A new file begins if the daemon restarts or the sampling time changes. A new file also begins
    after 8 388 608 samples, or if more than 200 000 samples of the current file are missing.
    """
    with until_signal() as ended:
        if remote.every or len(remote.rigs or ()) > 1:
            record_many(remote, ended)
        else:
            _record_one(remote, ended)


def _record_one(remote: _Remote, ended: SignalPipe) -> None:
    from armrig.rig.remote_recording import RemoteRecorder, RemoteRecording, recorder_ended
    from armrig.rig.session import no_reply, open_connection

    rig = (remote.rigs or ["1"])[0]
    path = _new_file(remote.out or Path(default_name(rig)))
    connection = open_connection(remote.source, rig=rig)
    where = connection.endpoint
    recording = RemoteRecording(path=path, rig=rig, endpoint=where, tell=tell)
    how = COMPLETE
    with connection.session as session:
        if ended.is_set():  # during loading and connecting
            raise KeyboardInterrupt
        recorder = RemoteRecorder(session, recording)
        try:
            if not recorder.begin():
                raise no_reply(rig, where)
            inform(f"recording rig {rig} from {where}; Ctrl-C ends it")
            recorder.record(ended, remote.seconds)
        except (RuntimeError, OSError) as err:
            how = recorder_ended(err)
            raise
        finally:
            _finish(recording, how)
    if not recording.done:
        raise OperationError(f"rig {rig} at {where} published no sample, so there is no recording")
    facts = {"recordings": [*map(_file_facts, recording.done)]}
    print_result(facts, *map(_file_line, recording.done), json=remote.json)
    if not remote.json:
        say_next("info", file=command_line_name(recording.done[-1].path))


def _finish(recording: RemoteRecording, ended: Ending) -> None:
    try:
        recording.finish(ended)
    except KeyboardInterrupt:
        tell("not complete: the samples are in *.mcap.active; `armrig recover` completes the file")
        raise
    finally:
        if recording.done and ended.code != OutcomeCode.COMPLETE:
            more = (
                f", the last of {plural(len(recording.done), 'file')}"
                if len(recording.done) > 1
                else ""
            )
            tell(f"recorded up to the error: {recording.done[-1].path}{more}")


def _new_file(path: Path) -> Path:
    from armrig_core.recording_file.part_names import ACTIVE

    check_output(path, (), "-o", "a recording is an MCAP file", ".mcap")
    for taken in (path, path.with_name(f"{path.name}{ACTIVE}")):
        if os.path.lexists(taken):
            raise InputError(f"-o {path}: {taken.name} exists; give another name")
    return path


def _file_facts(file: Any) -> dict[str, Any]:
    return {"recording": file.path} | fields_of(file, "samples missing outcome")


def _file_line(file: Any) -> str:
    return f"{file.path}: {plural(file.samples, 'sample')}, {file.missing} missing, {file.outcome}"


def default_name(rig: str) -> str:
    """Return the name of a new file of a rig."""
    return f"{rig}-remote-{time.strftime('%Y%m%dT%H%M%S')}.mcap"


def record_many(remote: _Remote, ended: SignalPipe) -> None:
    """Record several rigs at an endpoint into files in a folder."""
    from armrig.lab.fleet_recorder import FleetRecorder
    from armrig.rig.session import connect_setting, open_endpoint

    where, rigs = remote.source or connect_setting(), remote.rigs
    if not where:
        raise InputError(
            "--from is missing: give the endpoint of a router, such as tls/lab.local:7447"
        )
    folder = remote.out or Path()
    folder.mkdir(parents=True, exist_ok=True)
    with open_endpoint(where).session as session:
        if ended.is_set():  # during loading and connecting
            raise KeyboardInterrupt
        recorder = FleetRecorder(
            session, where, lambda rig: folder / default_name(rig), tell, tell_error
        )
        named = "all rigs" if rigs is None else f"rigs {', '.join(rigs)}"
        inform(f"recording {named} from {where}; Ctrl-C ends it")
        recorded = recorder.record(ended, remote.seconds, rigs)
    files = [(result.rig, file) for result in recorded for file in result.files]
    failed = [result for result in recorded if result.why]
    facts = {
        "recordings": [{"rig": rig} | _file_facts(file) for rig, file in files],
        "failed": [fields_of(result, "rig why") for result in failed],
    }
    print_result(facts, *(_file_line(file) for _, file in files), json=remote.json)
    if failed:
        names = ", ".join(result.rig for result in failed)
        raise OperationError(
            f"the recording ended early for rig {names}, of {plural(len(recorded), 'rig')}; see "
            "above"
        )
    if not files:
        msg = f"no rig at {where} published a sample: there is nothing to record; "
        raise OperationError(msg + "`armrig ls --live` lists the rigs")
    silent = [result.rig for result in recorded if not result.files]
    for rig in silent:
        tell(f"rig {rig}: no sample arrived, so it has no recording")
    if rigs is not None and silent:
        raise typer.Exit(1)


def play(
    file: File,
    speed: float = preset(1.0, "Speed of the playback, relative to the recording.", metavar="X"),
    start: From = None,
    stop: To = None,
    loop: bool = preset(False, "Repeat the recording until Ctrl-C."),
    wait: bool = preset(False, "Begin when the first listener connects."),
    listen: str | None = preset(
        None, "zenoh endpoint to publish at.", "a new socket of this user", metavar="ENDPOINT"
    ),
    json: Json = False,
) -> None:
    """Publish the messages of a recording again.

    The command ends with the recording, or by Ctrl-C. The messages have keys such as
    rig/played-1/sample for a recording of rig 1. No rig has the id played-1, so commands get no
    answer.

    With --json the first line contains the endpoint, and the last line contains the number of
    messages.
    """
    from armrig_core.telemetry.topics import check_rig_id, playback_id

    from armrig.rig.playback import open_stage, read_run, rest
    from armrig.rig.playback import play as played
    from armrig.rig.session import own_endpoint

    if not 0 < speed < inf:
        raise InputError(f"--speed {speed:g}: must be more than 0, such as 1 or 10")
    run = read_run(file, start, stop)
    rig = playback_id(check_rig_id(run.manifest.rig))
    if run.damage:
        tell(f"{file}: {run.damage}; the undamaged part is played")
    where = listen or own_endpoint(rig)
    count = 0
    # Ctrl-C is a normal end.
    with open_stage(where, rig, run.channels) as stage, suppress(KeyboardInterrupt):
        seconds = run.seconds / speed
        facts = {"rig": rig, "endpoint": where, "messages": len(run), "samples": run.samples.size}
        print_result(
            facts | {"seconds": seconds},
            f"{rig} at {where}: {plural(len(run), 'message')} in {digits(seconds, 3)} s; Ctrl-C "
            "ends it",
            f"in a second terminal: armrig watch{option_for_rig(rig, listen)}",
            json=json,
        )
        while True:
            if wait:
                stage.wait_for_listener()
            for _ in played(run, stage.publish, speed=speed):
                count += 1
            if not loop:
                break
            rest(run, speed=speed)
    print_result(
        {"rig": rig, "published": count}, f"published {plural(count, 'message')}", json=json
    )
    if not json:
        say_next("info", file=command_line_name(file))
