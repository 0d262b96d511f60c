"""A pytest plug-in that repeats a test in real time if the host stalled during it.

An emulated rig is real time: the daemon ends a run after a stall of the host, as it must, and a
test of that run fails. The plug-in repeats a failed test if a stall lay in the attempt and the test
is marked as `real_time`, `timed` or `machine`. The stall is judged by clocks alone (`host.py`),
never by the failure. The run fails if too many tests were repeated.
"""

from __future__ import annotations

import time
from contextlib import suppress
from typing import Final

import pytest
from _pytest.runner import runtestprotocol

from tests.stalls.host import Host

STALL_NS: Final = 40_000_000
"""Shortest stall for which a test is repeated: with a tick of 10 ms it exceeds the limit of S4."""
MAX_REPEATS: Final = 2
MAX_REPEATED_SHARE: Final = 0.01
MARKERS: Final = ("real_time", "timed", "machine")
_REPEATED: Final = "repeated"


class Repeats:
    """The repeated tests of a run, and how many tests there were."""

    def __init__(self) -> None:
        self._host: Host | None = None
        self._tests: set[str] = set()
        self._repeated: dict[str, list[str]] = {}

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> object:
        """Run a test in real time, and repeat it if the host stalled during it."""
        if not any(item.get_closest_marker(marker) for marker in MARKERS):
            return None
        self._host = self._host or Host()
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for report in _reports(item, nextitem, self._host):
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Count tests and repeated tests; the main process of xdist receives all reports."""
        self._tests.add(report.nodeid)
        if report.when == "teardown":
            said = [str(value) for name, value in report.user_properties if name == _REPEATED]
            self._repeated |= {report.nodeid: said} if said else {}

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail the run if too many tests were repeated."""
        if self._host is not None:
            self._host.end()
            self._host = None
        if len(self._repeated) > allowed(len(self._tests)) and session.exitstatus == 0:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Show the repeated tests, and why each attempt was repeated."""
        n, of = len(self._repeated), len(self._tests)
        if not n:
            return
        terminalreporter.section("repeated tests")
        for test, said in self._repeated.items():
            for attempt in said:
                terminalreporter.write_line(f"REPEATED {test} - {attempt}")
        judged = "" if n <= allowed(of) else f", at most {allowed(of)} may be: the run fails"
        terminalreporter.write_line(
            f"{n} of {of} tests were repeated because the host stalled{judged}"
        )


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker and the plug-in."""
    marker = (
        "real_time: drives an emulated rig in real time; repeated if the host stalled during it"
    )
    config.addinivalue_line("markers", marker)
    config.pluginmanager.register(Repeats())


def allowed(tests: int) -> int:
    """Return the number of tests that may be repeated: one at least, even in a short run."""
    return max(1, int(tests * MAX_REPEATED_SHARE))


def _reports(
    item: pytest.Item, nextitem: pytest.Item | None, host: Host
) -> list[pytest.TestReport]:
    """Return the reports of the last attempt."""
    for attempt in range(MAX_REPEATS + 1):
        began_ns = time.monotonic_ns()
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        failed = [report for report in reports if report.failed]
        stall_ns = host.longest_ns(began_ns, time.monotonic_ns()) if failed else 0
        if stall_ns < STALL_NS or attempt == MAX_REPEATS:
            for report in failed:
                text = f"the longest stall during this attempt: {stall_ns / 1e6:.0f} ms"
                report.sections.append(("Host", text))
            break
        said = f"the host stalled for {stall_ns / 1e6:.0f} ms; {_said(failed[0])}"
        item.user_properties.append((_REPEATED, said))
        with suppress(Exception):  # what ends badly here belongs to the discarded attempt
            item.session._setupstate.teardown_exact(None)
    return reports


def _said(report: pytest.TestReport) -> str:
    """Return the first line of a failure."""
    crash = getattr(report.longrepr, "reprcrash", None)
    lines = (crash.message if crash else str(report.longrepr)).splitlines()
    return lines[0] if lines else ""
