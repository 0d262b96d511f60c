"""Which directory recordings go to: the daemon writes there, and its clients look there."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import platformdirs

from armrig_core.bounded import CONFIGURATION_LIMIT, TextError, read_text

SYSTEM = Path("/etc/armrig/armrig.toml")
VARIABLE = "ARMRIG_RECORDING_DIRECTORY"


def installed(rig: str = "", *, system: bool = False) -> list[Path]:
    """Return the configuration files that there are, the weaker first.

    Parameters
    ----------
    rig : str
        Id of a rig, whose own file in the machine's folder stands over that of all rigs.
    system : bool
        The machine's files only, and not the user's.
    """
    own = [of_rig(rig)] if rig else []
    user = [] if system else [Path(platformdirs.user_config_dir("armrig")) / SYSTEM.name]
    return [path for path in (SYSTEM, *own, *user) if path.exists()]


def of_rig(rig: str) -> Path:
    """Return the machine's configuration file of one rig, whether it is there or not."""
    return SYSTEM.with_name(f"{rig}.toml")


def directory_of(given: str) -> Path:
    """Return the directory that a configuration names; "" is the user's own.

    Raises
    ------
    ValueError
        It begins with a user's home, and there is no such user.
    """
    if not given:
        return Path(platformdirs.user_data_dir("armrig")) / "recordings"
    try:
        return Path(given).expanduser().absolute()
    except RuntimeError as err:
        msg = f"recording.directory = {given!r}: there is no such user"
        raise ValueError(msg) from err


def recording_directory(paths: Sequence[Path], environ: Mapping[str, str]) -> Path:
    """Return the directory that a daemon started with these files and variables records into.

    Parameters
    ----------
    paths : sequence of Path
        TOML files, the later over the earlier; nothing else in them is looked at.
    environ : mapping
        Environment variables; `ARMRIG_RECORDING_DIRECTORY` is over the files.

    Raises
    ------
    ValueError
        A file cannot be read, or names no directory.
    """
    given: Any = ""
    for path in paths:
        given = _named_in(path, given)
    return directory_of(environ.get(VARIABLE, given))


def _named_in(path: Path, otherwise: str) -> str:
    """Return the directory that a configuration file names, or what holds without it."""
    try:
        table: Any = tomllib.loads(read_text(path, CONFIGURATION_LIMIT)).get("recording", {})
    except OSError as err:
        msg = f"{path}: {err.strerror}"
        raise ValueError(msg) from err
    except (TextError, tomllib.TOMLDecodeError, RecursionError) as err:
        msg = f"{path}: not a TOML file: {err}"
        raise ValueError(msg) from err
    given = table.get("directory", otherwise) if isinstance(table, dict) else None
    if not isinstance(given, str):
        msg = f"{path}: [recording] directory must be the path of a directory"
        raise ValueError(msg)
    return given
