"""Every key of the configuration, from its schema: an example, and the tables of the page.

`python -m armrig_daemon.configuration_reference [--check]` writes the tables between the two marks
of `docs/configuration.md`; with `--check` the exit code says whether they are what it would write.
"""

from __future__ import annotations

import ast
import inspect
import json
import sys
import textwrap
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from armrig_core.calibration import Made
from armrig_core.recording_directory import SYSTEM
from msgspec.inspect import (
    BoolType,
    DictType,
    FloatType,
    IntType,
    UnionType,
    type_info,
)

from armrig_daemon.config import Config
from armrig_daemon.emulator.settings import CHOICES, RANGES

PAGE = Path(__file__).parents[2] / "docs" / "configuration.md"
BEGIN, END = "<!-- keys: begin -->", "<!-- keys: end -->"
_WIDTH = 88  # of a line of the example
_HEADING = f"""\
# Configuration of armrigd: every key, with its default.
#
# Each key stands behind a #: take it away to give another value. What is not given has its
# default. A wrong key or value is refused in a line, and the motor stays at 0 V.
#
# The daemon reads {SYSTEM}, then {SYSTEM.parent}/<id>.toml of its rig, and then
# $XDG_CONFIG_HOME/armrig/{SYSTEM.name} (~/.config/armrig/{SYSTEM.name}), or the file of
# `armrigd run --config` in place of all three. Over them stand the environment
# (ARMRIG_<TABLE>_<KEY>, such as ARMRIG_LIMITS_U_MAX_V=4.5) and the command line.
"""


class Key(NamedTuple):
    """One key of a table."""

    name: str
    """As in its table; dotted where the value is in a table of its own."""
    kind: str
    """Of its value, in words."""
    default: str
    """As TOML; empty where there is none."""
    allowed: str
    """Range or choices in words; empty where the description says it, or all are allowed."""
    description: str
    """With the unit."""
    example: str
    """A value as TOML: the default, where there is one."""


def tables() -> Iterator[tuple[str, str, list[Key]]]:
    """Yield name, meaning and keys of each table of the configuration."""
    default = Config()
    for name, meaning in _meanings():
        yield name, meaning, [*_keys(getattr(default, name), name)]


def example() -> str:
    """Return a configuration with all keys, each commented out beside its description."""
    lines = [_HEADING]
    for table, meaning, keys in tables():
        lines += [_comment(f"{meaning}."), f"[{table}]"]
        for key in keys:
            allowed = f" Allowed: {key.allowed}." if key.allowed else ""
            lines += [_comment(key.description + allowed), f"#{key.name} = {key.example}"]
        lines.append("")
    return "\n".join(lines)


def page_tables() -> str:
    """Return the tables of the page, as Markdown."""
    lines: list[str] = []
    for table, meaning, keys in tables():
        lines += [f"## `[{table}]`", "", f"{meaning}.", ""]
        lines += ["| key | type | default | allowed | what it is |", "|---|---|---|---|---|"]
        for key in keys:
            default = f"`{key.default}`" if key.default else ""
            row = (f"`{key.name}`", key.kind, default, key.allowed, key.description)
            lines.append("".join(f"| {cell} " if cell else "| " for cell in row) + "|")
        lines.append("")
    return "\n".join(lines)


def _meanings() -> Iterator[tuple[str, str]]:
    """Yield each table's name and what it is for: "`[name]`: what" in the text of its class."""
    said_here = _descriptions(Config)
    for field in msgspec.structs.fields(Config):
        text = said_here.get(field.name) or " ".join((field.type.__doc__ or "").split())
        text = text.removeprefix(f"`[{field.name}]`: ").rstrip(".")
        yield field.name, text[0].upper() + text[1:]


def _keys(table: msgspec.Struct, path: str) -> Iterator[Key]:
    """Yield the keys of a table of the defaults, those of the tables in it by dotted names."""
    descriptions = _descriptions(type(table))
    if path == "calibration":
        yield _CALIBRATION_FILE
    kind: Any = type_info(type(table))
    for field in kind.fields:
        value = getattr(table, field.name)
        if isinstance(value, msgspec.Struct):
            inner = _keys(value, f"{path}.{field.name}")
            yield from (key._replace(name=f"{field.name}.{key.name}") for key in inner)
        elif isinstance(field.type, DictType):
            yield from (key._replace(name=f"{field.name}.{key.name}") for key in _arm_keys())
        elif field.type not in _WRITTEN_BY_PROGRAMS:
            if path == "arm" and value is None:
                value = getattr(Config().arm.parameters(), field.name)
            shown = "" if value is None else _toml(value)
            yield Key(
                name=field.name,
                kind=_in_words(field.type),
                default=shown,
                allowed=_emulator_range(field.name) if path == "emulator" else _range(field.type),
                description=descriptions[field.name],
                example=shown or "0",
            )


_WRITTEN_BY_PROGRAMS = (type_info(Made | None),)
_CALIBRATION_FILE = Key(
    name="file",
    kind="text",
    default="",
    allowed="",
    description=(
        "File that `armrig calibrate` wrote, relative to the folder of the file that names it; "
        "with it no other key of this table is allowed."
    ),
    example='"calibration-1.toml"',
)


def _arm_keys() -> Iterator[Key]:
    """Yield the parameters of the emulated arm, which are those of the model of the rig."""
    from armrig_core.arm import ArmParameters

    descriptions = _descriptions(ArmParameters)
    for name, field in ArmParameters.__dataclass_fields__.items():
        value = _toml(field.default)
        allowed = "0 or more" if field.default == 0 else "above 0"
        yield Key(name, "number", value, allowed, descriptions[name], value)


def _descriptions(kind: type) -> dict[str, str]:
    """Return the text below each field of a class, as one line."""
    parsed: Any = ast.parse(textwrap.dedent(inspect.getsource(kind)))
    return {
        field.target.id: " ".join(text.value.value.split())
        for field, text in pairwise(parsed.body[0].body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }


def _in_words(kind: Any) -> str:
    if isinstance(kind, UnionType):
        return _in_words(kind.types[0])
    if isinstance(kind, BoolType):
        return "true or false"
    if isinstance(kind, IntType):
        return "whole number"
    return "number" if isinstance(kind, FloatType) else "text"


def _range(kind: Any) -> str:
    """Return the range that the type of a number has, in words."""
    if isinstance(kind, UnionType):
        return _range(kind.types[0])
    if not isinstance(kind, IntType | FloatType):
        return ""
    if kind.gt is not None and kind.le is not None:
        return f"above {_bound(kind.gt)}, at most {_bound(kind.le)}"
    if kind.ge is not None and kind.le is not None:
        return f"{_bound(kind.ge)} to {_bound(kind.le)}"
    return "" if kind.ge is None else f"{_bound(kind.ge)} or more"


def _emulator_range(name: str) -> str:
    """Return what the emulator allows a setting to be, in words."""
    if name in CHOICES:
        *most, last = map(str, CHOICES[name])
        return f"{', '.join(most)} or {last}"
    return " to ".join(map(_bound, RANGES[name])) if name in RANGES else ""


def _bound(value: float) -> str:
    return str(int(value)) if value == int(value) else str(value)


def _toml(value: Any) -> str:
    # JSON's strings, numbers and booleans are TOML's, too.
    return json.dumps(value, ensure_ascii=False)


def _comment(text: str) -> str:
    return textwrap.fill(
        text, _WIDTH, initial_indent="# ", subsequent_indent="# ", break_on_hyphens=False
    )


def main(arguments: list[str]) -> int:
    """Write the page's tables, or with `--check` say whether they are what the schema says."""
    if arguments not in ([], ["--check"]):
        print(f"{' '.join(arguments)}: only --check is allowed", file=sys.stderr)
        return 2
    if not PAGE.exists():
        print(f"{PAGE}: no such page; run this in a checkout of armrig", file=sys.stderr)
        return 2
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    wanted = f"{before}{BEGIN}\n{page_tables()}{END}{rest.split(END)[1]}"
    if wanted == text:
        return 0
    if arguments:
        print(
            f"{PAGE}: not what config.py says; run python -m armrig_daemon.configuration_reference"
        )
        return 1
    PAGE.write_text(wanted, encoding="utf-8")
    print(f"{PAGE}: written")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
