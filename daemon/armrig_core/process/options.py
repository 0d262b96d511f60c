"""Options of a program's commands, alone and in groups that a command takes as one argument."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import Field, field, fields
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

import typer

HELP = {"help_option_names": ["-h", "--help"]}
_OPTION = "option"  # key of a field's metadata


def option(
    names: str, text: str, show: str | bool = True, metavar: str | None = None, **more: Any
) -> Any:
    """Return an option of a command, such as `option("-o --plot FIGURE", "Figure to write.")`.

    `show` is the text for the default in the help; it is needed if the default is None, or a flag
    is set. `more` are arguments of `typer.Option`.
    """
    flags = [word for word in names.split() if word.startswith("-")]
    metavar = metavar or names.removeprefix(" ".join(flags)).strip() or None
    return typer.Option(*flags, metavar=metavar, help=text, show_default=show, **more)


def preset(default: Any, text: str, show: str | bool = True, names: str = "", **more: Any) -> Any:
    """Return the value of a parameter or field that is an option with a default of its own.

    Such as `seconds: float = preset(30.0, "Length, in s.")`, the option `--seconds`. If the option
    has other `names`, they are those of `option`.
    """
    return field(default=default, metadata={_OPTION: (names, text, show, more)})


def _option_of(name: str, chosen: Field[Any]) -> Any:
    """Return the option of a parameter or field with the default `chosen`; None without one."""
    if _OPTION not in chosen.metadata:
        return None
    names, text, show, more = chosen.metadata[_OPTION]
    return option(names or f"--{name.replace('_', '-')}", text, show, **more)


def argument(metavar: str, text: str, show: str | bool = True, **more: Any) -> Any:
    """Return an argument of a command, from its metavar and its help."""
    return typer.Argument(metavar=metavar, help=text, show_default=show, **more)


def extend(which: Any, note: str) -> Any:
    """Return an option with a note at the end of its help."""
    which = copy(which)
    which.help = f"{which.help.removesuffix('.')}{note}."
    return which


class Group(NamedTuple):
    """Options that a command takes as one argument."""

    options: Sequence[inspect.Parameter]
    made: Callable[..., Any] = dict
    """Function that makes the argument of the options."""
    check: Callable[[Any, Sequence[Path]], None] | None = None
    """Function that gets this argument and the files in the other options before the command."""


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
    check: Callable[[Any, Sequence[Path]], None] | None = None,
) -> Group:
    """Return the fields of the dataclass `kind` as a group of options.

    The annotation of a field contains its option. `names` are the fields of the group in the order
    of the help, by default all fields. `made` makes the argument of the options, by default `kind`
    does. The options of the fields `repeatable` may be repeated; each is then a list.
    """
    kinds = get_type_hints(kind, include_extras=True)
    field_by_name = {option_field.name: option_field for option_field in fields(kind)}
    options = []
    for name in names or field_by_name:
        taken, which = kinds[name], _option_of(name, field_by_name[name])
        if which is None:
            taken, which = get_args(taken)
        if name in repeatable:
            taken, which = list[str] | None, extend(which, "; repeatable")
        options.append(parameter(name, taken, which, field_by_name[name].default))
    return Group(options, made or kind, check)


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with its options in the form of typer, and without groups.

    The annotation of a group is `Annotated[TYPE, Group]`.
    """
    signature = inspect.signature(command, eval_str=True)
    groups: dict[str, Group] = {}
    taken: list[inspect.Parameter] = []
    for p in signature.parameters.values():
        notes = getattr(p.annotation, "__metadata__", ())
        if notes and isinstance(notes[0], Group):
            groups[p.name] = notes[0]
            taken += notes[0].options
        elif isinstance(p.default, Field):
            which = _option_of(p.name, p.default)
            taken.append(parameter(p.name, p.annotation, which, p.default.default))
        else:
            taken.append(p)

    @wraps(command)
    def taking(**values: Any) -> None:
        made = {}
        for name, of in groups.items():
            made[name] = of.made(**{p.name: values.pop(p.name) for p in of.options})
            if of.check is not None:
                of.check(made[name], _files(values))
        command(**made, **values)

    taken = [_with_default(p).replace(kind=p.KEYWORD_ONLY) for p in taken]
    taking.__signature__ = signature.replace(parameters=taken)  # type: ignore[attr-defined]
    taking.__annotations__ = {p.name: p.annotation for p in taken}
    return taking


def _with_default(p: inspect.Parameter) -> inspect.Parameter:
    """Return an option or argument whose help ends with its default, if there is one.

    The default is a text of `option`, or a value that the user could type. A list has the metavar
    of one value, because the option is repeated.
    """
    kind, which = get_args(p.annotation)
    which, default_text = copy(which), which.show_default
    if values := [get_args(hint) for hint in (kind, *get_args(kind)) if get_origin(hint) is list]:
        which.metavar = which.metavar or f"<{values[0][0].__name__}>"
    if default_text is True and p.default not in (p.empty, None, False):
        default_text = f"{p.default:g}" if isinstance(p.default, float) else str(p.default)
    if isinstance(default_text, str):
        which.help = f"{which.help} Default: {default_text}"
        which.show_default = False
    return p.replace(annotation=Annotated[kind, which])


def _files(values: dict[str, Any]) -> list[Path]:
    each = (value if isinstance(value, list) else [value] for value in values.values())
    return [file for value in each for file in value if isinstance(file, Path)]


class CommandGroup(typer.Typer):
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
