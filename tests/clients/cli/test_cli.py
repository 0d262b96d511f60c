"""The command line for a person and a script, with good input and bad."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from contextlib import nullcontext, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import armrig
import pytest
from armrig.cli import main
from armrig.cli.options import folded, tell
from armrig.rig import live_rigs
from armrig.rig.status_rows import scheduling_sentences
from armrig_core import commands, telemetry

from tests.clients.fake_daemon import FakeDaemon
from tests.clients.made_recordings import sample, written
from tests.clients.running import running
from tests.clients.told import told

PROJECT = Path(__file__).parents[3] / "pyproject.toml"
VERSION = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]["version"]
READERS = (["info"], ["identify", "--structure", "arx"], ["compare"], ["report"])
HEAVY = ("numpy", "scipy", "zenoh", "mcap", "matplotlib", "typst", "control", "rich.console")


@pytest.mark.parametrize("command", [["info"], ["compare"], ["report"]], ids=lambda c: c[0])
def test_a_file_that_is_no_recording_is_reported_in_one_line(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(written(tmp_path, b"t;u;y\n0;1;2\n", "data.bin"))
    files = [path, path] if command == ["compare"] else [path]

    assert main([*command, *files]) == 1

    assert told(capsys).startswith(
        f"armrig: {path}: is not a recording of the rig; give a recording"
    )


@pytest.mark.parametrize("command", READERS, ids=lambda c: c[0])
def test_a_file_that_is_not_there_is_reported_in_one_line(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(tmp_path / "nothing.mcap")
    files = [path, path] if command == ["compare"] else [path]

    assert main([*command, *files]) == 1

    assert told(capsys) == (
        f"armrig: {path}: No such file or directory; `armrig ls` lists the recordings, each with "
        "its @NAME\n"
    )


@pytest.mark.parametrize("command", [["info"], ["check", "--Ts", "1"], ["check"]])
def test_a_directory_is_reported_in_one_line(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command, str(tmp_path)]) == 1

    assert told(capsys) == f"armrig: {tmp_path}: Is a directory; give a file in the folder\n"


@pytest.mark.parametrize("command", [["status"], ["watch"], ["stop"], ["collect", "blackbox"]])
def test_a_missing_daemon_is_reported_with_the_way_out(
    command: list[str], where: str, capsys: pytest.CaptureFixture[str]
) -> None:
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
def test_a_wrong_use_is_reported_in_one_line_with_exit_code_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2

    said = told(capsys)
    assert said.startswith("armrig: ")
    assert f"see `armrig{' ' + arguments[0] if arguments[0] != 'identfy' else ''} --help`" in said


def test_status_reports_what_the_daemon_says_of_scheduling(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["status", "--connect", where]) == 0
    text = capsys.readouterr().out
    assert main(["status", "--connect", where, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)

    assert "no real-time scheduling; not allowed: SCHED_FIFO (set LimitRTPRIO=)" in text
    assert facts["endpoint"] == where
    assert facts["u_max"] == 5.0


@pytest.mark.parametrize(
    ("is_recorded", "told"),
    [(True, "the note is in the recording"), (False, "no run is being recorded, so the note")],
)
def test_a_note_says_whether_a_recording_has_it(
    daemon: FakeDaemon,
    where: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    is_recorded: bool,
    told: str,
) -> None:
    monkeypatch.setattr(daemon, "_carry_out", lambda _: commands.Done(done=is_recorded))

    assert main(["note", "the arm was touched", "--connect", where, "--owner", "Ada"]) == 0
    said = capsys.readouterr().out
    assert main(["note", "the arm was touched", "--connect", where, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)

    assert said.startswith(f"rig 1: {told}")
    assert facts == {"rig": "1", "recorded": is_recorded}


def test_a_note_that_is_too_long_is_refused_in_a_line(
    daemon: FakeDaemon, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["note", "x" * 10_000, "--connect", where]) == 1

    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "characters)': allowed are 1 to 500 printable characters" in said
    assert daemon.asked == []


@pytest.mark.parametrize("command", ["stop", "reset"])
def test_stop_and_reset_need_nobodys_leave(command: str, daemon: FakeDaemon, where: str) -> None:
    assert main([command, "--connect", where]) == 0

    assert daemon.names() == [command]


def test_watch_gives_each_sample_as_a_line_of_json(daemon: FakeDaemon, where: str) -> None:
    arguments = ["watch", "--connect", where, "--json", "--count", "3"]
    program = [sys.executable, "-m", "armrig", *arguments]
    with (
        running(program, stdout=subprocess.PIPE) as watching,
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
    assert scheduling_sentences({"fifo": 80, "refused": []}) == [
        "real-time scheduling at priority 80"
    ]
    assert scheduling_sentences({}) == ["not known yet"]


@pytest.mark.parametrize("program", ["import armrig", "import armrig.cli"])
def test_nothing_heavy_is_imported_before_it_is_needed(program: str) -> None:
    checked = f"import sys; {program}; print(sorted(set({HEAVY!r}) & set(sys.modules)))"

    done = subprocess.run([sys.executable, "-c", checked], capture_output=True, check=True)

    assert done.stdout.decode().strip() == "[]"


def test_a_stop_imports_only_what_it_needs(daemon: FakeDaemon, where: str) -> None:
    program = (
        "import sys; from armrig.__main__ import main; code = main(); "
        f"print(code, sorted({{*{HEAVY!r}, 'google.protobuf', 'typer'}} & set(sys.modules))); "
        "print(*(name for name in sys.modules if name.startswith('armrig.')))"
    )

    arguments = [sys.executable, "-c", program, "stop", "--connect", where]
    done = subprocess.run(arguments, capture_output=True, check=True, text=True)

    said, heavy, own = done.stdout.splitlines()
    assert daemon.names() == ["stop"]
    assert said.startswith("rig 1, motor: ")
    assert heavy == "0 ['typer', 'zenoh']"
    assert {name.split(".")[1] for name in own.split()} == {"__main__", "cli", "rig"}
    assert {name for name in own.split() if ".cli." in name} == {
        *("armrig.cli.options", "armrig.cli.rig")
    }


def test_every_public_name_is_there() -> None:
    assert all(getattr(armrig, name) is not None for name in armrig.__all__)
    assert armrig.__version__ == VERSION
    assert set(armrig.__all__) < set(dir(armrig))
    assert not hasattr(armrig, "nothing")


def test_the_module_is_the_command() -> None:
    done = subprocess.run([sys.executable, "-m", "armrig", "info", "/nothing"], capture_output=True)

    assert done.returncode == 1
    assert done.stderr == b"armrig: /nothing: No such file or directory\n"


@pytest.mark.parametrize(
    ("module", "name", "loaded", "command"),
    [
        ("armrig", "armrig", "typer", ["ls"]),
        ("armrig", "armrig", "uvicorn", ["dashboard", "--json"]),
        ("armrig_daemon", "armrigd", "typer", ["ls"]),
    ],
)
def test_ctrl_c_while_the_command_is_loaded_is_reported_in_one_line(
    module: str, name: str, loaded: str, command: list[str], tmp_path: Path
) -> None:
    """Loading takes seconds on a busy machine."""
    pressed = "import signal\ntry:\n    signal.raise_signal(2)\nexcept BaseException as err:\n"
    (tmp_path / f"{loaded}.py").write_text(pressed + "    raise RuntimeError from err\n")
    beside = {**os.environ, "PYTHONPATH": str(tmp_path)}

    done = subprocess.run([sys.executable, "-m", module, *command], capture_output=True, env=beside)

    assert (done.returncode, done.stderr) == (130, f"{name}: interrupted\n".encode())


@pytest.mark.parametrize("which", [[], ["--all"]])
def test_ctrl_c_before_a_recorder_records_is_not_lost(
    which: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python only prints a KeyboardInterrupt in a callback of an import, and goes on."""

    def connected(*_: object, **__: object) -> Any:
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        return SimpleNamespace(session=nullcontext(object()), endpoint="tcp/nowhere:1", name="")

    for name in ("open_connection", "open_endpoint"):
        monkeypatch.setattr(f"armrig.rig.session.{name}", connected)
    # A module that the command loads would keep the function; this one is loaded already.
    monkeypatch.setattr(live_rigs, "open_endpoint", connected)

    assert (
        main(["record", "--from", "tcp/nowhere:1", "-o", str(tmp_path / "a.mcap"), *which]) == 130
    )


@pytest.mark.parametrize("program", ["raise KeyboardInterrupt", "raise E from KeyboardInterrupt()"])
def test_ctrl_c_while_a_command_is_loaded_is_no_error(program: str, tmp_path: Path) -> None:
    """Python 3.11 raises RuntimeError instead of KeyboardInterrupt in a class body."""
    pressed = f"exec({program!r}, {{'E': RuntimeError}})\n"
    (tmp_path / "mcap").mkdir()
    (tmp_path / "mcap" / "__init__.py").write_text(pressed)
    beside = {**os.environ, "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-m", "armrig", "info", str(tmp_path)]

    done = subprocess.run(command, capture_output=True, env=beside)

    assert (done.returncode, done.stderr) == (130, b"armrig: interrupted\n")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_while_the_options_are_made_ends_the_command_in_order(
    number: signal.Signals, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armrig.cli.load", lambda given: signal.raise_signal(number))

    assert main(["ls"]) == code


def test_what_is_no_file_is_reported_and_not_waited_for(tmp_path: Path) -> None:
    """The test runs in another process, because a wrong reader waits for ever."""
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


@pytest.mark.parametrize("pipe", ["cat", "head -n 2"])
def test_watch_into_a_pipe_gives_a_line_for_each_sample(
    pipe: str, daemon: FakeDaemon, where: str
) -> None:
    count = ["--count", "3"] if pipe == "cat" else []
    program = [sys.executable, "-m", "armrig", "watch", "--connect", where, *count]
    with (
        running(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as watching,
        running(pipe.split(), stdin=watching.stdout, stdout=subprocess.PIPE) as reader,
        daemon.session.declare_publisher("rig/1/sample") as out,
    ):
        assert watching.stdout is not None
        assert watching.stderr is not None
        assert reader.stdout is not None
        watching.stdout.close()
        k, until = 0, time.monotonic() + 60
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


def test_the_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0

    assert capsys.readouterr().out == f"armrig {VERSION}\n"


def test_without_a_command_there_is_help_and_exit_code_2(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main([]) == 2
    alone = capsys.readouterr().out
    assert main(["--help"]) == 0

    assert alone == capsys.readouterr().out
    assert "identify" in alone


def test_long_lines_are_broken_between_words_on_a_terminal_only() -> None:
    text = "- one two three /a/long/path/that-is-longer-than-the-line four\n\n  five"

    assert folded(text, 0) == text
    assert folded(text, 16).splitlines() == [
        *("- one two three", "  /a/long/path/that-is-longer-than-the-line", "  four"),
        *("", "  five"),
    ]
    assert folded("name  one two three four", 16, indent=6) == "name  one two\n      three four"


def test_a_demonstration_into_a_file_is_refused_with_the_way_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, b"", "file")

    assert main(["demo", "--directory", str(path)]) == 1

    assert f"--directory {path}: is a file; give a directory" in told(capsys)


def test_an_error_has_its_priority_in_the_journal(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    stderr = os.fstat(2)
    monkeypatch.setenv("JOURNAL_STREAM", f"{stderr.st_dev}:{stderr.st_ino}")

    tell("recording rig 1")
    assert main(["info", "none.mcap"]) == 1

    plain, error = capfd.readouterr().err.splitlines()
    assert plain == "armrig: recording rig 1"
    assert error.startswith("<3>armrig: none.mcap: ")
