"""`armrig collect`: its inputs, its refusals and its ends."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.cli import main, runs
from armrig.excitation.named_signals import realisations
from armrig.rig.collection import Collected, Plan
from armrig_core.commands import commands
from armrig_core.commands.commands import Rehearsal
from armrig_core.control.control_law import LawOutput, Reference
from armrig_core.rig.description import Input
from armrig_core.telemetry import telemetry

from tests.clients.fake_daemon import FakeDaemon
from tests.clients.made_recordings import gap, of_the_arm, sample, timing, written
from tests.clients.running import running
from tests.clients.told import told
from tests.sampling import sampled


@pytest.mark.parametrize(
    ("arguments", "kinds", "own"),
    [
        (["blackbox", "--a", "0.3", "--seed", "5", "--validation"], 2, {"a": 0.3, "seed": 5}),
        (["greybox", "--input", "prbs", "--a", "0.3", "--seed", "5"], 1, {"seed": 5}),
        (["step", "--at", "0.7"], 1, {"at": 0.7}),
        (["staircase", "--levels", "4"], 1, {"levels": 4}),
        (["bla", "--periods", "4", "--realisations", "3", "--seed", "5"], 3, {"periods": 4}),
    ],
)
def test_every_option_of_a_collection_reaches_its_plan(
    arguments: list[str], kinds: int, own: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[tuple[Plan, str, str | None]] = []

    def collected(plan: Plan, *, rig: str, connect: str | None, tell: object) -> Collected:
        made.append((plan, rig, connect))
        return Collected(Path("a.mcap"), 3, 0.02, None, f"run-{len(made)}", None)

    monkeypatch.setattr("armrig.rig.collection.collect", collected)
    shared = ["--low", "1.25", "--high", "3.5", "--seconds", "4", "--Ts", "0.02", "--name", "odd-1"]
    shared += ["--pacing", "exchange", "--owner", "a class", "--dead-man", "3", "--rig", "7"]

    assert main(["collect", *arguments, *shared, "--connect", "tcp/far:7447"]) == 0

    assert len(made) == kinds
    for plan, rig, connect in made:
        of_the_run = (plan.Ts, plan.pacing, plan.owner, plan.dead_man, plan.seconds)
        assert of_the_run == (0.02, "exchange", "a class", 3.0, 4.0)
        assert (rig, connect) == ("7", "tcp/far:7447")
        assert plan.experiment.removeprefix(arguments[0]) in ("-odd-1", "-validation-odd-1")
        assert plan.without_arm == (arguments[0] == "greybox")
        assert not plan.default_levels
        u = plan.make(200, 0.02)
        near = 0.5 if arguments[0] == "bla" else 1e-9  # its draws share a scale
        assert 1.25 - 1e-9 <= u.min() <= 1.25 + near
        assert 3.5 - near <= u.max() <= 3.5 + 1e-9
        assert plan.details.items() >= {"low": 1.25, "high": 3.5}.items()
    assert made[0][0].details.items() >= own.items()
    if kinds == 2:
        assert made[1][0].details["validation_of"] == "run-1"
        assert made[1][0].details["seed"] == 6
    step = made[0][0].make(200, 0.02)
    assert arguments[0] != "step" or (step[:35].max(), step[35:].min()) == (1.25, 3.5)


def law_file(folder: Path) -> Path:
    law = armrig.control.ControlLaw(
        Ts_us=20_000,
        outputs=(LawOutput(name="alpha", unit="rad"),),
        reference=Reference(name="velocity", unit="rad/s", low=0, high=8),
        A=(),
        B=(),
        C=(),
        D=1.0,
        x0=(),
    )
    (folder / "law.json").write_bytes(law.text)
    return folder / "law.json"


def test_every_option_of_a_control_run_reaches_its_plan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plans: list[Plan] = []

    def collected(plan: Plan, **_: object) -> Collected:
        plans.append(plan)
        return Collected(Path("a.mcap"), 3, 0.02, None, "run", None)

    monkeypatch.setattr("armrig.rig.collection.collect", collected)
    file = law_file(tmp_path)
    options = ["--reference", "staircase", "--levels", "3", "--low", "2", "--high", "4"]
    options += ["--dither", "0.1", "--seed", "7", "--seconds", "10", "--unstable", "--unmonitored"]

    assert main(["collect", "control", str(file), *options, "--name", "mine"]) == 0

    [plan] = plans
    assert (plan.Ts, plan.pacing, plan.seconds, plan.dead_man) == (0.02, "exchange", 10.0, 1.0)
    assert (plan.experiment, plan.law) == ("control-mine", armrig.control.load_law(file))
    assert (plan.unstable, plan.unmonitored) == (True, True)
    levels = {"reference": "staircase", "low": 2.0, "high": 4.0, "levels": 3}
    assert plan.details == levels | {"dither": 0.1, "seed": 7}
    r = plan.make(500, 0.02)
    assert (r.size, r.min(), r.max()) == (500, 1.9, 4.1)


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ([], "--seconds is missing: the law has no model of the plant"),
        (["--seconds", "5", "--Ts", "0.01"], "--Ts 0.01: the law has Ts = 0.02 s"),
        (["--seconds", "5", "--dead-man", "0"], "--dead-man 0: control stops if this program dies"),
        (["--seconds", "5", "--high", "9"], "the law allows 0 to 8"),
        (["--seconds", "5", "--reference", "r.csv"], "--seconds 5: a file has its own length"),
        (["--reference", "none.csv"], "none.csv"),
    ],
)
def test_a_control_run_is_refused_before_the_rig_is_armed(
    options: list[str],
    error: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("armrig.rig.collection.collect", pytest.fail)

    assert main(["collect", "control", str(law_file(tmp_path)), *options]) != 0

    assert error in told(capsys)


@pytest.mark.parametrize(
    ("levels", "volts"),
    [
        (["--low", "power=20", "--high", "power=80"], (1.0, 4.0)),
        (["--high", "power=80"], (0.5, 4.0)),
        (["--low", "power=20", "--high", "3.5"], (1.0, 3.5)),
        (["--low", "cold=30", "--high", "cold=10"], (2.0, 4.0)),
    ],
)
def test_a_level_with_the_name_of_the_input_is_its_own_value(
    levels: list[str], volts: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An inverting amplifier has its highest value at the lowest voltage."""
    inverting = Input(name="cold", per_volt=-10.0, offset=50.0)
    known = inverting if "cold" in levels[1] else Input(name="power", unit="%", per_volt=20.0)
    plans: list[Plan] = []

    def collected(plan: Plan, **_: object) -> Collected:
        plans.append(plan)
        return Collected(Path("a.mcap"), 3, 0.02, None, "run", None)

    monkeypatch.setattr("armrig.rig.collection.collect", collected)
    monkeypatch.setattr("armrig.cli.runs._input_of", lambda run: known)

    assert main(["collect", "step", *levels]) == 0

    assert (plans[0].details["low"], plans[0].details["high"]) == volts


@pytest.mark.parametrize(
    ("level", "error"),
    [
        ("torque=2", "the input of rig 1 is power in %; a number without a name is a voltage"),
        ("power=", "'power=' is no voltage, such as 2.5, and no value of the input, such as"),
    ],
)
def test_a_level_of_another_name_is_refused(
    level: str, error: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    known = Input(name="power", unit="%", per_volt=20.0)
    monkeypatch.setattr("armrig.cli.runs._input_of", lambda run: known)

    assert main(["collect", "step", "--low", level]) != 0

    assert error in told(capsys)


def test_collect_greybox_refuses_a_rig_with_its_arm_on(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["collect", "greybox", "--seconds", "2", "--connect", where]) == 1
    asked, said = daemon.names(), told(capsys)
    assert main(["collect", "blackbox", "--seconds", "2", "--connect", where]) == 0

    assert asked == []
    assert "rig 1 has its arm on: remove the rotating part (handout, figure 6)" in said
    assert "[arm] removed = true" in said


@pytest.mark.parametrize("arm_removed", [False, True])
def test_collect_blackbox_reports_a_removed_arm(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str], *, arm_removed: bool
) -> None:
    daemon.arm_removed = arm_removed

    assert main(["collect", "blackbox", "--seconds", "2", "--connect", where]) == 0

    said = capsys.readouterr().err
    assert ("rig 1 has no arm ([arm] removed)" in said) == arm_removed


@pytest.mark.parametrize(
    ("given", "seconds", "samples"),
    [
        (["--seconds", "1.57", "--periods", "3"], 1.57, 156),
        (["--period", "2", "--periods", "4"], 8.0, 800),
        (["--periods", "2"], 10.0, 1000),
    ],
)
def test_each_recording_of_a_bla_has_whole_periods_and_names_them(
    given: list[str], seconds: float, samples: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []
    monkeypatch.setattr("armrig.cli.runs.collect_each", lambda each, _: asked.extend(each))
    more = ["--realisations", "3", "--seed", "4", "--low", "1", "--high", "3"]

    assert main(["collect", "bla", *given, *more]) == 0

    assert [one.seconds for one in asked] == [pytest.approx(seconds)] * 3
    n = int(given[-1])
    wanted = realisations(samples, 3, 1.0, 3.0, 4, periods=n)
    for r, one in enumerate(asked):
        u = one.make(round(seconds * 100), 0.01)
        np.testing.assert_array_equal(u, wanted[r])
        of = {"input": "multisine", "low": 1.0, "high": 3.0, "periods": n}
        assert one.details == of | {"realisations": 3, "seed": 4, "realisation": r}


@pytest.mark.parametrize("name", ["telegraph", "prbs", "white", "multisine"])
def test_collect_validation_also_plays_the_next_seed(
    name: str, daemon: FakeDaemon, where: str
) -> None:
    arguments = ["collect", "blackbox", "--input", name, "--seed", "7", "--seconds", "1"]
    arguments += ["--validation", "--name", "monday", "--connect", where]

    assert main(arguments) == 0

    first, second = (r for r in daemon.asked if isinstance(r, commands.RunRequest))
    kinds = [first.experiment, second.experiment]
    assert kinds == ["blackbox-monday", "blackbox-validation-monday"]
    assert [r.details["seed"] for r in (first, second)] == [7, 8]
    assert {r.details["input"] for r in (first, second)} == {name}
    assert first.u != second.u
    assert "validation_of" not in first.details
    assert second.details["validation_of"] == "r1"


def test_collect_plays_the_voltages_of_a_file(
    daemon: FakeDaemon, where: str, tmp_path: Path
) -> None:
    file = tmp_path / "mine.csv"
    file.write_text("t,u\n" + "".join(f"{k / 100},{k % 5}\n" for k in range(40)))

    assert main(["collect", "blackbox", "--file", str(file), "--connect", where]) == 0

    [run] = [r for r in daemon.asked if isinstance(r, commands.RunRequest)]
    assert run.u == [k % 5 for k in range(40)]
    assert run.details == {"input": "csv", "file": "mine.csv"}


def test_collect_prints_the_verdict_on_the_data(
    daemon: FakeDaemon, where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon.recording = str(written(tmp_path, of_the_arm(armrig.telegraph(500, 0.05, 2.45, 2.55))))

    assert main(["collect", "blackbox", "--connect", where]) == 0
    said = capsys.readouterr()
    assert main(["collect", "blackbox", "--connect", where, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    verdict = facts["verdict"]

    assert said.out == f"{daemon.recording}\n"
    assert "3000 samples are on the disk; the data can be used, with care" in said.err
    assert facts["synced"] == facts["samples"] == 3000
    assert "use levels with a larger difference" in said.err
    assert verdict["usable"] is True
    assert {f["about"]: f["level"] for f in verdict["findings"]}["signal"] == "warning"


def test_unusable_data_are_a_failure_and_end_the_collection(
    daemon: FakeDaemon, where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon.recording = str(written(tmp_path, of_the_arm(np.full(500, 2.0))))

    assert main(["collect", "blackbox", "--validation", "--connect", where]) == 1

    said = capsys.readouterr()
    assert said.out == f"{daemon.recording}\n"
    assert "the data cannot be used: the input never changes" in said.err
    assert daemon.names().count("run") == 1


def test_the_progress_bar_shows_lateness_gaps_and_queue(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    report = timing(0)
    report.wake_lateness_us.p99 = 123.0  # of the loop, which is not what `info` calls lateness
    report.queue_depth.p50, report.queue_depth.n = 17, 100
    late = {"t_host_ns": sample(2).t_sched_ns + 456_000}
    messages = [
        ("sample", telemetry.encode_sample(sample(0, flags=0, t_host_ns=sample(9).t_host_ns))),
        ("gap", gap(1, 1, 0.0).SerializeToString()),
        ("sample", telemetry.encode_sample(sample(2, **late))),
        ("gap", gap(3, 2, 1.0).SerializeToString()),
        ("timing", report.SerializeToString()),
    ]

    def publish() -> None:
        while messages:
            stream, data = messages.pop(0)
            daemon.session.put(f"rig/1/{stream}", data)

    daemon.during_run = publish
    daemon.polls_per_run = 5

    assert main(["collect", "step", "--connect", where]) == 0

    said = " ".join(capsys.readouterr().err.split())
    assert "host late p99 456 µs, missing 2, queue 17" in said


def test_collect_reports_the_rehearsed_motion(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon.rehearsal = Rehearsal(revolutions=3.5, alpha_rad=0.2, turned_rad=21.0)

    assert main(["collect", "step", "--connect", where]) == 0
    said = capsys.readouterr()
    assert main(["collect", "step", "--connect", where, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)

    assert said.out == "/nowhere/run.mcap\n"
    assert "the chassis turns 3.5 times and ends 1203° from its start" in said.err
    assert "the arm deflects by up to 11.5°" in said.err
    assert told["rehearsal"]["revolutions"] == 3.5


@pytest.mark.parametrize(("given", "dead_man"), [([], 1.0), (["3"], 3.0), (["0"], None)])
def test_a_collection_ends_with_its_program_by_default(
    given: list[str], dead_man: float | None, daemon: FakeDaemon, where: str
) -> None:
    """A user who closes the terminal expects the motor to stop."""
    option = ["--dead-man", *given] if given else []

    assert main(["collect", "step", *option, "--connect", where]) == 0

    [run] = [r for r in daemon.asked if isinstance(r, commands.RunRequest)]
    assert run.dead_man == dead_man
    assert ("renew" in daemon.names()) == (dead_man is not None)


def test_a_run_that_ends_early_is_a_failure(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon.outcome = "the host paused for 68 ms"

    assert main(["collect", "step", "--connect", where]) == 1

    said = capsys.readouterr()
    assert said.out == ""
    assert "the host paused for 68 ms; recorded in /nowhere/run.mcap" in said.err
    assert "no fault is latched: repeat the command" in said.err


@pytest.mark.parametrize(
    ("number", "way"),
    sampled(
        [
            (signal.SIGINT, "interrupted: a stop (0 V) was sent to rig 1"),
            (signal.SIGTERM, "ended by SIGTERM"),
            (signal.SIGHUP, "ended by SIGHUP"),
        ],
        2,
    ),
)
def test_a_signal_that_ends_a_collection_stops_the_rig(
    number: signal.Signals, way: str, daemon: FakeDaemon, where: str
) -> None:
    daemon.polls_per_run = 10_000
    polled = threading.Event()
    daemon.during_run = polled.set
    program = [sys.executable, "-m", "armrig", "collect", "blackbox", "--connect", where]
    with running(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as collecting:
        assert polled.wait(60)
        collecting.send_signal(number)
        out, said = collecting.communicate(timeout=30)

    assert [name for name in daemon.names() if name != "renew"] == ["arm", "run", "stop"]
    assert collecting.returncode == 128 + number
    assert out == b""
    assert f"armrig: {way}" in said.decode()
    assert b"/nowhere/run.mcap" in said
    assert b"Traceback" not in said


def test_a_command_ignores_the_signals_that_nohup_ignores() -> None:
    """A command started with nohup is meant to outlive its terminal."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert main(["info", "/nothing"]) == 1
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


REFUSED = {
    "blackbox --input prbs --file mine.csv": "or give --input csv",
    "blackbox --file mine.csv --seconds 3": "--seconds 3: a file has its own length",
    "blackbox --input chirp --validation": "--validation: chirp would repeat the same input",
    "blackbox --file mine.csv --Ts 0.02": "t=0.01 s, but Ts=0.02 s gives 0.02 s",
    "blackbox --input prbs --a 0": "a=0.0: a prbs switches with a probability of more",
    "blackbox --seconds inf": "--seconds inf: must be a number of seconds",
    "blackbox --seconds 5e4 --Ts 0.01": "at most 40000 s at Ts = 0.01 s",
    "blackbox --Ts nan": "--Ts nan: must be a number of seconds",
    "blackbox --owner ''": "--owner of 0 characters: must have 1 to 80",
    "step --dead-man nan": "--dead-man nan: must be 0.5 to 60 s, or 0 for none",
    "step --seconds 0.5": "--at 1 s: after the end, 0.5 s",
    "step --at nan": "--at nan: must be a number of seconds",
    "bla --period nan": "--period nan: must be a number of seconds, more than 0",
    "bla --seconds 4 --period 2 --periods 3": "has 3 periods (--periods)",
}


@pytest.mark.parametrize("line", REFUSED)
def test_a_wrong_option_is_refused_before_the_rig_is_armed(
    line: str,
    daemon: FakeDaemon,
    where: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.csv").write_text("t,u\n0,1\n0.01,2\n0.02,3\n")

    assert main(["collect", *shlex.split(line), "--connect", where]) == 1

    assert REFUSED[line] in told(capsys)
    assert daemon.names() == []  # the state of the rig was asked at most


def test_a_length_too_great_for_the_sampling_time_releases_the_rig(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["collect", "blackbox", "--seconds", "80000", "--connect", where]) == 1

    assert "at most 40000 s at Ts = 0.01 s (4000000 samples)" in told(capsys)
    assert daemon.names() == ["arm", "disarm"]


def test_a_length_between_two_samples_is_rounded_and_reported(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["collect", "blackbox", "--seconds", "1", "--Ts", "0.6", "--connect", where]

    assert main(arguments) == 0

    said = capsys.readouterr().err
    assert "1 s is not a whole number of samples of 0.6 s: 2 samples are played, 1.2 s" in said


@pytest.mark.parametrize("refused", ["arm", "run"])
def test_a_trip_is_reported_with_its_reason(
    refused: str, daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon.fault, daemon.remedy = "the link is silent", "see to the cable"
    daemon.refusals = {refused: "not the lease in force: arm first"}

    assert main(["collect", "step", "--connect", where]) == 1

    said = capsys.readouterr().err
    assert (
        "rig 1 is in fault: the link is silent; see to the cable; then `armrig reset --conn" in said
    )
    assert "lease" not in said


def test_a_number_that_is_typed_during_a_run_is_its_reference(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A program in the background does not read from its terminal, which would stop it."""
    person, terminal = os.openpty()
    with os.fdopen(person, "wb", buffering=0) as typing, os.fdopen(terminal) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        monkeypatch.setattr("os.tcgetpgrp", lambda _: os.getpgrp())
        assert runs._read_number() is None
        typing.write(b"3.5\n")
        assert runs._read_number() == 3.5
        typing.write(b"faster\n")
        assert runs._read_number() is None
        monkeypatch.setattr("os.tcgetpgrp", lambda _: os.getpgrp() + 1)
        typing.write(b"4\n")
        assert runs._read_number() is None

    assert "faster is no number: type a number and Enter" in capsys.readouterr().err
