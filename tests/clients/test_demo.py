"""The demonstration leaves nothing running, and says what the daemon said."""

from __future__ import annotations

import subprocess
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from armrig import demo
from armrig.rig import Rig
from armrig.session import NoReplyError, RigError
from rich.console import Console


@pytest.fixture(autouse=True)
def sockets(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep the sockets apart from those of a daemon that the user may have."""
    directory = tmp_path_factory.mktemp("s")
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(directory))


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen[bytes]]:
    """Give the processes that the demonstration starts."""
    processes: list[subprocess.Popen[bytes]] = []

    class Kept(subprocess.Popen[bytes]):
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            processes.append(self)

    monkeypatch.setattr(subprocess, "Popen", Kept)
    return processes


def test_the_daemon_runs_while_it_is_needed_and_ends_when_that_fails(
    tmp_path: Path, started: list[subprocess.Popen[bytes]]
) -> None:
    """Whatever is raised inside, Ctrl-C too, stops daemon and emulator."""
    out = StringIO()
    with (
        pytest.raises(KeyboardInterrupt),
        demo.running(tmp_path, Console(file=out)),
        Rig(demo.RIG) as rig,
    ):
        _interrupted_when_safe(rig)

    [daemon] = started
    assert daemon.returncode == 0
    assert "daemon and emulator run" in out.getvalue()
    with pytest.raises(NoReplyError), Rig(demo.RIG):
        pass


def test_a_daemon_that_refuses_to_start_is_quoted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its own last line says what is wrong."""
    monkeypatch.setattr(demo, "_CONFIG", '[rig]\nid = "{rig}"\nname = "x"\n# {Ts} {directory}\n')

    with (
        pytest.raises(RigError, match=r"exit code 1: armrigd: .*name"),
        demo.running(tmp_path, Console(file=StringIO())),
    ):
        pass


def _interrupted_when_safe(rig: Rig) -> None:
    assert rig.status().phase == "safe"
    raise KeyboardInterrupt
