"""A daemon of this machine as a child leaves nothing running, and its last line is quoted."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from armrig.rig.client import Rig
from armrig.rig.local_daemon import running
from armrig.rig.session import NoReplyError, RigError

RIG = "child"


@pytest.fixture(autouse=True)
def sockets(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep the sockets apart from those of a daemon that the user may have."""
    directory = tmp_path_factory.mktemp("s")
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(directory))


def test_it_answers_while_it_is_needed_and_ends_when_that_fails(tmp_path: Path) -> None:
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


def test_one_that_refuses_to_start_is_quoted(tmp_path: Path) -> None:
    config = tmp_path / "armrig.toml"
    config.write_text('[rig]\nid = "child"\nname = "x"\n')

    with (
        pytest.raises(RigError, match=r"exit code 78: .*name"),
        running(["--config", str(config), "--emulate"], rig=RIG, log=tmp_path / "log"),
    ):
        pass


def test_one_whose_parent_was_killed_before_it_looked_ends_at_once() -> None:
    """The kernel reports only a parent that ends later."""
    program = [sys.executable, "-m", "armrig_daemon", "run", "--emulate", "--rig", RIG]

    done = subprocess.run([*program, "--parent", "999999999"], check=False, timeout=60)

    assert done.returncode == -signal.SIGTERM


def _interrupted_when_it_answers(rig: Rig) -> None:
    assert rig.status().rig == RIG
    raise KeyboardInterrupt
