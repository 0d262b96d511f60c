"""Reference of all keys of the configuration: an example, and the tables of the page.

`python -m armrig_daemon.configuration_reference` writes the tables between the two marks of
`docs/configuration.md`. With `--check` nothing is written, and the exit code is 1 if the tables on
the page are outdated.
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
from armrig_core.recording_file.recording_directory import SYSTEM
from armrig_core.rig.calibration import Made
from msgspec import UNSET
from msgspec.inspect import (
    BoolType,
    DictType,
    FloatType,
    IntType,
    LiteralType,
    UnionType,
    type_info,
)

from armrig_daemon.config import Config

PAGE = Path(__file__).parents[2] / "docs" / "configuration.md"
BEGIN, END = "<!-- keys: begin -->", "<!-- keys: end -->"
_LINE_WIDTH = 88  # of the example, in characters
_HEADING = f"""\
# Configuration of armrigd: every key, with its default.
#
# Each key follows a #. To give another value, remove the #. A key that is not given has its
# default. The daemon refuses a wrong key or value with a message, and the motor stays at 0 V.
#
# The daemon reads {SYSTEM}, then {SYSTEM.parent}/<id>.toml of its rig, and then
# $XDG_CONFIG_HOME/armrig/{SYSTEM.name} (~/.config/armrig/{SYSTEM.name}). With
# `armrigd run --config` it reads only this file. The environment
# (ARMRIG_<TABLE>_<KEY>, such as ARMRIG_LIMITS_U_MAX_V=4.5) and the command line override files.
"""


class Key(NamedTuple):
    """One key of a table."""

    name: str
    """Name in the table; dotted if the value is in a nested table."""
    kind: str
    """Type of the value, in words."""
    default: str
    """Default as TOML; empty if the key has no default."""
    allowed: str
    """Allowed values in words; empty if the description states them, or all values are allowed."""
    description: str
    """Meaning of the value, with its unit."""
    example: str
    """An example value as TOML: the default, if the key has a default."""


def tables() -> Iterator[tuple[str, str, list[Key]]]:
    """Yield name, meaning and keys of each table of the configuration."""
    default = Config()
    for name, meaning in _meanings():
        yield name, meaning, [*_keys(getattr(default, name), name)]


def example() -> str:
    """Return a configuration with all keys; each key is commented out, after its description."""
    lines = [_HEADING]
    for table, meaning, keys in tables():
        lines += [_comment(f"{meaning}."), f"[{table}]"]
        for key in keys:
            allowed = f" Allowed: {key.allowed}." if key.allowed else ""
            lines += [_comment(key.description + allowed), f"#{key.name} = {key.example}"]
        lines.append("")
    return "\n".join(lines)


def page_tables() -> str:
    """Return the text of the page's tables, as Markdown."""
    lines: list[str] = []
    for table, meaning, keys in tables():
        lines += [f"## `[{table}]`", "", f"{meaning}.", ""]
        lines += ["| key | type | default | allowed | meaning |", "|---|---|---|---|---|"]
        for key in keys:
            default = f"`{key.default}`" if key.default else ""
            row = (f"`{key.name}`", key.kind, default, key.allowed, key.description)
            lines.append("".join(f"| {cell} " if cell else "| " for cell in row) + "|")
        lines.append("")
    return "\n".join(lines)


def _meanings() -> Iterator[tuple[str, str]]:
    """Yield name and purpose of each table; the docstring of its class is "`[name]`: purpose"."""
    descriptions = _descriptions(Config)
    for field in msgspec.structs.fields(Config):
        text = descriptions.get(field.name) or " ".join((field.type.__doc__ or "").split())
        text = text.removeprefix(f"`[{field.name}]`: ").rstrip(".")
        yield field.name, text[0].upper() + text[1:]


def _keys(table: msgspec.Struct, path: str) -> Iterator[Key]:
    """Yield the keys of a table with their defaults; keys of nested tables have dotted names."""
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
        elif field.type not in _PROGRAM_TYPES:
            if path == "arm" and value is None:
                value = getattr(Config().arm.parameters(), field.name)
            default_text = "" if value is None or value is UNSET else _toml(value)
            yield Key(
                name=field.name,
                kind=_in_words(field.type),
                default=default_text,
                allowed=_range(field.type),
                description=descriptions[field.name],
                example=default_text or _EXAMPLES.get(_in_words(field.type), "0"),
            )


_EXAMPLES = {"text": '""', "true or false": "false"}  # of keys without a default
_PROGRAM_TYPES = (type_info(Made | None),)  # types of keys that only programs write
_CALIBRATION_FILE = Key(
    name="file",
    kind="text",
    default="",
    allowed="",
    description=(
        "File from `armrig calibrate`; its path is relative to the folder of the configuration "
        "file. If this key is given, no other key of this table is allowed."
    ),
    example='"calibration-1.toml"',
)


def _arm_keys() -> Iterator[Key]:
    """Yield the keys of the emulated arm; they are the parameters of the rig's model."""
    from armrig_core.rig.arm import ArmParameters

    descriptions = _descriptions(ArmParameters)
    for name, field in ArmParameters.__dataclass_fields__.items():
        value = _toml(field.default)
        allowed = "0 or more" if field.default == 0 else "above 0"
        yield Key(name, "number", value, allowed, descriptions[name], value)


def _descriptions(kind: type) -> dict[str, str]:
    """Return the docstring of each field of a class, as one line."""
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
    if isinstance(kind, LiteralType) and isinstance(kind.values[0], str):
        return "text"
    if isinstance(kind, IntType | LiteralType):
        return "whole number"
    return "number" if isinstance(kind, FloatType) else "text"


def _range(kind: Any) -> str:
    """Return the allowed values of a numeric type, in words."""
    if isinstance(kind, UnionType):
        return _range(kind.types[0])
    if isinstance(kind, LiteralType):
        *most, last = map(str, kind.values)
        return f"{', '.join(most)} or {last}"
    if not isinstance(kind, IntType | FloatType):
        return ""
    if kind.gt is not None and kind.le is not None:
        return f"above {_bound(kind.gt)}, at most {_bound(kind.le)}"
    if kind.ge is not None and kind.le is not None:
        return f"{_bound(kind.ge)} to {_bound(kind.le)}"
    return "" if kind.ge is None else f"{_bound(kind.ge)} or more"


def _bound(value: float) -> str:
    return str(int(value)) if value == int(value) else str(value)


def _toml(value: Any) -> str:
    # JSON and TOML have the same notation for these strings, numbers and booleans.
    return json.dumps(value, ensure_ascii=False)


def _comment(text: str) -> str:
    return textwrap.fill(
        text, _LINE_WIDTH, initial_indent="# ", subsequent_indent="# ", break_on_hyphens=False
    )


def main(arguments: list[str]) -> int:
    """Write the tables into the page; with `--check`, only compare them."""
    if arguments not in ([], ["--check"]):
        print(f"{' '.join(arguments)}: only --check is allowed", file=sys.stderr)
        return 2
    if not PAGE.exists():
        print(f"{PAGE}: no such page; run this in a checkout of armrig", file=sys.stderr)
        return 2
    text = PAGE.read_text(encoding="utf-8")
    before, after = text.split(BEGIN)
    wanted = f"{before}{BEGIN}\n{page_tables()}{END}{after.split(END)[1]}"
    if wanted == text:
        return 0
    if arguments:
        print(
            f"{PAGE}: differs from config.py; run python -m armrig_daemon.configuration_reference"
        )
        return 1
    PAGE.write_text(wanted, encoding="utf-8")
    print(f"{PAGE}: written")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
