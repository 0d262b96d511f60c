"""The tables of a TOML that anybody may have written."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from armrig_core.bounded import TextError, read_text

_DEEPEST, _MOST_LEVELS = 16, 64
# The reader's time grows with the square of the depth, and what it returns cannot be printed.
_PART = r"""(?:[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')"""
_TOO_DEEP = re.compile(rf"(?:{_PART}[ \t]*\.[ \t]*){{{_DEEPEST}}}{_PART}")


class TomlError(ValueError):
    """A text that is no TOML; says why."""

    def __init__(self, what: str, why: str) -> None:
        super().__init__(f"{what}{why}")
        self.why = why
        """As the reader says it."""


def read_toml(path: Path, most: int) -> dict[str, Any]:
    """Return the tables of a regular file of at most so many bytes.

    Raises
    ------
    TomlError
        It is no TOML, is saved in another encoding than UTF-8, or is nested too deeply.
    OSError
        It cannot be read, or is too long.
    """
    try:
        return toml_tables(read_text(path, most))
    except TextError as err:
        raise TomlError("", str(err)) from err


def toml_tables(text: str) -> dict[str, Any]:
    """Return the tables of a text.

    Raises
    ------
    TomlError
        It is no TOML, or is nested too deeply.
    """
    if _TOO_DEEP.search(text):
        raise TomlError("", f"nested too deeply: a key has at most {_DEEPEST} parts")
    try:
        tables = tomllib.loads(text)
    except RecursionError as err:
        raise TomlError("", "nested too deeply") from err
    except ValueError as err:  # TOMLDecodeError is one
        raise TomlError("not a TOML file: ", str(err)) from err
    _check_depth(tables)
    return tables


def _check_depth(tables: dict[str, Any]) -> None:
    """Refuse tables and lists so deep in each other that nothing can walk or print them."""
    level: list[Any] = [tables]
    for _ in range(_MOST_LEVELS):
        inner = [x.values() if isinstance(x, dict) else x for x in level]
        level = [x for values in inner for x in values if isinstance(x, dict | list)]
        if not level:
            return
    raise TomlError("", f"nested too deeply: at most {_MOST_LEVELS} levels are read")
