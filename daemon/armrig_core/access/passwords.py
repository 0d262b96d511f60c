"""Users and their passwords: a file with lines user:password, the format of zenoh.

The daemon accepts passwords only on the loopback of its own machine, because the connection is not
encrypted.
"""

from __future__ import annotations

import os
from pathlib import Path

from armrig_core.access.credential import check_name, require_private
from armrig_core.errors import FileError, InputError
from armrig_core.process.bounded import CONFIGURATION_LIMIT, decoded, read_bounded

MIN_PASSWORD_LENGTH = 12
"""Shortest password, in characters: a shorter password is guessed quickly."""


def read_users(path: Path) -> dict[str, str]:
    """Return the password of each user in a file.

    Raises
    ------
    FileError
        The file cannot be read, or users other than its owner can read it. A line is not
        user:password, a password is too short, or a user is listed twice.
    """

    def check(found: os.stat_result) -> None:
        require_private(path, found, "a password")

    try:
        data = read_bounded(path, CONFIGURATION_LIMIT, check)
    except OSError as err:
        raise FileError(
            f"{path}: {err.strerror}; the file needs a line user:password for each user"
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
        try:
            _check_user(name, password, users)
        except InputError as err:
            raise FileError(f"{path}: line {number}: {err}") from err
        users[name] = password
    if not users:
        raise FileError(f"{path}: no users; the file needs a line user:password for each user")
    return users


def read_passwords(path: Path) -> frozenset[str]:
    """Return the names of the users in a password file; raise as `read_users` does."""
    return frozenset(read_users(path))


def _check_user(name: str, password: str, before: dict[str, str]) -> None:
    try:
        check_name(name)
    except ValueError as err:
        raise InputError(f"{err}; after the name come : and the password") from err
    if (length := len(password)) < MIN_PASSWORD_LENGTH:
        raise InputError(
            f"the password of {name!r} has {length} characters: at least {MIN_PASSWORD_LENGTH}"
        )
    if name in before:
        raise InputError(f"{name!r} is listed twice; once is allowed")
