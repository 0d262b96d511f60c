"""The commands that record: collect blackbox, greybox, step, staircase, bla."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from armrig_core.errors import InputError

from armrig.cli.collect_runs import SECONDS, CollectedRun, Played, chosen_inputs, collect_each
from armrig.cli.options import Connect, Json, RigId

app = typer.Typer(
    help="Play an input and record the response of the rig.\n\n"
    "The command prints the path of the recording and whether its data can be used. "
    "The exit code is 1 if the data cannot be used.",
    rich_markup_mode=None,
)

SamplingTime = Annotated[
    float | None, typer.Option("--Ts", help="Sampling time, in s.", show_default="the daemon's")
]
Seconds = Annotated[
    float, typer.Option("--seconds", help="Length, in s; at most 4 000 000 samples.")
]
InputSeconds = Annotated[
    float | None,
    typer.Option(
        "--seconds",
        help="Length, in s; at most 4 000 000 samples; not with --file.",
        show_default="30",
    ),
]
Low = Annotated[float, typer.Option("--low", help="Lowest voltage of the input, in V, at least 0.")]
High = Annotated[
    float, typer.Option("--high", help="Highest voltage of the input, in V, at most 5.")
]
_MAX_SEED = 2**53
Seed = Annotated[
    int,
    typer.Option(
        "--seed",
        min=0,
        max=_MAX_SEED,
        help="Seed of the random numbers (telegraph, prbs, white, multisine).",
    ),
]
PhaseSeed = Annotated[
    int, typer.Option("--seed", min=0, max=_MAX_SEED, help="Seed of the random phases.")
]
Input = Annotated[
    Literal["telegraph", "prbs", "white", "multisine", "chirp", "csv"] | None,
    typer.Option("--input", help="Input signal.", show_default="telegraph"),
]
InputFile = Annotated[
    Path | None,
    typer.Option(
        "--file",
        metavar="CSV",
        help="File with your own input: a row with u, or t and u, for each sample.",
    ),
]
SwitchProbability = Annotated[
    float, typer.Option("--a", help="Probability of a switch at each sample (telegraph, prbs).")
]
Validation = Annotated[
    bool,
    typer.Option("--validation", help="Record a second run for validation, with the next seed."),
]
Name = Annotated[
    str,
    typer.Option(
        "--name",
        help="Name of the recording, for @NAME: a-z, 0-9 and -.",
        show_default="none",
    ),
]
Pacing = Annotated[
    Literal["scheduled", "exchange"],
    typer.Option(
        "--pacing",
        help="Clock of the samples: the device's timer (scheduled) or the host (exchange).",
    ),
]
Owner = Annotated[
    str | None,
    typer.Option(
        "--owner", help="Name of the rig's owner, shown to other users.", show_default="this user"
    ),
]

DeadMan = Annotated[
    float,
    typer.Option(
        "--dead-man",
        metavar="SECONDS",
        help="Time, 0.5 to 60 s, after which the daemon stops the run if this program is killed, "
        "frozen or disconnected. 0 plays the run to its end.",
    ),
]
DEFAULT_PERIOD_S = 5.0
DEAD_MAN_S = 1.0
"""Default time in s after which a closed terminal or a lost connection stops the motor."""


@app.command(epilog="Example: armrig collect blackbox --seconds 30 --validation")
def blackbox(
    seconds: InputSeconds = None,
    input: Input = None,
    file: InputFile = None,
    a: SwitchProbability = 0.05,
    low: Low = 0.5,
    high: High = 4.5,
    seed: Seed = 1,
    validation: Validation = False,
    Ts: SamplingTime = None,
    name: Name = "",
    pacing: Pacing = "scheduled",
    owner: Owner = None,
    dead_man: DeadMan = DEAD_MAN_S,
    rig: RigId = "1",
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Play a random input, or your own input, to the complete rig."""
    run = CollectedRun(Ts, name, pacing, owner, dead_man, rig, connect, json)
    collect_each(
        chosen_inputs(
            "blackbox",
            input=input,
            file=file,
            seconds=seconds,
            a=a,
            low=low,
            high=high,
            seed=seed,
            validation=validation,
            Ts=Ts,
        ),
        run,
    )


@app.command(epilog="Example: armrig collect greybox --seconds 30")
def greybox(
    seconds: InputSeconds = None,
    input: Input = None,
    file: InputFile = None,
    a: SwitchProbability = 0.05,
    low: Low = 0.5,
    high: High = 4.5,
    seed: Seed = 1,
    validation: Validation = False,
    Ts: SamplingTime = None,
    name: Name = "",
    pacing: Pacing = "scheduled",
    owner: Owner = None,
    dead_man: DeadMan = DEAD_MAN_S,
    rig: RigId = "1",
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Play a random input, or your own input, to the chassis alone.

    Remove the rotating part first. The configuration must have [arm] removed = true.
    """
    run = CollectedRun(Ts, name, pacing, owner, dead_man, rig, connect, json)
    plan = chosen_inputs(
        "greybox",
        input=input,
        file=file,
        seconds=seconds,
        a=a,
        low=low,
        high=high,
        seed=seed,
        validation=validation,
        Ts=Ts,
    )
    collect_each(plan, run, without_arm=True)


@app.command(epilog="Example: armrig collect step --Ts 0.002")
def step(
    seconds: Seconds = 5.0,
    at: Annotated[float, typer.Option("--at", help="Time of the step, in s.")] = 1.0,
    low: Low = 0.5,
    high: High = 4.5,
    Ts: SamplingTime = None,
    name: Name = "",
    pacing: Pacing = "scheduled",
    owner: Owner = None,
    dead_man: DeadMan = DEAD_MAN_S,
    rig: RigId = "1",
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Play a step, to measure time constant, delay and gain.

    The input steps from --low to --high.
    """
    from armrig.excitation.named_signals import check_step_time, step_at

    step_at(1, 1.0, low=low, high=high, at=0.0)
    check_step_time(at, seconds)
    details = {"input": "step", "low": low, "high": high, "at": at}
    make = partial(step_at, low=low, high=high, at=at)
    run = CollectedRun(Ts, name, pacing, owner, dead_man, rig, connect, json)
    collect_each([Played("step", make, details, seconds)], run)


@app.command(epilog="Example: armrig collect staircase --levels 6")
def staircase(
    seconds: Seconds = SECONDS,
    levels: Annotated[int, typer.Option("--levels", min=2, help="Number of levels.")] = 6,
    low: Low = 0.5,
    high: High = 4.5,
    Ts: SamplingTime = None,
    name: Name = "",
    pacing: Pacing = "scheduled",
    owner: Owner = None,
    dead_man: DeadMan = DEAD_MAN_S,
    rig: RigId = "1",
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Play a staircase of levels up and down, to measure static gain and friction."""
    from armrig.excitation.named_signals import step_at, up_and_down

    step_at(1, 1.0, low=low, high=high, at=0.0)
    details = {"input": "staircase", "low": low, "high": high, "levels": levels}
    run = CollectedRun(Ts, name, pacing, owner, dead_man, rig, connect, json)

    def make(N: int, _: float) -> Any:
        return up_and_down(N, low=low, high=high, levels=levels)

    collect_each([Played("staircase", make, details, seconds)], run)


@app.command(epilog="Example: armrig collect bla --realisations 4")
def bla(
    seconds: Annotated[
        float | None,
        typer.Option(
            "--seconds", help="Length of each recording, in s; use it instead of --period."
        ),
    ] = None,
    period: Annotated[
        float | None,
        typer.Option("--period", help="Length of a period, in s.", show_default="5"),
    ] = None,
    periods: Annotated[
        int, typer.Option("--periods", min=2, help="Number of periods in each recording.")
    ] = 5,
    count: Annotated[
        int,
        typer.Option(
            "--realisations", min=1, help="Number of recordings, each with different phases."
        ),
    ] = 4,
    low: Low = 0.5,
    high: High = 4.5,
    seed: PhaseSeed = 1,
    Ts: SamplingTime = None,
    name: Name = "",
    pacing: Pacing = "scheduled",
    owner: Owner = None,
    dead_man: DeadMan = DEAD_MAN_S,
    rig: RigId = "1",
    connect: Connect = None,
    json: Json = False,
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

    run = CollectedRun(Ts, name, pacing, owner, dead_man, rig, connect, json)
    collect_each(
        (
            Played("bla", partial(make, r), details | {"realisation": r}, seconds)
            for r in range(count)
        ),
        run,
    )
