"""The command that writes the firmware to a board: flash."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armrig.cli.options import Json, agree, echo, print_json, say

if TYPE_CHECKING:
    from armrig_core.firmware_image import FirmwareImage
    from armrig_protocol.messages import HelloReply

    from armrig.rig.flash.boards import Board

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
    typer.Option("--hex", metavar="FILE", help="Firmware to write.", show_default="armrig's own"),
]
Baud = Annotated[int, typer.Option("--baud", help="Speed of the firmware's line, [device] baud.")]
DryRun = Annotated[
    bool, typer.Option("--dry-run", help="Show what would be done; the port is not even opened.")
]
Yes = Annotated[bool, typer.Option("--yes", help="The motor is unplugged: do not ask.")]
MOTOR = (
    "While a board is written its pins are inputs: D9 and D7 float, and D13 blinks. What holds the "
    "motor at 0 V is the pull-downs of the wiring alone (docs/hardware.md). A program that is "
    "written in part may do anything, so unplug the motor."
)
_DEFAULT_BAUD = 500_000  # of the firmware that is shipped


def flash(
    port: Port = None,
    image: Image = None,
    baud: Baud = _DEFAULT_BAUD,
    dry_run: DryRun = False,
    yes: Yes = False,
    json: Json = False,
) -> None:
    """Write the firmware to an Uno, and ask it what it runs.

    By avrdude and the board's own boot loader; what was written is read back. It is refused while
    a daemon has the port.
    """
    from armrig_core.firmware_image import read_image, shipped_image

    from armrig.rig.flash import avrdude
    from armrig.rig.flash.boards import chosen, held, plugged_in

    firmware = read_image(shipped_image() if image is None else image)
    _check_size(firmware)
    program = avrdude.find()
    if program is None:
        raise avrdude.FlashError(avrdude.INSTALL)
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
        agree("Is the motor unplugged, and shall the board be written?", yes=yes)
        facts["device"] = _written(call, board, firmware, baud, json=json)
    if json:
        print_json(facts)
        return
    from armrig.cli.next_step import say_next

    say_next("flash", port=shlex.quote(board.port))


def _check_size(firmware: FirmwareImage) -> None:
    from armrig.rig.flash.avrdude import CHIP, FLASH_BYTES

    size = len(firmware.data)
    if size > FLASH_BYTES:
        msg = f"{firmware.path}: {size} B, and an {CHIP} has room for {FLASH_BYTES}"
        raise ValueError(msg)


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
    """Write the firmware; return what the board then says of itself."""
    from armrig_protocol.messages import State

    from armrig.cli.spinner import spinner
    from armrig.rig.flash import avrdude
    from armrig.rig.flash.greeting import greeting

    with spinner("flash:") as moved:
        avrdude.write(call, moved)
    if not json:
        echo("written and read back: the same")
    with spinner("waiting for the board"):
        device = greeting(board.port, baud)
    if device is None:
        msg = f"{board.port}: the firmware was written, and does not answer at {baud} baud; was it "
        msg += "built for another speed (--baud), or is another board there?"
        raise avrdude.FlashError(msg)
    _check_firmware(device, firmware)
    volts = "it drives the motor" if device.state == State.RUN else "0 V"
    if not json:
        say(
            f"the board says: firmware {device.firmware:08x}, protocol {device.version}, "
            f"uid {device.uid:x}, {State(device.state).name}, {volts}"
        )
    return {
        "firmware": f"{device.firmware:08x}",
        "version": device.version,
        "uid": f"{device.uid:x}",
        "state": State(device.state).name,
    }


def _check_firmware(device: HelloReply, firmware: FirmwareImage) -> None:
    from armrig.rig.flash.avrdude import FlashError

    if device.firmware != firmware.crc:
        msg = f"the board says that it runs the firmware {device.firmware:08x}, and not "
        msg += f"{firmware.crc:08x}, which was written; flash it again"
        raise FlashError(msg)
