"""Which directory recordings go to: the daemon writes there, and its clients look there."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import platformdirs

from armrig_core.bounded import CONFIGURATION_LIMIT
from armrig_core.errors import FileError, InputError
from armrig_core.toml_file import read_toml

SYSTEM = Path("/etc/armrig/armrig.toml")
VARIABLE = "ARMRIG_RECORDING_DIRECTORY"
OF_SERVICE = Path("/var/lib/armrig/recordings")
"""Where the service of this machine records, by StateDirectory= of its unit."""


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
        raise InputError(f"recording.directory = {given!r}: there is no such user") from err


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


def directory_to_look_in(paths: Sequence[Path], environ: Mapping[str, str]) -> Path:
    """Return the directory in which a client looks for recordings.

    That of `recording_directory`. Where none is configured, and no daemon of this user has ever
    recorded, the one of this machine's service, if this user may read it: who is in its group has
    recorded there without saying where.

    Raises
    ------
    ValueError
        As `recording_directory`.
    """
    own = recording_directory(paths, environ)
    is_unused = own == directory_of("") and not own.exists()
    if is_unused and os.access(OF_SERVICE, os.R_OK | os.X_OK):
        return OF_SERVICE
    return own


def _named_in(path: Path, otherwise: str) -> str:
    """Return the directory that a configuration file names, or what holds without it."""
    try:
        table: Any = read_toml(path, CONFIGURATION_LIMIT).get("recording", {})
    except OSError as err:
        raise InputError(f"{path}: {err.strerror}") from err
    except FileError as err:
        raise InputError(f"{path}: {err}") from err
    given = table.get("directory", otherwise) if isinstance(table, dict) else None
    if not isinstance(given, str):
        raise InputError(f"{path}: [recording] directory must be the path of a directory")
    return given
