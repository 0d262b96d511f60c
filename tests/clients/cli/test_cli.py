"""The command line: what a person and a script meet, good input or bad."""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from io import StringIO
from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig.cli import main
from armrig.cli.figures import write_plot
from armrig.cli.options import folded
from armrig.cli.spinner import AFTER_S, estimating, remaining, spinner
from armrig.rig.realtime_status import scheduling_sentences
from armrig_core import commands, telemetry
from armrig_core.rehearsal import Rehearsal
from fake_daemon import FakeDaemon
from made_recordings import gap, manifest, of_the_arm, recorded, sample, timing, written
from rich.console import Console

READERS = (["info"], ["identify", "--structure", "arx"], ["compare"], ["report"])
HEAVY = ("numpy", "scipy", "zenoh", "mcap", "matplotlib", "typst", "control", "rich.console")


def told(capsys: pytest.CaptureFixture[str]) -> str:
    """Return what was said on standard error, which must be one or two lines and no traceback."""
    said = capsys.readouterr()
    assert said.out == ""
    assert 1 <= said.err.count("\n") <= 2
    assert "Traceback" not in said.err
    return said.err


@pytest.mark.parametrize("command", [["info"], ["compare"], ["report"]], ids=lambda c: c[0])
def test_a_file_that_is_no_recording_is_told_in_a_line(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1: what came, and what is read."""
    path = str(written(tmp_path, b"t;u;y\n0;1;2\n", "data.bin"))
    files = [path, path] if command == ["compare"] else [path]

    assert main([*command, *files]) == 1

    assert told(capsys).startswith(f"armrig: {path}: not an MCAP file; a recording")


@pytest.mark.parametrize("command", READERS, ids=lambda c: c[0])
def test_a_file_that_is_not_there_is_told_in_a_line(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1, naming the file."""
    path = str(tmp_path / "nothing.mcap")
    files = [path, path] if command == ["compare"] else [path]

    assert main([*command, *files]) == 1

    assert told(capsys) == (
        f"armrig: {path}: No such file or directory; `armrig ls` lists the recordings, each taken "
        "as @NAME\n"
    )


@pytest.mark.parametrize("command", [["info"], ["check", "--Ts", "1"], ["check"]])
def test_a_directory_is_told_in_a_line(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is no file to read, by each way in which one is read."""
    assert main([*command, str(tmp_path)]) == 1

    assert told(capsys) == f"armrig: {tmp_path}: Is a directory; give a file in it\n"


@pytest.mark.parametrize(
    ("samples", "said"),
    [
        (5, "5 samples are too few for a model: record longer, 180 at least for na=9, nb=9"),
        (50, "na=9, nb=9: 18 parameters from 50 samples; at most 5"),
    ],
)
def test_orders_too_high_for_the_data_are_told_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], samples: int, said: str
) -> None:
    """What came and what is needed."""
    path = written(tmp_path, recorded([sample(k) for k in range(samples)]))

    assert main(["identify", str(path), "--structure", "arx", "--na", "9", "--nb", "9"]) == 1

    assert f"armrig: {said}" in told(capsys)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["blackbox", "--high", "5.5"], "high=5.5 V is outside the rig's 0 to 5 V"),
        (["blackbox", "--low", "-1"], "low=-1.0 V is outside the rig's 0 to 5 V"),
        (["blackbox", "--low", "nan"], "low=nan V is outside the rig's 0 to 5 V"),
        (["blackbox", "--a", "2"], "a=2.0 is a probability, 0 <= a <= 1"),
        (["step", "--high", "9"], "high=9.0 V is outside the rig's 0 to 5 V"),
    ],
)
def test_a_voltage_outside_the_rigs_range_is_refused_before_a_rig_is_asked(
    arguments: list[str],
    said: str,
    daemon: FakeDaemon,
    where: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It would be destroyed; nothing is sent."""
    assert main(["collect", *arguments, "--connect", where]) == 1

    assert told(capsys) == f"armrig: {said}\n"
    assert daemon.asked == []


@pytest.mark.parametrize("command", [["status"], ["watch"], ["stop"], ["collect", "blackbox"]])
def test_no_daemon_is_told_with_what_to_do(
    command: list[str], where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1: where it was looked for, and how to start it."""
    assert main([*command, "--connect", where]) == 1

    said = told(capsys)
    assert where in said
    assert "not running, or not permitted; start it with `armrig lab` or `armrigd run`" in said


@pytest.mark.parametrize(
    "arguments",
    [
        ["identfy"],
        ["info"],
        ["identify", "f.mcap"],
        ["identify", "f.mcap", "--structure", "arimax"],
        ["compare", "f.mcap"],
        ["identify", "f.mcap", "--search", "--na", "2"],
        ["identify", "f.mcap", "--structure", "oe", "--weights", "cva"],
        ["identify", "f.mcap", "--structure", "arx", "--na", "two"],
        ["identify", "f.mcap", "--structure", "arx", "--integrator"],
        ["collect", "nothing"],
    ],
    ids=" ".join,
)
def test_a_wrong_use_is_told_in_a_line_with_exit_code_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """It points to the help of that very command."""
    assert main(arguments) == 2

    said = told(capsys)
    assert said.startswith("armrig: ")
    assert f"see `armrig{' ' + arguments[0] if arguments[0] != 'identfy' else ''} --help`" in said


def test_a_truncated_recording_is_used_and_the_loss_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Standard output stays JSON."""
    whole = recorded([sample(k) for k in range(40)], flush_every=10)
    path = written(tmp_path, whole[: len(whole) // 2])

    assert main(["info", str(path), "--json"]) == 0

    facts = json.loads(capsys.readouterr().out)
    assert facts["truncated"] is True
    assert f"saved: {facts['samples']} samples" in facts["damage"]


def test_damage_is_told_wherever_a_recording_is_used(
    three_recordings: tuple[Path, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """On standard error, in a line: a model of half a recording is not taken for one of it all."""
    whole = three_recordings[1].read_bytes()
    path = written(tmp_path, whole[: len(whole) * 3 // 4])

    assert main(["identify", str(path), "--structure", "arx", "--json"]) == 0

    said = capsys.readouterr()
    assert json.loads(said.out)["structure"] == "arx"
    assert said.err.startswith(f"armrig: {path}: ")
    assert "saved: " in said.err
    assert said.err.count("\n") == 1


def test_info_says_what_a_recording_holds(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """For a person, and for a program."""
    path = str(three_recordings[2])

    assert main(["info", path]) == 0
    text = capsys.readouterr().out
    assert main(["info", path, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)

    assert "1195 at 0.01 s, 5 missing" in text
    assert "signal to noise" in text
    assert "\\x" not in text  # a blank between number and unit is no stranger's character
    assert facts["samples"] == 1195
    assert facts["missing"] == 5
    assert facts["gaps"][0]["count"] == 5
    assert facts["manifest"]["experiment"] == "blackbox"
    assert facts["sampling"]["Ts_us"] == 10_000


def test_identify_gives_the_model_and_its_uncertainty(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """With the validation beside it."""
    arguments = ["identify", str(three_recordings[1]), "--structure", "oe", "--integrator"]
    arguments += ["--validate", str(three_recordings[2])]

    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert main([*arguments, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)

    assert "OE(nb=4, nf=4, nk=1)" in text
    assert "Simulated on the validation data it fits to" in text
    assert facts["orders"] == {"nb": 4, "nf": 4, "nk": 1}
    assert set(facts["parameters"]["f1"]) == {"value", "std", "std_robust"}
    assert facts["validation"]["rms_error"] < 0.006
    assert facts["recording"] != facts["validation"]["recording"]


def test_compare_puts_the_models_and_the_physics_side_by_side(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """Same numbers for a person and for a program."""
    files = [str(path) for path in three_recordings[1:]]

    assert main(["compare", *files]) == 0
    text = capsys.readouterr().out
    assert main(["compare", *files, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)

    assert [m["model"] for m in facts["models"]] == ["ARX", "OE", "physics"]
    assert all(f"{m['rms_error']:.4g}" in text for m in facts["models"])


def test_a_model_that_is_estimated_here_anyway_is_shown_once(
    three_recordings: tuple[Path, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two identical columns tell nothing; another order has its own."""
    _, estimation, validation = map(str, three_recordings)
    saved = []
    for n in ("4", "3"):
        saved += ["--model", str(tmp_path / f"of-{n}.json")]
        orders = ["--structure", "oe", "--nb", n, "--nf", n, "--integrator"]
        assert main(["identify", estimation, *orders, "--save", saved[-1]]) == 0
    capsys.readouterr()

    assert main(["compare", estimation, validation, *saved, "--json"]) == 0

    said = capsys.readouterr()
    assert [m["model"] for m in json.loads(said.out)["models"]] == ["ARX", "OE", "physics", "of-3"]
    assert "the model of-4 is the OE that is estimated here: it is shown once" in said.err


def test_report_writes_a_pdf_and_says_where(
    three_recordings: tuple[Path, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The path on standard output, nothing else."""
    pdf = tmp_path / "r.pdf"

    assert main(["report", *map(str, three_recordings), "-o", str(pdf)]) == 0

    said = capsys.readouterr()
    assert said.out == f"{pdf}\n"
    assert re.fullmatch(rf"next: (xdg-open|open|start) {pdf}", said.err.splitlines()[-1])
    assert pdf.read_bytes().startswith(b"%PDF-")


def test_report_tells_a_program_what_it_was_made_from(
    three_recordings: tuple[Path, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The path, and the hash of each recording in the order given.

    A model judged on its own data is told so here, too: it flatters every model.
    """
    pdf = tmp_path / "r.pdf"
    step, recording, _ = three_recordings
    files = (recording, recording, step)

    assert main(["report", *map(str, files), "-o", str(pdf), "--json"]) == 0

    hashes = [hashlib.sha256(path.read_bytes()).hexdigest() for path in files]
    said = capsys.readouterr()
    assert json.loads(said.out) == {"report": str(pdf), "recordings": hashes}
    assert "judged on the very data that they were estimated from" in said.err


def test_a_report_that_cannot_be_written_is_told_in_a_line(
    three_recordings: tuple[Path, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1, naming the place."""
    pdf = tmp_path / "no" / "r.pdf"

    assert main(["report", *map(str, three_recordings), "-o", str(pdf)]) == 1

    said = told(capsys)
    assert said.startswith(f"armrig: -o {pdf}: there is no directory {pdf.parent}")


def test_status_tells_what_the_daemon_says_of_scheduling(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """For a person in words, for a program as it came."""
    assert main(["status", "--connect", where]) == 0
    text = capsys.readouterr().out
    assert main(["status", "--connect", where, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)

    assert "no real-time scheduling; not allowed: SCHED_FIFO (set LimitRTPRIO=)" in text
    assert facts["endpoint"] == where
    assert facts["u_max"] == 5.0


def test_collect_plays_the_telegraph_that_was_asked_for(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """At the daemon's sampling time, with everything that makes it again."""
    arguments = ["collect", "blackbox", "--seconds", "2", "--seed", "7", "--connect", where]

    assert main(arguments) == 0

    assert capsys.readouterr().out == "/nowhere/run.mcap\n"
    [run] = [r for r in daemon.asked if isinstance(r, commands.Run)]
    assert len(run.u) == 200
    assert set(run.u) == {0.5, 4.5}
    assert run.experiment == "blackbox"
    assert run.details == {"input": "telegraph", "a": 0.05, "low": 0.5, "high": 4.5, "seed": 7}


def test_collect_step_steps_when_it_was_asked_to(daemon: FakeDaemon, where: str) -> None:
    """Seconds become samples by the sampling time in force."""
    arguments = ["collect", "step", "--seconds", "1", "--at", "0.4", "--Ts", "0.02", "--json"]

    assert main([*arguments, "--connect", where]) == 0

    [run] = [r for r in daemon.asked if isinstance(r, commands.Run)]
    assert run.u == [0.5] * 20 + [4.5] * 30


def test_collect_greybox_plays_what_a_black_box_does(daemon: FakeDaemon, where: str) -> None:
    """To a rig whose daemon was told that the rotating part is off."""
    daemon.arm_removed = True

    assert main(["collect", "greybox", "--seconds", "2", "--connect", where]) == 0

    [run] = [r for r in daemon.asked if isinstance(r, commands.Run)]
    assert run.experiment == "greybox"
    assert run.details["input"] == "telegraph"


def test_collect_greybox_refuses_a_rig_with_its_arm_on(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before anything is armed or played; it says what to do. A black box is for the whole rig."""
    assert main(["collect", "greybox", "--seconds", "2", "--connect", where]) == 1
    asked, said = daemon.names(), told(capsys)
    assert main(["collect", "blackbox", "--seconds", "2", "--connect", where]) == 0

    assert asked == []
    assert "rig 1 has its arm on: take the rotating part off (handout, figure 6)" in said
    assert "[arm] removed = true" in said


@pytest.mark.parametrize("arm_removed", [False, True])
def test_collect_blackbox_says_where_the_arm_is_off(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str], *, arm_removed: bool
) -> None:
    """It may be meant; who forgot to put it back on learns it before the hour is over."""
    daemon.arm_removed = arm_removed

    assert main(["collect", "blackbox", "--seconds", "2", "--connect", where]) == 0

    said = capsys.readouterr().err
    assert ("rig 1 has no arm ([arm] removed)" in said) == arm_removed


def test_collect_staircase_goes_up_and_down_again(daemon: FakeDaemon, where: str) -> None:
    """Friction shows as the difference."""
    arguments = ["collect", "staircase", "--levels", "3", "--seconds", "1", "--connect", where]

    assert main(arguments) == 0

    [run] = [r for r in daemon.asked if isinstance(r, commands.Run)]
    stairs = np.repeat([0.5, 2.5, 4.5, 2.5, 0.5], 20)
    np.testing.assert_array_equal(run.u, stairs)


def test_collect_bla_plays_periods_with_other_phases(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """One recording a realisation, of the same power, so that they can be compared."""
    arguments = ["--period", "0.5", "--periods", "3", "--realisations", "2", "--connect", where]

    assert main(["collect", "bla", *arguments]) == 0

    played = [r for r in daemon.asked if isinstance(r, commands.Run)]
    one, two = (np.array(r.u).reshape(3, 50) for r in played)
    assert capsys.readouterr().out == "/nowhere/run.mcap\n" * 2
    for u in (one, two):
        np.testing.assert_array_equal(u, np.tile(u[0], (3, 1)))
    assert np.std(one) == pytest.approx(np.std(two), rel=1e-12)
    assert np.abs(one - two).max() > 0.5
    assert [r.details["realisation"] for r in played] == [0, 1]


def test_collect_bla_takes_the_length_of_a_recording(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """As the other kinds do, in place of a period's; not both."""
    arguments = ["collect", "bla", "--seconds", "1.5", "--periods", "3", "--realisations", "1"]
    arguments += ["--connect", where]

    assert main(arguments) == 0
    [run] = [r for r in daemon.asked if isinstance(r, commands.Run)]
    capsys.readouterr()
    assert main([*arguments, "--period", "0.5"]) == 1

    u = np.array(run.u).reshape(3, 50)
    np.testing.assert_array_equal(u, np.tile(u[0], (3, 1)))
    assert "--seconds 1.5 with --period 0.5: a recording is 3 periods long" in told(capsys)


@pytest.mark.parametrize("name", ["telegraph", "prbs", "white", "multisine"])
def test_collect_validation_plays_the_next_seed_too(
    name: str, daemon: FakeDaemon, where: str
) -> None:
    """Two recordings with one command; the second says in its name what it is for."""
    arguments = ["collect", "blackbox", "--input", name, "--seed", "7", "--seconds", "1"]
    arguments += ["--validation", "--name", "monday", "--connect", where]

    assert main(arguments) == 0

    first, second = (r for r in daemon.asked if isinstance(r, commands.Run))
    kinds = [first.experiment, second.experiment]
    assert kinds == ["blackbox-monday", "blackbox-validation-monday"]
    assert [r.details["seed"] for r in (first, second)] == [7, 8]
    assert {r.details["input"] for r in (first, second)} == {name}
    assert first.u != second.u
    assert "validation_of" not in first.details
    assert second.details["validation_of"] == "r1"


def test_collect_plays_a_file_of_ones_own(daemon: FakeDaemon, where: str, tmp_path: Path) -> None:
    """As long as it is, at the times that it says."""
    file = tmp_path / "mine.csv"
    file.write_text("t,u\n" + "".join(f"{k / 100},{k % 5}\n" for k in range(40)))

    assert main(["collect", "blackbox", "--file", str(file), "--connect", where]) == 0

    [run] = [r for r in daemon.asked if isinstance(r, commands.Run)]
    assert run.u == [k % 5 for k in range(40)]
    assert run.details == {"input": "csv", "file": "mine.csv"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--input", "csv"], "a file is played with --file CSV"),
        (["--input", "prbs", "--file", "FILE"], "no other --input than csv"),
        (["--file", "FILE", "--seconds", "3"], "--seconds 3: a file has its own length"),
        (["--file", "FILE", "--validation"], "--validation: csv would be the same again"),
        (["--input", "chirp", "--validation"], "--validation: chirp would be the same again"),
        (["--file", "FILE", "--Ts", "0.02"], "t=0.01 s where Ts=0.02 s gives 0.02 s"),
        (["--file", "/nowhere.csv"], "/nowhere.csv: No such file or directory"),
        (["--input", "prbs", "--a", "0"], "a=0.0: a prbs switches with a probability of more"),
        (["--name", "My run"], "--name My run: at most 31 of a-z, 0-9 and -"),
        (["--high", "6"], "high=6.0 V is outside the rig's 0 to 5 V"),
    ],
    ids=lambda x: " ".join(x) if isinstance(x, list) else "",
)
def test_an_input_that_cannot_be_played_is_told_before_a_rig_is_asked_for(
    arguments: list[str],
    said: str,
    daemon: FakeDaemon,
    where: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """With the way out."""
    file = tmp_path / "mine.csv"
    file.write_text("t,u\n0,1\n0.01,2\n0.02,3\n")
    given = [str(file) if x == "FILE" else x for x in arguments]

    assert main(["collect", "blackbox", *given, "--connect", where]) == 1

    assert said in told(capsys)
    assert daemon.asked == []


def test_collect_judges_the_data(
    daemon: FakeDaemon, where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In words beside the path, whole in the JSON; data with a fault are no failure."""
    daemon.recording = str(written(tmp_path, of_the_arm(armrig.telegraph(500, 0.05, 2.45, 2.55))))

    assert main(["collect", "blackbox", "--connect", where]) == 0
    said = capsys.readouterr()
    assert main(["collect", "blackbox", "--connect", where, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    verdict = facts["verdict"]

    assert said.out == f"{daemon.recording}\n"
    assert "3000 samples are on the disk; the data can be used, with care" in said.err
    assert facts["synced"] == facts["samples"] == 3000
    assert "too quiet" in said.err
    assert verdict["usable"] is True
    assert {f["about"]: f["level"] for f in verdict["findings"]}["signal"] == "warning"


def test_data_that_cannot_be_used_are_a_failure_and_end_the_collection(
    daemon: FakeDaemon, where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The recording is told all the same; there is no second one."""
    daemon.recording = str(written(tmp_path, of_the_arm(np.full(500, 2.0))))

    assert main(["collect", "blackbox", "--validation", "--connect", where]) == 1

    said = capsys.readouterr()
    assert said.out == f"{daemon.recording}\n"
    assert "the data cannot be used: the input never changes" in said.err
    assert daemon.names().count("run") == 1


def test_the_bar_says_how_the_timing_is(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the run alone, and in the words of `info`: lateness, missing samples; and the queue."""
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


def test_info_says_lateness_as_the_bar_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And what it is of: an arrival where the device paced, a request where the host did."""
    for pacing, of in (("scheduled", "samples' arrival"), ("exchange", "request for each sample")):
        data = recorded([sample(k) for k in range(10)], manifest=manifest(pacing=pacing))

        assert main(["info", "--verbose", str(written(tmp_path, data))]) == 0

        lines = capsys.readouterr().out.splitlines()
        [line] = [x for x in lines if x.startswith("host's lateness")]
        [jitter] = [x for x in lines if x.startswith("jitter")]
        assert "p50 3.0, p99 3.0, max 3 µs" in line
        assert of in line
        assert jitter.endswith(" µs; of the sampling interval, by the device's clock")


def test_collect_says_what_the_rehearsal_was(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Beside the path; with --json in it."""
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
def test_a_collection_dies_with_its_program_unless_told_otherwise(
    given: list[str], dead_man: float | None, daemon: FakeDaemon, where: str
) -> None:
    """Who closes the terminal expects that the motor stops."""
    option = ["--dead-man", *given] if given else []

    assert main(["collect", "step", *option, "--connect", where]) == 0

    [run] = [r for r in daemon.asked if isinstance(r, commands.Run)]
    assert run.dead_man == dead_man
    assert ("renew" in daemon.names()) == (dead_man is not None)


@pytest.mark.parametrize("text", ["0.1", "61", "-1", "nan"])
def test_a_dead_man_that_cannot_be_is_told_before_a_rig_is_asked_for(
    text: str, daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """With what is allowed."""
    assert main(["collect", "step", "--dead-man", text, "--connect", where]) == 1

    assert "must be 0.5 to 60 s, or 0 for none" in capsys.readouterr().err
    assert daemon.asked == []


def test_a_run_that_ends_early_is_a_failure(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1, with the reason and the recording."""
    daemon.outcome = "the host paused for 68 ms"

    assert main(["collect", "step", "--connect", where]) == 1

    said = capsys.readouterr()
    assert said.out == ""
    assert "the host paused for 68 ms; recorded in /nowhere/run.mcap" in said.err


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_ends_a_collection_stops_the_rig(
    number: signal.Signals, daemon: FakeDaemon, where: str
) -> None:
    """A closed terminal or a shutdown: the motor does not go on alone, and the code says why."""
    daemon.polls_per_run = 10_000
    program = [sys.executable, "-m", "armrig", "collect", "blackbox", "--connect", where]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as collecting:
        until = time.monotonic() + 20
        while "run" not in daemon.names():
            assert collecting.poll() is None
            assert time.monotonic() < until
            time.sleep(0.01)
        collecting.send_signal(number)
        out, said = collecting.communicate(timeout=20)

    assert [name for name in daemon.names() if name != "renew"] == ["arm", "run", "stop"]
    assert collecting.returncode == 128 + number
    assert out == b""
    assert f"armrig: ended by {number.name}" in said.decode()
    assert b"Traceback" not in said


def test_what_nohup_ignores_stays_ignored() -> None:
    """A command started with nohup is meant to outlive its terminal."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert main(["info", "/nothing"]) == 1
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_program_is_told_in_json_what_was_done(
    where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Stopped; and whether a fault was latched."""
    with FakeDaemon(where):
        assert main(["stop", "--connect", where, "--json"]) == 0
        assert main(["reset", "--connect", where, "--json"]) == 0

    said = capsys.readouterr()
    assert [json.loads(line) for line in said.out.splitlines()] == [
        {"rig": "1", "stopped": True},
        {"rig": "1", "was_latched": True},
    ]
    assert said.err == ""


@pytest.mark.parametrize("command", ["stop", "reset"])
def test_stop_and_reset_need_nobodys_leave(command: str, daemon: FakeDaemon, where: str) -> None:
    """They are sent at once, without arming."""
    assert main([command, "--connect", where]) == 0

    assert daemon.names() == [command]


def test_watch_gives_each_sample_as_a_line_of_json(daemon: FakeDaemon, where: str) -> None:
    """Until as many as asked for have come."""
    arguments = ["watch", "--connect", where, "--json", "--count", "3"]
    program = [sys.executable, "-m", "armrig", *arguments]
    with (
        subprocess.Popen(program, stdout=subprocess.PIPE) as watching,
        daemon.session.declare_publisher("rig/1/sample") as out,
    ):
        k = 0
        while watching.poll() is None:
            out.put(telemetry.encode_sample(sample(k)))
            k += 1
            with suppress(subprocess.TimeoutExpired):
                watching.wait(0.01)
        assert watching.stdout is not None
        lines = [json.loads(line) for line in watching.stdout]

    assert watching.returncode == 0
    assert [line["k"] - lines[0]["k"] for line in lines] == [0, 1, 2]
    assert lines[0]["u_applied_v"] == 1.0


def test_where_the_host_allows_all_nothing_is_complained_of() -> None:
    """One line with the priority."""
    assert scheduling_sentences({"fifo": 80, "refused": []}) == [
        "real-time scheduling at priority 80"
    ]
    assert scheduling_sentences({}) == ["nothing known yet"]


@pytest.mark.parametrize("program", ["import armrig", "import armrig.cli"])
def test_nothing_heavy_is_imported_before_it_is_needed(program: str) -> None:
    """`import armrig` and `armrig --help` answer at once."""
    checked = f"import sys; {program}; print(sorted(set({HEAVY!r}) & set(sys.modules)))"

    done = subprocess.run([sys.executable, "-c", checked], capture_output=True, check=True)

    assert done.stdout.decode().strip() == "[]"


def test_every_public_name_is_there() -> None:
    """And nothing else is pretended."""
    import armrig

    assert all(getattr(armrig, name) is not None for name in armrig.__all__)
    assert armrig.__version__ == "0.1.0"
    assert set(armrig.__all__) < set(dir(armrig))
    assert not hasattr(armrig, "nothing")


def test_the_module_is_the_command() -> None:
    """`python -m armrig` has the command's exit code."""
    done = subprocess.run([sys.executable, "-m", "armrig", "info", "/nothing"], capture_output=True)

    assert done.returncode == 1
    assert done.stderr == b"armrig: /nothing: No such file or directory\n"


def test_what_is_no_file_is_told_and_not_waited_for(tmp_path: Path) -> None:
    """A pipe that nobody writes to, by each way in which a file is read.

    In a process of its own: where one is waited for, that goes on for ever.
    """
    os.mkfifo(tmp_path / "pipe")
    commands = (
        "info pipe",
        "identify pipe --structure arx",
        "validate pipe --model pipe",
        "collect blackbox --Ts 0.01 --file pipe",
        "greybox pipe",
    )
    program = "import sys; from armrig.cli import main\n"
    program += "print([main(command.split()) for command in sys.argv[1:]])"

    done = subprocess.run(
        [sys.executable, "-c", program, *commands],
        **{"capture_output": True, "text": True, "timeout": 100, "cwd": tmp_path},
    )

    assert done.stdout == f"{[1] * len(commands)}\n"
    said = done.stderr.splitlines()
    assert len(said) == len(commands)
    assert all(line.startswith("armrig: pipe: not a regular file") for line in said)


@pytest.mark.parametrize("name", ["estimation.mcap", "other.mcap", "other.pdf", "r.txt", "."])
def test_a_report_never_replaces_what_is_no_report(
    name: str,
    three_recordings: tuple[Path, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A recording cannot be made again; said before any work."""
    for path in three_recordings:
        (tmp_path / path.name).write_bytes(path.read_bytes())
    for other in ("other.mcap", "other.pdf"):
        (tmp_path / other).write_bytes(three_recordings[0].read_bytes())
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    files = [str(tmp_path / path.name) for path in three_recordings]

    assert main(["report", *files, "-o", str(tmp_path / name)]) == 1

    assert f"-o {tmp_path / name}: " in told(capsys)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_figure_never_replaces_a_recording(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """As with a report."""
    path = three_recordings[0]
    before = path.read_bytes()

    assert main(["info", str(path), "--plot", str(path)]) == 1

    assert "is one of the recordings to read, which would be lost" in told(capsys)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["blackbox", "--seconds", "inf"], "--seconds inf: must be a number of seconds"),
        (["blackbox", "--seconds", "nan"], "--seconds nan: must be a number of seconds"),
        (["blackbox", "--seconds", "1e9"], "--seconds 1e+09: at most 4000000 samples"),
        (["blackbox", "--seconds", "5e4", "--Ts", "0.01"], "that is 40000 s at Ts = 0.01 s"),
        (["blackbox", "--seconds", "0.2", "--Ts", "1"], "too short for one sample of 1 s"),
        (["blackbox", "--Ts", "nan"], "--Ts nan: must be a number of seconds"),
        (["blackbox", "--Ts", "inf"], "--Ts inf: must be a number of seconds"),
        (["blackbox", "--Ts", "2"], "--Ts 2: at most 1, in seconds"),
        (["blackbox", "--owner", ""], "--owner has 0 characters: 1 to 80 are allowed"),
        (["step", "--seconds", "0.5"], "--at 1 s is after the end, 0.5 s"),
        (["step", "--at", "nan"], "--at nan: must be a number of seconds"),
    ],
    ids=lambda x: " ".join(x) if isinstance(x, list) else "",
)
def test_a_length_that_cannot_be_played_is_refused_before_a_rig_is_asked(
    arguments: list[str],
    said: str,
    daemon: FakeDaemon,
    where: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """What came, and what is allowed."""
    assert main(["collect", *arguments, "--connect", where]) == 1

    assert said in told(capsys)
    assert daemon.asked == []


def test_a_length_too_great_for_the_daemons_sampling_time_gives_the_rig_back(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is known only once the rig is ours."""
    assert main(["collect", "blackbox", "--seconds", "80000", "--connect", where]) == 1

    assert "at most 4000000 samples, that is 40000 s at Ts = 0.01 s" in told(capsys)
    assert daemon.names() == ["arm", "disarm"]


def test_a_length_between_two_samples_is_rounded_and_told(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is really played."""
    arguments = ["collect", "blackbox", "--seconds", "1", "--Ts", "0.6", "--connect", where]

    assert main(arguments) == 0

    said = capsys.readouterr().err
    assert "1 s is not a whole number of samples of 0.6 s: 2 samples are played, 1.2 s" in said


@pytest.mark.parametrize("refused", ["arm", "run"])
def test_a_trip_is_told_with_its_reason(
    refused: str, daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not as the lease that went with it."""
    daemon.fault, daemon.remedy = "the link is silent", "see to the cable"
    daemon.refusals = {refused: "not the lease in force: arm first"}

    assert main(["collect", "step", "--connect", where]) == 1

    said = capsys.readouterr().err
    assert (
        "rig 1 is in fault: the link is silent; see to the cable; then `armrig reset --conn" in said
    )
    assert "lease" not in said


def test_ctrl_c_tells_how_the_rig_was_left_and_where_the_recording_lies(
    daemon: FakeDaemon, where: str
) -> None:
    """Exit code 130."""
    daemon.polls_per_run = 10_000
    program = [sys.executable, "-m", "armrig", "collect", "blackbox", "--connect", where]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as collecting:
        until = time.monotonic() + 20
        while "run" not in daemon.names():
            assert time.monotonic() < until
            time.sleep(0.01)
        time.sleep(0.3)
        collecting.send_signal(signal.SIGINT)
        out, said = collecting.communicate(timeout=20)

    assert collecting.returncode == 130
    assert out == b""
    assert b"armrig: interrupted: rig 1 was told to stop (0 V)" in said
    assert b"/nowhere/run.mcap" in said
    assert b"Traceback" not in said


@pytest.mark.parametrize("pipe", ["cat", "head -n 2"])
def test_watch_into_a_pipe_gives_a_line_for_each_sample(
    pipe: str, daemon: FakeDaemon, where: str
) -> None:
    """At once, and a reader that goes is nothing to complain of."""
    count = ["--count", "3"] if pipe == "cat" else []
    program = [sys.executable, "-m", "armrig", "watch", "--connect", where, *count]
    with (
        subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as watching,
        subprocess.Popen(pipe.split(), stdin=watching.stdout, stdout=subprocess.PIPE) as reader,
        daemon.session.declare_publisher("rig/1/sample") as out,
    ):
        assert watching.stdout is not None
        assert watching.stderr is not None
        assert reader.stdout is not None
        watching.stdout.close()
        k, until = 0, time.monotonic() + 20
        while watching.poll() is None:
            assert time.monotonic() < until
            out.put(telemetry.encode_sample(sample(k)))
            k += 1
            with suppress(subprocess.TimeoutExpired):
                watching.wait(0.01)
        text, said = reader.stdout.read().decode(), watching.stderr.read()

    assert said == b""
    assert text.endswith("\n")
    assert text.splitlines()[0].split()[0] == "k"
    assert text.count("\n") == (4 if pipe == "cat" else 2)
    assert watching.returncode == (0 if pipe == "cat" else 128 + signal.SIGPIPE)


def test_the_coefficients_are_a_table_with_both_standard_deviations(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """The loss has its unit, and each p value its hypothesis."""
    arguments = ["identify", str(three_recordings[1]), "--structure", "arx"]

    assert main([*arguments, "--validate", str(three_recordings[2]), "--verbose"]) == 0

    text = capsys.readouterr().out
    assert ["coefficient", "estimate", "σ", "σ", "robust"] in [x.split() for x in text.splitlines()]
    assert [x.split()[:2] for x in text.splitlines()[4:12:7]] == [["a1", "q^-1"], ["b4", "q^-4"]]
    assert " rad², FPE " in text
    assert "residuals coloured (p < 0.001, " in text
    assert " test): trust σ robust, not σ" in text
    assert "no dynamics missing: p" in text
    assert "no feedback seen in them: p" in text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["arx", "--nf", "3"],
            "--nf 3 goes with --structure oe or bj; an ARX model has na, nb and nk",
        ),
        (
            ["oe", "--na", "3"],
            "--na 3 goes with --structure arx or armax or iv4; an OE model has nb, nf and nk",
        ),
        (
            ["OE"],
            "--structure: 'OE' is not one of 'arx', 'armax', 'oe', 'bj', 'iv4', 'n4sid'; see",
        ),
        (["arx", "--na", "two"], "--na two: must be an integer; see"),
    ],
    ids=lambda x: " ".join(x) if isinstance(x, list) else "",
)
def test_an_option_that_does_not_apply_is_refused(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """It would be without effect, which nobody would see."""
    assert main(["identify", "f.mcap", "--structure", *arguments]) == 2

    assert f"armrig: {said}" in told(capsys)


@pytest.mark.parametrize("command", [["identify", "--structure", "oe"], ["compare"], ["report"]])
def test_orders_absurd_for_the_data_are_refused_with_what_is_allowed(
    command: list[str], three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """A parameter wants ten samples."""
    files = [str(path) for path in three_recordings[1 : 2 if command[0] == "identify" else 3]]

    assert main([*command, *files, "--nb", "100", "--nf", "100"]) == 1

    said = told(capsys)
    assert "from 1459 samples; at most 145, one for each 10 samples" in said


def test_numerics_that_give_up_are_told_as_orders_too_high() -> None:
    """Without a line of numpy's source."""

    def give_up() -> None:
        with estimating("nb and nf"):
            np.sqrt(np.array([-1.0]))
            np.linalg.svd(np.full((2, 2), np.nan))

    with pytest.raises(ValueError, match="too high for these data: lower nb and nf"):
        give_up()


def test_a_long_estimation_shows_that_it_lives() -> None:
    """On a terminal, after a while; what is quick says nothing."""
    out = StringIO()
    terminal = Console(file=out, force_terminal=True)

    with spinner("estimating", terminal, after_s=60):
        pass
    quick = out.getvalue()
    with spinner("estimating", terminal, after_s=0.0):
        time.sleep(0.3)

    assert quick == ""
    assert "estimating …" in out.getvalue()


def test_a_wait_that_is_counted_tells_what_it_does_and_what_remains() -> None:
    """A bar from the first count on, gone at the end; nothing where there is no terminal."""
    out, nowhere = StringIO(), StringIO()

    for console in (Console(file=out, force_terminal=True, width=100), Console(file=nowhere)):
        with spinner("estimating", console, after_s=0.0) as count:
            time.sleep(0.05)
            count(10, 40, "OE[2 2 1]")
            time.sleep(0.3)

    assert "estimating OE[2 2 1] …" in out.getvalue()
    assert "30 of 40 remain, about " in out.getvalue()
    assert not nowhere.getvalue()


@pytest.mark.parametrize(
    ("done", "elapsed_s", "told"),
    [
        (0, 0.0, "40 of 40 remain"),
        (10, 6.0, "30 of 40 remain, about 18 s"),
        (1, 10.0, "39 of 40 remain, about 6 min"),
        (40, 9.0, "0 of 40 remain"),
    ],
)
def test_the_time_left_is_that_of_what_was_done(done: int, elapsed_s: float, told: str) -> None:
    """None before the first is done, nor after the last."""
    assert remaining(done, 40, elapsed_s) == told


def test_a_figure_that_takes_long_shows_that_it_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On a terminal, as an estimation does."""
    monkeypatch.setenv("FORCE_COLOR", "1")

    write_plot(tmp_path / "slow.png", lambda **_: time.sleep(AFTER_S + 0.3))

    assert "drawing …" in capsys.readouterr().err


def test_an_integrator_is_hinted_at_where_it_belongs(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """The angle integrates, the velocity does not."""
    path = str(three_recordings[1])

    assert main(["identify", path, "--structure", "oe"]) == 0
    angle = capsys.readouterr().err
    arguments = ["--structure", "oe", "--integrator", "--signal", "velocity"]
    assert main(["identify", path, *arguments]) == 0
    velocity = capsys.readouterr().err

    assert "the angle theta_1 integrates: try --integrator" in angle
    assert "--integrator: velocity does not integrate" in velocity


def test_a_model_judged_on_its_own_data_is_told_so(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """It flatters every model."""
    path = str(three_recordings[1])

    assert main(["compare", path, path]) == 0

    assert "judged on the very data that they were estimated from" in capsys.readouterr().err


def test_compare_names_the_recording_that_it_validates_on(
    three_recordings: tuple[Path, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """A step is not identified from: the other one is halved."""
    assert main(["compare", str(three_recordings[1]), str(three_recordings[0])]) == 0

    assert f"simulated on {three_recordings[1]}, its second half" in capsys.readouterr().out


def test_the_version_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    """As other programs do."""
    assert main(["--version"]) == 0

    assert capsys.readouterr().out == "armrig 0.1.0\n"


def test_without_a_command_there_is_help_and_exit_code_2(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """As `armrigd` does; `--help` is what was asked for."""
    assert main([]) == 2
    alone = capsys.readouterr().out
    assert main(["--help"]) == 0

    assert alone == capsys.readouterr().out
    assert "identify" in alone


def test_info_of_a_recording_cut_off_at_once_says_what_is_not_known(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Words in place of nan."""
    whole = recorded([sample(k) for k in range(40)], flush_every=10)
    cut = written(tmp_path, whole[: len(whole) // 4], "cut.mcap")
    short = written(tmp_path, recorded([sample(0)]), "short.mcap")

    assert main(["info", str(cut)]) == 0
    of_cut = capsys.readouterr().out
    assert main(["info", str(short)]) == 0
    of_short = capsys.readouterr().out

    assert "not known: the file is cut off before it says" in of_cut
    assert re.search(r"; up to 0(\.\d+)? s of 0\.1 s\n", of_cut)
    assert "too few samples" in of_short
    assert "nan" not in of_cut + of_short


def test_info_says_who_ran_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As he called himself and, where the daemon checked it, by his certificate."""
    owner = "group 3\x1b[2J (certificate alice)"
    path = written(tmp_path, recorded([sample(0)], manifest=manifest(owner=owner)))

    assert main(["info", str(path)]) == 0

    said = capsys.readouterr().out
    assert re.search(r"^owner +group 3\\x1b\[2J \(certificate alice\)$", said, re.MULTILINE)


def test_info_of_a_cut_file_does_not_call_the_run_cut_short(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The run was complete, the file is not; one that the daemon left may still be growing."""
    run = {"manifest": manifest(samples=40, k_first=0), "flush_every": 10}
    whole = recorded([sample(k) for k in range(40)], **run, outcome_first=True)
    left = recorded([sample(k) for k in range(40)], **run, outcome=None)

    assert main(["info", str(written(tmp_path, whole[:-200]))]) == 0
    of_whole = capsys.readouterr().out
    assert main(["info", str(written(tmp_path, left[:-400], "run.mcap.active"))]) == 0
    of_left = capsys.readouterr().out

    assert "of the run: complete; but the file is cut off" in of_whole
    assert re.search(r"samples +\d+ at 0.01 s, 0 missing", of_whole)
    assert "s of 0.4 s" in of_whole
    assert "the file is cut off before it says, or is still being written" in of_left


def test_what_is_missing_is_told_with_what_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    """And where it comes from."""
    assert main(["validate", "F.mcap"]) == 2
    option = told(capsys)
    assert main(["validate"]) == 2
    argument = told(capsys)
    assert main(["compare", "F.mcap"]) == 2
    either = told(capsys)

    assert "--model JSON is missing: model that identify --save has written" in option
    assert "F is missing: recording (*.mcap, @last or @NAME)" in argument
    assert "--model FILE (from `armrig identify --save FILE`)" in either


def test_long_lines_are_broken_between_words_on_a_terminal_only() -> None:
    """A path or a command in one piece can be taken from there; a program gets the line."""
    text = "- one two three /a/long/path/that-is-longer-than-the-line four\n\n  five"

    assert folded(text, 0) == text
    assert folded(text, 16).splitlines() == [
        *("- one two three", "  /a/long/path/that-is-longer-than-the-line", "  four"),
        *("", "  five"),
    ]
    assert folded("name  one two three four", 16, indent=6) == "name  one two\n      three four"


def test_a_demonstration_into_a_file_is_told_what_to_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before anything is started."""
    path = written(tmp_path, b"", "file")

    assert main(["demo", "--directory", str(path)]) == 1

    assert f"--directory {path}: is a file; give a directory" in told(capsys)
