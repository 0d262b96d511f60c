"""The command line for a person and a script, with good input and bad."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import tomllib
from contextlib import nullcontext, suppress
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import armrig
import pytest
from armrig.cli import main
from armrig.cli.printing import fold, tell
from armrig.rig import status
from armrig_core.telemetry import telemetry

from tests.clients.fake_daemon import FakeDaemon
from tests.clients.made_recordings import sample
from tests.clients.running import running

PROJECT = Path(__file__).parents[3] / "pyproject.toml"
VERSION = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]["version"]
HEAVY = ("numpy", "scipy", "zenoh", "mcap", "matplotlib", "typst", "control", "rich.console")


@pytest.mark.parametrize("program", ["import armrig", "import armrig.cli"])
def test_no_large_package_is_imported_before_it_is_needed(program: str) -> None:
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
        *("armrig.cli.options", "armrig.cli.printing", "armrig.cli.rig")
    }


def test_every_public_name_can_be_imported() -> None:
    assert all(getattr(armrig, name) is not None for name in armrig.__all__)
    assert armrig.__version__ == VERSION
    assert set(armrig.__all__) < set(dir(armrig))
    assert not hasattr(armrig, "nothing")
    assert all(getattr(armrig.control, name) is not None for name in armrig.control.__all__)
    assert all(getattr(armrig.physics, name) is not None for name in armrig.physics.__all__)


EARLIER_NAMES = {"SubspaceFit": "Fit", "MultivariableFit": "Fit", "from_csv": "input_from_file"}
EARLIER_NAMES |= {name: f"control.{name}" for name in armrig.control.__all__}
EARLIER_NAMES |= {name: f"physics.{name}" for name in armrig.physics.__all__}


@pytest.mark.parametrize(("earlier", "present"), EARLIER_NAMES.items())
def test_an_earlier_name_warns_of_its_end_and_names_the_present_name(
    earlier: str, present: str
) -> None:
    with pytest.warns(DeprecationWarning, match=f"armrig.{earlier} is armrig.{present} now"):
        meant = getattr(armrig, earlier)

    assert meant is attrgetter(present)(armrig)
    assert earlier not in dir(armrig)


# Python 3.11 raises RuntimeError instead of KeyboardInterrupt in a class body.
IN_A_CLASS = (
    "try:\n    signal.raise_signal(2)\nexcept BaseException as e:\n    raise RuntimeError from e"
)


@pytest.mark.parametrize(
    ("module", "name", "loaded", "command", "pressed"),
    [
        ("armrig", "armrig", "typer", "ls", IN_A_CLASS),
        ("armrig", "armrig", "uvicorn", "dashboard --json", IN_A_CLASS),
        ("armrig", "armrig", "mcap", "info .", IN_A_CLASS),
        ("armrig", "armrig", "mcap", "info .", "raise KeyboardInterrupt"),
        ("armrig_daemon", "armrigd", "typer", "ls", IN_A_CLASS),
    ],
    ids=["command line", "server", "reader", "reader, at once", "daemon"],
)
def test_ctrl_c_during_an_import_is_reported_in_one_line(
    module: str, name: str, loaded: str, command: str, pressed: str, tmp_path: Path
) -> None:
    """Loading takes seconds on a busy machine."""
    (tmp_path / f"{loaded}.py").write_text(f"import signal\n{pressed}\n")
    program = [sys.executable, "-m", module, *command.split()]
    paths = {**os.environ, "PYTHONPATH": str(tmp_path)}

    done = subprocess.run(program, capture_output=True, env=paths)

    assert (done.returncode, done.stderr) == (130, f"{name}: interrupted\n".encode())


@pytest.mark.parametrize("which", [[], ["--all"]])
def test_ctrl_c_during_the_start_of_a_recorder_ends_it(
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
    monkeypatch.setattr(status, "open_endpoint", connected)

    assert (
        main(["record", "--from", "tcp/nowhere:1", "-o", str(tmp_path / "a.mcap"), *which]) == 130
    )


def test_a_named_pipe_is_refused_without_waiting(tmp_path: Path) -> None:
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
def test_watch_prints_a_line_for_each_sample_to_a_pipe(
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


def test_armrig_without_a_command_prints_help_and_has_exit_code_2(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main([]) == 2
    alone = capsys.readouterr().out
    assert main(["--help"]) == 0

    assert alone == capsys.readouterr().out
    assert "identify" in alone


def test_long_lines_are_broken_between_words_on_a_terminal_only() -> None:
    text = "- one two three /a/long/path/that-is-longer-than-the-line four\n\n  five"

    assert fold(text, 0) == text
    assert fold(text, 16).splitlines() == [
        *("- one two three", "  /a/long/path/that-is-longer-than-the-line", "  four"),
        *("", "  five"),
    ]
    assert fold("name  one two three four", 16, indent=6) == "name  one two\n      three four"


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
