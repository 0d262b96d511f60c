"""Which tests reach which line, and how long each takes: a bug is shown to those alone."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

import coverage
import pytest

from mutation.trial import in_child

Lines = dict[str, dict[int, list[str]]]
"""Tests by module and line."""


class Reach(NamedTuple):
    """What the tests reach without any bug."""

    lines: Lines
    took_s: dict[str, float]
    """By test."""


class _Contexts:
    """Tells coverage which test is running, and times it."""

    def __init__(self, measured: coverage.Coverage) -> None:
        self._measured = measured
        self.took_s: defaultdict[str, float] = defaultdict(float)
        self.failed: list[str] = []

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self._measured.switch_context(nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.took_s[report.nodeid] += report.duration
        if report.failed:
            self.failed.append(report.nodeid)


def measured(tests: list[str], package: str, limit_s: float) -> Reach:
    """Run all tests once; one that fails without a bug says nothing, and is left out.

    Raises
    ------
    RuntimeError
        pytest did not come to its end.
    """

    def run(told: Path) -> None:
        lines: defaultdict[str, defaultdict[int, list[str]]] = defaultdict(
            lambda: defaultdict(list)
        )
        cov = coverage.Coverage(data_file=None, source_pkgs=[package], config_file=False)
        contexts = _Contexts(cov)
        cov.start()
        code = pytest.main(
            ["-q", "--no-header", "-p", "no:cacheprovider", "-p", "no:cov", *tests],
            plugins=[contexts],
        )
        cov.stop()
        data = cov.get_data()
        for path in data.measured_files():
            for line, names in data.contexts_by_lineno(path).items():
                lines[path][line] = [name for name in names if name]
        told.write_text(json.dumps([int(code), contexts.failed, lines, contexts.took_s]))

    status, told = in_child(run, limit_s)
    if told is None or told[0] not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        why = told[1] if told else f"status {status}"
        msg = f"the tests without a bug did not come to their end: {why}"
        raise RuntimeError(msg)
    failed = set(told[1])
    for name in failed:
        print(f"left out, for it fails without a bug: {name}")
    by_line: Lines = {
        path: {int(line): [n for n in names if n not in failed] for line, names in found.items()}
        for path, found in told[2].items()
    }
    return Reach(by_line, told[3])


def tests_of(reach: Reach, path: str, line: int, budget_s: float) -> list[str]:
    """Return the tests that reach a line, the quickest first, for as long as the budget allows.

    A line that is done at the import is reached by whatever reaches its module.
    """
    lines = reach.lines.get(path, {})
    names = lines.get(line) or sorted({name for found in lines.values() for name in found})
    chosen, spent_s = [], 0.0
    for name in sorted(names, key=lambda name: reach.took_s.get(name, 0.0)):
        spent_s += reach.took_s.get(name, 0.0)
        if chosen and spent_s > budget_s:
            break
        chosen.append(name)
    return chosen
