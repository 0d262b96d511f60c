"""Options that choose the data of a command, and decorators that give options to a command."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, fields
from functools import wraps
from shlex import quote
from typing import Annotated, Any, Literal, get_args, get_type_hints

import typer

from armrig.cli.options import CalibrationFile, Detrend, From, To

Assumption = Literal["integrating", "settling"]
READING = ("time", "Ts", "topic", "decimal", "resample", "hold_input", "mask_rails", "unwrap")
"""Options of reading a table, which are arguments of `load_data`."""
PART = ("calibration", "start", "stop")
"""Options of reading a recording."""
_FLAGS = {"start": "--from", "stop": "--to"}
_DIGITS = 12  # of a number in a command line
_SEVERAL = ("input", "signal")
"""Options that a command line may repeat."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DataOptions:
    """Options that choose and treat the data of a command."""

    input: Annotated[
        str | None,
        typer.Option(
            "--input",
            metavar="NAME",
            help="Column of the input in other data: its name, or its number from 1.",
            show_default="u",
        ),
    ] = None
    signal: Annotated[
        str | None,
        typer.Option(
            "--signal",
            metavar="NAME",
            help="Output: theta_1, alpha or velocity; in other data, the column's name, or its "
            "number from 1.",
            show_default="theta_1; y of other data",
        ),
    ] = None
    time: Annotated[
        str | None,
        typer.Option(
            "--time",
            metavar="NAME",
            help="Column of the times in other data.",
            show_default="t or time, if there is one",
        ),
    ] = None
    Ts: Annotated[
        float | None,
        typer.Option(
            "--Ts", help="Sampling time of other data, in s.", show_default="by the times"
        ),
    ] = None
    topic: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Topic of an MCAP file of another program; its messages' fields are the columns.",
        ),
    ] = None
    decimal: Annotated[
        Literal[",", "."] | None,
        typer.Option(
            help="Decimal mark of other data: comma or point.",
            show_default="by all numbers of the file",
        ),
    ] = None
    resample: Annotated[
        bool, typer.Option("--resample", help="Interpolate other data at uneven times.")
    ] = False
    hold_input: Annotated[
        bool, typer.Option("--hold-input", help="Hold the input where its cell is empty.")
    ] = False
    mask_rails: Annotated[
        bool,
        typer.Option("--mask-rails", help="Mark samples at a rail of the converter as missing."),
    ] = False
    unwrap: Annotated[
        float | None,
        typer.Option(
            metavar="RANGE",
            help="Remove the jumps of a counter or angle that wraps, such as 65536 or 360.",
        ),
    ] = None
    detrend: Detrend = False
    hampel: Annotated[
        bool, typer.Option("--hampel", help="Mark single outliers of the output as missing.")
    ] = False
    assume: Annotated[
        Assumption | None,
        typer.Option(
            "--assume",
            help="Take the output as the integral of its rate, or as an output that settles.",
            show_default="a test of the data decides",
        ),
    ] = None
    calibration: CalibrationFile = None
    start: From = None
    stop: To = None

    def given(self, *names: str) -> list[str]:
        """Return the options that differ from their defaults, as a user types them."""
        typed = []
        for name in names or OPTIONS:
            value = getattr(self, name)
            if value is None or value is False:  # not 0.0
                continue
            text = f"{value:.{_DIGITS}g}" if isinstance(value, float) else quote(str(value))
            flag = _FLAGS.get(name, f"--{name.replace('_', '-')}")
            typed.append(flag if value is True else f"{flag} {text}")
        return typed


OPTIONS = tuple(field.name for field in fields(DataOptions))
"""Names of all options."""


def grouped(
    name: str, options: Sequence[inspect.Parameter], made: Callable[..., Any] = dict
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that replaces the argument `name` of a command by options.

    The command gets the value that `made` makes of the options, in place of the argument.
    """

    def decorated(command: Callable[..., None]) -> Callable[..., None]:
        @wraps(command)
        def taking(**values: Any) -> None:
            group = made(**{p.name: values.pop(p.name) for p in options})
            command(**{name: group}, **values)

        signature = inspect.signature(command, eval_str=True)
        taken = [
            p
            for one in signature.parameters.values()
            for p in (options if one.name == name else [one])
        ]
        taking.__signature__ = signature.replace(  # type: ignore[attr-defined]
            parameters=[p.replace(kind=p.KEYWORD_ONLY) for p in taken]
        )
        taking.__annotations__ = {p.name: p.annotation for p in taken}
        return taking

    return decorated


def data_options(names: Sequence[str], *, several: bool) -> list[inspect.Parameter]:
    """Return options of `DataOptions` as parameters of a command.

    Parameters
    ----------
    names : sequence of str
        Names of the options.
    several : bool
        Whether the command takes several inputs and outputs.
    """
    kinds = get_type_hints(DataOptions, include_extras=True)
    for name in _SEVERAL if several else ():
        _, option = get_args(kinds[name])
        option = copy(option)
        option.help = f"{option.help.removesuffix('.')}; repeatable."
        kinds[name] = Annotated[list[str] | None, option]
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=field.default,
            annotation=kinds[field.name],
        )
        for field in fields(DataOptions)
        if field.name in names
    ]
