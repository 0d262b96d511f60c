"""The file of the Unix socket is deleted while the daemon runs."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from armrig.rig.session import open_session
from armrig_core.access.daemon_lock import DaemonFacts, read_facts
from armrig_core.access.emulator_socket import lock_path
from armrig_core.telemetry.topics import stream_key
from armrig_daemon.service.publish import MAX_DELETED, Session
from armrig_daemon.service.socket_file import SocketFile
from zenoh.handlers import RingChannel

STATE = stream_key("1", "state")
FACTS = DaemonFacts(pid=os.getpid(), port="/dev/ttyACM0", baud=500_000)


@pytest.fixture
def path() -> Iterator[Path]:
    """Give a socket's path; not pytest's own directory, whose path may be too long."""
    with tempfile.TemporaryDirectory(prefix="armrig-") as directory:
        yield Path(directory) / "armrig" / "1.sock"


@pytest.fixture
def session(path: Path) -> Iterator[Session]:
    """Give the session of a service."""
    path.parent.mkdir(mode=0o700)
    with Session(f"unixsock-stream/{path}", "1", lambda: None) as opened:
        yield opened


@pytest.mark.parametrize("deleted", ["socket", "lock", "folder"])
def test_a_deleted_socket_is_opened_again(path: Path, session: Session, deleted: str) -> None:
    watched = SocketFile(path, FACTS, session.open_socket)
    where = f"unixsock-stream/{path}"
    with open_session(where, rig="1") as old:
        heard = old.declare_subscriber(STATE, RingChannel(1))
        unchanged = watched.look()
        if deleted == "folder":
            shutil.rmtree(path.parent)
        else:
            {"socket": path, "lock": lock_path(path)}[deleted].unlink()

        line = watched.look()

        assert unchanged == ""
        assert line == f"{path}: another program deleted this socket; it is open again"
        assert watched.look() == ""
        with open_session(where, rig="1") as new:
            also = new.declare_subscriber(STATE, RingChannel(1))
            while also.try_recv() is None:  # a subscription takes a moment to arrive
                session.put("state", b"ours")
        assert heard.recv().payload.to_bytes() == b"ours"
    assert read_facts(path) == FACTS


def test_the_socket_of_another_program_is_not_replaced_and_reported_once(path: Path) -> None:
    path.parent.mkdir(mode=0o700)
    path.touch()
    opened: list[str] = []
    watched = SocketFile(path, FACTS, lambda: opened.append("open") or "")
    (path.parent / "other").touch()
    (path.parent / "other").rename(path)

    lines = watched.look(), watched.look()

    assert "deleted, and another program listens there" in lines[0]
    assert (lines[1], opened) == ("", [])


def test_opening_again_is_tried_until_it_succeeds_and_its_failure_is_reported_once(
    path: Path,
) -> None:
    path.parent.mkdir(mode=0o700)
    path.touch()
    faults = iter(["no room", "no room", ""])
    watched = SocketFile(path, FACTS, lambda: next(faults))
    path.unlink()

    lines = [watched.look() for _ in range(3)]

    end = "no client can connect: restart armrigd"
    assert lines[:2] == [f"{path}: deleted, no room; {end}", ""]
    assert lines[2].endswith("it is open again")


def test_the_number_of_sessions_is_limited(path: Path, session: Session) -> None:
    watched = SocketFile(path, FACTS, session.open_socket)
    lines = []
    for _ in range(MAX_DELETED + 1):
        path.unlink()
        lines.append(watched.look())

    assert all(line.endswith("it is open again") for line in lines[:-1])
    assert f"deleted, for the {MAX_DELETED + 1}th time; no client can connect" in lines[-1]
