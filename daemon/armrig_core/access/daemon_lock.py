"""Lock file of a daemon's socket, with facts about the daemon for the case that it is silent.

zenoh creates the file and holds its lock as long as the daemon lives. A killed daemon leaves the
file without a lock; a daemon that ends in order removes the file.
"""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

import msgspec
from msgspec.structs import replace

from armrig_core.process.bounded import CONFIGURATION_LIMIT, read_bounded
from armrig_core.rig.emulated import SOCKET_PREFIX

_MODE = 0o640  # the group of a service may read which process serves a rig


class DaemonFacts(msgspec.Struct, frozen=True, kw_only=True):
    """Process of a daemon, and the port and speed, in bit/s, of its device."""

    pid: int
    port: str
    baud: int
    is_alive: bool = True


def lock_path(socket: Path) -> Path:
    """Return the path of the lock file of a socket."""
    return socket.with_name(f"{socket.name}.lock")


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
