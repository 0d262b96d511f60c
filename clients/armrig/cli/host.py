"""The commands about this host and what is plugged into it: demo, doctor, conformance."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer
from armrig_core.errors import InputError

from armrig.cli.next_step import say_next, typed
from armrig.cli.options import Connect, Json, RigId, print_json, say

_LONGEST_DEMO_S = 600.0


def demo(
    directory: Annotated[Path, typer.Option(help="Where everything goes.")] = Path("demo"),
    seconds: Annotated[float, typer.Option(min=5, help="Length of each telegraph.")] = 30.0,
    seed: Annotated[
        int, typer.Option(min=0, max=2**63 - 2, help="Of the inputs and of the rig's noise.")
    ] = 1,
    virtual: Annotated[
        bool,
        typer.Option("--virtual", help="In virtual time: at once, the same bytes for each seed."),
    ] = False,
    firmware: Annotated[
        bool, typer.Option("--firmware", help="The Uno's firmware in simavr, in virtual time.")
    ] = False,
    json: Json = False,
) -> None:
    """Emulate a rig, record it, identify it, write a report.

    Two minutes, no hardware; with --virtual 20 s, on any system with Python.

    With --json where everything lies, and each model's fit, are a line of JSON at the end.
    """
    from rich.console import Console

    from armrig.cli.demo import demo as run_demo
    from armrig.cli.demo import from_here

    if directory.exists() and not directory.is_dir():
        raise InputError(
            f"--directory {directory}: is a file; give a directory, which is made where none is"
        )
    if not seconds <= _LONGEST_DEMO_S:  # NaN neither
        raise typer.BadParameter(f"--seconds {seconds:g}: 5 to {_LONGEST_DEMO_S:g} s")
    console = Console(stderr=json)
    how = {"virtual": virtual or firmware, "firmware": firmware}
    done = run_demo(directory, seconds=seconds, seed=seed, console=console, **how)
    if json:
        print_json(done)
    else:
        say_next("demo", file=typed(from_here(Path(done["recordings"]["telegraph"]))))


def doctor(rig: RigId = "1", connect: Connect = None, json: Json = False) -> None:
    """Say what on this host costs timing, and how to mend it.

    If a daemon of this machine answers, it is judged, and not the user who calls.

    Exit code 1 if anything costs timing.

    What cannot be told or mended here is a note, and does not count.
    """
    from armrig.lab.doctor import doctor as examine_this_host
    from armrig.lab.doctor import is_well

    checks = examine_this_host(rig, connect)
    if json:
        print_json(checks)
    else:
        say("\n".join(map(str, checks)))
    if not is_well(checks):
        raise typer.Exit(1)


def conformance(
    device: Annotated[str, typer.Option("--device", metavar="PORT", help="Serial port.")],
    baud: Annotated[int, typer.Option("--baud", help="Speed of the line, in bit/s.")] = 500_000,
    motor_unplugged: Annotated[
        bool, typer.Option("--motor-unplugged", help="Do not ask: the motor is unplugged.")
    ] = False,
    json: Json = False,
) -> None:
    """Try a device on every rule of the wire, the motor unplugged; it takes a minute.

    One line for each rule of PROTOCOL.md. Exit code 0 only where no rule is broken.

    The device is left at 0 V.
    """
    program = [sys.executable, "-m", "armrig_daemon", "conformance", "--device", device]
    program += ["--baud", str(baud), *["--motor-unplugged"] * motor_unplugged, *["--json"] * json]
    os.execv(program[0], program)  # in our place: a signal must reach who holds the device
