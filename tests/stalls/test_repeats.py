"""The repetition of tests in real time."""

from __future__ import annotations

import os
import signal
import time
from types import SimpleNamespace
from typing import Any

import pytest

from tests.stalls.host import GAP_NS, Host
from tests.stalls.repeats import MAX_REPEATS, STALL_NS, Repeats

pytest_plugins = ["pytester"]
TEST = """
import pathlib, pytest

@pytest.fixture(scope="module")
def made():
    with open("made", "a") as file:
        file.write("x")

@pytest.mark.{marker}
def test_fails(made):
    with open("ran", "a") as file:
        file.write("x")
    assert pathlib.Path("ran").stat().st_size > {failures}
"""


def ran(pytester: pytest.Pytester, stall_ns: int, most: int = 9, **test: Any) -> pytest.RunResult:
    """Run a test that fails `failures` times, each time with a stall of the host."""
    pytester.makepyfile(TEST.format(**test))
    host: Any = SimpleNamespace(longest_ns=lambda *_: stall_ns, end=lambda: None)
    repeats = Repeats(lambda: host, most)
    return pytester.runpytest_inprocess("-p", "no:cacheprovider", plugins=[repeats])


@pytest.mark.parametrize(
    ("failures", "marker", "stall_ns", "attempts"),
    [
        (MAX_REPEATS, "real_time", STALL_NS, MAX_REPEATS + 1),
        (MAX_REPEATS + 1, "machine", STALL_NS, MAX_REPEATS + 1),
        (1, "real_time", STALL_NS - 1, 1),
        (1, "skipif(False, reason='')", 10**9, 1),
    ],
    ids=["repeated", "twice at most", "no stall", "not in real time"],
)
def test_a_failed_test_in_real_time_is_repeated_if_the_host_stalled(
    pytester: pytest.Pytester, failures: int, marker: str, stall_ns: int, attempts: int
) -> None:
    result = ran(pytester, stall_ns, failures=failures, marker=marker)

    assert result.parseoutcomes()["passed" if attempts > failures else "failed"] == 1
    assert (pytester.path / "ran").read_text() == "x" * attempts
    assert (pytester.path / "made").read_text() == "x" * attempts
    assert result.stdout.str().count("REPEATED ") == attempts - 1


@pytest.mark.parametrize("most", [0, 1])
def test_a_run_with_too_many_repeated_tests_fails(pytester: pytest.Pytester, most: int) -> None:
    result = ran(pytester, STALL_NS, most, failures=1, marker="real_time")

    assert result.parseoutcomes() == {"passed": 1}
    assert (result.ret == pytest.ExitCode.TESTS_FAILED) == (most == 0)


def test_each_monitor_merges_two_stalls_with_a_short_interval() -> None:
    host = Host()
    for monitor in host._monitors:
        began_ns = time.monotonic_ns()
        for _ in range(2):
            os.kill(monitor.pid, signal.SIGSTOP)
            os.waitpid(monitor.pid, os.WUNTRACED)
            time.sleep(STALL_NS / 1e9)
            os.kill(monitor.pid, signal.SIGCONT)
            time.sleep(GAP_NS / 4e9)

        assert host.longest_ns(began_ns, time.monotonic_ns()) >= 1.8 * STALL_NS
        assert host.longest_ns(0, began_ns - 3600 * 10**9) == 0
    host.end()


def test_each_processor_has_a_monitor() -> None:
    host = Host()
    assert [{cpu} for cpu in os.sched_getaffinity(0)] == [
        os.sched_getaffinity(monitor.pid) for monitor in host._monitors[1:]
    ]
    host.end()
