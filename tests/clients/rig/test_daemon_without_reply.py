"""A daemon or a service of this machine that is silent, dead or restarted."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh
from armrig.cli import main
from armrig.rig import client, remote_recording, session
from armrig.rig.client import Rig
from armrig.rig.collection import collect
from armrig.rig.remote_recording import RemoteRecorder, RemoteRecording
from armrig.rig.remote_source import Piece
from armrig.rig.session import NoReplyError, RigError, default_endpoint
from armrig_core.access import daemon_lock
from armrig_core.access.daemon_lock import (
    DaemonFacts,
    daemon_at,
    living_daemon,
    write_facts,
)
from armrig_core.access.emulator_socket import lock_path
from armrig_core.access.endpoint import endpoint
from armrig_core.commands.commands import StatusReport
from armrig_core.telemetry.history import Past
from msgspec.structs import replace

from tests.clients.fake_daemon import FakeDaemon, step_plan, unseen
from tests.clients.told import told

SAID = (
    "the service of rig 1 has stopped; `systemctl status armrigd@1`; what was recorded is in "
    "`armrig ls`"
)
PLAN = step_plan("a student")


class Service(FakeDaemon):
    """A daemon in the folder of a service, which can die as one does under systemd."""

    def __init__(self, services: Path) -> None:
        self.folder = services / "1"
        self.held: list[zenoh.Query] = []
        self.is_silent = self.dies_with_its_run = False
        super().__init__(endpoint("1", self.folder))

    def _answer(self, query: zenoh.Query) -> None:
        if self.is_silent:
            if not self.dies_with_its_run:
                self.held.append(query)
            return
        super()._answer(query)

    def status(self) -> StatusReport:
        """Return what `status` answers; there is none after the end of a run."""
        report = super().status()
        if self.dies_with_its_run and report.last_run and report.last_run.finished:
            self.is_silent = True
        return report

    def die(self) -> None:
        """End, and have systemd take the folder away."""
        self.session.close()
        shutil.rmtree(self.folder)


@pytest.fixture
def service(services: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Service]:
    """Give the service of rig 1 on a machine where services are installed."""
    for name in ("armrigd@.service", "1.toml"):
        (tmp_path / name).touch()
    monkeypatch.setattr(session, "UNIT", tmp_path / "armrigd@.service")
    monkeypatch.setattr(session, "of_rig", lambda rig: tmp_path / f"{rig}.toml")
    with Service(services) as service:
        yield service
        service.held.clear()


def test_a_stopped_service_is_reported_on_open_and_new_connections(service: Service) -> None:
    with Rig() as rig:
        service.die()
        with pytest.raises(NoReplyError) as here:
            rig.status()

    with pytest.raises(NoReplyError) as anew, Rig():
        pass
    with pytest.raises(NoReplyError, match="in another terminal: `armrig lab --rig 2`"), Rig("2"):
        pass
    assert (str(here.value), str(anew.value)) == (SAID, SAID)


def test_a_missing_reply_is_not_a_refusal(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The word Timeout is zenoh's, not a daemon's."""
    monkeypatch.setattr(client, "REPLY_S", 0.1)
    service.is_silent = True

    with Rig() as rig, pytest.raises(NoReplyError) as told:
        rig.reset()

    assert str(told.value) == SAID


@pytest.mark.parametrize("command", [["status"], ["watch"], ["collect", "step"], ["record"]])
def test_each_command_reports_a_stopped_service(
    service: Service,
    command: list[str],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    service.die()

    assert main(command) == 1
    assert capsys.readouterr().err == f"armrig: {SAID}\n"


def test_a_collection_reports_the_outcome_and_the_stopped_service(service: Service) -> None:
    service.outcome, service.dies_with_its_run = "the daemon was ended", True

    with pytest.raises(RigError) as told:
        collect(PLAN, rig="1", connect=None, tell=lambda _: None, display=unseen)

    assert str(told.value) == (
        "the run ended after 100 of 100 samples: the daemon was ended; recorded in "
        f"/nowhere/run.mcap; {SAID}"
    )


class _Pauses:
    """Source that is silent for these spans of a clock's seconds, with an answer after each."""

    def __init__(self, clock: list[float], *spans: tuple[float, float]) -> None:
        self._clock, self._spans = clock, spans

    def next_piece(self) -> Piece | None:
        self._clock[0] += 0.1
        if any(begin < self._clock[0] < end for begin, end in self._spans):
            return None
        return Piece(past=Past(bytes(16), 0, 0, ()), is_new_life=False, lost=0)


def test_a_recorder_reports_each_long_silence_once_with_its_length(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, told, session = [0.0], list[str](), None
    monkeypatch.setattr(remote_recording.time, "monotonic", lambda: clock[0])
    recording = RemoteRecording(
        path=tmp_path / "a.mcap", rig="7", endpoint="tls/lab:7447", tell=told.append
    )
    recorder = RemoteRecorder(session, recording)  # type: ignore[arg-type]
    recorder._row = _Pauses(clock, (1.05, 4.05), (5.05, 6.05), (7.05, 12.05))

    ended: Any = SimpleNamespace(is_set=lambda: False, wait=lambda _: False)
    recorder.record(ended, 15.0)

    assert told == [
        "rig 7 does not answer; waiting for it",
        "rig 7 answers again, after 3.1 s",
        "rig 7 does not answer; waiting for it",
        "rig 7 answers again, after 5.1 s",
    ]
    assert clock[0] == pytest.approx(15.1, abs=0.15)


def test_a_dead_daemon_of_this_user_does_not_hide_a_silent_service(
    service: Service, capsys: pytest.CaptureFixture[str]
) -> None:
    """ESTOP would reach the device of the dead daemon, which is another one."""
    own = Path(os.environ["XDG_RUNTIME_DIR"]) / "armrig"
    service.die()
    for folder, pid in ((own, 1), (service.folder, os.getpid())):
        folder.mkdir(mode=0o700)
        (folder / "1.sock").touch()
        write_facts(folder / "1.sock", DaemonFacts(pid=pid, port="/dev/other", baud=1))
    with lock_path(service.folder / "1.sock").open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)

        assert main(["stop"]) == 1

    assert "`sudo systemctl stop armrigd@1` ends it" in capsys.readouterr().err


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
def test_an_unresponsive_daemon_is_reported_with_a_way_to_stop_the_motor(
    command: str, socket: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    socket.touch()

    assert main([command]) == 1

    assert told(capsys) == (
        f"armrig: rig 1 at {default_endpoint('1')}: its daemon (process {FACTS.pid}) runs, but "
        f"does not answer: `kill -9 {FACTS.pid}` ends it, then the device stops the motor; or use "
        "the emergency switch\n"
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

    monkeypatch.setattr(daemon_lock, "time", SimpleNamespace(monotonic=lambda: 0.0, sleep=slept))

    with Rig("1") as rig:
        rig.stop()

    (daemon,) = opened
    assert daemon.names() == ["stop"]
    assert daemon_at(default_endpoint("1")) == FACTS
    daemon.__exit__()


@pytest.mark.usefixtures("_alive")
def test_a_lock_file_in_an_untrusted_directory_is_not_read(socket: Path) -> None:
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
