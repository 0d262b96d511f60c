"""The bugs that are planted: each is one, runs, is drawn the same way again, and is seen."""

from __future__ import annotations

import os
import subprocess
import sys
from ast import literal_eval
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from armrig_daemon import config
from armrig_daemon.config import Config
from armrig_daemon.loop.process import Settings
from armrig_daemon.service import child

from tests.integration.processes import state_of, wait_for
from tests.mutation import __main__ as mutation
from tests.mutation import by_hand, outcomes, python_sites, text_sites
from tests.mutation.__main__ import ROOT, Room, Trials, drawn, rooms, sources_of
from tests.mutation.bug import bugs
from tests.mutation.mutant import Mutant, planted
from tests.mutation.outcomes import Outcomes
from tests.mutation.planting import Planted, keep, module_of, plant
from tests.mutation.reach import Passing, Reach
from tests.mutation.trial import Outcome, Verdict, in_child, tried_in

SOURCE = '''
"""A module."""
import math
LIMIT = 3


def clip(x: int, *, strict: bool = False) -> int:
    """Return x, at most the limit."""
    if x > LIMIT and not strict:
        x = LIMIT
    return x


def kind(x: object) -> str:
    """Return what x is."""
    match x:
        case int():
            return "number"
    return "nothing"


def angle(turns: float, at: list[float]) -> float:
    """Return an angle in rad."""
    angle = pow(turns, 2) * 2 * math.pi
    for i in range(len(at)):
        try:
            angle += at[1:][i]
        except IndexError:
            at.clear()
    return angle
'''
MUTANT = Mutant("tests/mutation/mutant.py", 3, "constant", 10, "1", "2")
CAUGHT = Verdict(Outcome.CAUGHT, "tests/mutation/test_mutation.py::test_it", 1.5)
SURVIVED = Verdict(Outcome.SURVIVED, "", 1.5)


def _seen(source: str) -> tuple[object, ...]:
    """Return a module's value."""
    names: dict[str, Any] = {}
    exec(compile(source, "module", "exec"), names)
    clip, kind, angle = names["clip"], names["kind"], names["angle"]
    said: list[object] = [clip(x, strict=s) for x in (1, 2, 3, 4, 9) for s in (False, True)]
    for turns, at in ((3.0, [1.0, 2.0]), (0.5, [])):
        try:
            said += [angle(turns, at), list(at)]
        except IndexError:
            said.append("index")
    return (*said, clip(9), kind(1), kind(""))


def _found(line: str) -> set[tuple[str, str]]:
    """Return the kinds of bugs of a function of one line, each with the line that it makes."""
    source = f"def f(self, x, lock):\n    {line}\n"
    found = python_sites.sites("clients/armrig/a.py", source)
    return {(bug.kind, planted(source, bug).split("\n")[1].strip()) for bug in found}


def test_each_bug_is_one_and_runs() -> None:
    found = python_sites.sites("clients/armrig/a.py", SOURCE)

    runs = [bug for bug in found if python_sites.is_bug(SOURCE, bug)]
    hidden = [bug for bug in runs if _seen(planted(SOURCE, bug)) == _seen(SOURCE)]

    assert runs == found
    assert [bug.kind for bug in hidden] == ["boundary"]


@pytest.mark.parametrize(
    ("line", "bug"),
    [
        ("if x < 3: pass", ("boundary", "if (x <= 3): pass")),
        ("if x < 3: pass", ("condition inverted", "if not (x < 3): pass")),
        ("return x[1:n]", ("off by one", "return x[1:n + 1]")),
        ("return f(x, 'é', y)", ("arguments swapped", "return f(x, y, 'é')")),
        ("return f(a=x, b=y)", ("arguments swapped", "return f(a=y, b=x)")),
        ("self.x = x", ("stale value", "pass")),
        ("with lock: self.x = x", ("missing lock", "if True: self.x = x")),
        ("self.file.flush()", ("missing flush", "pass")),
        ("return 1e3 * x", ("unit", "return (x)")),
        ("raise ValueError(x)", ("exception swallowed", "pass")),
        ("return max(x)", ("neighbour", "return min(x)")),
        ("return x[0]", ("neighbour", "return x[-1]")),
    ],
)
def test_the_mistakes_that_people_make(line: str, bug: tuple[str, str]) -> None:
    assert bug in _found(line)


def test_a_default_is_another_one() -> None:
    source = "def f(x=3): return x\nclass A:\n    y: bool = True\n    z: int | None = None\n"

    found = python_sites.sites("clients/armrig/a.py", source)

    assert {(bug.line, bug.old, bug.new) for bug in found if bug.kind == "wrong default"} == {
        (1, "3", "4"),
        (1, "3", "2"),
        (3, "True", "False"),
    }


def test_what_only_a_person_reads_is_left_alone() -> None:
    text = 'import os\n"""Doc 5."""\nx: int\ny = "5"\nmsg = f"{x + 1}"\nassert x > 1\n'
    figure = "axes.plot(linewidth=2)\n"

    assert python_sites.sites("a.py", text) == []
    assert python_sites.sites("clients/armrig/figures.py", figure) == []


def test_what_changes_no_result_is_left_alone() -> None:
    text = "far = margin(1e-9)\npairs = zip(a, strict=True)\nc = np.convolve(a, b)\n"

    assert python_sites.sites("a.py", text) == []


def test_the_bugs_of_c_and_of_javascript() -> None:
    c = "static int a[] = {1};\nint f(int x)\n{\n    return x < b ? g(x, b) : b; // 1 < 2\n}\n"
    js = 'const a = (x) => x === "1 < 2" ? Math.min(x, 2000) : b;\n'

    assert {bug.new for bug in text_sites.sites("a.c", c)} == {"<=", ">=", "b, x"}
    assert {bug.new for bug in text_sites.sites("a.js", js)} == {"!==", "Math.max", "4000"}


@pytest.mark.exhaustive
def test_bugs_are_drawn_from_every_room_by_its_lines_and_the_same_ones_again() -> None:
    every = {name: room for name, room in rooms().items() if name in ("wire", "core", "page")}
    lines = {
        name: sum((ROOT / file).read_text().count("\n") for file in files)
        for name, files in sources_of(rooms()).items()
        if name in every
    }

    chosen = drawn(every, list(every), 60, 7, [])

    assert chosen == drawn(every, list(every), 60, 7, [])
    assert chosen != drawn(every, list(every), 60, 8, [])
    assert len(set(chosen)) == len(chosen)
    for name, n in Counter(room for room, _ in chosen).items():
        assert abs(n - 60 * lines[name] / sum(lines.values())) <= 0.5


def test_every_source_is_in_a_room_and_every_test_is_there() -> None:
    found = [file for files in sources_of(rooms()).values() for file in files]
    packages = ["clients", "daemon", "firmware_protocol/armrig_protocol"]
    python = {p for package in packages for p in (ROOT / package).rglob("*.py")}

    assert len(found) == len(set(found))
    missing = {str(p.relative_to(ROOT)) for p in python} - set(found)
    assert {Path(name).name for name in missing} <= mutation.NOT_OURS
    for room in rooms().values():
        assert all((ROOT / test).exists() for test in [*room.tests, *room.processes])


def test_a_bug_that_nobody_would_see_is_not_planted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The module was imported before."""
    monkeypatch.setitem(sys.modules, "already_there", ModuleType("already_there"))

    with pytest.raises(RuntimeError, match="already_there is imported already"):
        plant("already_there", SOURCE)

    assert not any(isinstance(finder, Planted) for finder in sys.meta_path)


# -- in what a test starts -----------------------------------------------------------------------


def _plant_from_now_on(
    monkeypatch: pytest.MonkeyPatch, folder: Path, path: str, before: str, after: str
) -> None:
    source = (ROOT / path).read_text()
    assert source.count(before) == 1
    variables = keep(folder / "mutant", module_of(path), source.replace(before, after))
    for name, value in variables.items():
        monkeypatch.setenv(name, value)


def _exit_code_without_a_port() -> int:
    settings = Settings(
        rules=Config().rules(), port="/dev/null", baud=500_000, priority=0, cpu=None, spin_ns=0
    )
    loop = child.start(settings)
    while loop.records() is not None:
        pass
    return loop.end()


def test_a_bug_is_in_a_program_that_is_started(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = "daemon/armrig_core/recording_file/recorder.py"
    program = "from armrig_core.recording_file import recorder as r; print(r.QUEUE)"
    _plant_from_now_on(monkeypatch, tmp_path, path, "QUEUE = 10_000", "QUEUE = 10_001")

    said = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )

    assert (said.stdout, said.stderr) == ("10001\n", "")


def test_a_bug_is_in_the_module_that_is_run_as_a_program(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = "daemon/armrig_daemon/loop/process.py"
    assert _exit_code_without_a_port() == 2
    _plant_from_now_on(monkeypatch, tmp_path, path, "NO_PORT = 2", "NO_PORT = 3")

    assert _exit_code_without_a_port() == 3


def test_the_daemon_takes_the_bug_for_no_setting_of_its_own(tmp_path: Path) -> None:
    """Otherwise the daemon would not start, and every test would see every bug."""
    assert config.load([], keep(tmp_path / "mutant", "a", ""), {}) == Config()


# -- trials --------------------------------------------------------------------------------------


def _said_by(program: str, folder: Path = ROOT) -> Any:
    """Return the output of a separate program, because pytest does not run within pytest."""
    paths = os.pathsep.join(p for p in sys.path if p)
    said = subprocess.run(
        [sys.executable, "-c", program],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=True,
    )
    return literal_eval(said.stdout.splitlines()[-1])


def test_a_failed_test_is_reported_though_pytest_itself_fails_afterwards(tmp_path: Path) -> None:
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
        "from tests.mutation.trial import tried; "
        f"print(repr(tried([{str(path)!r}], lambda: None, 60.0).by))"
    )

    assert _said_by(program).endswith("test_it")


def test_what_a_bug_has_left_ends_with_its_child(tmp_path: Path) -> None:
    """A daemon without its guards would drive on into the next trial."""
    pid = tmp_path / "pid"

    def run(told: Path) -> None:
        left = subprocess.Popen(["sleep", "600"])
        pid.write_text(str(left.pid))
        told.write_text("1")

    assert in_child(run, 5.0)[1] == 1

    wait_for(lambda: _has_ended(int(pid.read_text())))


def _has_ended(pid: int) -> bool:
    try:
        return state_of(pid) == "Z"
    except (FileNotFoundError, ProcessLookupError):  # its parent has waited for it
        return True


def test_a_trial_in_a_copy_names_the_test_and_asks_those_of_a_marker_alone(tmp_path: Path) -> None:
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = exhaustive: all\naddopts = -rfE\n")
    (tmp_path / "test_this.py").write_text(
        "import pytest\ndef test_a(): pass\n@pytest.mark.exhaustive\ndef test_b(): assert False\n"
    )

    everyday = tried_in(tmp_path, ["test_this.py"], "not exhaustive", 60.0)
    exhaustive = tried_in(tmp_path, ["test_this.py"], "exhaustive", 60.0)

    assert everyday.outcome is Outcome.SURVIVED
    assert (exhaustive.outcome, exhaustive.by) == (Outcome.CAUGHT, "test_this.py::test_b")


def test_tests_are_measured_without_a_bug(tmp_path: Path) -> None:
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = exhaustive: all\n")
    (tmp_path / "test_this.py").write_text(
        "import pytest\n"
        "from armrig_core.volts import code_of\n"
        "def test_a(): assert code_of(5.0)\n"
        "def test_b(): assert False\n"
        "@pytest.mark.exhaustive\n"
        "def test_c(): pass\n"
    )
    program = (
        "from tests.mutation import reach; "
        "reach.markers = lambda: ['exhaustive']; "
        "print(reach.measured(['test_this.py'], ['armrig_core'])['test_this.py'])"
    )

    found = _said_by(program, tmp_path)

    markers = {name: marker for name, (_, marker) in found["tests"].items()}
    assert markers == {"test_this.py::test_a": "", "test_this.py::test_c": "exhaustive"}
    assert list(found["lines"]["daemon/armrig_core/volts.py"]) == ["test_this.py::test_a"]
    assert list(found["digests"]) == ["test_this.py", "daemon/armrig_core/volts.py"]


ONE, TWO = "tests/daemon/a.py::one", "tests/daemon/a.py::two"
PROCESS = "tests/integration/test_a.py::process"
ROOM = Room(name="a", sources=[], tests=["tests/daemon"], processes=["tests/integration"])


class _Known(Reach):
    """Reach of invented tests."""

    def __init__(self) -> None:
        super().__init__(Path())
        self.tests = {
            ONE: Passing(1.0, ""),
            TWO: Passing(2.0, "exhaustive"),
            PROCESS: Passing(1.0, ""),
        }
        self._lines["daemon/a.py"] = {TWO: 1 << 3, ONE: 1 << 3 | 1 << 4}

    def measure(self, paths: object, *, sources: bool = True) -> None:
        """Know it already."""


def _judged(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, fails: Callable[[str, bool], bool]
) -> tuple[Verdict, list[list[str]]]:
    asked: list[list[str]] = []

    def tried(tests: list[str], plant: Callable[[], None], *_: object) -> Verdict:
        asked.append(tests)
        is_planted = plant.__name__ == "plant"
        failed = next((test for test in tests if fails(test, is_planted)), "")
        return Verdict(Outcome.CAUGHT if failed else Outcome.SURVIVED, failed, 1.0)

    monkeypatch.setattr(mutation, "tried", tried)
    monkeypatch.setattr(mutation, "markers", lambda: ("exhaustive",))
    monkeypatch.setattr(mutation, "_test_files", lambda _: ["tests/integration/test_a.py"])
    trials = Trials(tmp_path, _Known(), Counter(), everyday=False)
    mutant = MUTANT._replace(file="tests/mutation/mutant.py")
    return trials.judged(ROOM, mutant, [ONE, TWO]), asked


@pytest.mark.parametrize(("seen_by", "marker"), [(ONE, ""), (PROCESS, ""), (TWO, "exhaustive")])
def test_the_exhaustive_tests_are_asked_last(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, seen_by: str, marker: str
) -> None:
    verdict, _ = _judged(monkeypatch, tmp_path, lambda test, bug: bug and test == seen_by)

    assert (verdict.outcome, verdict.by, verdict.marker) == (Outcome.CAUGHT, seen_by, marker)


def test_what_a_process_shows_it_must_show_again_and_not_without_the_bug(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A test that fails because others needed the processor has seen no bug."""
    verdict, asked = _judged(monkeypatch, tmp_path, lambda test, bug: test == PROCESS)

    assert verdict.outcome is Outcome.SURVIVED
    assert asked == [[ONE], [PROCESS], [PROCESS], [PROCESS], [TWO]]


def test_a_bug_is_shown_to_the_tests_that_reach_it_first(tmp_path: Path) -> None:
    trials = Trials(tmp_path, _Known(), Counter(), everyday=False)
    mutant = MUTANT._replace(file="daemon/a.py")

    assert trials.tests_of(ROOM, mutant._replace(line=4)) == [ONE, TWO]
    assert trials.tests_of(ROOM, mutant._replace(line=9, file="daemon/b.py")) == [ONE, TWO]
    assert trials.tests_of(ROOM, mutant) == [ONE, TWO]


def test_a_draw_goes_on_where_it_was_left(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "results"
    Outcomes(path).add("a", MUTANT, ["tests/a.py::x"], CAUGHT)
    Outcomes(path).add("a", MUTANT._replace(new="3"), ["tests/a.py::x"], SURVIVED)
    with path.open("a") as file:
        file.write('{"bug": "service.ru')

    known = Outcomes(path)

    assert known.verdict(MUTANT, ["tests/b.py::y"]) == CAUGHT
    assert known.verdict(MUTANT._replace(new="3"), ["tests/a.py::x"]) == SURVIVED
    assert known.verdict(MUTANT._replace(new="3"), ["tests/b.py::y"]) is None
    assert known.verdict(MUTANT._replace(new="4"), ["tests/a.py::x"]) is None
    monkeypatch.setattr(outcomes, "digest", lambda _: "another")
    assert Outcomes(path).verdict(MUTANT, []) is None


def test_each_bug_of_the_table_fits_the_code() -> None:
    table = bugs(by_hand.TABLE)

    astray = [bug.name for bug in table if bug.source.count(bug.old) != 1]
    lost = [name for bug in table for name in bug.tests if not _is_there(name)]

    assert astray == []
    assert lost == []
    assert len({bug.name for bug in table}) == len(table)


def _is_there(name: str) -> bool:
    """Return whether a test, or a folder of tests, is in the tree."""
    path, _, function = name.partition("::")
    if not function:
        return (ROOT / path).exists()
    return f"def {function.partition('[')[0]}(" in (ROOT / path).read_text(encoding="utf-8")
