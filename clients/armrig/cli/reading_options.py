"""Options of the commands that read tables, and decorators that give options to a command."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import wraps
from shlex import quote
from typing import Annotated, Any, Literal, get_type_hints

import typer


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingOptions:
    """Options of reading a table; the fields are arguments of `load_data`."""

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

    def given(self) -> dict[str, str | float]:
        """Return the values of the options that differ from their defaults; "" for a switch."""
        values = {f"--{f.name.replace('_', '-')}": getattr(self, f.name) for f in fields(self)}
        given = {name: value for name, value in values.items() if value not in (None, False)}
        return {name: "" if value is True else value for name, value in given.items()}

    def typed(self) -> str:
        """Return the options as a user types them, for the next command; "" for the defaults."""
        given = self.given().items()
        return "".join(f" {name} {value and quote(str(value))}".rstrip() for name, value in given)


AS_IT_STANDS = ReadingOptions()
"""The defaults."""


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


_KINDS = get_type_hints(ReadingOptions, include_extras=True)
reads_tables = grouped(
    "reading",
    [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=field.default,
            annotation=_KINDS[field.name],
        )
        for field in fields(ReadingOptions)
    ],
    ReadingOptions,
)
"""Decorator that replaces the argument `reading` of a command by the options."""
