"""The way to a daemon: its endpoint, a zenoh session, and the errors where nobody replies."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path, PurePosixPath

import zenoh
from armrig_core.endpoint import distrust, endpoint, socket_directory
from armrig_core.printable import printable
from armrig_core.topics import PLAYED

MOST_RECEIVED = 16 << 20
"""Longest message that is received, in B; beyond it the connection ends."""


class RigError(RuntimeError):
    """A rig, or the way to it, refuses; the message says what to do."""

    def __init__(self, message: str) -> None:
        """Take the message; characters that do not print, as others may write them, are escaped."""
        super().__init__(printable(message))


class NoReplyError(RigError):
    """Nobody replies."""


def default_endpoint(rig: str) -> str:
    """Return where the daemon of this user and rig listens."""
    return endpoint(rig, _socket_directory())


def own_endpoint(rig: str) -> str:
    """Return where we listen ourselves under the id `rig`, in a directory of this user's alone.

    Raises
    ------
    RigError
        The directory may be another user's, or there is no place for one.
    """
    directory = Path(_socket_directory())
    try:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as err:
        msg = f"{directory}: {err.strerror}; set XDG_RUNTIME_DIR to a directory of yours"
        raise RigError(msg) from err
    where = default_endpoint(rig)
    _check_directory(rig, where)
    return where


def open_session(connect: str | None, *, rig: str) -> zenoh.Session:
    """Return a zenoh session as a client of the endpoint `connect`; it must be closed.

    Parameters
    ----------
    connect : str, optional
        None is the daemon of this user and rig. Then no other user may be able to put a socket
        into its directory.

    Raises
    ------
    NoReplyError
        Nobody listens there.
    RigError
        `connect` is not an endpoint, or the directory may be another user's.
    """
    where = connect or default_endpoint(rig)
    if not connect:
        _check_directory(rig, where)
    config = zenoh.Config()
    for key, value in (
        ("mode", "client"),
        ("connect/endpoints", [where]),
        # Only the endpoint asked for: zenoh looks for nobody else, and tells nobody of us.
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
        ("transport/shared_memory/enabled", False),
        # Longer than anything that a daemon sends. What listens there may not be a daemon.
        ("transport/link/rx/max_message_size", MOST_RECEIVED),
    ):
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as err:
            msg = f"{where!r} is no zenoh endpoint, such as unixsock-stream/run/armrig/1.sock"
            raise RigError(msg) from err
    try:
        return zenoh.open(config)
    except zenoh.ZError as err:
        raise no_reply(rig, where) from err


def _socket_directory() -> PurePosixPath:
    if not hasattr(os, "getuid"):  # Windows
        msg = "there is no daemon here: a rig is driven from Linux; name its endpoint with "
        msg += "--connect"
        raise RigError(msg)
    return socket_directory(os.environ, uid=os.getuid(), temporary=tempfile.gettempdir())


def _check_directory(rig: str, where: str) -> None:
    """Refuse a directory that others may have made, as anybody could in a temporary one."""
    directory = Path(_socket_directory())
    try:
        found = directory.lstat()
    except OSError as err:
        raise no_reply(rig, where) from err
    wrong = distrust(found, owners={os.getuid()})
    if wrong:
        msg = f"{directory}: {wrong}, so what listens there may be a stranger's; set "
        msg += "XDG_RUNTIME_DIR to a directory of yours, for armrigd too, or name the endpoint "
        msg += "with --connect"
        raise RigError(msg)


def no_reply(rig: str, where: str) -> NoReplyError:
    """Return the error of a daemon that does not answer."""
    if rig.startswith(PLAYED):
        return NoReplyError(
            f"no reply from {rig} at {where}: a recording that is played again takes no commands; "
            f"start it with `armrig play F`, watch it with `armrig watch --rig {rig}`"
        )
    return NoReplyError(
        f"no reply from rig {rig} at {where}: not running, or not permitted; "
        "start it with `armrig lab` or `armrigd run`, or give its endpoint with --connect"
    )


def no_daemon(rig: str, where: str, what: str) -> RigError:
    """Return the error where the replies are not those of a daemon of this version."""
    return RigError(
        f"rig {rig} at {where}: {what}; what listens there is no armrigd, or one of another version"
    )
