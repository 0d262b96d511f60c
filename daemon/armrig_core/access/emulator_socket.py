"""The Unix socket that replaces the serial port between a daemon and an emulated rig.

A port `unix:PATH` names the socket. The socket leads to an emulator that the same user runs on the
same machine. The program that opened the port holds the lock of the file `PATH.lock`.
"""

from __future__ import annotations

import os
import socket
import stat
from pathlib import Path
from struct import Struct

from armrig_core.access.endpoint import SOCKET_PATH_MAX, require_trusted
from armrig_core.errors import InputError
from armrig_core.rig.emulated import SOCKET_PREFIX

_CREDENTIALS = Struct("iII")  # struct ucred of unix(7): pid, uid, gid


def socket_path(port: str) -> Path | None:
    """Return the path of the socket that a port names; None for a serial port.

    Raises ValueError if the path is empty or too long for a socket.
    """
    if not port.startswith(SOCKET_PREFIX):
        return None
    text = port.removeprefix(SOCKET_PREFIX)
    length = len(os.fsencode(text))
    if not text or length > SOCKET_PATH_MAX:
        msg = f"{port}: the path has {length} B; a socket's path has 1 to {SOCKET_PATH_MAX} B; "
        msg += "choose a shorter folder" if text else "name a socket in your own folder"
        raise InputError(msg)
    return Path(text)


def lock_path(path: Path) -> Path:
    """Return the path of the file that is locked while a program uses a socket."""
    return path.with_name(f"{path.name}.lock")


def require_safe_folder(path: Path) -> None:
    """Refuse a path at which other users could replace the socket.

    Raises InputError if another user owns the folder, or may write to it. Raises OSError if the
    folder does not exist or cannot be read.
    """
    try:
        require_trusted(path.parent.lstat(), owners={os.geteuid(), 0})
    except InputError as err:
        raise InputError(f"its folder {err}; choose your own folder") from err


def is_socket(path: Path) -> bool:
    """Return whether `path` is a socket, and not a link to a socket.

    Raises FileNotFoundError if `path` does not exist.
    """
    return stat.S_ISSOCK(path.lstat().st_mode)


def stranger(connection: socket.socket) -> int | None:
    """Return the id of the user at the other end; None for this user and for root."""
    data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    _, uid, _ = _CREDENTIALS.unpack(data)
    return None if uid in (os.geteuid(), 0) else int(uid)
