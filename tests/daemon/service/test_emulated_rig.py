"""The emulator that a daemon starts."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest
from armrig_core.errors import OperationError
from armrig_daemon.config import RigIdentity
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.service.host import emulated_rig
from armrig_daemon.service.host.emulated_rig import emulator_process
from msgspec.structs import replace

from tests.daemon.odd_bench import CONFIG

WITHIN_S = 600.0
"""A busy machine takes its time to load a program."""
_DAEMON = """
import os, subprocess, sys
from pathlib import Path
from armrig_daemon.config import Config
from armrig_daemon.service.host import emulated_rig

class Killed(subprocess.Popen):
    def __init__(self, *given, **how):
        super().__init__(*given, **how)
        os._exit(9)

subprocess.Popen = Killed
with emulated_rig.emulator_process(Config(), Path(sys.argv[1])):
    pass
"""


def test_an_emulator_ends_with_a_daemon_that_dies_during_the_start(tmp_path: Path) -> None:
    paths = os.pathsep.join(path for path in sys.path if path)

    # It has the same standard output: this is at its end once both have ended.
    done = subprocess.run(
        [sys.executable, "-c", _DAEMON, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": paths},
        stdout=subprocess.PIPE,
        timeout=WITHIN_S,
    )

    assert done.returncode == 9
    assert list(tmp_path.iterdir()) == []


class _Child:
    """Emulator that creates its socket, or ends."""

    def __init__(self, program: list[str], pass_fds: tuple[int, ...], stderr: object) -> None:
        options = dict(zip(program[4::2], program[5::2], strict=True))
        self.settings = msgspec.json.decode(options["--settings"], type=EmulatorSettings)
        self.parent = options["--parent"]
        self.code = None if "lives" in options["--port"] else 1
        if self.code is None:
            Path(options["--port"].removeprefix("unix:")).touch()
        self.stalls_fd = int(options["--stalls-fd"])
        assert pass_fds == (self.stalls_fd,)
        os.write(self.stalls_fd, b"5\n")
        self.ended: list[str] = []
        _CHILDREN.append(self)

    def poll(self) -> int | None:
        return self.code

    def terminate(self) -> None:
        self.ended.append("terminate")

    def wait(self) -> None:
        self.ended.append("wait")


_CHILDREN: list[_Child] = []


@pytest.fixture
def child(monkeypatch: pytest.MonkeyPatch) -> None:
    """Start no process."""
    monkeypatch.setattr(emulated_rig.subprocess, "Popen", _Child)


@pytest.mark.usefixtures("child")
def test_an_emulator_has_the_speed_of_the_line_and_ends_with_its_daemon(tmp_path: Path) -> None:
    config = replace(
        CONFIG, rig=RigIdentity(id="lives"), device=replace(CONFIG.device, baud=115_200)
    )

    with emulator_process(config, tmp_path) as (found, stalls_fd):
        child = _CHILDREN.pop()
        told = os.read(stalls_fd, 100)
        assert child.ended == []

    port = f"unix:{tmp_path}/lives-{os.getpid()}.line"
    assert found == replace(config, device=replace(config.device, port=port))
    assert child.settings == replace(CONFIG.emulator, baud=115_200)
    assert (child.parent, told) == (str(os.getpid()), b"5\n")
    assert child.ended == ["terminate", "wait"]


@pytest.mark.usefixtures("child")
def test_an_emulator_that_ends_at_once_is_reported(tmp_path: Path) -> None:
    with (
        pytest.raises(OperationError, match=rf"did not start at {tmp_path}/lab-2-\d+\.line"),
        emulator_process(CONFIG, tmp_path),
    ):
        pytest.fail("it has not started")

    assert _CHILDREN.pop().ended == ["terminate", "wait"]
