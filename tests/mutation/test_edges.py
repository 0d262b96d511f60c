"""Bugs that reach the processes that a test starts, and a draw that goes on where it was left."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import tomllib
from ast import literal_eval
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from armrig_daemon import config
from armrig_daemon.config import Config
from armrig_daemon.loop.process import Settings
from armrig_daemon.service import child

from mutation import edges
from mutation.__main__ import ROOT, modules
from mutation.outcomes import Outcomes
from mutation.planting import path_of, plant_in_started
from mutation.sites import Site, planted, sites
from mutation.trial import Outcome, Verdict, in_child

SITE = Site("armrig_daemon.service.runs", 17, 100, "constant")
CAUGHT = Verdict(Outcome.CAUGHT, "tests/a.py::test_it", 1.5)


def _bug(module: str, before: str, after: str) -> Site:
    """Return the bug that makes of one statement another."""
    source = path_of(module).read_text()
    for site in sites(module, source):
        bug = planted(source, site.number)
        if (bug.before, bug.after) == (before, after):
            return site
    raise LookupError(before)


def _plant_from_now_on(monkeypatch: pytest.MonkeyPatch, site: Site) -> None:
    for name, value in plant_in_started(site.name).items():
        monkeypatch.setenv(name, value)


def _exit_code_without_a_port() -> int:
    settings = Settings(
        rules=Config().rules(), port="/dev/null", baud=500_000, priority=0, cpu=None, spin_ns=0
    )
    loop = child.start(settings)
    while loop.records() is not None:
        pass
    return loop.end()


def _said_by(program: str) -> Any:
    """Return what a program of its own has printed: pytest is not run within pytest."""
    paths = os.pathsep.join(p for p in sys.path if p)
    said = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=True,
    )
    return literal_eval(said.stdout)


def test_a_bug_is_in_a_program_that_is_started(monkeypatch: pytest.MonkeyPatch) -> None:
    """In its module, wherever that is imported."""
    program = [
        sys.executable,
        "-c",
        "from armrig_core.recording_file import recorder as r; print(r.QUEUE)",
    ]
    _plant_from_now_on(
        monkeypatch, _bug("armrig_core.recording_file.recorder", "QUEUE = 10000", "QUEUE = 10001")
    )

    said = subprocess.run(program, capture_output=True, text=True, check=True)

    assert (said.stdout, said.stderr) == ("10001\n", "")


def test_a_bug_is_in_the_module_that_is_run_as_a_program(monkeypatch: pytest.MonkeyPatch) -> None:
    """As the loop is, by its service: a child of a child of the test's."""
    assert _exit_code_without_a_port() == 2
    _plant_from_now_on(
        monkeypatch, _bug("armrig_daemon.loop.process", "NO_PORT = 2", "NO_PORT = 3")
    )

    assert _exit_code_without_a_port() == 3


def test_the_daemon_takes_the_bug_for_no_setting_of_its_own() -> None:
    """Else it would not even start: each bug would be seen by whatever starts it."""
    assert config.load([], plant_in_started(SITE.name), {}) == Config()


def test_what_failed_is_told_though_pytest_itself_fails_behind_it(tmp_path: Path) -> None:
    """A process that a failed test has left behind is a warning that comes at the very end."""
    (tmp_path / "pytest.ini").write_text("[pytest]\nfilterwarnings = error\n")
    path = tmp_path / "test_this.py"
    path.write_text(
        "import subprocess\n"
        "def test_it():\n"
        "    left = [subprocess.Popen(['sleep', '600'])]\n"
        "    left.append(left)\n"
        "    del left\n"
        "    assert False\n"
    )
    program = (
        "from mutation.trial import tried; "
        f"print(repr(tried([{str(path)!r}], lambda: None, 60.0).by))"
    )

    assert _said_by(program).endswith("test_it")


def test_what_a_bug_has_left_behind_ends_with_its_child(tmp_path: Path) -> None:
    """A daemon without its guards would drive on into the next trial."""
    pid = tmp_path / "pid"

    def run(told: Path) -> None:
        left = subprocess.Popen(["sleep", "600"])
        pid.write_text(str(left.pid))
        told.write_text("1")

    assert in_child(run, 5.0)[1] == 1

    state, until = Path(f"/proc/{pid.read_text()}/stat"), time.monotonic() + 10.0
    while state.exists() and state.read_text().rpartition(")")[2].split()[0] != "Z":
        assert time.monotonic() < until


def test_a_draw_goes_on_where_it_was_left(tmp_path: Path) -> None:
    """Also behind a line that was cut off; but a module that has changed is tried anew."""
    path = tmp_path / "state"
    Outcomes(path).add(SITE, "x = 1", CAUGHT)
    Outcomes(path).add_timed(
        "tests/a.py", {"tests/a.py::test_it": 2.0, "tests/a.py::b": 1.0}, ["tests/a.py::b"]
    )
    with path.open("a") as file:
        file.write('{"bug": "service.ru')

    known = Outcomes(path)

    assert known.verdict(SITE, "x = 1") == CAUGHT
    assert known.verdict(SITE, "x = 2") is None
    assert known.verdict(SITE._replace(number=18), "x = 1") is None
    assert known.timed == {"tests/a.py": ["tests/a.py::test_it"]}
    assert known.took_s == {"tests/a.py::test_it": 2.0}
    assert known.verdicts() == [CAUGHT]


def test_tests_are_chosen_in_their_order_as_far_as_the_budget_goes() -> None:
    """One that is too long for what is left makes room for those behind it."""
    took_s = {"a": 10.0, "b": 31.0, "c": 20.0, "d": 10.0, "e": 1.0}

    assert edges.chosen_tests(took_s, 40.0) == ["a", "c", "d"]


ONE, TWO = "tests/daemon/a.py::one", "tests/daemon/a.py::two"
PROCESS = "tests/integration/a.py::process"


@pytest.mark.parametrize(
    ("fails_again", "fails_without", "by"),
    [(True, False, ONE), (False, False, PROCESS), (True, True, PROCESS)],
)
def test_what_is_seen_is_seen_again_and_not_without_the_bug(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    fails_again: bool,
    fails_without: bool,
    by: str,
) -> None:
    """A test that fails because others needed the processor has seen no bug: the next is asked."""
    asked: list[tuple[list[str], bool]] = []

    def tried(tests: list[str], plant: Callable[[], None], *_: object) -> Verdict:
        planted = plant is not edges.nothing
        asked.append((tests, planted))
        fails = {ONE: fails_again if planted else fails_without, TWO: False, PROCESS: planted}
        if len(asked) == 1:
            fails[ONE] = True
        failed = next((test for test in tests if fails[test]), "")
        return Verdict(Outcome.CAUGHT if failed else Outcome.SURVIVED, failed, 1.0)

    monkeypatch.setattr(edges, "tried", tried)
    known = Outcomes(tmp_path / "state")
    known.add_timed("all", {ONE: 1.0, TWO: 1.0, PROCESS: 1.0}, [])

    found = edges.judged(SITE, [ONE, TWO, PROCESS], known)

    assert (found.outcome, found.by) == (Outcome.CAUGHT, by)
    again = [([ONE], True), *[([ONE], False)] * fails_again]
    further = [([TWO], True), ([PROCESS], True), ([PROCESS], True), ([PROCESS], False)]
    assert asked == [([ONE, TWO], True), *again, *(further if by == PROCESS else [])]


def test_tests_are_timed_without_a_bug(tmp_path: Path) -> None:
    """Those that fail then are named."""
    path = tmp_path / "test_these.py"
    path.write_text("def test_a(): pass\ndef test_b(): assert False\n")
    program = f"from mutation.trial import timed; print(timed([{str(path)!r}], 60.0))"

    took_s, failed = _said_by(program)
    assert [name.rpartition("::")[2] for name in took_s] == ["test_a", "test_b"]
    assert [name.rpartition("::")[2] for name in failed] == ["test_b"]


def test_the_table_names_what_there_is() -> None:
    """Modules beside those of the coverage gate, and tests that exist."""
    table = tomllib.loads(edges.TABLE.read_text())

    assert not set(table["tests"]) & set(modules())
    for module, wanted in table["tests"].items():
        assert path_of(module).exists()
        for test in wanted:
            path, _, name = test.partition("::")
            assert f"def {name}(" in (ROOT / path).read_text() if name else (ROOT / path).exists()
