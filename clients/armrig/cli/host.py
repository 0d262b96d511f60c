"""The commands about this host and its devices: demo, doctor, conformance."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from shlex import quote
from typing import Annotated

import typer
from armrig_core.errors import InputError

from armrig.cli.next_step import opener, say_next
from armrig.cli.options import Json, RigId, Verbose, print_json, say_answer, say_more

Socket = Annotated[
    str | None,
    typer.Option(
        "--connect",
        metavar="ENDPOINT",
        help="Socket of a daemon on this machine, unixsock-stream/PATH; other endpoints are "
        "refused.",
        show_default="[client] connect, or the daemon on this machine",
    ),
]
_MAX_DEMO_S = 600.0


def demo(
    directory: Annotated[Path, typer.Option(help="Folder for all files.")] = Path("demo"),
    seconds: Annotated[
        float, typer.Option(min=5, help="Length of each telegraph signal, in s.")
    ] = 30.0,
    seed: Annotated[
        int, typer.Option(min=0, max=2**63 - 2, help="Seed of the inputs and of the rig's noise.")
    ] = 1,
    virtual: Annotated[
        bool,
        typer.Option(
            "--virtual",
            help="Run in virtual time, without waiting; the same seed gives the same bytes.",
        ),
    ] = False,
    firmware: Annotated[
        bool,
        typer.Option(
            "--firmware",
            help="Run the Uno's firmware in simavr, in virtual time; `make fil` in a checkout "
            "builds the necessary program, which no wheel contains.",
        ),
    ] = False,
    json: Json = False,
) -> None:
    """Emulate a rig, record it, identify models and write a report.

    The demo needs no hardware. It takes two minutes; with --virtual it takes 20 s, on any system
    with Python.

    With --json the last line contains the paths of all files and the fit of each model.
    """
    from rich.console import Console

    from armrig.cli.demo import demo as run_demo
    from armrig.cli.demo import from_here

    if directory.exists() and not directory.is_dir():
        raise InputError(f"--directory {directory}: is a file; give a directory, which may be new")
    if seconds > _MAX_DEMO_S:
        raise typer.BadParameter(f"--seconds {seconds:g}: 5 to {_MAX_DEMO_S:g} s")
    console = Console(stderr=json)
    how = {"virtual": virtual or firmware, "firmware": firmware}
    done = run_demo(directory, seconds=seconds, seed=seed, console=console, **how)
    if json:
        print_json(done)
    else:
        say_next("demo", opener=opener(), file=quote(str(from_here(Path(done["report"])))))


def doctor(
    rig: RigId = "1", connect: Socket = None, json: Json = False, verbose: Verbose = False
) -> None:
    """Show what degrades the timing here, and how to correct it.

    If a daemon answers on this machine, the command checks the rights of the daemon, otherwise the
    rights of this user. The exit code is 1 if a check fails.

    A note is a fact that cannot be checked or corrected here; it does not change the exit code.
    """
    from armrig.lab.doctor import brief, is_well
    from armrig.lab.doctor import doctor as examine_this_host

    checks = examine_this_host(rig, connect)
    if json:
        print_json(checks)
    else:
        say_answer("\n".join(map(str, checks)) if verbose else brief(checks))
        if not verbose:
            say_more("the result of each check")
    if not is_well(checks):
        raise typer.Exit(1)


def conformance(
    device: Annotated[
        str, typer.Option("--device", metavar="DEVICE", help="Serial port of the device.")
    ],
    baud: Annotated[int, typer.Option("--baud", help="Speed of the line, in bit/s.")] = 500_000,
    motor_unplugged: Annotated[
        bool,
        typer.Option("--motor-unplugged", help="Confirm that the motor is unplugged; do not ask."),
    ] = False,
    json: Json = False,
) -> None:
    """Test a device against PROTOCOL.md, with the motor unplugged.

    The test takes a minute and prints a line for each rule of PROTOCOL.md. The exit code is 0 only
    if no rule is broken.

    At the end, the device is at 0 V.
    """
    program = [sys.executable, "-m", "armrig_daemon", "conformance", "--device", device]
    program += ["--baud", str(baud), *["--motor-unplugged"] * motor_unplugged, *["--json"] * json]
    os.execv(
        program[0], program
    )  # in place of this process: a signal must reach the process that holds the device
