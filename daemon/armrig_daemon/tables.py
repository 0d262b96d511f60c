"""Conversion of TOML tables to checked values, with messages that name the wrong key."""

from __future__ import annotations

import re
from typing import Any, TypeVar

import msgspec
from armrig_core.errors import InputError

T = TypeVar("T", bound=msgspec.Struct)
Table = dict[str, Any]


def convert(table: Table, kind: type[T]) -> T:
    """Return the table as a value of the type `kind`, with each key checked.

    Raises
    ------
    InputError
        A key is unknown, or a value has a wrong type or is out of its range.
    """
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as err:
        raise InputError(_explain(str(err), table, kind)) from err


def _explain(message: str, table: Table, kind: type[msgspec.Struct]) -> str:
    text, _, place = message.partition(" - at `$")
    keys = [key for key in place.strip("`.").split(".") if key and key != "[...]"]
    came, owner = _at(table, keys), _kind_at(kind, keys)
    unknown = re.search(r"unknown field `(.+?)`", text)
    if unknown:
        name = ".".join([*keys, unknown[1]])
        value = came.get(unknown[1]) if isinstance(came, dict) else None
        allowed = f"; allowed are {', '.join(owner.__struct_fields__)}" if owner else ""
        return f"{name} = {value!r}: no such key{allowed}"
    if keys and owner is not None and not isinstance(came, dict):
        name = ".".join(keys)
        return f"{name} = {came!r}: must be a table, [{name}]"
    if not keys or owner is not None:  # the message of a check of a table names the key
        return f"{'.'.join(keys)}: {text}" if keys else text
    return f"{'.'.join(keys)} = {came!r}: {text[0].lower()}{text[1:]}"


def _at(table: Any, keys: list[str]) -> Any:
    for key in keys:
        table = table.get(key) if isinstance(table, dict) else None
    return table


def _kind_at(kind: type[msgspec.Struct], keys: list[str]) -> type[msgspec.Struct] | None:
    at: Any = kind
    for key in keys:
        if not (isinstance(at, type) and issubclass(at, msgspec.Struct)):
            return None
        at = next((f.type for f in msgspec.structs.fields(at) if f.name == key), None)
    return at if isinstance(at, type) and issubclass(at, msgspec.Struct) else None
