"""Sockets on which a process listens."""

from __future__ import annotations

import contextlib
from pathlib import Path

_LISTENS = "0A"  # TCP_LISTEN of tcp_states.h
_INODE = {"tcp": 9, "tcp6": 9, "udp": 9, "udp6": 9, "raw": 9, "raw6": 9, "packet": 8}


def inodes(pid: int) -> set[str]:
    """Return the inodes of the sockets of a process, as the tables of /proc/net have them."""
    links = []
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed since it was listed
            links.append(str(descriptor.readlink()))
    return {link[8:-1] for link in links if link.startswith("socket:[")}


def sockets(pid: int) -> dict[str, list[str]]:
    """Return ports of TCP at which a process listens, and all its sockets of other kinds."""
    of_process = inodes(pid)
    found = {}
    for table, inode in _INODE.items():
        rows = [row.split() for row in Path(f"/proc/net/{table}").read_text().splitlines()[1:]]
        own = [row for row in rows if row[inode] in of_process]
        found[table] = [r[1] for r in own if not table.startswith("tcp") or r[3] == _LISTENS]
    return {table: where for table, where in found.items() if where}
