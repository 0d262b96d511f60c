"""What the commands share: the options that several take, and how they print."""

from __future__ import annotations

import os
import sys
import textwrap
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer
from armrig_core.errors import OperationError
from armrig_core.journal import log_prefix
from armrig_core.printable import brief, json_printable, printable

RigId = Annotated[str, typer.Option("--rig", help="Id of the rig.")]
Connect = Annotated[
    str | None, typer.Option("--connect", metavar="ENDPOINT", help="zenoh endpoint of the daemon.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Verbose = Annotated[bool, typer.Option("-v", "--verbose", help="Say all that there is to say.")]
CalibrationFile = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        metavar="TOML",
        help="Read the recordings with this calibration instead of the one attached.",
    ),
]
From = Annotated[
    float | None,
    typer.Option(
        "--from",
        metavar="S",
        help="Take samples from this time on, in s, of each file.",
        show_default="its start",
    ),
]
To = Annotated[
    float | None,
    typer.Option(
        "--to", metavar="S", help="Take samples before this time.", show_default="its end"
    ),
]
Signal = Annotated[
    str | None,
    typer.Option(
        "--signal",
        metavar="NAME",
        help="The output: theta_1, alpha or velocity; of other data a column's name or number.",
        show_default="theta_1; y of other data",
    ),
]
Input = Annotated[
    str | None,
    typer.Option(
        "--input",
        metavar="NAME",
        help="The input's column in other data: name or number, from 1.",
        show_default="u",
    ),
]
TimeColumn = Annotated[
    str | None,
    typer.Option(
        "--time",
        metavar="NAME",
        help="The column of times in other data.",
        show_default="t or time, if there is one",
    ),
]
DataTs = Annotated[
    float | None,
    typer.Option("--Ts", help="Sampling time in s of other data.", show_default="by the times"),
]

Detrend = Annotated[
    bool, typer.Option("--detrend", help="Take the means off first, off each file its own.")
]
Hampel = Annotated[
    bool, typer.Option("--hampel", help="Mark single wrong samples of the output missing first.")
]


def _refuse_output(given: str | None) -> None:
    if given is not None:
        raise typer.BadParameter(
            f"the signal is chosen by --signal {given}; a figure's file is -o, a model's --save"
        )


NoOutput = Annotated[str | None, typer.Option("--output", hidden=True, callback=_refuse_output)]
"""What chose the signal in 0.1."""
Na = Annotated[int, typer.Option("--na", help="Number of a's (ARX).")]
Nb = Annotated[int, typer.Option("--nb", help="Number of b's.")]
Nf = Annotated[int, typer.Option("--nf", help="Number of f's (OE), the integrator's included.")]
Nk = Annotated[int, typer.Option("--nk", help="Samples before u reaches y.")]

_ANSWER = 16  # characters for a default and an answer behind a question
_NO_BREAK_SPACE = "\u00a0"

SAME_DATA = (
    "the models are judged on the very data that they were estimated from, which flatters them: "
    "validate on data that they have not seen"
)


def tell(message: str) -> None:
    """Print a line for the person, beside what was asked for."""
    with suppress(OSError):  # the terminal may be closed
        line = _for_terminal(f"armrig: {brief(' '.join(message.split()))}")
        print(folded(line, _columns(sys.stderr)), file=sys.stderr)


def tell_error(message: str) -> None:
    """Print a line as `tell` does; the journal of systemd gets it with the priority of an error."""
    with suppress(OSError):
        print(log_prefix("error") or "", end="", file=sys.stderr)
    tell(message)


def say(text: str) -> None:
    """Print what was asked for; on a terminal its long lines are broken between words."""
    echo(folded(text, _columns(sys.stdout)))


def echo(text: str) -> None:
    """Print what was asked for; a character that does not print is escaped.

    All output goes this way, or through the two that are named `print`: a name or a reason may come
    from another user, or from a file of unknown origin.
    """
    typer.echo(_for_terminal(text, keep="\n"))


def _for_terminal(text: str, keep: str = "") -> str:
    """Return the text for a terminal; a number's blank before its unit becomes an ordinary one."""
    return printable(text.replace(_NO_BREAK_SPACE, " "), keep)


def question(text: str) -> str:
    """Return what a person is asked, in lines that leave room for the answer."""
    columns = _columns(sys.stderr)
    return folded(text, columns - _ANSWER, indent=0) if columns > 2 * _ANSWER else text


def agree(text: str, *, yes: bool) -> None:
    """Ask a person, unless `yes`; return where it is agreed to.

    Raises
    ------
    RuntimeError
        It is not, or nobody is there to ask.
    """
    if yes:
        return
    if not sys.stdin.isatty():
        raise OperationError(
            "nobody is there to agree to this: --yes does it, --dry-run only shows it"
        )
    if not typer.confirm(question(text), err=True):
        raise OperationError("nothing was done")


def folded(text: str, columns: int, indent: int | None = None) -> str:
    """Return the text with no line longer than `columns` where there are blanks to break it at.

    Parameters
    ----------
    columns : int
        Width of the terminal; 0 leaves the text as it is.
    indent : int, optional
        Of what is folded of a line; two more than the line's own by default.
    """
    if not columns:
        return text
    lines = []
    for line in text.splitlines():
        own = len(line) - len(line.lstrip())
        rest = min(own + 2 if indent is None else indent, columns // 2)
        lines += textwrap.wrap(
            line,
            columns,
            subsequent_indent=" " * rest,
            break_long_words=False,
            break_on_hyphens=False,
        ) or [""]
    return "\n".join(lines)


def _columns(stream: TextIO) -> int:
    """Return the width of the terminal; 0 where the stream is not a terminal."""
    try:
        return os.get_terminal_size(stream.fileno()).columns if stream.isatty() else 0
    except (OSError, ValueError):
        return 0


def print_json(value: Any) -> None:
    """Print a value as a line of JSON."""
    import msgspec

    try:
        text = msgspec.json.encode(value)
    except UnicodeEncodeError:  # the name of a file, whose bytes need be no text
        text = msgspec.json.encode(_as_text(msgspec.to_builtins(value)))
    typer.echo(json_printable(text.decode()))


def _as_text(value: Any) -> Any:
    """Return a value in which bytes that are no text are escaped."""
    match value:
        case str():
            return value.encode("utf-8", "backslashreplace").decode()
        case dict():
            return {_as_text(key): _as_text(item) for key, item in value.items()}
        case list():
            return [_as_text(item) for item in value]
    return value


def print_table(*rows: tuple[str, str]) -> None:
    """Print the values one below the other, their names before them."""
    width = max(len(name) for name, _ in rows)
    columns = _columns(sys.stdout)
    for name, value in rows:
        line = _for_terminal(f"{name:{width}}  {value}")
        typer.echo(folded(line, columns, indent=width + 2))


def warned(recording: Any) -> Any:
    """Return the recording, and tell its damage."""
    if recording.truncated:
        unfinished = recording.path.suffix == ".active"
        why = "is still being recorded, or the daemon was killed; " if unfinished else ""
        tell(f"{recording.path}: {why}{recording.damage}")
    return recording
