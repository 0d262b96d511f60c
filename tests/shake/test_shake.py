"""Disturbances of `make shake`, and the results that it keeps."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.integration.processes import state_of
from tests.shake import suite
from tests.shake.__main__ import code_hash, kept, short_folder
from tests.shake.conditions import CONDITIONS, DRAWN, of_seed
from tests.shake.run import TIMED_OUT, Result, interrupted, named, run
from tests.shake.stopping import stopped

ECHO = "import sys\nfor line in sys.stdin: print(line, end='', flush=True)"


def ran(folder: Path, condition: str, *program: str, limit_s: float = 30.0) -> Result:
    """Run a program of Python under a condition."""
    return run(
        [sys.executable, "-c", *program],
        CONDITIONS[condition],
        seed=1,
        folder=folder,
        log=folder / "log",
        limit_s=limit_s,
        environ=dict(os.environ),
    )


def test_a_stopped_process_does_nothing_until_it_is_continued() -> None:
    # Of no run: else the disturber of `make shake` may stop it, too.
    environ = {name: value for name, value in os.environ.items() if name != suite.MARK}
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [sys.executable, "-c", ECHO], stdin=pipe, stdout=pipe, bufsize=0, env=environ
    ) as program:
        assert program.stdin is not None
        assert program.stdout is not None

        with stopped(program.pid) as done:
            program.stdin.write(b"1\n")
            in_the_block = state_of(program.pid)
        answer = program.stdout.readline()
        program.stdin.close()

    assert (done, in_the_block, answer) == (True, "t", b"1\n")


def test_a_run_says_how_it_ended_and_what_failed(tmp_path: Path) -> None:
    program = "print('FAILED tests/a.py::test_b[x y] - no'); sum(range(10**6)); exit(3)"

    result = ran(tmp_path, "quiet", program)

    assert (result.exit_code, result.stops, result.left_over) == (3, 0, 0)
    assert result.failed == ["tests/a.py::test_b[x y]"]
    assert result.cpu_s > 0


def test_a_run_that_does_not_end_is_killed(tmp_path: Path) -> None:
    result = ran(tmp_path, "quiet", "import time; time.sleep(60)", limit_s=0.0)

    assert result.exit_code == TIMED_OUT


def test_a_run_is_interrupted_before_it_is_killed() -> None:
    program = """if 1:
        import signal
        # blocked, because a signal just before a call that waits would not end that call
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        print("ready", flush=True)
        signal.sigwait([signal.SIGINT])
        exit(3)
    """
    with subprocess.Popen(
        [sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        process_group=0,
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()

        ended = interrupted(process)

    assert ended is not None
    assert ended[0] == 3


def test_all_that_a_run_has_started_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(suite.MARK, "a run")
    program = [sys.executable, "-c", "print(flush=True); input()"]
    ends = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(program, **ends, start_new_session=True) as process:
        assert process.stdout
        process.stdout.readline()  # the kernel shows its variables from a little after its start on
        killed = suite.kill("a run")

    assert (killed, process.returncode) == (1, -signal.SIGKILL)


def test_a_run_has_a_session_of_its_own(tmp_path: Path) -> None:
    result = ran(tmp_path, "quiet", "import os; exit(os.getsid(0) != os.getpid())")

    assert result.exit_code == 0


def test_one_core_is_what_the_suite_gets(tmp_path: Path) -> None:
    result = ran(tmp_path, "one-core", "import os; exit(len(os.sched_getaffinity(0)))")

    assert result.exit_code == 1


def test_seeds_select_all_conditions() -> None:
    assert [of_seed(seed) for seed in (1, 2, 3, 4)] == list(DRAWN)
    assert of_seed(5) == of_seed(1)


def test_what_failed_and_what_was_repeated_is_read_from_the_summary() -> None:
    text = "FAILED tests/a.py::b - x\nERROR tests/c.py::d\nFAILED tests/a.py::b - x\n"
    text += "REPEATED tests/e.py::f - the host stalled\ntests/a.py FAILED\n"

    assert named(text, "FAILED|ERROR") == ["tests/a.py::b", "tests/c.py::d"]
    assert named(text, "REPEATED") == ["tests/e.py::f"]


@pytest.mark.parametrize(
    ("name", "voids"), [("tests", True), ("Makefile", True), ("docs", False), ("README.md", False)]
)
def test_a_change_of_code_or_tests_voids_results(name: str, voids: bool) -> None:
    names = ("Makefile", "README.md", "docs", "tests")
    before = "\n".join(f"040000 tree 1111\t{each}" for each in names)

    changed = before.replace(f"1111\t{name}", f"2222\t{name}")

    assert (code_hash(changed) != code_hash(before)) == voids


def test_each_run_has_a_temporary_folder_with_a_short_name(tmp_path: Path) -> None:
    """The path of a socket in the folder must be short."""
    assert [short_folder(tmp_path).name for _ in range(2)] == ["s0", "s1"]


def test_results_are_known_for_the_same_code(tmp_path: Path) -> None:
    path = tmp_path / "results"
    lines = [
        {"code": "a", "condition": "busy", "seed": 1, "exit_code": 0},
        {"code": "b", "condition": "busy", "seed": 2, "exit_code": 1},
    ]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))

    assert kept(path, "a") == {("busy", 1): 0}
    assert kept(tmp_path / "none", "a") == {}
