"""Options of commands, alone and in groups that a command takes as one argument."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, fields
from functools import wraps
from math import isnan
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args, get_type_hints

import typer


def option(names: str, text: str, shown: str | bool = True, **more: Any) -> Any:
    """Return an option of a command, such as `option("-o --plot FIGURE", "Figure to write.")`.

    `shown` is the text for the default in the help; `more` are arguments of `typer.Option`.
    """
    flags = [word for word in names.split() if word.startswith("-")]
    metavar = names.removeprefix(" ".join(flags)).strip() or None
    return typer.Option(*flags, metavar=metavar, help=text, show_default=shown, **more)


def argument(metavar: str, text: str, shown: str | bool = True, **more: Any) -> Any:
    """Return an argument of a command, from its metavar and its help."""
    return typer.Argument(metavar=metavar, help=text, show_default=shown, **more)


def noted(which: Any, note: str) -> Any:
    """Return an option with a note at the end of its help."""
    which = copy(which)
    which.help = f"{which.help.removesuffix('.')}{note}."
    return which


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
    """Return the fields of the dataclass `kind` as a group of options.

    The annotation of a field contains its option. `names` are the fields of the group in the order
    of the help, by default all fields. `made` makes the argument of the options, by default `kind`
    does. The options of the fields `repeatable` may be repeated; each is then a list.
    """
    kinds = get_type_hints(kind, include_extras=True)
    defaults = {field.name: field.default for field in fields(kind)}
    options = []
    for name in names or defaults:
        taken, which = get_args(kinds[name])
        if name in repeatable:
            taken, which = list[str] | None, noted(which, "; repeatable")
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
