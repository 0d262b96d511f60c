"""docs/class.md: its statements about a shared rig."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from armrig.rig.client import Rig
from armrig.rig.replies import BusyError, RefusedError
from armrig_daemon import config
from armrig_daemon.config import EX_CONFIG
from armrig_daemon.emulator.settings import EmulatorSettings

from tests.integration.processes import WITHIN_S, Bench

PAGE = (Path(__file__).parents[2] / "docs" / "class.md").read_text(encoding="utf-8")
SAID = [text.strip() for text in re.findall(r"```text\n(.*?)```", PAGE, re.DOTALL)]
LINES = [
    line for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL) for line in block.split("\n")
]
THERE = "unixsock-stream//run/armrig/1.sock"


@pytest.mark.exhaustive
def test_the_commands_of_the_page_for_students_are_valid(served: Bench) -> None:
    lines = [line for line in LINES if line.startswith("armrig ") and THERE in line]

    done = {}
    for line in lines:
        here = line.replace(THERE, served.endpoint).replace("--seconds 30", "--seconds 2")
        _, name, *arguments = shlex.split(here)
        if name != "watch":
            done[name] = served.armrig(name, *arguments)

    assert [*done] == ["status", "collect", "stop"]
    assert {name: run.returncode for name, run in done.items()} == dict.fromkeys(done, 0)


def test_the_group_may_open_the_socket_and_read_recordings(served: Bench) -> None:
    with served.rig() as rig:
        rig.arm("a test")
        recording = rig.run([1.0] * 10)

    socket = served.folder / "armrig" / "1.sock"
    assert oct(socket.stat().st_mode & 0o777) == "0o770"
    assert oct(recording.stat().st_mode & 0o777) == "0o640"


def test_a_held_rig_is_refused_with_the_name_of_its_holder(served: Bench) -> None:
    with served.rig() as holder, Rig("1", connect=served.endpoint) as other:
        holder.arm("group 3")
        with pytest.raises(RefusedError) as refused:
            other.arm("group 4")
        other.stop()
        with pytest.raises(RefusedError):
            holder.set(1.0)

    assert str(refused.value) in SAID
    assert not isinstance(refused.value, BusyError)


def test_a_second_daemon_of_the_same_rig_is_refused(served: Bench) -> None:
    second = served.start("armrig_daemon", "run", "--port", str(served.folder / "no-port"))

    assert second.popen.wait(WITHIN_S) == EX_CONFIG
    (said,) = [text for text in SAID if "already runs" in text]
    assert f"armrigd: error: {said.replace(THERE, served.endpoint)}" in second.said.splitlines()
    assert served.settled() == "safe"


def test_the_configuration_of_the_page_is_valid(tmp_path: Path) -> None:
    (text,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    path = tmp_path / "armrig.toml"
    path.write_text(text)

    limits = config.load([path], {}, {}).limits

    assert (limits.u_max_v, limits.revolutions, limits.alpha_rad) == (4.5, 40.0, 0.8)


def test_the_page_configures_the_emulated_rig_of_a_group() -> None:
    (line,) = [line for line in LINES if line.startswith("ARMRIG_")]
    environ = dict(word.split("=", 1) for word in shlex.split(line) if word.startswith("ARMRIG_"))

    emulator = config.load([], environ, {}).emulator

    assert emulator == EmulatorSettings(seed=3, arm={"J_1": 0.0021})
