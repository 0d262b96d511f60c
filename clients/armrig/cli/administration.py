"""The commands on this host and its devices: doctor, flash, conformance, rigs."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from shlex import join, quote
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.errors import InputError, OperationError
from armrig_core.process.options import CommandGroup, argument, option, preset

from armrig.cli.next_step import say_next
from armrig.cli.options import Json, RigId, Verbose
from armrig.cli.printing import (
    agree,
    echo,
    inform,
    print_json,
    print_table,
    say,
    say_answer,
    say_more,
    spinner,
)

if TYPE_CHECKING:
    from armrig_core.rig.firmware_image import FirmwareImage

    from armrig.lab.avrdude import SerialBoard


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


def doctor(
    rig: RigId = "1",
    connect: str | None = preset(
        None,
        "Socket of a daemon on this machine, unixsock-stream/PATH; other endpoints are refused.",
        "the configuration's [client] connect, otherwise the daemon on this machine",
        metavar="ENDPOINT",
    ),
    json: Json = False,
    verbose: Verbose = False,
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
    port: str | None = preset(
        None, "Serial port of the board.", "the Uno, if only one is plugged in", metavar="DEVICE"
    ),
    image: str | None = preset(
        None,
        "Firmware of armrig to write: uno (the arm), tclab, heatshield or optoshield.",
        "uno",
        metavar="NAME",
    ),
    file: Path | None = preset(
        None, "Firmware file to write (Intel HEX).", "the file of --image", names="--hex FILE"
    ),
    baud: int = preset(_BAUD, "Speed of the firmware's serial line, in bit/s ([device] baud)."),
    dry_run: bool = preset(False, "Show the plan only, without opening the port."),
    yes: bool = preset(False, "Confirm that the motor is unplugged; do not ask."),
    json: Json = False,
) -> None:
    """Write the firmware to an Uno, and check what the board runs.

    The command uses avrdude and the board's boot loader, Optiboot, and verifies the written
    firmware. It refuses a port that a daemon uses, and a board with another boot loader.
    """
    from armrig_core.rig.firmware_image import image_path, read_image

    from armrig.lab import avrdude

    show: Callable[[str], object] = (lambda _: None) if json else say
    if image is not None and file is not None:
        raise typer.BadParameter("--image and --hex exclude each other")
    firmware = read_image(file or image_path(image or "uno"))
    size = len(firmware.data)
    if size > avrdude.FLASH_BYTES:
        has = f"an {avrdude.CHIP} has room for {avrdude.FLASH_BYTES}"
        raise InputError(f"{firmware.path}: {size} B, but {has}")
    program = avrdude.find()
    board = avrdude.choose_board(port, avrdude.usb_boards())
    call = avrdude.command(program, port=board.port, image=firmware.path)
    about = {"path": str(firmware.path), "bytes": size, "crc": f"{firmware.crc:08x}"}
    about["sha256"] = firmware.sha256
    facts = {"port": board.port, "board": board.name, "firmware": about, "command": call}
    plan = (
        f"board     {board.name} at {board.port}\n"
        f"firmware  {firmware.path}\n"
        f"          {size} B, CRC-32 {firmware.crc:08x}, sha256 {firmware.sha256}\n"
        f"command   {join(call)}"
    )
    show(plan)
    if not dry_run:
        with avrdude.lock_port(board):
            show(MOTOR)
            agree("Is the motor unplugged? Write the board?", yes=yes)
            with spinner("asking the boot loader"):
                facts["loader"] = f"Optiboot {avrdude.loader(program, board.port)}"
            show(f"loader    {facts['loader']}")
            show(BROWN_OUT)
            with spinner("flash:") as moved:
                avrdude.write(call, moved)
            show("written; the board returned the same bytes")
            facts["device"], identity = _device(board, firmware, baud)
            show(identity)
    if json:
        print_json(facts)
    elif not dry_run:
        say_next("conformance", port=quote(board.port))


def _device(board: SerialBoard, firmware: FirmwareImage, baud: int) -> tuple[dict[str, Any], str]:
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
    baud: int = preset(_BAUD, "Speed of the line, in bit/s."),
    motor_unplugged: bool = preset(False, "Confirm that the motor is unplugged; do not ask."),
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


rigs = CommandGroup("List the descriptions of rigs, or check a description.", no_args_is_help=False)


@rigs.callback(invoke_without_command=True)
def list_rigs(context: typer.Context) -> None:
    """List the descriptions that come with armrig; `armrig rigs check FILE` checks another."""
    from armrig_core.rig.description import builtin_files, read_description

    if context.invoked_subcommand is None:
        for path in builtin_files():
            echo(f"{path.stem:10} {read_description(path).rig.title}")
        inform("`armrig lab --rig-file NAME` emulates a rig; `armrig rigs check NAME` shows it")


@rigs.add("rigs check heater.toml", "check")
def check_rig(
    file: Annotated[Path, argument("FILE", "Description (TOML), or a name of `armrig rigs`.")],
    json: Json = False,
) -> None:
    """Check the description of a rig, and print how it was understood.

    A file of own equations is executed.
    """
    from armrig_core.rig.description import path_of, read_description

    from armrig.excitation.pace import pace_of

    described = read_description(path_of(file))
    rows = described.rows()
    if described.model and not described.arm:
        try:
            with spinner("simulating the model"):
                paced = pace_of(described).row
        except (InputError, OperationError) as err:
            paced = f"no demo: {err}"
        rows.insert(-1, ("experiments", paced))
    if json:
        print_json(dict(rows))
    else:
        print_table(*rows)
