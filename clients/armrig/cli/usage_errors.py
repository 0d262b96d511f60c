"""Messages for wrong command lines, with the value, the allowed values and a remedy."""

from __future__ import annotations

import re
from collections.abc import Sequence
from difflib import SequenceMatcher, get_close_matches
from pathlib import Path, PurePath
from typing import Any

from armrig_core.recording_file.part_names import PART, part_number

from armrig.data.files import DATA, RECORDING
from armrig.models.structure_table import OFFERED_NAMES

_ELSEWHERE: dict[str, str] = {
    "help": "`armrig --help` lists the commands, `armrig COMMAND --help` explains one",
    "version": "`armrig --version` shows it",
    **{name: f"`armrig identify F --structure {name}` estimates one" for name in OFFERED_NAMES},
}
"""Remedies for words that users try as commands, by the word."""
_TO_WRITE = frozenset(
    f"--{name}" for name in ("out", "output", "outfile", "figure", "fig", "image", "png", "save")
)
"""Options that name an output file in other programs."""
_PREFIXES = {"m": 1e-3, "u": 1e-6, "µ": 1e-6, "k": 1e3}
_MIN_SIMILARITY = 0.6
"""Smallest similarity, 0 to 1, between a wrong name and an option that the message suggests."""
_FILES = (RECORDING, ".active", *DATA, ".json", ".pdf")


def usage_error(err: Any, arguments: Sequence[str]) -> str:
    """Return a message with the error in the arguments and the command that shows the help."""
    where = err.ctx.command_path if err.ctx else " ".join(["armrig", *arguments[:1]])
    kind = type(err).__name__
    if kind == "MissingParameter" and err.param is not None:
        problem = _missing(err.param) + _example(err.ctx)
    elif kind == "NoSuchOption":
        problem = _no_option(err, arguments)
    elif kind == "BadOptionUsage":
        problem = _plainly(err.format_message())
        problem = re.sub(
            r"^Option '(.+?)' requires an argument$", r"\1 is given without a value", problem
        )
    elif extra := re.match(
        r"Got unexpected extra arguments?(?:\(s\))? \((.+)\)$", err.format_message()
    ):
        problem = _too_many(extra[1], err.ctx)
    elif name := re.match(r"No such command '(.+?)'", err.format_message()):
        problem = _no_command(name[1], err.format_message())
    else:
        problem = _plainly(
            err.format_message(), value=_value(getattr(err, "param", None), arguments)
        )
    return f"{problem}; see `{where} --help`"


def _missing(parameter: Any) -> str:
    name = parameter.metavar
    if parameter.param_type_name == "option":
        name = " ".join(filter(None, (max(parameter.opts, key=len), name)))
    help_text = (parameter.help or "").rstrip(".")
    return f"{name} is missing" + (f": {help_text[:1].lower()}{help_text[1:]}" if help_text else "")


def _example(ctx: Any) -> str:
    """Return the example at the end of a command's help."""
    line = (getattr(ctx.command, "epilog", None) or "") if ctx else ""
    example = line.removeprefix("Example: ")
    return f", as in `{example}`" if example != line else ""


def _too_many(extra: str, ctx: Any) -> str:
    arguments = [p for p in ctx.command.params if p.param_type_name == "argument"]
    if part_number(Path(extra)):
        run = f"{extra.partition(PART)[0]}{RECORDING}"
        return f"{extra}: the command takes one file; the name {run} means all parts of the run"
    takes = " ".join(p.metavar if p.required else f"[{p.metavar}]" for p in arguments)
    return f"{extra}: superfluous; `{ctx.command_path}` takes {takes or 'no file'}" + (
        f" and options of one value each, `{ctx.command_path} {takes} --OPTION VALUE`"
        if takes
        else ", options only"
    )


def _no_option(err: Any, arguments: Sequence[str]) -> str:
    name = err.option_name
    word = next((text for text in arguments if text.startswith(name)), name)
    if not name.startswith("--") and len(word) > 2:
        return f"no such option: {word}; a name of several letters has two dashes, -{word}"
    if err.ctx is not None and err.ctx.parent is None:
        return f"no such option: {name}; options follow the command, armrig COMMAND {name}"
    near = _near(name, err)
    return f"no such option: {name}" + (f": did you mean {' or '.join(near)}?" if near else "")


def _near(name: str, err: Any) -> list[str]:
    if name in _TO_WRITE:
        written = [p for p in err.ctx.command.params if "-o" in p.opts]
        return [f"-o {p.metavar or 'FILE'}" for p in written]
    letters = name.lstrip("-")
    return [
        name
        for name in err.possibilities or ()
        if SequenceMatcher(None, letters, name.lstrip("-")).ratio() > _MIN_SIMILARITY
    ]


def _no_command(name: str, message: str) -> str:
    if name in _ELSEWHERE:
        return f"no such command '{name}'; {_ELSEWHERE[name]}"
    if PurePath(name).suffix in _FILES or name.startswith("@"):
        return f"no such command '{name}'; the command precedes the file, armrig info {name}"
    near = re.findall(r"'([^']+)'", message.partition("Did you mean")[2])
    return f"no such command '{name}'" + (f": did you mean {' or '.join(near)}?" if near else "")


def _value(parameter: Any, arguments: Sequence[str]) -> str:
    """Return the value that was given to an option; "" if it is not known."""
    options = getattr(parameter, "opts", ())
    for i, text in enumerate(arguments):
        name, _, value = text.partition("=")
        if name in options:
            return value or (arguments[i + 1] if i + 1 < len(arguments) else "")
    return ""


def _plainly(message: str, value: str = "") -> str:
    """Return a message of typer in armrig's words, with the option and the allowed values."""
    message = message.strip().rstrip(".")
    for theirs, ours in (
        (r"^Invalid value for '?([^']+?)'?: ", r"\1: "),
        (r"^Invalid value: ", ""),
        (r"^(--\S+): (?=\1 )", ""),
        (r"Value error, ", ""),
        (r"Input should be ", "must be "),
        (r"must be a valid (integer|number),? .*$", r"must be a \1"),
        (r"must be a integer", "must be an integer"),
    ):
        message = re.sub(theirs, ours, message)
    if choice := re.match(r"\S+: '(.+?)' is not one of (.+)$", message):
        near = get_close_matches(choice[1], re.findall(r"'([^']+)'", choice[2]), n=1)
        message += f": did you mean {near[0]}?" if near else ""
    if value and (parts := re.match(r"(\S+): (must be .*)$", message)):
        message = f"{parts[1]} {value}: {parts[2]}"
        if "number" in parts[2] and re.fullmatch(r"-?\d*,\d+", value):
            message += f", decimals have a point: {value.replace(',', '.')}"
        elif "number" in parts[2] and (unit := re.fullmatch(r"(-?[\d.]+) ?([a-zA-Zµ]+)", value)):
            message += f" without its unit, such as {_in_whole_units(unit[1], unit[2])}"
        elif "integer" in parts[2] and re.search(r"[,:]", value):
            message += "; --search tries several"
    return message


def _in_whole_units(number: str, unit: str) -> str:
    """Return a number, converted to the unit without a prefix, such as 0.5 for 500 mV."""
    factor = _PREFIXES.get(unit[0], 1.0) if len(unit) > 1 else 1.0
    try:
        return f"{float(number) * factor:g}" if factor != 1 else number
    except ValueError:
        return number
