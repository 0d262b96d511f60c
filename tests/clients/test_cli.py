"""The command line: what a person and a script meet, good input or bad."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath

import pytest
from armrig.cli import main
from armrig.scheduling import scheduling
from armrig_core import commands, telemetry
from armrig_core.endpoint import endpoint
from fake_daemon import FakeDaemon
from recordings import recorded, sample, written

READERS = (["info"], ["identify", "--structure", "arx"], ["compare"], ["report"])
HEAVY = ("numpy", "scipy", "zenoh", "mcap", "matplotlib", "typst", "control", "rich.console")


@pytest.fixture
def where() -> Iterator[str]:
    """Give an endpoint whose path is short enough for a socket."""
    with tempfile.TemporaryDirectory(prefix="armrig-") as directory:
        yield endpoint("1", PurePosixPath(directory))


@pytest.fixture
def daemon(where: str) -> Iterator[FakeDaemon]:
    """Give a daemon that answers at the endpoint."""
    with FakeDaemon(where) as running:
        yield running


def told(capsys: pytest.CaptureFixture[str]) -> str:
    """Return what was said on standard error, which must be one or two lines and no traceback."""
    said = capsys.readouterr()
    assert said.out == ""
    assert 1 <= said.err.count("\n") <= 2
    assert "Traceback" not in said.err
    return said.err


@pytest.mark.parametrize("command", READERS, ids=lambda c: c[0])
def test_a_file_that_is_no_recording_is_told_in_a_line(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1: what came, and what is read."""
    path = str(written(tmp_path, b"t;u;y\n0;1;2\n", "data.csv"))
    files = [path, path] if command == ["compare"] else [path]

    assert main([*command, *files]) == 1

    assert told(capsys).startswith(f"armrig: {path}: not an MCAP file; armrig reads what")


@pytest.mark.parametrize("command", READERS, ids=lambda c: c[0])
def test_a_file_that_is_not_there_is_told_in_a_line(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1, naming the file."""
    path = str(tmp_path / "nothing.mcap")
    files = [path, path] if command == ["compare"] else [path]

    assert main([*command, *files]) == 1

    assert told(capsys) == f"armrig: {path}: No such file or directory\n"


def test_a_directory_is_told_in_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is no file to read."""
    assert main(["info", str(tmp_path)]) == 1

    assert "Is a directory" in told(capsys)


def test_orders_too_high_for_the_data_are_told_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What came and what is needed."""
    path = written(tmp_path, recorded([sample(k) for k in range(5)]))

    assert main(["identify", str(path), "--structure", "arx", "--na", "9", "--nb", "9"]) == 1

    assert told(capsys) == "armrig: na=9, nb=9, nk=1 needs at least 28 samples, got 5\n"


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
    assert "not running, or not permitted; start it with `armrigd run`" in said


@pytest.mark.parametrize(
    "arguments",
    [
        ["identfy"],
        ["info"],
        ["identify", "f.mcap"],
        ["identify", "f.mcap", "--structure", "armax"],
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
    assert "validation on" in text
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


def test_report_writes_a_pdf_and_says_where(
    three_recordings: tuple[Path, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The path on standard output, nothing else."""
    pdf = tmp_path / "r.pdf"

    assert main(["report", *map(str, three_recordings), "-o", str(pdf)]) == 0

    assert capsys.readouterr().out == f"{pdf}\n"
    assert pdf.read_bytes().startswith(b"%PDF-")


def test_a_report_that_cannot_be_written_is_told_in_a_line(
    three_recordings: tuple[Path, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1, naming the place."""
    pdf = tmp_path / "no" / "r.pdf"

    assert main(["report", *map(str, three_recordings), "-o", str(pdf)]) == 1

    assert told(capsys) == f"armrig: {pdf}: No such file or directory\n"


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


def test_a_run_that_ends_early_is_a_failure(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1, with the reason and the recording."""
    daemon.outcome = "the host paused for 68 ms"

    assert main(["collect", "step", "--connect", where]) == 1

    said = capsys.readouterr()
    assert said.out == ""
    assert "the host paused for 68 ms; recorded in /nowhere/run.mcap" in said.err


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
    assert scheduling({"fifo": 80, "refused": []}) == ["real-time scheduling at priority 80"]
    assert scheduling({}) == ["nothing known yet"]


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
