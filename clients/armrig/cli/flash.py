"""The command that writes the firmware to a board: flash."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from armrig_core.errors import InputError, OperationError

from armrig.cli.options import Json, agree, echo, print_json, say

if TYPE_CHECKING:
    from armrig_core.firmware_image import FirmwareImage
    from armrig_protocol.messages import HelloReply

    from armrig.lab.avrdude import Board

Port = Annotated[
    str | None,
    typer.Option(
        "--port",
        metavar="DEVICE",
        help="Serial port of the board.",
        show_default="the only Uno plugged in",
    ),
]
Image = Annotated[
    Path | None,
    typer.Option(
        "--hex", metavar="FILE", help="Firmware file to write.", show_default="armrig's own"
    ),
]
Baud = Annotated[
    int,
    typer.Option("--baud", help="Speed of the firmware's serial line, in bit/s ([device] baud)."),
]
DryRun = Annotated[
    bool, typer.Option("--dry-run", help="Show the plan only, without opening the port.")
]
Yes = Annotated[
    bool, typer.Option("--yes", help="Confirm that the motor is unplugged; do not ask.")
]
Fuse = Annotated[
    str | None,
    typer.Option(
        "--fuse",
        metavar="PROGRAMMER",
        help="Read only the brown-out fuse, with this ISP programmer, such as usbasp.",
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
_DEFAULT_BAUD = 500_000  # of the firmware that is shipped


def flash(
    port: Port = None,
    image: Image = None,
    baud: Baud = _DEFAULT_BAUD,
    dry_run: DryRun = False,
    yes: Yes = False,
    fuse: Fuse = None,
    json: Json = False,
) -> None:
    """Write the firmware to an Uno, and check what the board runs.

    The command uses avrdude and the board's boot loader, Optiboot, and verifies the written
    firmware. It refuses a port that a daemon uses, and a board with another boot loader.
    """
    from armrig_core.firmware_image import read_image, shipped_image

    from armrig.cli.spinner import spinner
    from armrig.lab import avrdude
    from armrig.lab.avrdude import chosen, held, plugged_in

    if fuse is not None:
        _say_fuse(fuse, port, json=json)
        return
    firmware = read_image(shipped_image() if image is None else image)
    _check_size(firmware)
    program = _program()
    board = chosen(port, plugged_in())
    call = avrdude.command(program, port=board.port, image=firmware.path)
    facts = _facts(board, firmware, call)
    if dry_run:
        _say_plan(facts, json=json)
        return
    with held(board):
        if not json:
            _say_plan(facts, json=False)
            say(MOTOR)
        agree("Is the motor unplugged? Write the board?", yes=yes)
        with spinner("asking the boot loader"):
            facts["loader"] = f"Optiboot {avrdude.loader(program, board.port)}"
        if not json:
            echo(f"loader    {facts['loader']}")
            say(BROWN_OUT)
        facts["device"] = _written(call, board, firmware, baud, json=json)
    if json:
        print_json(facts)
        return
    from armrig.cli.next_step import say_next

    say_next("flash", port=shlex.quote(board.port))


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
        at = "" if port is None else f" -P {shlex.quote(port)}"
        say(
            "16 MHz needs at least 3.8 V, so the level must be 4.3 V; set it with "
            f"avrdude -p {avrdude.CHIP.lower()} -c {shlex.quote(programmer)}{at} "
            f"-U efuse:w:0x{avrdude.WANTED_FUSE:02x}:m"
        )


def _check_size(firmware: FirmwareImage) -> None:
    from armrig.lab.avrdude import CHIP, FLASH_BYTES

    size = len(firmware.data)
    if size > FLASH_BYTES:
        raise InputError(f"{firmware.path}: {size} B, but an {CHIP} has room for {FLASH_BYTES}")


def _facts(board: Board, firmware: FirmwareImage, call: list[str]) -> dict[str, Any]:
    return {
        "port": board.port,
        "board": board.name,
        "firmware": {
            "path": str(firmware.path),
            "bytes": len(firmware.data),
            "crc": f"{firmware.crc:08x}",
            "sha256": firmware.sha256,
        },
        "command": call,
    }


def _say_plan(facts: dict[str, Any], *, json: bool) -> None:
    if json:
        print_json(facts)
        return
    firmware = facts["firmware"]
    echo(f"board     {facts['board']} at {facts['port']}")
    echo(f"firmware  {firmware['path']}")
    echo(f"          {firmware['bytes']} B, CRC-32 {firmware['crc']}, sha256 {firmware['sha256']}")
    echo(f"command   {shlex.join(facts['command'])}")


def _written(
    call: list[str], board: Board, firmware: FirmwareImage, baud: int, *, json: bool
) -> dict[str, Any]:
    """Write the firmware; return the identity that the board then reports."""
    from armrig_protocol.messages import State

    from armrig.cli.spinner import spinner
    from armrig.lab import avrdude
    from armrig.lab.avrdude import greeting

    with spinner("flash:") as moved:
        avrdude.write(call, moved)
    if not json:
        echo("written; the board returned the same bytes")
    with spinner("waiting for the board"):
        device = greeting(board.port, baud)
    if device is None:
        raise OperationError(
            f"{board.port}: the firmware was written, but does not answer at {baud} baud; was it "
            "built for another speed (--baud), or is this another board?"
        )
    _check_firmware(device, firmware)
    volts = "it drives the motor" if device.state == State.RUN else "0 V"
    if not json:
        say(
            f"the board reports: firmware {device.firmware:08x}, protocol {device.version}, "
            f"uid {device.uid:x}, {State(device.state).name}, {volts}"
        )
    return {
        "firmware": f"{device.firmware:08x}",
        "version": device.version,
        "uid": f"{device.uid:x}",
        "state": State(device.state).name,
    }


def _check_firmware(device: HelloReply, firmware: FirmwareImage) -> None:

    if device.firmware != firmware.crc:
        raise OperationError(
            f"the board reports the firmware {device.firmware:08x}, but {firmware.crc:08x} was "
            "written; flash the board again"
        )
