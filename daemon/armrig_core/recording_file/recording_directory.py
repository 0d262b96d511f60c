"""The directory of recordings, into which the daemon writes and in which its clients search."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import platformdirs

from armrig_core.errors import InputError
from armrig_core.process.bounded import CONFIGURATION_LIMIT
from armrig_core.process.toml_file import read_toml

SYSTEM = Path("/etc/armrig/armrig.toml")
VARIABLE = "ARMRIG_RECORDING_DIRECTORY"
OF_SERVICE = Path("/var/lib/armrig/recordings")
"""Recordings directory of the service on this machine, set by StateDirectory= of its unit."""


def configuration_files(rig: str = "", *, system: bool = False) -> list[Path]:
    """Return the configuration files that exist; a later file overrides an earlier one.

    The own file of `rig` in /etc/armrig overrides the file for all rigs. If `system` is True, the
    files of the user are left out.
    """
    rig_files = [of_rig(rig)] if rig else []
    user = [] if system else [Path(platformdirs.user_config_dir("armrig")) / SYSTEM.name]
    return [path for path in (SYSTEM, *rig_files, *user) if path.exists()]


def of_rig(rig: str) -> Path:
    """Return the path of a rig's configuration file in /etc/armrig; the file may not exist."""
    return SYSTEM.with_name(f"{rig}.toml")


def directory_of(directory: str) -> Path:
    """Return the directory that a configuration names; "" is the user's own directory.

    Raises ValueError if the path begins with the home of an unknown user.
    """
    if not directory:
        return Path(platformdirs.user_data_dir("armrig")) / "recordings"
    try:
        return Path(directory).expanduser().absolute()
    except RuntimeError as err:
        raise InputError(f"recording.directory = {directory!r}: there is no such user") from err


def recording_directory(paths: Sequence[Path], environ: Mapping[str, str]) -> Path:
    """Return the recordings directory that these files and variables configure.

    `paths` are TOML files; a later file overrides an earlier one. All other keys are ignored. The
    variable `ARMRIG_RECORDING_DIRECTORY` in `environ` overrides the files.

    Raises ValueError if a file cannot be read, or names no directory.
    """
    directory: Any = ""
    for path in paths:
        directory = _directory_in(path, directory)
    return directory_of(environ.get(VARIABLE, directory))


def directory_to_look_in(paths: Sequence[Path], environ: Mapping[str, str]) -> Path:
    """Return the directory in which a client searches for recordings.

    The result is the directory of `recording_directory`, with one exception. The exception applies
    if no directory is configured, this user's own directory does not exist, and this user may read
    the service's directory. The result is then the service's directory. The service records the
    runs of all members of its group in this directory.

    Raises ValueError if a file cannot be read, or names no directory.
    """
    directory = recording_directory(paths, environ)
    is_unused = directory == directory_of("") and not directory.exists()
    if is_unused and os.access(OF_SERVICE, os.R_OK | os.X_OK):
        return OF_SERVICE
    return directory


def _directory_in(path: Path, otherwise: str) -> str:
    """Return the directory that a configuration file names; `otherwise` if it names none."""
    table: Any = read_toml(path, CONFIGURATION_LIMIT).get("recording", {})
    directory = table.get("directory", otherwise) if isinstance(table, dict) else None
    if not isinstance(directory, str):
        raise InputError(f"{path}: [recording] directory must be the path of a directory")
    return directory
