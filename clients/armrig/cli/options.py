"""Options of commands, alone and in groups, and functions that print."""

from __future__ import annotations

import inspect
import os
import sys
import textwrap
from collections.abc import Callable, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, fields
from functools import wraps
from math import isnan
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TextIO, get_args, get_type_hints

import typer
from armrig_core.errors import OperationError
from armrig_core.journal import log_prefix
from armrig_core.printable import brief, json_printable, printable


def option(names: str, text: str, shown: str | bool = True, **more: Any) -> Any:
    """Return an option of a command.

    Parameters
    ----------
    names : str
        Flags and metavar, such as `-o --plot FIGURE`.
    text : str
        Help of the option.
    shown : str, optional
        Text for the default in the help.
    **more
        Other arguments of `typer.Option`.
    """
    flags = [word for word in names.split() if word.startswith("-")]
    metavar = names.removeprefix(" ".join(flags)).strip() or None
    return typer.Option(*flags, metavar=metavar, help=text, show_default=shown, **more)


def argument(metavar: str, text: str, shown: str | bool = True, **more: Any) -> Any:
    """Return an argument of a command, from its metavar and its help."""
    return typer.Argument(metavar=metavar, help=text, show_default=shown, **more)


class Group(NamedTuple):
    """Options that a command takes as one argument."""

    options: Sequence[inspect.Parameter]
    made: Callable[..., Any] = dict
    """Function that makes the argument of the options."""


def parameter(name: str, kind: Any, which: Any, default: Any = None) -> inspect.Parameter:
    """Return an option of a group: its name, type, `option` and default."""
    keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, keyword, default=default, annotation=Annotated[kind, which])


def group(
    kind: Any,
    names: Sequence[str] | None = None,
    made: Callable[..., Any] | None = None,
    *,
    repeatable: Sequence[str] = (),
) -> Group:
    """Return the fields of a dataclass as a group of options.

    Parameters
    ----------
    kind : type
        Dataclass; the annotation of a field contains its option.
    names : sequence of str, optional
        Fields of the group, in the order of the help; by default all fields.
    made : callable, optional
        Function that makes the argument of the options; by default `kind`.
    repeatable : sequence of str
        Fields whose options may be repeated; each is then a list.
    """
    kinds = get_type_hints(kind, include_extras=True)
    defaults = {field.name: field.default for field in fields(kind)}
    options = []
    for name in names or defaults:
        taken, which = get_args(kinds[name])
        if name in repeatable:
            taken, which = list[str] | None, copy(which)
            which.help = f"{which.help.removesuffix('.')}; repeatable."
        options.append(parameter(name, taken, which, defaults[name]))
    return Group(options, made or kind)


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with the options of its groups in place of the arguments.

    The annotation of such an argument is `Annotated[TYPE, Group]`.
    """
    signature = inspect.signature(command, eval_str=True)
    groups = {
        p.name: note
        for p in signature.parameters.values()
        for note in getattr(p.annotation, "__metadata__", ())
        if isinstance(note, Group)
    }
    if not groups:
        return command

    @wraps(command)
    def taking(**values: Any) -> None:
        made = {
            name: of.made(**{p.name: values.pop(p.name) for p in of.options})
            for name, of in groups.items()
        }
        command(**made, **values)

    taken = [
        p
        for one in signature.parameters.values()
        for p in (groups[one.name].options if one.name in groups else [one])
    ]
    taking.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[p.replace(kind=p.KEYWORD_ONLY) for p in taken]
    )
    taking.__annotations__ = {p.name: p.annotation for p in taken}
    return taking


class Commands(typer.Typer):
    """Commands of a group such as `armrig pki`."""

    def __init__(self, text: str, **settings: Any) -> None:
        super().__init__(help=text, rich_markup_mode=None, **settings)

    def add(
        self, example: str, name: str | None = None
    ) -> Callable[[Callable[..., None]], Callable[..., None]]:
        """Return a decorator that adds a command with an example at the end of its help."""
        line = f"Example: armrig {example}"
        adding = self.command(name, epilog=line, context_settings=HELP)
        return lambda command: adding(with_options(command))


RigId = Annotated[str, option("--rig", "Id of the rig.")]
Connect = Annotated[
    str | None,
    option(
        "--connect ENDPOINT",
        "zenoh endpoint of the daemon or a router, such as tls/HOST:7447.",
        "[client] connect, or the daemon on this machine",
    ),
]
SamplingTime = Annotated[float | None, option("--Ts", "Sampling time, in s.", "the daemon's")]
Json = Annotated[bool, option("--json", "Print JSON.")]
Verbose = Annotated[bool, option("-v --verbose", "Print all details.")]
CalibrationFile = Annotated[
    Path | None,
    option(
        "--calibration TOML",
        "Calibration to use in place of the calibration attached to a recording.",
    ),
]


def _not_nan(seconds: float | None) -> float | None:
    if seconds is not None and isnan(seconds):
        raise typer.BadParameter("nan is not a time; give a number of seconds")
    return seconds


From = Annotated[
    float | None,
    option(
        "--from S",
        "Start of the samples to use, in s from the first sample of the file.",
        "its start",
        callback=_not_nan,
    ),
]
To = Annotated[
    float | None,
    option(
        "--to S",
        "End of the samples to use, in s from the first sample of the file; a sample at this "
        "time is left out.",
        "its end",
        callback=_not_nan,
    ),
]
Detrend = Annotated[bool, option("--detrend", "Subtract the mean of each signal of each file.")]


@dataclass(frozen=True, kw_only=True)
class _ModelOrders:
    na: Annotated[int, option("--na", "Number of a's (ARX).")] = 4
    nb: Annotated[int, option("--nb", "Number of b's.")] = 4
    nf: Annotated[int, option("--nf", "Number of f's (OE); an integrator counts as one.")] = 4
    nk: Annotated[int, option("--nk", "Delay from u to y, in samples.")] = 1


ModelOrders = Annotated[dict[str, Any], group(_ModelOrders, made=dict)]
"""Orders of the models of a study, by name."""

HELP = {"help_option_names": ["-h", "--help"]}
_ANSWER_WIDTH = 16  # characters for the default and the answer after a question
_NO_BREAK_SPACE = "\u00a0"


def tell(message: str) -> None:
    """Print a warning or an error on standard error."""
    inform(f"armrig: {message}")


def inform(message: str, **style: bool) -> None:
    """Print news for the user on standard error, as a single line, in a style of `say`."""
    with suppress(OSError):  # the terminal may be closed
        line = folded(_for_terminal(brief(" ".join(message.split()))), _columns(sys.stderr))
        typer.echo(_styled(line, sys.stderr, style), err=True)


def tell_error(message: str) -> None:
    """Print a line for the user on standard error; systemd's journal shows the line as an error."""
    with suppress(OSError):
        print(log_prefix("error") or "", end="", file=sys.stderr)
    tell(message)


def say(text: str, **style: bool) -> None:
    """Print text on standard output; on a terminal, lines are folded between words.

    A terminal shows the text in a style, such as `bold=True` or `dim=True`.
    """
    text = _for_terminal(folded(text, _columns(sys.stdout)), keep="\n")
    typer.echo(_styled(text, sys.stdout, style))


def say_answer(text: str) -> None:
    """Print text as `say` does; the first line, which contains the verdict, is bold."""
    first, _, rest = text.partition("\n")
    say(first, bold=True)
    if rest:
        say(rest)


def say_more(contents: str) -> None:
    """Print what --verbose adds to the output."""
    say(f"--verbose: {contents}", dim=True)


def takes_styles() -> bool:
    """Return True if the user accepts bold and dim text (https://no-color.org)."""
    return not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def _styled(text: str, stream: TextIO, style: dict[str, bool]) -> str:
    """Return the text in a style if the stream is a terminal; otherwise return it unchanged."""
    return typer.style(text, **style) if style and stream.isatty() and takes_styles() else text


def echo(text: str) -> None:
    """Print text on standard output with unprintable characters escaped.

    The text may contain parts from other users or from files of unknown origin. All output
    therefore uses this function, `print_json` or `print_table`.
    """
    typer.echo(_for_terminal(text, keep="\n"))


def _for_terminal(text: str, keep: str = "") -> str:
    """Return the text for a terminal, with ordinary blanks between numbers and units."""
    return printable(text.replace(_NO_BREAK_SPACE, " "), keep)


def question(text: str) -> str:
    """Return a question, folded into lines; the last line leaves room for the answer."""
    columns = _columns(sys.stderr)
    return folded(text, columns - _ANSWER_WIDTH, indent=0) if columns > 2 * _ANSWER_WIDTH else text


def agree(text: str, *, yes: bool) -> None:
    """Ask the user for agreement, unless `yes` is True.

    Raises
    ------
    RuntimeError
        The user does not agree, or there is no terminal.
    """
    if yes:
        return
    if not sys.stdin.isatty():
        raise OperationError(
            "there is no terminal for the question: --yes agrees, --dry-run only shows the plan"
        )
    if not typer.confirm(question(text), err=True):
        raise OperationError("nothing was done")


def folded(text: str, columns: int, indent: int | None = None) -> str:
    """Return the text with lines of at most `columns` characters, broken at blanks.

    Parameters
    ----------
    columns : int
        Width of the terminal; 0 leaves the text as it is.
    indent : int, optional
        Indent of continuation lines; by default two more than the line's own indent.
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
    """Return the width of the terminal; 0 if the stream is not a terminal."""
    try:
        return os.get_terminal_size(stream.fileno()).columns if stream.isatty() else 0
    except (OSError, ValueError):
        return 0


def fields_of(value: Any, names: str) -> dict[str, Any]:
    """Return attributes of a value as JSON fields; blanks separate the names."""
    return {name: getattr(value, name) for name in names.split()}


def print_json(value: Any) -> None:
    """Print a value as a line of JSON."""
    import msgspec

    try:
        text = msgspec.json.encode(value)
    except UnicodeEncodeError:  # the name of a file need not be valid text
        text = msgspec.json.encode(_as_text(msgspec.to_builtins(value)))
    typer.echo(json_printable(text.decode()))


def _as_text(value: Any) -> Any:
    """Return the value with invalid text escaped."""
    match value:
        case str():
            return value.encode("utf-8", "backslashreplace").decode()
        case dict():
            return {_as_text(key): _as_text(item) for key, item in value.items()}
        case list():
            return [_as_text(item) for item in value]
    return value


def print_table(*rows: tuple[str, str], verdict: bool = False) -> None:
    """Print each value in a line of its own, after its name; a verdict in the first row is bold."""
    width = max(len(name) for name, _ in rows)
    columns = _columns(sys.stdout)
    for i, (name, value) in enumerate(rows):
        line = folded(_for_terminal(f"{name:{width}}  {value}"), columns, indent=width + 2)
        typer.echo(_styled(line, sys.stdout, {"bold": True} if verdict and not i else {}))


def warned(recording: Any) -> Any:
    """Return the recording, and print its damage."""
    if recording.truncated:
        unfinished = recording.path.suffix == ".active"
        why = "still being recorded, or the daemon was killed; " if unfinished else ""
        tell(f"{recording.path}: {why}{recording.damage}")
    return recording
