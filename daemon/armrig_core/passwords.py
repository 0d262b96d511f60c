"""Users with a password: a file of lines user:password, as zenoh reads them.

For this machine alone: the daemon takes passwords on its loopback only, where nothing is encrypted.
"""

from __future__ import annotations

import os
from pathlib import Path

from armrig_core.bounded import CONFIGURATION_LIMIT, decoded, read_bounded
from armrig_core.credential import check_name, exposed
from armrig_core.errors import FileError

SHORTEST = 12
"""A password that is guessed in no time protects nobody."""


def read_users(path: Path) -> dict[str, str]:
    """Return the password of each user in a file.

    Raises
    ------
    FileError
        It cannot be read, or not by its owner alone; a line is not user:password, a password is
        too short, or a user stands there twice.
    """

    def check(found: os.stat_result) -> None:
        if error := exposed(path, found, "a password"):
            raise FileError(error)

    try:
        data = read_bounded(path, CONFIGURATION_LIMIT, check)
    except OSError as err:
        raise FileError(
            f"{path}: {err.strerror}; a line user:password for each user is needed there"
        ) from err
    try:
        lines = decoded(data).splitlines()
    except FileError as err:
        raise FileError(f"{path}: {err}") from err
    users: dict[str, str] = {}
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        name, _, password = (part.strip() for part in line.partition(":"))
        wrong = _wrong(name, password, users)
        if wrong:
            raise FileError(f"{path}: line {number}: {wrong}")
        users[name] = password
    if not users:
        raise FileError(f"{path}: nobody is in it; a line user:password for each user is needed")
    return users


def read_passwords(path: Path) -> frozenset[str]:
    """Return who has a password in a file; raises as `read_users`."""
    return frozenset(read_users(path))


def _wrong(name: str, password: str, before: dict[str, str]) -> str:
    try:
        check_name(name)
    except ValueError as err:
        return f"{err}, then : and the password"
    if len(password) < SHORTEST:
        return f"the password of {name!r} has {len(password)} characters: at least {SHORTEST}"
    return f"{name!r} stands there twice: once is allowed" if name in before else ""
