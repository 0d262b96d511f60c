"""If a busy machine ends its runs, the demonstration goes on, finally in virtual time."""

from __future__ import annotations

import subprocess
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig.cli import demo, demo_rig
from armrig.cli.demo_rig import Patience, TooBusyError
from armrig.rig import client as rig_module
from armrig.rig.client import Rig
from armrig.rig.replies import RefusedError
from armrig.rig.session import RigError
from armrig_core.commands import commands
from rich.console import Console

from tests.clients.fake_daemon import FakeDaemon
from tests.sampling import sampled

LATE = "the host was up to 264 ms late in the last second: try again"


@pytest.fixture(autouse=True)
def sockets(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep the sockets apart from those of a daemon of the user, and repeat no command."""
    monkeypatch.setattr(rig_module, "_REPEAT_S", 0.0)
    directory = tmp_path_factory.mktemp("s")
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(directory))


class StallingDaemon(FakeDaemon):
    """Refuses to arm, then ends a run by a fault, so many times each."""

    def __init__(self, endpoint: str, *, refusals: list[str], ends: list[str]) -> None:
        super().__init__(endpoint, demo.RIG)
        self._refusals, self._ends = refusals, ends

    def _carry_out(self, request: commands.Request) -> Any:
        if isinstance(request, commands.Arm) and self._refusals:
            raise ValueError(self._refusals.pop(0))
        if isinstance(request, commands.Run):
            self.outcome = self._ends.pop(0) if self._ends else "complete"
            self.fault = "" if self.outcome == "complete" else self.outcome
        if isinstance(request, commands.Reset):
            self.fault = ""
        return super()._carry_out(request)


def test_the_demonstration_repeats_runs_that_a_stall_ended(
    where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = StringIO()
    daemon = StallingDaemon(where, refusals=[LATE, LATE], ends=["WATCHDOG (load 3)"])

    with daemon, Rig(demo.RIG, connect=where) as rig:
        path = _recorded(rig, out)

    assert str(path) == daemon.recording
    said = [line for line in out.getvalue().splitlines() if line.startswith("  step again: ")]
    assert [line.endswith("264 ms late in the last second") for line in said] == [True, True, False]
    assert "WATCHDOG (load 3)" in said[2]


def test_the_demonstration_gives_up_after_three_ended_runs(
    where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = StringIO()
    daemon = StallingDaemon(where, refusals=[LATE] * 4, ends=["first", "second", "third", "x"])

    with (
        daemon,
        Rig(demo.RIG, connect=where) as rig,
        pytest.raises(TooBusyError, match=r"third$"),  # not where that recording is
    ):
        _recorded(rig, out)

    assert out.getvalue().count("again: ") == 6


def test_the_demonstration_gives_up_at_its_time_limit(
    where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit is 150 s after the beginning."""
    monkeypatch.setattr(demo_rig, "MAX_REAL_TIME_S", -1.0)
    daemon = StallingDaemon(where, refusals=[LATE] * 2, ends=[])

    with (
        daemon,
        Rig(demo.RIG, connect=where) as rig,
        pytest.raises(TooBusyError, match="264 ms late"),
    ):
        _recorded(rig, StringIO())


def test_a_permanent_refusal_is_reported_at_once(where: str) -> None:
    out, held = (
        StringIO(),
        "a student has the rig: wait until it is free, or end it with `armrig stop`",
    )
    daemon = StallingDaemon(where, refusals=[held], ends=[])

    with (
        daemon,
        Rig(demo.RIG, connect=where) as rig,
        pytest.raises(RefusedError, match=f"^{held}$"),
    ):
        _recorded(rig, out)

    assert out.getvalue() == ""


def test_a_rig_that_tripped_before_its_run_is_armed_again(where: str) -> None:
    """The watchdog runs from the arming on, so a refusal after it is due to the fault."""
    out = StringIO()
    daemon = TrippingDaemon(where, demo.RIG)

    with daemon, Rig(demo.RIG, connect=where) as rig:
        path = _recorded(rig, out)

    assert str(path) == daemon.recording
    assert daemon.names() == ["arm", "run", "reset", "arm", "run"]
    assert "again: " in out.getvalue()


def test_a_rig_tripped_after_a_refusal_is_reset(
    where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = LateTrippingDaemon(where, refusals=[LATE], ends=[])

    with daemon, Rig(demo.RIG, connect=where) as rig:
        path = _recorded(rig, StringIO())

    assert str(path) == daemon.recording
    assert daemon.fault == ""


def test_a_fault_that_remains_is_named_in_the_error(
    where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo_rig, "_SAFE_TIMEOUT_S", 0.0)
    daemon = FakeDaemon(where, demo.RIG)
    daemon.fault = "the device stopped by itself: WATCHDOG"

    with (
        daemon,
        Rig(demo.RIG, connect=where) as rig,
        pytest.raises(RigError, match=f"not ready after 0 s: {daemon.fault}"),
    ):
        demo_rig.wait_until_safe(rig)


class LateTrippingDaemon(StallingDaemon):
    """Trips while the rig is given back."""

    def _carry_out(self, request: commands.Request) -> Any:
        if isinstance(request, commands.Stop):
            self.fault = "no answer from the device for 70 ms"
        return super()._carry_out(request)


class TrippingDaemon(FakeDaemon):
    """Trips between the first arming and its run."""

    def _carry_out(self, request: commands.Request) -> Any:
        if isinstance(request, commands.Run) and self.names() == ["arm"]:
            self.asked.append(request)
            self.fault = "the device stopped by itself: WATCHDOG"
            raise ValueError("not the lease in force: arm first")
        if isinstance(request, commands.Reset):
            self.fault = ""
        return super()._carry_out(request)


@pytest.mark.exhaustive
@pytest.mark.parametrize("runtime", sampled(["/tmp/" + 100 * "x", "/dev/null/none"]))
def test_the_demonstration_continues_in_virtual_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, runtime: str
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", runtime)
    out, folder = StringIO(), tmp_path / "demo"

    demo.demo(folder, seconds=5, seed=1, console=Console(file=out, width=400))

    said = out.getvalue()
    assert "the demonstration goes on in virtual time" in said
    assert len(list(folder.glob("*.mcap"))) == 3
    assert (folder / "report.pdf").read_bytes().startswith(b"%PDF")


def test_an_interrupted_demonstration_leaves_no_player(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The player would write into a folder that is being removed."""
    players = []

    class Player(subprocess.Popen[bytes]):
        def __init__(self, *args: Any, **how: Any) -> None:
            super().__init__(*args, **how)
            players.append(self)

    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(subprocess, "Popen", Player)

    with pytest.raises(KeyboardInterrupt):
        demo.record_in_virtual_time(
            [], tmp_path, tmp_path / "armrig.toml", seed=1, meanwhile=interrupted
        )

    [player] = players
    assert player.returncode is not None


def test_the_report_names_recordings_in_virtual_time_and_the_reason() -> None:
    assert "virtual" not in " ".join(demo._remarks(3, 3, ""))
    assert "All recordings were made in virtual time" in demo._remarks(3, 0, "")[-1]
    remark = demo._remarks(3, 1, "too busy")[-1]
    assert remark.startswith("The last 2 of the recordings were made in virtual time")
    assert remark.endswith("could not emulate the rig in real time: too busy.")


def _recorded(rig: Rig, out: StringIO) -> Path:
    experiment = demo.Experiment("step", np.full(3, 1.0), {})
    console = Console(file=out, width=400)
    return demo_rig.recorded(rig, experiment, console, Patience([experiment]))
