"""Options of commands, alone and in groups that a command takes as one argument."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import Field, dataclass, field, fields
from functools import wraps
from math import isnan
from pathlib import Path
from shlex import quote
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_type_hints

import typer
from armrig_core.recording_file.part_names import part_paths

from armrig.cli.printing import inform
from armrig.data.files import OTHER_DATA, RECORDING

HELP = {"help_option_names": ["-h", "--help"]}
_OPTION = "option"  # key of a field's metadata


def option(names: str, text: str, shown: str | bool = True, **more: Any) -> Any:
    """Return an option of a command, such as `option("-o --plot FIGURE", "Figure to write.")`.

    `shown` is the text for the default in the help; `more` are arguments of `typer.Option`.
    """
    flags = [word for word in names.split() if word.startswith("-")]
    metavar = names.removeprefix(" ".join(flags)).strip() or None
    return typer.Option(*flags, metavar=metavar, help=text, show_default=shown, **more)


def chosen(default: Any, names: str, text: str, shown: str | bool = True, **more: Any) -> Any:
    """Return the value of a parameter or field that is an option with a default of its own.

    Such as `seconds: float = chosen(30.0, "--seconds", "Length, in s.")`.
    """
    return field(default=default, metadata={_OPTION: option(names, text, shown, **more)})


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
    known = {one.name: one for one in fields(kind)}
    options = []
    for name in names or known:
        taken, which = kinds[name], known[name].metadata.get(_OPTION)
        if which is None:
            taken, which = get_args(taken)
        if name in repeatable:
            taken, which = list[str] | None, noted(which, "; repeatable")
        options.append(parameter(name, taken, which, known[name].default))
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
            which, default = p.default.metadata[_OPTION], p.default.default
            taken.append(parameter(p.name, p.annotation, which, default))
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

    taking.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[p.replace(kind=p.KEYWORD_ONLY) for p in taken]
    )
    taking.__annotations__ = {p.name: p.annotation for p in taken}
    return taking


def _files(values: dict[str, Any]) -> list[Path]:
    each = (value if isinstance(value, list) else [value] for value in values.values())
    return [file for value in each for file in value if isinstance(file, Path)]


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
    na: int = chosen(4, "--na", "Number of a's (ARX).")
    nb: int = chosen(4, "--nb", "Number of b's.")
    nf: int = chosen(4, "--nf", "Number of f's (OE); an integrator counts as one.")
    nk: int = chosen(1, "--nk", "Delay from u to y, in samples.")


ModelOrders = Annotated[dict[str, Any], group(_ModelOrders, made=dict)]
"""Orders of the models of a study, by name."""


_NAMES = "@last or @NAME"


def recording_path(text: str) -> Path:
    """Return the path of a recording from its path or @name; print what the @name means.

    Raises
    ------
    NoSuchRecordingError
        No recording has the name, or several recordings have the name.
    """
    from armrig.recordings.recording_names import chosen, described, recording_folder

    if not text.startswith("@"):
        _check_bare_name(Path(text))
        return Path(text)
    found = chosen(text, recording_folder())
    about = described(found).removeprefix(f"{text}, ")  # an id is not repeated
    inform(f"{text} is {about}", dim=True)
    return found.path


def _check_bare_name(path: Path) -> None:
    """Refuse a word that is not a file: a name without @, or a file without its suffix."""
    if path.suffix or path.parent != Path() or path.exists():
        return
    from armrig.recordings.recording_names import NoSuchRecordingError

    beside = path.with_suffix(RECORDING)
    is_there = path.name and part_paths(beside)[0].exists()
    meant = str(beside) if is_there else f"@{path}"
    raise NoSuchRecordingError(f"{path}: there is no such file; did you mean {meant}?")


OtherFile = Annotated[
    Path | None, argument("F2", "Recording for validation.", False, parser=recording_path)
]
File = Annotated[Path, argument("F", f"Recording (*.mcap), {_NAMES}.", parser=recording_path)]
DataFile = Annotated[
    Path, argument("F", f"Recording (*.mcap, {_NAMES}), or {OTHER_DATA}.", parser=recording_path)
]
Assumption = Literal["integrating", "settling"]
READING = ("time", "Ts", "topic", "decimal", "resample", "hold_input", "mask_rails", "unwrap")
"""Options of reading a table, which are arguments of `load_data`."""
PART = ("calibration", "start", "stop")
"""Options of reading a recording."""
_FLAGS = {"start": "--from", "stop": "--to"}
_DIGITS = 12  # of a number in a command line


@dataclass(frozen=True, slots=True, kw_only=True)
class DataOptions:
    """Options that choose and treat the data of a command."""

    input: str | None = chosen(
        None,
        "--input NAME",
        "Column of the input in other data: its name, or its number from 1.",
        "u",
    )
    signal: str | None = chosen(
        None,
        "--signal NAME",
        "Output: theta_1, alpha or velocity; in other data, the column's name, or its number "
        "from 1.",
        "theta_1; y of other data",
    )
    time: str | None = chosen(
        None, "--time NAME", "Column of the times in other data.", "t or time, if there is one"
    )
    Ts: float | None = chosen(None, "--Ts", "Sampling time of other data, in s.", "by the times")
    topic: str | None = chosen(
        None,
        "--topic NAME",
        "Topic of an MCAP file of another program; its messages' fields are the columns.",
    )
    decimal: Literal[",", "."] | None = chosen(
        None,
        "--decimal",
        "Decimal mark of other data: comma or point.",
        "by all numbers of the file",
    )
    resample: bool = chosen(False, "--resample", "Interpolate other data at uneven times.")
    hold_input: bool = chosen(False, "--hold-input", "Hold the input where its cell is empty.")
    mask_rails: bool = chosen(
        False, "--mask-rails", "Mark samples at a rail of the converter as missing."
    )
    unwrap: float | None = chosen(
        None,
        "--unwrap RANGE",
        "Remove the jumps of a counter or angle that wraps, such as 65536 or 360.",
    )
    detrend: Detrend = False
    hampel: bool = chosen(False, "--hampel", "Mark single outliers of the output as missing.")
    assume: Assumption | None = chosen(
        None,
        "--assume",
        "Take the output as the integral of its rate, or as an output that settles.",
        "a test of the data decides",
    )
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
"""Names of all options of `DataOptions`."""
