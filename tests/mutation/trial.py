"""Runs of pytest in a child each: the parent never imports what bugs are planted in."""

from __future__ import annotations

import contextlib
import json
import os
import re
import resource
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from enum import StrEnum
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import pytest

MEMORY_BYTES = 3 << 30  # a bug may let a list grow for ever
PATIENCE = 10  # of the clock for one of the processor: others use it too
QUIET = ["-q", "-x", "--no-header", "--no-summary", "-p", "no:cacheprovider", "-p", "no:cov"]
QUIET += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # plugins are imported by the parent


class Outcome(StrEnum):
    """Outcome of a bug."""

    CAUGHT = "caught"
    TIMED_OUT = "timed out"
    SURVIVED = "survived"
    NOT_BUILT = "not built"
    """The compiler, or node, refuses it: that is no bug that could be met."""


class Verdict(NamedTuple):
    """An outcome, and who brought it about."""

    outcome: Outcome
    by: str
    """Test that failed, or another reason."""
    took_s: float
    marker: str = ""
    """Marker of the test; empty if `make test` runs it."""


class _First:
    """Notes the first test that fails."""

    def __init__(self) -> None:
        self.failed = ""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self.failed:
            self.failed = report.nodeid

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed and not self.failed:
            self.failed = f"import of {report.nodeid}"


def tried(
    tests: list[str], plant: Callable[[], None], limit_s: float, clock_s: float | None = None
) -> Verdict:
    """Run tests one after the other, in a child with a bug in it, until one fails.

    Parameters
    ----------
    limit_s : float
        Of the processor's time.
    clock_s : float, optional
        Of the clock's, for tests that wait for processes; some more unless given.

    Raises
    ------
    RuntimeError
        pytest itself did not run: that is no bug caught.
    """

    def run(told: Path) -> None:
        plant()
        first, code = _First(), -1
        # What a failed test has left may make pytest itself fail at its end.
        with contextlib.suppress(Exception):
            code = int(pytest.main([*QUIET, *tests], plugins=[first]))
        told.write_text(json.dumps([code, first.failed]))

    began = time.monotonic()
    status, told = in_child(run, limit_s, clock_s)
    took_s = time.monotonic() - began
    if status is None:
        return Verdict(Outcome.TIMED_OUT, f"{limit_s:.0f} s", took_s)
    if told is None:
        return Verdict(Outcome.CAUGHT, f"the process ended with status {status}", took_s)
    code, failed = told
    if code == pytest.ExitCode.OK:
        return Verdict(Outcome.SURVIVED, "", took_s)
    if not failed:
        raise RuntimeError(f"pytest ended with {code}, and no test failed: do they exist?")
    return Verdict(Outcome.CAUGHT, failed, took_s)


def tried_in(copy: Path, tests: list[str], markers: str, clock_s: float) -> Verdict:
    """Run tests one after the other in a copy of the project, until one fails.

    Raises
    ------
    RuntimeError
        pytest itself did not run: that is no bug caught.
    """
    packages = ("firmware_protocol", "daemon", "clients")
    paths = os.pathsep.join(str(copy / package) for package in packages)
    words = [sys.executable, "-m", "pytest", *QUIET, "-m", markers, *tests]
    words = [word for word in words if word != "--no-summary"]
    began = time.monotonic()
    with subprocess.Popen(
        words,
        cwd=copy,
        env={**os.environ, "PYTHONPATH": paths},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    ) as child:
        try:
            said, _ = child.communicate(timeout=clock_s)
        except subprocess.TimeoutExpired:
            return Verdict(Outcome.TIMED_OUT, f"{clock_s:.0f} s", time.monotonic() - began)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
    took_s = time.monotonic() - began
    if child.returncode in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
        return Verdict(Outcome.SURVIVED, "", took_s)
    if child.returncode == pytest.ExitCode.USAGE_ERROR:
        raise RuntimeError(f"pytest did not run: {shlex.join(words)}")
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", said, re.MULTILINE)
    by = failed[1] if failed else f"the process ended with status {child.returncode}"
    return Verdict(Outcome.CAUGHT, by, took_s)


def in_child(
    run: Callable[[Path], None], limit_s: float, clock_s: float | None = None
) -> tuple[int | None, Any]:
    """Return the child's exit status, None after a timeout, and its result.

    Processes that it has started end with it.

    Parameters
    ----------
    limit_s : float
        Limit of the processor's time.
    clock_s : float, optional
        Limit of the clock's time.
    """
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder) / "told"
        pid = os.fork()
        if pid == 0:
            os.setpgid(0, 0)
            _be_modest(Path(folder), limit_s)
            try:
                run(told)
            except BaseException:  # whatever it is, it is the child's
                told.write_text(json.dumps([-1, ""]))
            finally:
                os._exit(0)
        try:
            status = _waited_for(pid, PATIENCE * limit_s if clock_s is None else clock_s)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(pid, signal.SIGKILL)
        if status is None or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU):
            return None, None
        return status, json.loads(told.read_text()) if told.exists() else None


def _waited_for(pid: int, clock_s: float) -> int | None:
    """Return the exit status of a child; kill it after a timeout, and return None."""
    deadline = time.monotonic() + clock_s
    while time.monotonic() < deadline:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return status
        time.sleep(0.01)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return None


def _be_modest(folder: Path, limit_s: float) -> None:
    """Redirect a child's output and files, and bound its resources."""
    resource.setrlimit(resource.RLIMIT_CPU, (ceil(limit_s), ceil(limit_s) + 5))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    os.environ["HYPOTHESIS_STORAGE_DIRECTORY"] = str(folder)
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, sys.stdout.fileno())
    os.dup2(nothing, sys.stderr.fileno())
