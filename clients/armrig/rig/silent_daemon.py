"""Facts about a daemon of this machine that does not answer."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path

from armrig_core.access.daemon_lock import DaemonFacts, read_facts
from armrig_core.access.endpoint import SERVICE_USER, require_trusted
from armrig_core.errors import InputError

_UNIX_SOCKET = "unixsock-stream/"
_REOPENED_S = 2.0
"""Longest wait for a deleted socket, in s; its daemon opens it again within 1 s."""
_POLL_INTERVAL_S = 0.02


def service_owners() -> set[int]:
    """Return the allowed owners of a service's folder: root, and the user of the service."""
    from pwd import getpwnam

    with suppress(KeyError):  # the user does not exist
        return {0, getpwnam(SERVICE_USER).pw_uid}
    return {0}


def daemon_at(where: str) -> DaemonFacts | None:
    """Return the facts about the daemon of a Unix socket; None if nothing is known.

    A person may end the process in the facts. No other user may therefore have written them.
    """
    socket = Path(where.removeprefix(_UNIX_SOCKET))
    if not where.startswith(_UNIX_SOCKET) or not hasattr(os, "getuid"):  # no getuid: Windows
        return None
    try:
        require_trusted(socket.parent.lstat(), owners={*service_owners(), os.getuid()})
    except (InputError, OSError):
        return None
    return read_facts(socket)


def living_daemon(where: str) -> int:
    """Return the process of the living daemon of a Unix socket; 0 if none is known."""
    facts = daemon_at(where)
    return facts.pid if facts is not None and facts.is_alive else 0


def has_socket(where: str) -> bool:
    """Return whether a daemon has a socket; if the socket was deleted, wait for its return."""
    socket = Path(where.removeprefix(_UNIX_SOCKET))
    if socket.exists() or not living_daemon(where):
        return socket.exists()
    until = time.monotonic() + _REOPENED_S
    # The daemon writes its facts when the new session is complete.
    while not (socket.exists() and living_daemon(where)) and time.monotonic() < until:
        time.sleep(_POLL_INTERVAL_S)
    return True
