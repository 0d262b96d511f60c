"""If a busy machine ends its runs, the demonstration goes on, finally in virtual time."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from armrig.cli import demo, demo_rig, main
from armrig.cli.demo_files import LIST
from armrig.excitation.demonstration import DemonstrationRun
from armrig.excitation.pace import pace_of
from armrig.rig import client as rig_module
from armrig.rig.client import Rig
from armrig.rig.replies import RefusedError
from armrig.rig.session import RigError
from armrig.rig.status import scheduling_line
from armrig_core.commands import commands
from armrig_core.rig.description import builtin

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

    def _carry_out(self, request: commands.DaemonRequest) -> Any:
        if isinstance(request, commands.ArmRequest) and self._refusals:
            raise ValueError(self._refusals.pop(0))
        if isinstance(request, commands.RunRequest):
            self.outcome = self._ends.pop(0) if self._ends else "complete"
            self.fault = "" if self.outcome == "complete" else self.outcome
        if isinstance(request, commands.ResetRequest):
            self.fault = ""
        return super()._carry_out(request)


def test_the_demonstration_repeats_runs_that_a_stall_ended(
    where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon = StallingDaemon(where, refusals=[LATE, LATE], ends=["WATCHDOG (load 3)"])

    with daemon, Rig(demo.RIG, connect=where) as rig:
        path = _recorded(rig)

    assert str(path) == daemon.recording
    said = [x for x in capsys.readouterr().err.splitlines() if x.startswith("step again: ")]
    assert [line.endswith("264 ms late in the last second") for line in said] == [True, True, False]
    assert "WATCHDOG (load 3)" in said[2]


@pytest.mark.parametrize(
    ("refusals", "ends", "left_s", "why"),
    [
        ([LATE] * 4, ["first", "second", "third", "x"], 60.0, "third$"),
        ([LATE] * 2, [], -1.0, "264 ms late"),
    ],
)
def test_the_demonstration_gives_up_after_three_ended_runs_or_at_its_time_limit(
    refusals: list[str], ends: list[str], left_s: float, why: str, where: str
) -> None:
    daemon = StallingDaemon(where, refusals=refusals, ends=ends)

    with daemon, Rig(demo.RIG, connect=where) as rig, pytest.raises(RigError, match=why):
        _recorded(rig, left_s)


def test_a_permanent_refusal_is_reported_at_once(
    where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    held = "a student has the rig: wait until it is free, or end it with `armrig stop`"
    daemon = StallingDaemon(where, refusals=[held], ends=[])

    with daemon, Rig(demo.RIG, connect=where) as rig, pytest.raises(RefusedError, match=f"^{held}"):
        _recorded(rig)

    assert capsys.readouterr().err == ""


def test_a_rig_that_tripped_before_its_run_is_armed_again(where: str) -> None:
    """The watchdog runs from the arming on, so a refusal after it is due to the fault."""
    daemon = TrippingDaemon(where, demo.RIG)

    with daemon, Rig(demo.RIG, connect=where) as rig:
        path = _recorded(rig)

    assert str(path) == daemon.recording
    assert daemon.names() == ["arm", "run", "reset", "arm", "run"]


def test_a_rig_tripped_after_a_refusal_is_reset(where: str) -> None:
    daemon = LateTrippingDaemon(where, refusals=[LATE], ends=[])

    with daemon, Rig(demo.RIG, connect=where) as rig:
        path = _recorded(rig)

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


@pytest.mark.parametrize(
    ("host", "line"),
    [
        ({}, "not known yet"),
        ({"fifo": 80, "refused": []}, "real-time scheduling at priority 80"),
        (
            {"fifo": 0, "refused": ["SCHED_FIFO (…)", "mlockall (…)", "/dev/cpu_dma_latency (…)"]},
            "no real-time scheduling: the host refuses 3 settings; `armrig doctor` shows the "
            "remedies",
        ),
        (
            {"fifo": 80, "refused": "mlockall (…)"},
            "real-time scheduling at priority 80: the host refuses 1 setting; `armrig doctor` "
            "shows the remedies",
        ),
    ],
)
def test_the_demonstration_describes_the_scheduling_in_one_line(
    host: dict[str, Any], line: str
) -> None:
    assert scheduling_line(host) == line


class LateTrippingDaemon(StallingDaemon):
    """Trips while the rig is given back."""

    def _carry_out(self, request: commands.DaemonRequest) -> Any:
        if isinstance(request, commands.StopRequest):
            self.fault = "no answer from the device for 70 ms"
        return super()._carry_out(request)


class TrippingDaemon(FakeDaemon):
    """Trips between the first arming and its run."""

    def _carry_out(self, request: commands.DaemonRequest) -> Any:
        if isinstance(request, commands.RunRequest) and self.names() == ["arm"]:
            self.asked.append(request)
            self.fault = "the device stopped by itself: WATCHDOG"
            raise ValueError("not the lease in force: arm first")
        if isinstance(request, commands.ResetRequest):
            self.fault = ""
        return super()._carry_out(request)


@pytest.mark.exhaustive
@pytest.mark.parametrize("runtime", sampled(["/tmp/" + 100 * "x", "/dev/null/none"]))
def test_the_demonstration_continues_in_virtual_time(
    runtime: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", runtime)
    folder = tmp_path / "demo"

    assert main(["demo", "--directory", str(folder), "--seconds", "5"]) == 0

    assert "the demonstration goes on in virtual time" in capsys.readouterr().err
    assert len(list(folder.glob("*.mcap"))) == 3
    assert (folder / "report.pdf").read_bytes().startswith(b"%PDF")


def test_the_report_names_recordings_in_virtual_time_and_the_reason() -> None:
    assert "virtual" not in " ".join(demo._remarks(3, 3, ""))
    assert "All recordings were made in virtual time" in demo._remarks(3, 0, "")[-1]
    remark = demo._remarks(3, 1, "too busy")[-1]
    assert remark.startswith("The last 2 of the recordings were made in virtual time")
    assert remark.endswith("could not emulate the rig in real time: too busy.")


def _recorded(rig: Rig, left_s: float = 60.0) -> Path:
    experiment = DemonstrationRun("step", np.full(3, 1.0), {})
    return demo_rig.record_experiment(rig, experiment, time.monotonic() + left_s)


@pytest.mark.parametrize(
    ("name", "high"), [("arm", 4.5), ("rc", 4.5), ("tclab", 1.07), ("optoshield", 1.125)]
)
def test_the_levels_of_another_rig_keep_its_limits(name: str, high: float) -> None:
    """1.07 V heats TCLab to 47 °C; its limit is 50 °C."""
    assert pace_of(builtin(name), None).high == high


@pytest.mark.parametrize("how", [["--virtual"], ["--rig-file", "rc"], []])
def test_a_repeated_demonstration_writes_its_own_files_again_and_says_so(
    how: list[str], short_demo: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", *how]) == 0
    before = names_in(short_demo)
    assert "earlier demonstration" not in capsys.readouterr().err

    assert main(["demo", *how]) == 0

    assert "demo: 3 files of an earlier demonstration will be replaced" in capsys.readouterr().err
    assert names_in(short_demo) == before == ["armrig.toml", "data.svg", LIST, "report.pdf"]


@pytest.mark.parametrize("how", [["--virtual"], ["--rig-file", "rc"], []])
@pytest.mark.parametrize("name", ["report.pdf", "data.svg", "armrig.toml", "demo-x.mcap", LIST])
@pytest.mark.parametrize("is_changed", [True, False])
def test_a_demonstration_overwrites_no_file_of_the_user(
    is_changed: bool,
    name: str,
    how: list[str],
    short_demo: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if is_changed:
        assert main(["demo", *how]) == 0
    short_demo.mkdir(exist_ok=True)
    (short_demo / name).write_text("mine\n")
    before = names_in(short_demo)
    capsys.readouterr()

    assert main(["demo", *how]) == 1

    said = capsys.readouterr().err
    assert f"demo/{name}: is not a file of an earlier demonstration, or was changed" in said
    assert "--directory FOLDER" in said
    assert (short_demo / name).read_text() == "mine\n"
    assert names_in(short_demo) == before


def test_an_interrupted_demonstration_can_be_repeated(
    short_demo: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(demo, "_write_report", lambda *_: Path("nowhere/report.pdf").read_bytes())
        assert main(["demo", "--virtual"]) == 1
    assert "armrig.toml" in names_in(short_demo)

    assert main(["demo", "--virtual"]) == 0


def names_in(folder: Path) -> list[str]:
    """Return the names of the files in a folder."""
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def short_demo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Replace the experiments and the study of a demonstration; give the folder of its files."""

    def report_of(_: list[Path], __: list[str], folder: Path) -> tuple[Any, Path]:
        for name in ("data.svg", "report.pdf"):
            (folder / name).write_text(f"{time.monotonic_ns()}")
        return SimpleNamespace(models=[], recordings=[], of_arm=True), folder / "report.pdf"

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(demo, "_record", lambda *_: "no time")
    monkeypatch.setattr(demo, "record_in_virtual_time", lambda *_, **__: [])
    monkeypatch.setattr(demo, "_write_report", report_of)
    monkeypatch.setattr(demo, "_text", lambda *_: "")
    monkeypatch.setattr("armrig.excitation.demonstration.experiments", lambda *_: [])
    return tmp_path / "demo"
