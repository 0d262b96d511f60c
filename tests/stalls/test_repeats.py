"""The repetition of tests in real time."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.stalls.host import GAP_NS, STOPS, Host, Stall, merged, stops_of
from tests.stalls.repeats import MAX_REPEATS, STALL_NS, allowed

pytest_plugins = ["pytester"]

TEST = """
import pathlib, pytest

@pytest.fixture(scope="module")
def made():
    yield
    with open("made", "a") as file:
        file.write("x")

@pytest.mark.{marker}
def test_fails(made):
    with open("ran", "a") as file:
        file.write("x")
    assert pathlib.Path("ran").stat().st_size > {failures}

def test_passes(made):
    pass
"""


@pytest.fixture
def host() -> Iterator[Host]:
    """Give the monitor of the host."""
    host = Host()
    yield host
    host.end()


@pytest.fixture
def stops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give a file of stops: this process was stopped until now, and for the next hour."""
    path = tmp_path / "stops"
    now_ns = time.monotonic_ns()
    path.write_text(f"{now_ns} {now_ns + 3600 * 10**9} 1 {os.getpid()}\n")
    monkeypatch.setenv(STOPS, str(path))
    return path


def ran(pytester: pytest.Pytester, *, failures: int, marker: str = "real_time") -> pytest.RunResult:
    """Run a test that fails so often and then passes."""
    pytester.makepyfile(TEST.format(marker=marker, failures=failures))
    return pytester.runpytest_inprocess("-p", "tests.stalls.repeats", "-p", "no:cacheprovider")


def test_a_test_in_real_time_is_repeated_if_the_host_stalled(
    pytester: pytest.Pytester, stops: Path
) -> None:
    result = ran(pytester, failures=MAX_REPEATS)

    assert result.ret == 0
    assert (pytester.path / "made").read_text() == "x" * (MAX_REPEATS + 1)
    result.stdout.fnmatch_lines(
        ["REPEATED *::test_fails - the host stalled for * ms; *assert 1 > 2"]
    )
    result.stdout.fnmatch_lines(["1 of 2 tests were repeated because the host stalled"])


def test_a_test_is_repeated_twice_at_most(pytester: pytest.Pytester, stops: Path) -> None:
    result = ran(pytester, failures=MAX_REPEATS + 1)

    assert result.ret == pytest.ExitCode.TESTS_FAILED
    assert len((pytester.path / "ran").read_text()) == MAX_REPEATS + 1


@pytest.mark.parametrize("stopped", [True, False])
def test_nothing_else_is_repeated(
    stopped: bool, pytester: pytest.Pytester, stops: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Host, "_ask", lambda _: None)  # a busy host stalls during this test, too
    if not stopped:
        stops.write_text(f"0 {10**18} 1\n")  # another process

    result = ran(
        pytester, failures=1, marker="skipif(False, reason='')" if stopped else "real_time"
    )

    assert result.ret == pytest.ExitCode.TESTS_FAILED
    assert (pytester.path / "ran").read_text() == "x"


def test_more_than_one_percent_of_repeated_tests_fails_the_run(
    pytester: pytest.Pytester, stops: Path
) -> None:
    pytester.makepyfile(test_other=TEST.format(marker="real_time", failures=3))

    result = ran(pytester, failures=1)

    assert result.ret == pytest.ExitCode.TESTS_FAILED
    assert result.parseoutcomes() == {"passed": 4}
    result.stdout.fnmatch_lines(["2 of 4 tests were repeated*at most 1 may be: the run fails"])
    assert [allowed(n) for n in (1, 199, 200, 3000)] == [1, 1, 2, 30]


def test_each_monitor_measures_a_stall(host: Host) -> None:
    for monitor in host._monitors:
        pid = monitor.pid
        os.kill(pid, signal.SIGSTOP)
        os.waitpid(pid, os.WUNTRACED)

        began_ns = time.monotonic_ns()
        time.sleep(2 * STALL_NS / 1e9)
        ended_ns = time.monotonic_ns()
        os.kill(pid, signal.SIGCONT)

        assert host.longest_ns(began_ns, ended_ns) >= 1.8 * STALL_NS
        assert host.longest_ns(0, began_ns - 3600 * 10**9) == 0


def test_two_stalls_with_little_between_them_are_one() -> None:
    first, near, far = Stall(0, 25), Stall(24 + GAP_NS, 50 + GAP_NS), Stall(60 + 3 * GAP_NS, 10**9)

    assert merged([far, near, first]) == [(0, 50 + GAP_NS), far]
    assert merged([Stall(0, 9), Stall(2, 5)]) == [(0, 9)]


def test_a_stop_counts_for_the_tests_whose_process_was_stopped(tmp_path: Path) -> None:
    path = tmp_path / "stops"
    path.write_text("10 20 7 5 1\n30 50 8 6 1\n")

    assert stops_of(5, str(path)) == [(10, 20)]
    assert stops_of(6, str(path)) == [(30, 50)]
    assert stops_of(9, str(path)) == stops_of(5, None) == []
