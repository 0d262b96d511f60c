"""A daemon of this machine as a child leaves nothing running, and its last line is quoted."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from armrig.rig.client import Rig
from armrig.rig.local_daemon import require_running, running, stop
from armrig.rig.session import NoReplyError, RigError

from tests.integration.processes import settled

RIG = "child"


@pytest.fixture(autouse=True)
def sockets(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep the sockets apart from those of a daemon that the user may have."""
    directory = tmp_path_factory.mktemp("s")
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(directory))


def test_a_child_daemon_ends_with_its_context(tmp_path: Path) -> None:
    log = tmp_path / "armrigd.log"
    with (
        pytest.raises(KeyboardInterrupt),
        running(["--rig", RIG, "--emulate"], rig=RIG, log=log) as daemon,
        Rig(RIG) as rig,
    ):
        _interrupted_when_it_answers(rig)

    assert daemon.returncode == 0
    with pytest.raises(NoReplyError), Rig(RIG):
        pass


def test_the_error_of_a_daemon_that_fails_to_start_is_quoted(tmp_path: Path) -> None:
    config = tmp_path / "armrig.toml"
    config.write_text('[rig]\nid = "child"\nname = "x"\n')

    with (
        pytest.raises(RigError, match=r"exit code 78: .*name"),
        running(["--config", str(config), "--emulate"], rig=RIG, log=tmp_path / "log"),
    ):
        pass


def test_a_daemon_without_its_parent_ends_at_once() -> None:
    """The kernel reports only a parent that ends later."""
    program = [sys.executable, "-m", "armrig_daemon", "run", "--emulate", "--rig", RIG]

    done = subprocess.run([*program, "--parent", "999999999"], check=False, timeout=60)

    assert done.returncode == -signal.SIGTERM


@pytest.mark.parametrize(
    ("log", "quoted"),
    [
        ("armrigd: first\narmrigd: the port is taken\n\n", "the port is taken"),
        ("first\nlast of all", "last of all"),
        ("", "it printed nothing in "),
    ],
)
def test_the_last_line_of_an_ended_daemon_is_quoted(tmp_path: Path, log: str, quoted: str) -> None:
    path = tmp_path / "log"
    path.write_text(log)
    ended: Any = SimpleNamespace(poll=lambda: 78, returncode=78)

    with pytest.raises(RigError, match=f"^the daemon ended with exit code 78: {quoted}"):
        require_running(ended, path)
    require_running(SimpleNamespace(poll=lambda: None), path)  # type: ignore[arg-type]
    killed: Any = SimpleNamespace(poll=lambda: -9, returncode=-9)
    with pytest.raises(RigError, match=r"^the daemon was ended by SIGKILL"):
        require_running(killed, path)


class _Child:
    """Child process that ends by itself, by a signal, or only if it is killed."""

    def __init__(self, *, ends: bool, has_ended: bool = False) -> None:
        self.did: list[str] = []
        self._ends, self._has_ended = ends, has_ended

    def poll(self) -> int | None:
        return 0 if self._has_ended else None

    def send_signal(self, number: signal.Signals) -> None:
        self.did.append(number.name)

    def wait(self, timeout: float | None = None) -> None:
        self.did.append("ignores" if signal.getsignal(signal.SIGINT) is signal.SIG_IGN else "heeds")
        if not self._ends:
            self._ends = True
            raise subprocess.TimeoutExpired("armrigd", timeout or 0.0)

    def kill(self) -> None:
        self.did.append("killed")


@pytest.mark.parametrize(
    ("child", "did"),
    [
        (_Child(ends=True), ["SIGTERM", "ignores"]),
        (_Child(ends=False), ["SIGTERM", "ignores", "killed", "ignores"]),
        (_Child(ends=True, has_ended=True), []),
    ],
)
def test_ctrl_c_does_not_interrupt_the_end_of_a_daemon(child: Any, did: list[str]) -> None:
    before = signal.getsignal(signal.SIGINT)

    stop(child)

    assert child.did == did
    assert signal.getsignal(signal.SIGINT) is before


def _interrupted_when_it_answers(rig: Rig) -> None:
    assert rig.status().rig == RIG
    assert settled(rig) == "safe"
    raise KeyboardInterrupt
