"""The Unix socket that takes the place of a serial port between a daemon and an emulated rig.

A port `unix:PATH` names it. The socket is for an emulator on the same machine, of the same user.
The program that opened the port holds the lock of the file `PATH.lock`.
"""

from __future__ import annotations

import os
import socket
import stat
from pathlib import Path
from struct import Struct

from armrig_core.emulated import SOCKET_PREFIX
from armrig_core.endpoint import SOCKET_PATH_MAX, distrust
from armrig_core.errors import InputError

_CREDENTIALS = Struct("iII")  # struct ucred of unix(7): pid, uid, gid


def socket_path(port: str) -> Path | None:
    """Return the path of the socket that a port names; None for a serial port.

    Raises
    ------
    ValueError
        The path is empty or too long for a socket.
    """
    if not port.startswith(SOCKET_PREFIX):
        return None
    text = port.removeprefix(SOCKET_PREFIX)
    length = len(os.fsencode(text))
    if not text or length > SOCKET_PATH_MAX:
        msg = f"{port}: a path of {length} B, a socket's has 1 to {SOCKET_PATH_MAX}; "
        msg += "choose a shorter folder" if text else "name a socket in a folder of yours"
        raise InputError(msg)
    return Path(text)


def port_of(path: Path) -> str:
    """Return the name of the port at a path."""
    return f"{SOCKET_PREFIX}{path}"


def lock_path(path: Path) -> Path:
    """Return the file whose lock the program that opened the port holds."""
    return path.with_name(f"{path.name}.lock")


def folder_fault(path: Path) -> str:
    """Return why other users could replace the socket at `path`, or nothing.

    Raises
    ------
    OSError
        The folder is not there or may not be looked at.
    """
    fault = distrust(path.parent.lstat(), owners={os.geteuid(), 0})
    return f"its folder {fault}; choose a folder of yours" if fault else ""


def is_socket(path: Path) -> bool:
    """Return whether a socket lies at `path`, and no link to one.

    Raises
    ------
    FileNotFoundError
        There is nothing.
    """
    return stat.S_ISSOCK(path.lstat().st_mode)


def peer_fault(connection: socket.socket) -> str:
    """Return why the program at the other end is not trusted, or nothing."""
    data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    _, uid, _ = _CREDENTIALS.unpack(data)
    if uid in (os.geteuid(), 0):
        return ""
    return f"a program of another user (uid {uid}) answers; start the emulator as this user"
