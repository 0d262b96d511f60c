"""A daemon of this machine that lives and does not answer, or is dead."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from armrig.cli import main
from armrig.rig import silent_daemon
from armrig.rig.client import Rig
from armrig.rig.session import NoReplyError, default_endpoint
from armrig.rig.silent_daemon import daemon_at, living_daemon
from armrig_core.daemon_lock import DaemonFacts, lock_path, write_facts
from msgspec.structs import replace

from tests.clients.fake_daemon import FakeDaemon
from tests.clients.told import told

FACTS = DaemonFacts(pid=os.getpid(), port="/dev/rig", baud=115_200)


@pytest.fixture
def socket(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the path of the socket of this user's daemon, which is not there."""
    home = tmp_path_factory.mktemp("x")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(home))
    (home / "armrig").mkdir(mode=0o700)
    return home / "armrig" / "1.sock"


@pytest.fixture
def _alive(socket: Path) -> Iterator[None]:
    """Hold the lock of a daemon that lives."""
    write_facts(socket, FACTS)
    with lock_path(socket).open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


@pytest.mark.usefixtures("_alive")
@pytest.mark.parametrize("command", ["stop", "status"])
def test_a_living_daemon_that_does_not_answer_is_named_with_what_stops_the_motor(
    command: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(silent_daemon, "_REOPENED_S", 0.0)

    assert main([command]) == 1

    assert told(capsys) == (
        f"armrig: rig 1 at {default_endpoint('1')}: its daemon (process {FACTS.pid}) runs, but "
        f"does not answer: `kill {FACTS.pid}` ends it, then the device stops the motor; or use the "
        "emergency switch\n"
    )


@pytest.mark.usefixtures("_alive")
def test_a_client_waits_for_a_deleted_socket_of_a_living_daemon(
    socket: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[FakeDaemon] = []

    def slept(_: float) -> None:
        if opened:
            write_facts(socket, FACTS)
        else:
            lock_path(socket).unlink()  # the daemon does so, too
            opened.append(FakeDaemon(default_endpoint("1")).__enter__())

    monkeypatch.setattr(silent_daemon, "time", SimpleNamespace(monotonic=lambda: 0.0, sleep=slept))

    with Rig("1") as rig:
        rig.stop()

    (daemon,) = opened
    assert daemon.names() == ["stop"]
    assert daemon_at(default_endpoint("1")) == FACTS
    daemon.__exit__()


@pytest.mark.usefixtures("_alive")
def test_the_facts_in_a_stranger_s_directory_are_not_read(socket: Path) -> None:
    own = daemon_at(default_endpoint("1"))
    socket.parent.chmod(0o777)

    assert own == FACTS
    assert daemon_at(default_endpoint("1")) is None
    assert daemon_at("tls/lab:7447") is None


def test_a_killed_daemon_is_not_alive(socket: Path) -> None:
    write_facts(socket, FACTS)

    assert daemon_at(default_endpoint("1")) == replace(FACTS, is_alive=False)
    assert living_daemon(default_endpoint("1")) == 0


DEAD = f"its daemon (process {FACTS.pid}) is dead; "
AT_REST = f"rig 1, motor: at 0 V by `armrigd estop`; {DEAD}start it again, then `armrig reset`"


@pytest.mark.parametrize(
    ("code", "json", "said"),
    [
        (0, [], (AT_REST + "\n", "")),
        (0, ["--json"], ('{"rig":"1","stopped":true}\n', "")),
        (1, [], ("", f"armrig: rig 1: {DEAD}armrigd: estop: nothing sent\n")),
    ],
)
def test_a_stop_without_its_daemon_is_sent_to_the_device(
    code: int,
    json: list[str],
    said: tuple[str, str],
    socket: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write_facts(socket, FACTS)
    ran: list[list[str]] = []

    def run(command: list[str], **_: object) -> SimpleNamespace:
        ran.append(command[2:])
        return SimpleNamespace(returncode=code, stderr="armrigd: estop: nothing sent\n")

    monkeypatch.setattr("armrig.cli.rig.subprocess.run", run)

    assert main(["stop", *json]) == code

    device = ["--port", "/dev/rig", "--baud", "115200"]
    assert ran == [["armrig_daemon", "estop", "--rig", "1", *device]]
    assert tuple(capsys.readouterr()) == said


def test_a_stop_without_reply_names_the_emergency_switch(
    socket: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["stop"]) == 1

    assert told(capsys).endswith(
        "; whether the motor turns is unknown here; if it does, use the emergency switch\n"
    )
    with pytest.raises(NoReplyError, match="no rig runs here"), Rig("1"):
        pass
