"""The commands about this host and its devices: demo, doctor, flash, conformance."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from shlex import join, quote
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.errors import InputError, OperationError

from armrig.cli.next_step import opener, say_next
from armrig.cli.options import Json, RigId, Verbose, chosen, option
from armrig.cli.printing import agree, echo, print_json, say, say_answer, say_more
from armrig.cli.spinner import spinner

if TYPE_CHECKING:
    from armrig_core.rig.firmware_image import FirmwareImage

    from armrig.lab.avrdude import Board

Socket = Annotated[
    str | None,
    option(
        "--connect ENDPOINT",
        "Socket of a daemon on this machine, unixsock-stream/PATH; other endpoints are refused.",
        "[client] connect, or the daemon on this machine",
    ),
]
BROWN_OUT = (
    "The brown-out fuse is not known: Optiboot does not read fuses. A new board has "
    "a brown-out level of 2.7 V, too low for 16 MHz; docs/hardware.md explains how to read and set "
    "it."
)
MOTOR = (
    "While a board is written, its pins are inputs: D9 and D7 float, and D13 blinks. Only the "
    "pull-downs of the wiring hold the motor at 0 V (docs/hardware.md). A partly written program "
    "may do anything, so unplug the motor."
)
_BAUD = 500_000  # of the firmware that is shipped
_MAX_DEMO_S = 600.0


def demo(
    directory: Path = chosen(Path("demo"), "--directory", "Folder for all files."),
    seconds: float = chosen(30.0, "--seconds", "Length of each telegraph signal, in s.", min=5),
    seed: int = chosen(
        1, "--seed", "Seed of the inputs and of the rig's noise.", min=0, max=2**63 - 2
    ),
    virtual: bool = chosen(
        False,
        "--virtual",
        "Run in virtual time, without waiting; the same seed gives the same bytes.",
    ),
    firmware: bool = chosen(
        False,
        "--firmware",
        "Run the Uno's firmware in simavr, in virtual time; `make fil` in a checkout "
        "builds the necessary program, which no wheel contains.",
    ),
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


def flash(
    port: str | None = chosen(
        None, "--port DEVICE", "Serial port of the board.", "the only Uno plugged in"
    ),
    image: Path | None = chosen(None, "--hex FILE", "Firmware file to write.", "armrig's own"),
    baud: int = chosen(
        _BAUD, "--baud", "Speed of the firmware's serial line, in bit/s ([device] baud)."
    ),
    dry_run: bool = chosen(False, "--dry-run", "Show the plan only, without opening the port."),
    yes: bool = chosen(False, "--yes", "Confirm that the motor is unplugged; do not ask."),
    fuse: str | None = chosen(
        None,
        "--fuse PROGRAMMER",
        "Read only the brown-out fuse, with this ISP programmer, such as usbasp.",
    ),
    json: Json = False,
) -> None:
    """Write the firmware to an Uno, and check what the board runs.

    The command uses avrdude and the board's boot loader, Optiboot, and verifies the written
    firmware. It refuses a port that a daemon uses, and a board with another boot loader.
    """
    from armrig_core.rig.firmware_image import read_image, shipped_image

    from armrig.lab import avrdude

    if fuse is not None:
        _say_fuse(fuse, port, json=json)
        return

    def show(text: str, how: Callable[[str], None] = say) -> None:
        if not json:
            how(text)

    firmware = read_image(shipped_image() if image is None else image)
    _check_size(firmware)
    program = _program()
    board = avrdude.chosen(port, avrdude.plugged_in())
    call = avrdude.command(program, port=board.port, image=firmware.path)
    about = {"path": str(firmware.path), "bytes": len(firmware.data), "crc": f"{firmware.crc:08x}"}
    about["sha256"] = firmware.sha256
    facts = {"port": board.port, "board": board.name, "firmware": about, "command": call}
    plan = (
        f"board     {board.name} at {board.port}\n"
        f"firmware  {firmware.path}\n"
        f"          {len(firmware.data)} B, CRC-32 {firmware.crc:08x}, sha256 {firmware.sha256}\n"
        f"command   {join(call)}"
    )
    show(plan, echo)
    if not dry_run:
        with avrdude.held(board):
            show(MOTOR)
            agree("Is the motor unplugged? Write the board?", yes=yes)
            with spinner("asking the boot loader"):
                facts["loader"] = f"Optiboot {avrdude.loader(program, board.port)}"
            show(f"loader    {facts['loader']}", echo)
            show(BROWN_OUT)
            with spinner("flash:") as moved:
                avrdude.write(call, moved)
            show("written; the board returned the same bytes", echo)
            facts["device"], found = _device(board, firmware, baud)
            show(found)
    if json:
        print_json(facts)
    elif not dry_run:
        say_next("flash", port=quote(board.port))


def _program() -> str:
    from armrig.lab import avrdude

    program = avrdude.find()
    if program is None:
        raise OperationError(avrdude.INSTALL)
    return program


def _say_fuse(programmer: str, port: str | None, *, json: bool) -> None:
    """Print the brown-out level, and how to correct it."""
    from armrig.lab import avrdude

    value = avrdude.fuse(_program(), programmer, port)
    level = avrdude.BROWN_OUT.get(value & 7, "reserved")
    if json:
        print_json({"efuse": f"{value:02x}", "brown_out": level})
        return
    echo(f"brown-out  {level} (extended fuse 0x{value:02x})")
    if value & 7 != avrdude.WANTED_FUSE & 7:
        at = "" if port is None else f" -P {quote(port)}"
        say(
            "16 MHz needs at least 3.8 V, so the level must be 4.3 V; set it with "
            f"avrdude -p {avrdude.CHIP.lower()} -c {quote(programmer)}{at} "
            f"-U efuse:w:0x{avrdude.WANTED_FUSE:02x}:m"
        )


def _check_size(firmware: FirmwareImage) -> None:
    from armrig.lab.avrdude import CHIP, FLASH_BYTES

    size = len(firmware.data)
    if size > FLASH_BYTES:
        raise InputError(f"{firmware.path}: {size} B, but an {CHIP} has room for {FLASH_BYTES}")


def _device(board: Board, firmware: FirmwareImage, baud: int) -> tuple[dict[str, Any], str]:
    """Return the identity that the board reports, as JSON fields and as a line."""
    from armrig_protocol.messages import State

    from armrig.lab.avrdude import greeting

    with spinner("waiting for the board"):
        device = greeting(board.port, baud)
    if device is None:
        raise OperationError(
            f"{board.port}: the firmware was written, but does not answer at {baud} baud; was it "
            "built for another speed (--baud), or is this another board?"
        )
    if device.firmware != firmware.crc:
        raise OperationError(
            f"the board reports the firmware {device.firmware:08x}, but {firmware.crc:08x} was "
            "written; flash the board again"
        )
    facts = {"firmware": f"{device.firmware:08x}", "version": device.version}
    facts |= {"uid": f"{device.uid:x}", "state": State(device.state).name}
    volts = "it drives the motor" if device.state == State.RUN else "0 V"
    return facts, (
        f"the board reports: firmware {device.firmware:08x}, protocol {device.version}, "
        f"uid {device.uid:x}, {State(device.state).name}, {volts}"
    )


def conformance(
    device: Annotated[str, option("--device DEVICE", "Serial port of the device.")],
    baud: int = chosen(_BAUD, "--baud", "Speed of the line, in bit/s."),
    motor_unplugged: bool = chosen(
        False, "--motor-unplugged", "Confirm that the motor is unplugged; do not ask."
    ),
    json: Json = False,
) -> None:
    """Test a device against PROTOCOL.md, with the motor unplugged.

    The test takes a minute and prints a line for each rule of PROTOCOL.md. The exit code is 0 only
    if no rule is broken.

    At the end, the device is at 0 V.
    """
    program = [sys.executable, "-m", "armrig_daemon", "conformance", "--device", device]
    program += ["--baud", str(baud), *["--motor-unplugged"] * motor_unplugged, *["--json"] * json]
    # In place of this process: a signal must reach the process that holds the device.
    os.execv(program[0], program)
