"""The commands that record: collect blackbox, collect step."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import typer

from armrig.cli.options import Connect, Json, RigId, print_json, tell

app = typer.Typer(
    help="Play an input, record what the rig does, and print the recording's path.",
    rich_markup_mode=None,
)

SamplingTime = Annotated[
    float | None, typer.Option("--Ts", help="Sampling time in s; the daemon's by default.")
]
Seconds = Annotated[
    float, typer.Option("--seconds", help="Length; at most 1 000 000 samples are played.")
]
Low = Annotated[float, typer.Option("--low", help="Lower level in V.")]
High = Annotated[float, typer.Option("--high", help="Upper level in V.")]
Pacing = Annotated[
    Literal["scheduled", "exchange"],
    typer.Option("--pacing", help="Who makes the samples: the device's timer, or the host."),
]
Owner = Annotated[str, typer.Option("--owner", help="Who takes the rig, for others to read.")]

DeadMan = Annotated[
    float,
    typer.Option(
        "--dead-man",
        metavar="SECONDS",
        help="The daemon stops the run so long after this program was killed, frozen or cut off; "
        "0 plays on.",
    ),
]
DEAD_MAN_S = 1.0
"""Who closes the terminal, or loses the connection, expects that the motor stops."""


@app.command()
def blackbox(
    seconds: Seconds = 30.0,
    a: Annotated[float, typer.Option("--a", help="Probability of a switch at each sample.")] = 0.05,
    low: Low = 0.5,
    high: High = 4.5,
    seed: Annotated[
        int, typer.Option("--seed", min=0, max=2**53, help="Of the random switches.")
    ] = 1,
    Ts: SamplingTime = None,
    pacing: Pacing = "scheduled",
    owner: Owner = "armrig collect",
    dead_man: DeadMan = DEAD_MAN_S,
    rig: RigId = "1",
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Play a random telegraph signal."""
    from armrig.excitation import telegraph

    telegraph(1, a, low, high)  # a level that is not allowed is told before a rig is asked for
    details = {"input": "telegraph", "a": a, "low": low, "high": high, "seed": seed}
    _collect(
        "blackbox",
        lambda N, _: telegraph(N, a, low, high, seed),
        *(details, seconds, Ts, pacing, owner, dead_man, rig, connect),
        json=json,
    )


@app.command()
def step(
    seconds: Seconds = 5.0,
    at: Annotated[float, typer.Option("--at", help="When it steps, in s.")] = 1.0,
    low: Low = 0.5,
    high: High = 4.5,
    Ts: SamplingTime = None,
    pacing: Pacing = "scheduled",
    owner: Owner = "armrig collect",
    dead_man: DeadMan = DEAD_MAN_S,
    rig: RigId = "1",
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Play a step from the lower to the upper level."""
    from armrig.excitation import step as stepped

    stepped(1, low=low, high=high)
    _check_step_time(at, seconds)
    details = {"input": "step", "low": low, "high": high, "at": at}
    _collect(
        "step",
        # A time just before the end may be nearest to the end, where it would be no step.
        lambda N, Ts: stepped(N, low=low, high=high, at=min(round(at / Ts), N - 1)),
        *(details, seconds, Ts, pacing, owner, dead_man, rig, connect),
        json=json,
    )


def _check_step_time(at: float, seconds: float) -> None:
    if not at >= 0:  # NaN neither
        msg = f"--at {at:g}: must be a number of seconds, 0 or more"
        raise ValueError(msg)
    if at >= seconds:
        where = "at" if at == seconds else "after"
        msg = f"--at {at:g} s is {where} the end, {seconds:g} s; give an earlier --at or more "
        msg += "--seconds"
        raise ValueError(msg)


def _collect(
    experiment: str,
    make: Any,
    details: dict[str, Any],
    seconds: float,
    Ts: float | None,
    pacing: Literal["scheduled", "exchange"],
    owner: str,
    dead_man: float,
    rig: str,
    connect: str | None,
    *,
    json: bool,
) -> None:
    from armrig.collection import Plan, collect

    plan = Plan(
        experiment=experiment,
        make=make,
        details=details,
        seconds=seconds,
        Ts=Ts,
        pacing=pacing,
        owner=owner,
        dead_man=dead_man or None,
    )
    done = collect(plan, rig=rig, connect=connect, tell=tell)
    if json:
        told = {"recording": str(done.path), "samples": done.samples, "Ts": done.Ts}
        print_json(told | {"rehearsal": done.rehearsal})
    else:
        typer.echo(str(done.path))
