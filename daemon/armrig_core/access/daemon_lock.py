"""Lock file of a daemon's socket, with facts about the daemon for the case that it is silent.

zenoh creates the file and holds its lock as long as the daemon lives. A killed daemon leaves the
file without a lock; a daemon that ends in order removes the file.
"""

from __future__ import annotations

import os
import re
import time
from contextlib import suppress
from pathlib import Path

import msgspec
from msgspec.structs import replace

from armrig_core.access.emulator_socket import lock_path
from armrig_core.access.endpoint import SERVICE_USER, require_trusted
from armrig_core.errors import InputError
from armrig_core.process.bounded import CONFIGURATION_LIMIT, read_bounded
from armrig_core.rig.emulated import SOCKET_PREFIX

_MODE = 0o640  # the group of a service may read which process serves a rig
_UNIX_SOCKET = "unixsock-stream/"
_REOPENED_S = 2.0
"""Longest wait for a deleted socket, in s; its daemon opens it again within 1 s."""
_POLL_INTERVAL_S = 0.02


class DaemonFacts(msgspec.Struct, frozen=True, kw_only=True):
    """Process of a daemon, and the port and speed, in bit/s, of its device."""

    pid: int
    port: str
    baud: int
    is_alive: bool = True


def absolute(port: str) -> str:
    """Return a port that has the same meaning in every folder."""
    kind = SOCKET_PREFIX if port.startswith(SOCKET_PREFIX) else ""
    return f"{kind}{Path(port.removeprefix(kind)).absolute()}"


def write_facts(socket: Path, facts: DaemonFacts) -> None:
    """Write the facts about this daemon into the lock file of its open socket."""
    path = lock_path(socket)
    path.write_bytes(msgspec.json.encode(facts))
    path.chmod(_MODE)


def read_facts(socket: Path) -> DaemonFacts | None:
    """Return the facts about the daemon of a socket; None if nothing is known."""
    path = lock_path(socket)
    with suppress(OSError, msgspec.DecodeError):
        facts = msgspec.json.decode(read_bounded(path, CONFIGURATION_LIMIT), type=DaemonFacts)
        # Not flock: a daemon that starts at this moment would not get the lock.
        held = rf" WRITE +{facts.pid} \S+:{path.stat().st_ino} "
        locks = Path("/proc/locks").read_text(encoding="ascii")
        return replace(facts, is_alive=re.search(held, locks) is not None)
    return None


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
