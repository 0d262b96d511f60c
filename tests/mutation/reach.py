"""The tests that reach each line, their times and their markers."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections import defaultdict
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import coverage
import pytest

from tests.mutation.trial import QUIET, in_child

ROOT = Path(__file__).parents[2]
PACKAGES = ["armrig", "armrig_core", "armrig_daemon", "armrig_protocol"]
ENDS = (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.NO_TESTS_COLLECTED)
LIMIT_S = 1800.0  # of the clock, for the tests of one folder


class Passing(NamedTuple):
    """A test that passes without a bug."""

    took_s: float
    marker: str
    """One of `markers`, or empty."""


class Reach:
    """Coverage of the tests without a bug, in a folder: a JSON file for each file of tests."""

    def __init__(self, folder: Path, *, everyday: bool = False) -> None:
        """Keep the measurements in `folder`: of the tests of `make test` only, if `everyday`."""
        self._folder = folder / "everyday" if everyday else folder
        self._everyday = everyday
        self.tests: dict[str, Passing] = {}
        self._lines: defaultdict[str, dict[str, int]] = defaultdict(dict)

    def measure(self, paths: Iterable[str], *, sources: bool = True) -> None:
        """Run the tests of these files that were not measured before, or have changed.

        Without `sources` the tests are only timed: they start processes, which are not measured.
        """
        stale: defaultdict[Path, list[str]] = defaultdict(list)
        for path in paths:
            kept = self._kept(path)
            if kept is None:
                stale[Path(path).parent].append(path)
            else:
                self._take(kept)
        for folder, of_folder in stale.items():
            print(f"measures {folder}", flush=True)
            for path, found in measured(
                of_folder, PACKAGES if sources else [], everyday=self._everyday
            ).items():
                self._folder.mkdir(parents=True, exist_ok=True)
                self._file(path).write_text(json.dumps(found))
                self._take(found)

    def tests_of(self, source: str, line: int) -> list[str]:
        """Return the tests that reach a line.

        A line that is executed by the import is reached by each test that reaches its module.
        """
        found = self._lines[source]
        return [test for test, bits in found.items() if bits >> line & 1] or list(found)

    def _file(self, path: str) -> Path:
        return self._folder / f"{path.replace('/', '.')}.json"

    def _kept(self, path: str) -> dict[str, Any] | None:
        file = self._file(path)
        kept = json.loads(file.read_text()) if file.exists() else None
        if kept is None or any(digest(name) != was for name, was in kept["digests"].items()):
            return None
        return kept  # type: ignore[no-any-return]

    def _take(self, found: dict[str, Any]) -> None:
        self.tests |= {name: Passing(*test) for name, test in found["tests"].items()}
        for source, by_test in found["lines"].items():
            for test, bits in by_test.items():
                if test in self.tests:
                    self._lines[source][test] = int(bits, 16)


@cache
def markers() -> tuple[str, ...]:
    """Return the project's markers: of tests that `make test` does not run with the others."""
    options = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]
    return tuple(marker.partition(":")[0] for marker in options["markers"])


@cache
def digest(path: str) -> str:
    """Return the hash of a file of the project; empty if there is none."""
    file = ROOT / path
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16] if file.exists() else ""


class _Contexts:
    """Names the test that is running to coverage, and times it."""

    def __init__(self, measured: coverage.Coverage | None) -> None:
        self._measured = measured
        self.tests: dict[str, tuple[float, str]] = {}
        self.failed: set[str] = set()

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        for item in items:
            marker = next((name for name in markers() if item.get_closest_marker(name)), "")
            self.tests[item.nodeid] = (0.0, marker)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logstart(self, nodeid: str) -> None:
        if self._measured is not None:
            self._measured.switch_context(nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        took_s, marker = self.tests[report.nodeid]
        self.tests[report.nodeid] = (round(took_s + report.duration, 3), marker)
        if not report.passed:
            self.failed.add(report.nodeid)


def measured(
    paths: list[str], packages: list[str], *, everyday: bool = False
) -> dict[str, dict[str, Any]]:
    """Run tests once; a test that fails or is skipped without a bug is left out.

    Raises
    ------
    RuntimeError
        pytest did not come to its end.
    """

    def run(told: Path) -> None:
        cov = coverage.Coverage(data_file=None, source_pkgs=packages, config_file=False)
        contexts = _Contexts(cov if packages else None)
        if packages:
            cov.start()
        words = [word for word in QUIET if word not in ("-x", "--no-summary")]
        if everyday:
            words += ["-m", " and ".join(f"not {name}" for name in markers())]
        code = pytest.main([*words, *paths], plugins=[contexts])
        lines: defaultdict[str, defaultdict[str, int]] = defaultdict(lambda: defaultdict(int))
        if packages:
            cov.stop()
            data = cov.get_data()
            for path in data.measured_files():
                source = str(Path(path).relative_to(ROOT))
                for line, names in data.contexts_by_lineno(path).items():
                    for name in names:
                        lines[source][name] |= 1 << line
        tests = {name: test for name, test in contexts.tests.items() if name not in contexts.failed}
        told.write_text(json.dumps([int(code), tests, sorted(contexts.failed), lines]))

    status, told = in_child(run, LIMIT_S, LIMIT_S)
    if told is None or told[0] not in ENDS:
        raise RuntimeError(
            f"{' '.join(paths)} did not come to an end without a bug: {told or status}"
        )
    for name in told[2]:
        print(f"left out, for it does not pass without a bug: {name}", flush=True)
    return {path: _of_file(path, told[1], told[3]) for path in paths}


def _of_file(path: str, tests: dict[str, Any], lines: dict[str, dict[str, int]]) -> dict[str, Any]:
    """Return what one file of tests has done, and the hashes of the files that it depends on."""
    own = {name: test for name, test in tests.items() if name.partition("::")[0] == path}
    reached = {
        source: {test: hex(bits) for test, bits in by_test.items() if test in own}
        for source, by_test in lines.items()
    }
    reached = {source: by_test for source, by_test in reached.items() if by_test}
    return {
        "tests": own,
        "lines": reached,
        "digests": {name: digest(name) for name in (path, *reached)},
    }
