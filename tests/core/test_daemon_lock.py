"""The lock file of a rig's daemon, while the daemon lives and after its death."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

import msgspec
import pytest
from armrig_core.access.daemon_lock import DaemonFacts, lock_path, read_facts, write_facts
from msgspec.structs import replace

FACTS = DaemonFacts(pid=os.getpid(), port="/dev/ttyACM0", baud=500_000)


@pytest.fixture
def socket(tmp_path: Path) -> Path:
    """Give the path of a socket."""
    return tmp_path / "1.sock"


def test_the_lock_shows_whether_its_daemon_is_alive(socket: Path) -> None:
    write_facts(socket, FACTS)
    with lock_path(socket).open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        living = read_facts(socket)
    dead = read_facts(socket)

    assert (living, dead) == (FACTS, replace(FACTS, is_alive=False))
    assert lock_path(socket).name == "1.sock.lock"


def test_a_lock_held_by_another_program_is_not_that_of_a_daemon(socket: Path) -> None:
    """A member of the group, who may read the file, could hold a lock of it."""
    write_facts(socket, FACTS)
    with lock_path(socket).open() as file:
        fcntl.flock(file, fcntl.LOCK_SH)
        shared = read_facts(socket)
        fcntl.flock(file, fcntl.LOCK_EX)
        lock_path(socket).write_bytes(msgspec.json.encode(replace(FACTS, pid=1)))
        other = read_facts(socket)

    assert shared is not None
    assert other is not None
    assert not shared.is_alive
    assert not other.is_alive


def test_only_the_owner_and_its_group_may_read_the_lock_file(socket: Path) -> None:
    write_facts(socket, FACTS)

    assert lock_path(socket).stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("text", ["", "{}", "[" * 5000, '{"pid": "1", "port": "", "baud": 1}'])
def test_a_lock_file_without_facts_is_ignored(text: str, socket: Path) -> None:
    missing = read_facts(socket)
    lock_path(socket).write_text(text)

    assert (missing, read_facts(socket)) == (None, None)
