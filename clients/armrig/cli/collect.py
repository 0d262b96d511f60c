"""The commands that play an input and record: collect blackbox, greybox, step, staircase, bla."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from armrig_core.errors import FileError, InputError, OperationError

from armrig.cli.next_step import naming, own_recordings, say_next, step_again, typed
from armrig.cli.options import Commands, Connect, Json, RigId, SamplingTime, chosen, group, option
from armrig.cli.printing import echo, fields_of, inform, print_json

collect = Commands(
    "Play an input and record the response of the rig.\n\n"
    "The command prints the path of the recording and whether its data can be used. "
    "The exit code is 1 if the data cannot be used."
)
SECONDS = 30.0
DEFAULT_PERIOD_S = 5.0
DEAD_MAN_S = 1.0
"""Default time in s after which a closed terminal or a lost connection stops the motor."""
_MAX_NAME_LENGTH = 40  # characters of a kind of experiment that the daemon accepts
_MAX_SEED = 2**53
Seconds = Annotated[float, option("--seconds", "Length, in s; at most 4 000 000 samples.")]
Low = Annotated[float, option("--low", "Lowest voltage of the input, in V, at least 0.")]
High = Annotated[float, option("--high", "Highest voltage of the input, in V, at most 5.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Run:
    """Options common to all kinds of experiment."""

    Ts: SamplingTime = None
    name: str = chosen("", "--name", "Name of the recording, for @NAME: a-z, 0-9 and -.", "none")
    pacing: Literal["scheduled", "exchange"] = chosen(
        "scheduled",
        "--pacing",
        "Clock of the samples: the device's timer (scheduled) or the host (exchange).",
    )
    owner: str | None = chosen(
        None, "--owner", "Name of the rig's owner, shown to other users.", "this user"
    )
    dead_man: float = chosen(
        DEAD_MAN_S,
        "--dead-man SECONDS",
        "Time, 0.5 to 60 s, after which the daemon stops the run if this program is killed, "
        "frozen or disconnected. 0 plays the run to its end.",
    )
    rig: RigId = "1"
    connect: Connect = None
    json: Json = False


@dataclass(frozen=True, slots=True, kw_only=True)
class InputChoice:
    """Options of a random input, or of the user's own input."""

    seconds: float | None = chosen(
        None, "--seconds", "Length, in s; at most 4 000 000 samples; not with --file.", "30"
    )
    input: Literal["telegraph", "prbs", "white", "multisine", "chirp", "csv"] | None = chosen(
        None, "--input", "Input signal.", "telegraph"
    )
    file: Path | None = chosen(
        None, "--file CSV", "File with your own input: a row with u, or t and u, for each sample."
    )
    a: float = chosen(0.05, "--a", "Probability of a switch at each sample (telegraph, prbs).")
    low: Low = 0.5
    high: High = 4.5
    seed: int = chosen(
        1,
        "--seed",
        "Seed of the random numbers (telegraph, prbs, white, multisine).",
        min=0,
        max=_MAX_SEED,
    )
    validation: bool = chosen(
        False, "--validation", "Record a second run for validation, with the next seed."
    )


Run = Annotated[_Run, group(_Run)]
Choice = Annotated[InputChoice, group(InputChoice)]


@collect.add("collect blackbox --seconds 30 --validation")
def blackbox(choice: Choice, run: Run) -> None:
    """Play a random input, or your own input, to the complete rig."""
    collect_each(chosen_inputs("blackbox", choice, run.Ts), run)


@collect.add("collect greybox --seconds 30")
def greybox(choice: Choice, run: Run) -> None:
    """Play a random input, or your own input, to the chassis alone.

    Remove the rotating part first. The configuration must have [arm] removed = true.
    """
    collect_each(chosen_inputs("greybox", choice, run.Ts), run, without_arm=True)


@collect.add("collect step --Ts 0.002")
def step(
    *,
    seconds: Seconds = 5.0,
    at: float = chosen(1.0, "--at", "Time of the step, in s."),
    low: Low = 0.5,
    high: High = 4.5,
    run: Run,
) -> None:
    """Play a step, to measure time constant, delay and gain.

    The input steps from --low to --high.
    """
    from armrig.excitation.named_signals import check_step_time, step_at

    step_at(1, 1.0, low=low, high=high, at=0.0)
    check_step_time(at, seconds)
    details = {"input": "step", "low": low, "high": high, "at": at}
    make = partial(step_at, low=low, high=high, at=at)
    collect_each([Played("step", make, details, seconds)], run)


@collect.add("collect staircase --levels 6")
def staircase(
    *,
    seconds: Seconds = SECONDS,
    levels: int = chosen(6, "--levels", "Number of levels.", min=2),
    low: Low = 0.5,
    high: High = 4.5,
    run: Run,
) -> None:
    """Play a staircase of levels up and down, to measure static gain and friction."""
    from armrig.excitation.named_signals import step_at, up_and_down

    step_at(1, 1.0, low=low, high=high, at=0.0)
    details = {"low": low, "high": high, "levels": levels}

    def make(N: int, _: float) -> Any:
        return up_and_down(N, low=low, high=high, levels=levels)

    collect_each([Played("staircase", make, {"input": "staircase", **details}, seconds)], run)


@collect.add("collect bla --realisations 4")
def bla(
    *,
    seconds: float | None = chosen(
        None, "--seconds", "Length of each recording, in s; use it instead of --period."
    ),
    period: float | None = chosen(None, "--period", "Length of a period, in s.", "5"),
    periods: int = chosen(5, "--periods", "Number of periods in each recording.", min=2),
    count: int = chosen(
        4, "--realisations", "Number of recordings, each with different phases.", min=1
    ),
    low: Low = 0.5,
    high: High = 4.5,
    seed: int = chosen(1, "--seed", "Seed of the random phases.", min=0, max=_MAX_SEED),
    run: Run,
) -> None:
    """Play multisines for `armrig.bla`, the best linear approximation.

    Each recording has different random phases.
    """
    from armrig.excitation.named_signals import realisations

    realisations(3, 1, low, high, seed, periods=1)
    if seconds is not None and period is not None:
        raise InputError(
            f"--seconds {seconds:g} with --period {period:g}: give only one of these two options, "
            f"because a recording has {periods} periods (--periods)"
        )
    if period is not None and not period > 0:  # also refuses NaN
        raise InputError(f"--period {period:g}: must be a number of seconds, more than 0")
    if seconds is None:
        seconds = periods * (DEFAULT_PERIOD_S if period is None else period)
    details = {"input": "multisine", "low": low, "high": high, "periods": periods}
    details |= {"realisations": count, "seed": seed}

    def make(r: int, N: int, _: float) -> Any:
        return realisations(N - N % periods, count, low, high, seed, periods=periods)[r]

    collect_each(
        (
            Played("bla", partial(make, r), details | {"realisation": r}, seconds)
            for r in range(count)
        ),
        run,
    )


class Played(NamedTuple):
    """One recording of `armrig collect`."""

    experiment: str
    make: Callable[[int, float], Any]
    """Function of N and Ts, in s, that returns u, in V."""
    details: dict[str, Any]
    seconds: float | None
    is_validation: bool = False
    """True if the recording validates the models of the previous recording."""


def chosen_inputs(experiment: str, choice: InputChoice, Ts: float | None) -> list[Played]:
    """Return the runs to play; refuse wrong options before the connection to a rig."""
    from armrig.excitation.named_signals import SEEDED, details_of, named_signal

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
        return [_from_file(experiment, file, choice.seconds, Ts)]
    figures = fields_of(choice, "a low high")
    # A wrong value is refused here, before the rig is armed.
    named_signal(name, 3, 0.01, seed=choice.seed, **figures)

    def played(kind: str, seed: int) -> Played:
        return Played(
            kind,
            lambda N, Ts: named_signal(name, N, Ts, seed=seed, **figures),
            details_of(name, seed=seed, **figures),
            SECONDS if choice.seconds is None else choice.seconds,
        )

    first = played(experiment, choice.seed)
    second = played(f"{experiment}-validation", choice.seed + 1)._replace(is_validation=True)
    return [first, second] if choice.validation else [first]


def _from_file(experiment: str, file: Path, seconds: float | None, Ts: float | None) -> Played:
    from armrig.excitation import from_csv

    if seconds is not None:
        raise InputError(f"--seconds {seconds:g}: a file has its own length; leave out --seconds")
    file.stat()  # a missing file is refused here
    if Ts is not None:
        from_csv(file, Ts)
    details = {"input": "csv", "file": file.name}
    return Played(experiment, lambda _, Ts: from_csv(file, Ts), details, None)


def _experiment_name(experiment: str, name: str) -> str:
    whole = f"{experiment}-{name}" if name else experiment
    if not re.fullmatch(r"[a-z0-9-]*", name) or len(whole) > _MAX_NAME_LENGTH:
        most = _MAX_NAME_LENGTH - len(experiment) - 1
        raise InputError(f"--name {name}: at most {most} of a-z, 0-9 and - are allowed")
    if name == "last" or re.match(r"validation\b", name):
        meant = "@last is the newest recording" if name == "last" else "--validation adds this name"
        raise InputError(f"--name {name}: {meant}; give another name")
    return whole


def _check_name_is_free(name: str) -> None:
    """Refuse the name of a complete recording; otherwise the name would become ambiguous."""
    from armrig.recordings.recording_names import matching

    if not name:
        return
    paths = own_recordings()

    def is_used(text: str) -> bool:
        return any(s.is_complete for s in matching(text, paths))

    if is_used(f"@{name}"):
        free = next(f"{name}-{n}" for n in count(2) if not is_used(f"@{name}-{n}"))
        msg = f"--name {name}: @{name} is already a complete recording; give another name, "
        raise InputError(f"{msg}such as --name {free}")


def collect_each(played: Iterable[Played], run: _Run, *, without_arm: bool = False) -> None:
    """Record each run and print its result; stop if the data cannot be used.

    If `without_arm` is True, the experiment needs the chassis without the arm, and a rig with an
    arm is refused.
    """
    from dataclasses import replace

    from armrig.recordings.recording_summary import VALIDATION_OF
    from armrig.rig.collection import Plan
    from armrig.rig.collection import collect as collected
    from armrig.rig.replies import this_user

    each = list(played)
    plans = [
        Plan(
            experiment=_experiment_name(p.experiment, run.name),
            **fields_of(p, "make details seconds"),
            **fields_of(run, "Ts pacing"),
            owner=this_user() or "armrig collect" if run.owner is None else run.owner,
            dead_man=run.dead_man or None,
            without_arm=without_arm,
        )
        for p in each
    ]
    _check_name_is_free(run.name)
    estimation, first = "", None  # id of the previous run; path of the first readable recording
    for p, plan in zip(each, plans, strict=True):
        details = {**plan.details, VALIDATION_OF: estimation} if p.is_validation else plan.details
        done = collected(
            replace(plan, details=details), rig=run.rig, connect=run.connect, tell=inform
        )
        verdict, estimation = done.verdict, done.run_id
        first = first or (done.path if verdict else None)
        if run.json:
            facts = {"recording": str(done.path)} | fields_of(done, "samples Ts synced rehearsal")
            print_json(facts | {"verdict": verdict.facts() if verdict else None})
        else:
            echo(str(done.path))
        kept = f"{done.synced} samples are on the disk; " if done.synced else ""
        if verdict is None:
            where = "the recording is on the daemon's machine; run `armrig info` there to show its"
            inform(f"{kept}{where} contents")
        elif not verdict.usable:
            raise OperationError(verdict.summary)
        else:
            inform(f"{kept}{verdict.summary}", bold=True)
    if first is not None and not run.json:
        _say_next(each[0].experiment, first, naming(run.rig, run.connect))


def _say_next(kind: str, first: Path, rig: str) -> None:
    from armrig.recordings.loading import load

    again = ""
    if kind == "step":
        with suppress(FileError, OSError):  # the verdict is printed already: this is only a hint
            again = step_again(load(first))
    if again:
        say_next("step hidden", again=f"{rig}{again}")
    else:
        say_next(f"collect {kind}", file=typed(first))
