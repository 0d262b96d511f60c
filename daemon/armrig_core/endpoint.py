"""Where a daemon listens and its clients look for it, unless told otherwise."""

from __future__ import annotations

import os
import stat
from collections.abc import Collection, Mapping
from pathlib import PurePosixPath

from armrig_core.topics import check_rig_id

SOCKET_PATH_MAX = 107
"""Longest path of a Unix socket, in B: sun_path of unix(7) without its closing zero."""


def socket_directory(
    environ: Mapping[str, str], *, uid: int, temporary: str | PurePosixPath
) -> PurePosixPath:
    """Return the directory of the sockets.

    The first of `$RUNTIME_DIRECTORY` (a systemd service has it; the first, where it names several),
    `$XDG_RUNTIME_DIR/armrig` (a login has it), and `armrig-<uid>` in the temporary directory.

    Parameters
    ----------
    environ : mapping
        The environment, such as os.environ.
    uid : int
        The user, for whom the last one is private.
    temporary : path
        The temporary directory.
    """
    if service := environ.get("RUNTIME_DIRECTORY"):
        return PurePosixPath(service.split(":")[0])
    if login := environ.get("XDG_RUNTIME_DIR"):
        return PurePosixPath(login) / "armrig"
    return PurePosixPath(temporary) / f"armrig-{uid}"


def distrust(found: os.stat_result, *, owners: Collection[int]) -> str:
    """Return why the sockets in a directory may be a stranger's, or nothing.

    Who may write to the directory can put a socket of his own there, and answer for the daemon.

    Parameters
    ----------
    found : os.stat_result
        Of the directory itself, as by `lstat`.
    owners : collection of int
        Users who may own it.
    """
    if stat.S_ISLNK(found.st_mode):
        return "is a symbolic link, which may lead to another user's directory"
    if not stat.S_ISDIR(found.st_mode):
        return "is no directory"
    if found.st_uid not in owners:
        return f"belongs to another user (uid {found.st_uid})"
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"can be written by other users (mode {stat.S_IMODE(found.st_mode):o}, not 700)"
    return ""


def endpoint(rig: str, directory: PurePosixPath) -> str:
    """Return the zenoh endpoint of a rig whose socket lies in `directory`.

    Raises
    ------
    ValueError
        The id cannot be part of a key, or the path is too long for a socket.
    """
    path = directory / f"{check_rig_id(rig)}.sock"
    length = len(bytes(str(path), "utf-8", "surrogateescape"))
    if length > SOCKET_PATH_MAX:
        msg = f"{path}: {length} B, a socket's path has at most {SOCKET_PATH_MAX}; "
        msg += "set XDG_RUNTIME_DIR to a shorter directory"
        raise ValueError(msg)
    return f"unixsock-stream/{path}"
