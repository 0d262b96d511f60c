"""A pytest plug-in that repeats a failed test in real time if the host stalled during it.

The daemon must end a run after a stall of the host. Only clocks prove a stall (`host.py`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import pytest
from _pytest.runner import runtestprotocol

from tests.stalls.host import Host

STALL_NS: Final = 40_000_000
"""Shortest stall for which a test is repeated: with a tick of 10 ms it exceeds the limit of S4."""
MAX_REPEATS: Final = 2
MOST_REPEATED: Final = 30  # more repeated tests fail the run
MARKERS: Final = ("real_time", "timed", "machine")


class Repeats:
    """The repeated tests of a run."""

    def __init__(self, host: Callable[[], Host] = Host, most: int = MOST_REPEATED) -> None:
        self._make_host, self._most = host, most
        self._host: Host | None = None
        self._repeated: dict[str, list[str]] = {}

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> object:
        if not any(item.get_closest_marker(marker) for marker in MARKERS):
            return None
        self._host = self._host or self._make_host()
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for report in _reports(item, nextitem, self._host):
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a repeated test; the main process of xdist receives all reports."""
        if said := [str(value) for name, value in report.user_properties if name == "repeated"]:
            self._repeated[report.nodeid] = said

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if self._host is not None:
            self._host.end()
        if len(self._repeated) > self._most and session.exitstatus == 0:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        for test, said in self._repeated.items():
            for attempt in said:
                terminalreporter.write_line(f"REPEATED {test} - {attempt}")
        if n := len(self._repeated):
            terminalreporter.write_line(f"{n} repeated; more than {self._most} fail the run")


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(Repeats())


def _reports(
    item: pytest.Item, nextitem: pytest.Item | None, host: Host
) -> list[pytest.TestReport]:
    for repeats_left in range(MAX_REPEATS, -1, -1):
        began_ns = time.monotonic_ns()
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        failed = [report for report in reports if report.failed]
        stall_ns = host.longest_ns(began_ns, time.monotonic_ns()) if failed else 0
        said = f"the longest stall during this attempt: {stall_ns / 1e6:.0f} ms"
        if stall_ns < STALL_NS or not repeats_left:
            for report in failed:
                report.sections.append(("Host", said))
            break
        crash = getattr(failed[0].longrepr, "reprcrash", None)
        message = crash.message.partition("\n")[0] if crash else ""
        item.user_properties.append(("repeated", f"{said}; {message}"))
        with suppress(Exception):  # what ends badly here belongs to the discarded attempt
            item.session._setupstate.teardown_exact(None)
    return reports
