"""Progress by room, failures as they come, and what was skipped for want of which tool.

In place of pytest's dots; with -q or -v pytest speaks as it does elsewhere.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import PurePosixPath
from typing import Any

import pytest

MAX_REASONS = 10


def room(nodeid: str) -> str:
    """Return the folder below `tests` that a test is in, down to two levels."""
    return "/".join(PurePosixPath(nodeid.partition("::")[0]).parts[1:-1][:2])


def grouped(reasons: Iterable[str], most: int = MAX_REASONS) -> list[str]:
    """Return a line for each reason with its count, the most frequent first; `most` lines at most.

    Examples
    --------
    >>> grouped(["no node: apt install nodejs"] * 3)
    ['   3 skipped, no node: apt install nodejs']
    """
    counted = Counter(reasons).most_common()
    shown = counted if len(counted) <= most else counted[: most - 1]
    lines = [f"{n:4d} skipped, {reason}" for reason, n in shown]
    if rest := counted[len(shown) :]:
        lines.append(f"{sum(n for _, n in rest):4d} skipped, {len(rest)} other reasons: pytest -rs")
    return lines


class Progress:
    """A line for each room whose tests have all ended."""

    def __init__(self, terminal: pytest.TerminalReporter) -> None:
        """Write to a terminal."""
        self._terminal = terminal
        terminal.showfspath = False
        self._left: Counter[str] = Counter()
        self._outcomes: dict[str, Counter[str]] = {}
        self._total = 0

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Count the tests of each room, without xdist."""
        self._expect(item.nodeid for item in session.items)

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_node_collection_finished(self, ids: list[str]) -> None:
        """Count the tests of each room; each worker has collected the same ones."""
        self._expect(ids)

    def _expect(self, nodeids: Iterable[str]) -> None:
        self._left = Counter(map(room, nodeids))
        self._outcomes = {name: Counter() for name in self._left}
        self._total = self._left.total()

    def pytest_report_teststatus(self, report: pytest.TestReport) -> tuple[str, str, str] | None:
        """Give no test a letter; the summary at the end needs the word of a failure."""
        if report.failed:
            return ("failed", "", "FAILED") if report.when == "call" else ("error", "", "ERROR")
        if report.skipped or report.when == "call":
            return report.outcome, "", ""
        return None

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Name a failure at once; count a test once it is torn down."""
        name = room(report.nodeid)
        if report.failed or report.skipped or report.when == "call":
            self._outcomes[name][report.outcome] += 1
        if report.failed:
            self._terminal.write_line(f"FAILED {report.nodeid} ({report.when})", red=True)
        if report.when == "teardown":
            self._left[name] -= 1
            if not self._left[name]:
                self._room_ended(name)

    def _room_ended(self, name: str) -> None:
        counts = ", ".join(f"{n} {outcome}" for outcome, n in self._outcomes[name].items())
        share = 1 - self._left.total() / self._total
        self._terminal.write_line(f"{share:4.0%}  {name or 'tests'}: {counts}")

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the skipped tests with their reasons."""
        reasons = [_reason(report) for report in terminalreporter.stats.get("skipped", [])]
        for line in grouped(reasons):
            terminalreporter.write_line(line)


def _reason(report: Any) -> str:
    _, _, reason = report.longrepr
    return str(reason).removeprefix("Skipped: ")
