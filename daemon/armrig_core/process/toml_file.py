"""Tables of a TOML file from an untrusted source, and their conversion to checked values."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import msgspec

from armrig_core.errors import FileError, InputError
from armrig_core.process.bounded import read_text

_MAX_KEY_PARTS, _MAX_LEVELS = 16, 64
# The reader's time grows with the square of the depth, and a deeply nested result cannot be
# printed.
_PART = r"""(?:[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')"""
# Only from the start of a part, so that the time is not that of each character of a long word.
_DEEP_KEY = re.compile(rf"(?<![\\\w-])(?:{_PART}[ \t]*\.[ \t]*){{{_MAX_KEY_PARTS}}}{_PART}")
T = TypeVar("T", bound=msgspec.Struct)


class TomlTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of a TOML file."""


def read_toml(path: Path, most: int) -> dict[str, Any]:
    """Return the tables of a TOML file; the file may have at most `most` bytes.

    Raises FileError, which names the file, if the file cannot be read, is too long, is not encoded
    as UTF-8, is not TOML, or is nested too deeply.
    """
    try:
        return toml_tables(read_text(path, most))
    except OSError as err:
        raise FileError(f"{path}: {err.strerror}") from err
    except FileError as err:
        raise FileError(f"{path}: {err}") from err


def toml_tables(text: str) -> dict[str, Any]:
    """Return the tables in a TOML text.

    Raises FileError if the text is not TOML, or is nested too deeply.
    """
    if _DEEP_KEY.search(text):
        raise FileError(f"nested too deeply: a key has at most {_MAX_KEY_PARTS} parts")
    try:
        tables = tomllib.loads(text)
    except RecursionError as err:
        raise FileError("nested too deeply") from err
    except ValueError as err:  # such as TOMLDecodeError
        raise FileError(f"not a TOML file: {err}") from err
    _check_depth(tables)
    return tables


def _check_depth(tables: dict[str, Any]) -> None:
    """Refuse tables and lists that are nested too deeply to be walked or printed."""
    level: list[Any] = [tables]
    for _ in range(_MAX_LEVELS):
        inner = [x.values() if isinstance(x, dict) else x for x in level]
        level = [x for values in inner for x in values if isinstance(x, dict | list)]
        if not level:
            return
    raise FileError(f"nested too deeply: at most {_MAX_LEVELS} levels are read")


def convert(table: dict[str, Any], kind: type[T]) -> T:
    """Return the table as a value of the type `kind`, with each key checked.

    Raises InputError if a key is unknown, or a value has a wrong type or is out of its range.
    """
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as err:
        raise InputError(_explain(str(err), table, kind)) from err


def _explain(message: str, table: dict[str, Any], kind: type[msgspec.Struct]) -> str:
    text, _, place = message.partition(" - at `$")
    keys = [key for key in place.strip("`.").split(".") if key and key != "[...]"]
    setting, expected, name = _at(table, keys), _kind_at(kind, keys), ".".join(keys)
    is_table = isinstance(expected, type) and issubclass(expected, msgspec.Struct)
    unknown = re.search(r"unknown field `(.+?)`", text)
    if unknown:
        value = setting.get(unknown[1]) if isinstance(setting, dict) else None
        allowed = f"; allowed are {', '.join(expected.__struct_fields__)}" if is_table else ""
        return f"{'.'.join([*keys, unknown[1]])} = {value!r}: no such key{allowed}"
    if keys and is_table and not isinstance(setting, dict):
        return f"{name} = {setting!r}: must be a table, [{name}]"
    if not keys or is_table:  # the message of a check of a table names the key
        return f"{name}: {text}" if keys else text
    if get_origin(expected) is Literal:
        text = f"allowed are {', '.join(map(repr, get_args(expected)))}"
    return f"{name} = {setting!r}: {text[0].lower()}{text[1:]}"


def _at(table: Any, keys: list[str]) -> Any:
    for key in keys:
        table = table.get(key) if isinstance(table, dict) else None
    return table


def _kind_at(kind: Any, keys: list[str]) -> Any:
    """Return the type of the value with these keys; None for a value that is in no table."""
    for key in keys:
        if not (isinstance(kind, type) and issubclass(kind, msgspec.Struct)):
            return None
        kind = next((f.type for f in msgspec.structs.fields(kind) if f.name == key), None)
    return kind
