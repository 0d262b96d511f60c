"""Messages between a daemon and systemd; a test replaces systemd."""

from __future__ import annotations

import select
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from armrig_daemon.config import EX_CONFIG
from armrig_daemon.service.service import EX_TEMPFAIL

from tests.integration.processes import WITHIN_S, Bench, Process


class Systemd:
    """Socket on which a service reports its state."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.settimeout(WITHIN_S)
        self.told: list[str] = []

    @property
    def env(self) -> dict[str, str]:
        """Variables that systemd sets for a service."""
        return {"NOTIFY_SOCKET": str(self._path)}

    def hear(self) -> str:
        """Return the next message."""
        self.told.append(self._socket.recv(4096).decode())
        return self.told[-1]

    def hear_until(self, line: str) -> list[str]:
        """Return the messages up to this line."""
        before = len(self.told)
        while self.hear() != line:
            pass
        return self.told[before:]

    def heard_within(self, seconds: float) -> list[str]:
        """Return all messages within a time."""
        before, until = len(self.told), time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            if select.select([self._socket], [], [], left)[0]:
                self.hear()
        return self.told[before:]

    def close(self) -> None:
        """Hear no more."""
        self._socket.close()


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[Systemd]:
    """Give a socket in systemd's place."""
    systemd = Systemd(tmp_path / "notify")
    yield systemd
    systemd.close()


@pytest.fixture
def daemon(bench: Bench, systemd: Systemd) -> Process:
    """Give a daemon of a rig that samples, started as systemd would."""
    bench.emulate()
    return bench.serve(systemd.env)


def test_a_service_reports_its_state_from_its_start_to_its_end(
    bench: Bench, systemd: Systemd, daemon: Process
) -> None:
    systemd.hear_until("READY=1")
    systemd.hear_until("STATUS=safe, nobody has it")
    with bench.rig() as rig:
        rig.arm("group 3")
        systemd.hear_until("STATUS=armed, group 3 has it")

    daemon.kill(signal.SIGTERM)

    systemd.hear_until("STOPPING=1")
    assert daemon.popen.wait(WITHIN_S) == 0


def test_a_reload_of_a_free_rig_ends_the_daemon_to_be_started_again(
    bench: Bench, daemon: Process
) -> None:
    """At this exit code systemd starts the daemon again, with the priority of a loop."""
    bench.configure(more="[limits]\nu_max_v = 4")

    daemon.kill(signal.SIGHUP)

    assert daemon.popen.wait(WITHIN_S) == EX_TEMPFAIL
    bench.serve()
    with bench.rig() as rig:
        assert rig.status().u_max == 4


def test_a_service_that_cannot_begin_is_never_ready(bench: Bench, systemd: Systemd) -> None:
    bench.use_terminal()
    bench.port.write_text("")

    daemon = bench.start(*("armrig_daemon", "run", "--config", str(bench.config)), env=systemd.env)

    assert daemon.popen.wait(WITHIN_S) == EX_CONFIG
    assert "READY=1" not in systemd.heard_within(0.1)
