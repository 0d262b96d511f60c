"""Endpoints at which a daemon listens and its clients connect."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any

from armrig_core.errors import InputError
from armrig_core.telemetry.topics import check_rig_id

SOCKET_PATH_MAX = 107
"""Longest path of a Unix socket, in B: sun_path of unix(7) without its final zero."""

SERVICES = PurePosixPath("/run/armrig")
"""Folder that contains one folder for each rig whose daemon systemd runs."""
SERVICE_USER = "armrig"
"""User of the daemons that systemd runs."""
_FILES = {
    "access": ("certificate", "names"),
    "client": ("certificate",),
    "rig": ("file",),
}
_NETWORK = re.compile(r"(tls|tcp)/(?:\[([0-9A-Fa-f:.]+)\]|([A-Za-z0-9.-]+)):(\d{1,5})")


def socket_directory(
    environ: Mapping[str, str], *, uid: int, temporary: str | PurePosixPath
) -> PurePosixPath:
    """Return the directory of the sockets.

    The directory is the first entry of `$RUNTIME_DIRECTORY`, which systemd sets for a service.
    Without this variable, the directory is `$XDG_RUNTIME_DIR/armrig`; a login sets
    `$XDG_RUNTIME_DIR`. Without both variables, the directory is `armrig-<uid>` in the temporary
    directory.

    `uid` is the id of the user, for the private directory in the temporary directory `temporary`.
    """
    if service := environ.get("RUNTIME_DIRECTORY"):
        return PurePosixPath(service.split(":")[0])
    if login := environ.get("XDG_RUNTIME_DIR"):
        return PurePosixPath(login) / "armrig"
    return PurePosixPath(temporary) / f"armrig-{uid}"


def require_trusted(inode: os.stat_result, *, owners: Collection[int]) -> None:
    """Refuse a directory that another user owns or may write to.

    Such a user could replace the socket and answer instead of the daemon.

    `inode` is the state of the directory itself, from `lstat`. The users with the ids `owners` may
    own the directory.

    Raises InputError if another user owns the directory or may write to it, or the path is a link
    or not a directory. The message names only this defect, not the directory.
    """
    if stat.S_ISLNK(inode.st_mode):
        raise InputError("is a symbolic link, which may lead to another user's directory")
    if not stat.S_ISDIR(inode.st_mode):
        raise InputError("is not a directory")
    if inode.st_uid not in owners:
        raise InputError(f"belongs to another user (uid {inode.st_uid})")
    if inode.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        mode = stat.S_IMODE(inode.st_mode)
        raise InputError(f"can be written by other users (mode {mode:o}, not 700)")


def endpoint(rig: str, directory: PurePosixPath) -> str:
    """Return the zenoh endpoint of a rig whose socket is in `directory`.

    Raises ValueError if the id cannot be part of a key, or the path is too long for a socket.
    """
    path = directory / f"{check_rig_id(rig)}.sock"
    length = len(bytes(str(path), "utf-8", "surrogateescape"))
    if length > SOCKET_PATH_MAX:
        raise InputError(
            f"{path}: the path has {length} B; a socket's path has at most {SOCKET_PATH_MAX} B; "
            "set XDG_RUNTIME_DIR to a shorter directory"
        )
    return f"unixsock-stream/{path}"


def check_listen(where: str) -> None:
    """Refuse an endpoint that does not listen on a network by TLS; raise InputError."""
    if not where.startswith("tls/") or network_address(where) is None:
        raise InputError(f"listen = {where!r} must be tls/HOST:PORT, such as tls/0.0.0.0:7447")


def network_address(where: str) -> tuple[str, int] | None:
    """Return host and port of a tls or tcp endpoint; None for any other endpoint."""
    match = _NETWORK.fullmatch(where)
    if match is None or not 0 < int(match[4]) < 1 << 16:
        return None
    return match[2] or match[3], int(match[4])


def resolve_paths(tables: Mapping[str, Any], directory: Path) -> dict[str, Any]:
    """Return `tables` with absolute paths of files; relative paths begin at `directory`."""
    result = dict(tables)
    for table, keys in _FILES.items():
        values = result.get(table)
        if isinstance(values, Mapping):
            paths = {k: values[k] for k in keys if isinstance(values.get(k), str) and values[k]}
            result[table] = {**values, **{k: _absolute(p, directory) for k, p in paths.items()}}
    return result


def _absolute(path: str, directory: Path) -> str:
    with suppress(RuntimeError):  # the home of an unknown user
        return str(directory / Path(path).expanduser())
    return str(directory / path)
