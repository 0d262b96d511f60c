"""The way to a daemon: its endpoint, a zenoh session there, and what is said of none."""

from __future__ import annotations

import json
import os
import tempfile

import zenoh
from armrig_core.endpoint import endpoint, socket_directory


class RigError(RuntimeError):
    """What a rig, or the way to it, refuses; says what to do."""


class NoReplyError(RigError):
    """Nobody answers."""


def default_endpoint(rig: str) -> str:
    """Return where the daemon of this user and rig listens."""
    directory = socket_directory(os.environ, uid=os.getuid(), temporary=tempfile.gettempdir())
    return endpoint(rig, directory)


def open_session(where: str, *, rig: str) -> zenoh.Session:
    """Return a zenoh session as a client of the endpoint `where`; it must be closed.

    Raises
    ------
    NoReplyError
        Nobody listens there.
    RigError
        `where` is no endpoint.
    """
    config = zenoh.Config()
    for key, value in (
        ("mode", "client"),
        ("connect/endpoints", [where]),
        # Only the endpoint asked for: nobody is looked for, nobody is told of.
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
        ("transport/shared_memory/enabled", False),
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


def no_reply(rig: str, where: str) -> NoReplyError:
    """Return the error of a daemon that does not answer."""
    return NoReplyError(
        f"no reply from rig {rig} at {where}: not running, or not permitted; "
        "start it with `armrigd run`, or give its endpoint with --connect"
    )
