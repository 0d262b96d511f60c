"""What the commands share: the options that several take, and how they print."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

RigId = Annotated[str, typer.Option("--rig", help="Id of the rig.")]
Connect = Annotated[
    str | None, typer.Option("--connect", metavar="ENDPOINT", help="zenoh endpoint of the daemon.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
CalibrationFile = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        metavar="TOML",
        help="Read the recordings with this calibration instead of the one attached.",
    ),
]
File = Annotated[Path, typer.Argument(metavar="F", help="Recording (*.mcap).")]
Na = Annotated[int, typer.Option("--na", help="Number of a's (ARX).")]
Nb = Annotated[int, typer.Option("--nb", help="Number of b's.")]
Nf = Annotated[int, typer.Option("--nf", help="Number of f's (OE), the integrator's included.")]
Nk = Annotated[int, typer.Option("--nk", help="Samples before u reaches y.")]

SAME_DATA = (
    "the models are judged on the very data that they were estimated from, which flatters them: "
    "validate on another recording"
)


def tell(message: str) -> None:
    """Print a line for the person, beside what was asked for."""
    with suppress(OSError):  # the terminal may be closed
        print(f"armrig: {' '.join(message.split())}", file=sys.stderr)


def print_json(value: Any) -> None:
    """Print a value as a line of JSON."""
    import msgspec

    typer.echo(msgspec.json.encode(value))


def print_table(*rows: tuple[str, str]) -> None:
    """Print the values one below the other, their names before them."""
    width = max(len(name) for name, _ in rows)
    for name, value in rows:
        typer.echo(f"{name:{width}}  {value}")


def warned(recording: Any) -> Any:
    """Return the recording; its damage is told."""
    if recording.truncated:
        tell(f"{recording.path}: {recording.damage}")
    return recording
