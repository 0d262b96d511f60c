"""Recordings of `armrig collect`: their inputs and their printed results."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any, Literal, NamedTuple

from armrig_core.errors import FileError, InputError, OperationError

from armrig.cli.next_step import naming, own_recordings, say_next, step_again, typed
from armrig.cli.options import echo, inform, print_json

SECONDS = 30.0
_MAX_NAME_LENGTH = 40  # characters of a kind of experiment that the daemon accepts


class CollectedRun(NamedTuple):
    """Options common to all kinds of experiment."""

    Ts: float | None
    name: str
    pacing: Literal["scheduled", "exchange"]
    owner: str | None
    dead_man: float
    rig: str
    connect: str | None
    json: bool


class Played(NamedTuple):
    """One recording of `armrig collect`."""

    experiment: str
    make: Callable[[int, float], Any]
    """Function of N and Ts, in s, that returns u, in V."""
    details: dict[str, Any]
    seconds: float | None
    is_validation: bool = False
    """True if the recording validates the models of the previous recording."""


def chosen_inputs(
    experiment: str,
    *,
    input: str | None,
    file: Path | None,
    seconds: float | None,
    a: float,
    low: float,
    high: float,
    seed: int,
    validation: bool,
    Ts: float | None,
) -> list[Played]:
    """Return the runs to play; refuse wrong options before the connection to a rig."""
    from armrig.excitation.named_signals import SEEDED, details_of, named_signal

    name = input or ("telegraph" if file is None else "csv")
    if (name == "csv") != (file is not None):
        msg = f"--input {name} with --file {file}: " if file else f"--input {name}: "
        msg += "--file CSV plays a file; leave out --input, or give --input csv"
        raise InputError(msg)
    if validation and name not in SEEDED:
        raise InputError(
            f"--validation: {name} would repeat the same input; choose an input with a seed "
            f"({', '.join(SEEDED)}), or collect twice"
        )
    if file is not None:
        return [_from_file(experiment, file, seconds, Ts)]
    figures = {"a": a, "low": low, "high": high}
    # A wrong value is refused here, before the rig is armed.
    named_signal(name, 3, 0.01, seed=seed, **figures)

    def played(kind: str, seed: int) -> Played:
        return Played(
            kind,
            lambda N, Ts: named_signal(name, N, Ts, seed=seed, **figures),
            details_of(name, seed=seed, **figures),
            SECONDS if seconds is None else seconds,
        )

    first = played(experiment, seed)
    second = played(f"{experiment}-validation", seed + 1)._replace(is_validation=True)
    return [first, second] if validation else [first]


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
    """Return the kind of experiment, with the name that the user added."""
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


def collect_each(played: Iterable[Played], run: CollectedRun, *, without_arm: bool = False) -> None:
    """Record each run and print its result; stop if the data cannot be used.

    If `without_arm` is True, the experiment needs the chassis without the arm, and a rig with an
    arm is refused.
    """
    from dataclasses import replace

    from armrig.recordings.recording_summary import VALIDATION_OF
    from armrig.rig.collection import Plan, collect
    from armrig.rig.replies import this_user

    each = list(played)
    plans = [
        Plan(
            experiment=_experiment_name(p.experiment, run.name),
            make=p.make,
            details=p.details,
            seconds=p.seconds,
            Ts=run.Ts,
            pacing=run.pacing,
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
        done = collect(
            replace(plan, details=details), rig=run.rig, connect=run.connect, tell=inform
        )
        verdict, estimation = done.verdict, done.run_id
        first = first or (done.path if verdict else None)
        if run.json:
            facts = {"recording": str(done.path), "samples": done.samples, "Ts": done.Ts}
            facts |= {"synced": done.synced}
            facts |= {"rehearsal": done.rehearsal}
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
    """Print the next command, which repeats a step if the dead band hid its rise."""
    from armrig.recordings.loading import load

    again = ""
    if kind == "step":
        with suppress(FileError, OSError):  # the verdict is printed already: this is only a hint
            again = step_again(load(first))
    if again:
        say_next("step hidden", again=f"{rig}{again}")
    else:
        say_next(f"collect {kind}", file=typed(first))
