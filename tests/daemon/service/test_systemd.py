"""Reports to systemd, over a socket in its place."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from armrig_daemon.service.host.systemd import Notifier


@pytest.fixture(params=["path", "abstract"])
def systemd(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[tuple[socket.socket, str]]:
    """Give a socket, and its address as systemd writes it: @ is a zero byte."""
    path = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(path if request.param == "path" else f"\0{path}")
        listening.setblocking(False)
        yield listening, path if request.param == "path" else f"@{path}"


def _told(listening: socket.socket) -> list[str]:
    lines = []
    while True:
        try:
            lines.append(listening.recv(1000).decode())
        except BlockingIOError:
            return lines


def _close(notifier: Notifier) -> None:
    assert notifier._socket is not None
    notifier._socket.close()


def test_each_change_is_reported_to_systemd_once(systemd: tuple[socket.socket, str]) -> None:
    listening, address = systemd
    environ = {"NOTIFY_SOCKET": address, "HOME": "/"}
    notifier = Notifier(environ)

    notifier.ready()
    for line in ("safe", "safe", "armed", "safe"):
        notifier.status(line)
    notifier.progress()
    notifier.progress()
    notifier.stopping()
    _close(notifier)

    assert _told(listening) == [
        *("READY=1", "STATUS=safe", "STATUS=armed", "STATUS=safe"),
        *("WATCHDOG=1", "WATCHDOG=1", "STOPPING=1"),
    ]
    assert notifier.is_asked
    assert environ == {"HOME": "/"}


def test_an_unresponsive_systemd_does_not_block_the_service(
    systemd: tuple[socket.socket, str],
) -> None:
    listening, address = systemd
    notifier = Notifier({"NOTIFY_SOCKET": address})

    for n in range(2000):  # more than the queue of the socket holds
        notifier.status(str(n))
    _close(notifier)

    assert _told(listening)[0] == "STATUS=0"


def test_no_report_is_sent_without_systemd(tmp_path: Path) -> None:
    assert not Notifier({}).is_asked
    Notifier({}).ready()
    gone = Notifier({"NOTIFY_SOCKET": str(tmp_path / "nobody")})
    gone.stopping()
    _close(gone)
    assert gone.is_asked
