"""`python -m tests.mutation`: plant bugs in every room, and say which of them no test sees.

What became of each bug is written to a file at once; the next call goes on after it.
"""

from __future__ import annotations

import argparse
import gc
import os
import random
import shutil
import subprocess
import sys
import time
import tomllib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from importlib import import_module
from itertools import pairwise
from math import sqrt
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.mutation import python_sites, text_sites
from tests.mutation.bug import bugs
from tests.mutation.mutant import Mutant, difference, planted
from tests.mutation.outcomes import Outcomes
from tests.mutation.planting import keep, module_of, plant_kept
from tests.mutation.reach import ROOT, Reach, markers
from tests.mutation.trial import Outcome, Verdict, tried, tried_in

TABLE = Path(__file__).with_name("rooms.toml")
PRELOADED = ("numpy", "scipy.linalg", "scipy.signal", "scipy.optimize", "msgspec", "hypothesis")
PRELOADED += ("pytest", "control", "typer", "rich.console", "mcap.reader", "google.protobuf")
"""Modules without bugs are imported once, and not again in each child."""
STAGES = (3, 20)
"""Tests that are tried before the rest is even collected: most bugs fall to the first."""
BUDGET_S = 60.0
"""Time of tests in this process against one bug, and again of tests of processes."""
COPIED_S = 400.0
CLOCK_S = 30.0  # in addition to what the tests take without a bug: each may wait for one more
NOT_OURS = {"vendor", "messages.py"}
"""Vendored files, and a generated file, which a test compares with the generator's output."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Room:
    """Sources, and the tests that bugs in them are shown to."""

    name: str
    sources: list[str]
    tests: list[str]
    processes: list[str] = field(default_factory=list)
    build: list[str] = field(default_factory=list)
    least: float = 0.9


def main() -> int:
    """Draw, plant, run, report; return 1 if fewer bugs are seen than required."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("--n", type=int, default=400, help="bugs to draw, over all rooms")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rooms", nargs="*", default=[], help="draw in these alone")
    parser.add_argument("--bugs", type=Path, help="plant those of this table, and draw none")
    parser.add_argument("--only", nargs="*", default=[], help="files, or `file:line`")
    parser.add_argument("--everyday", action="store_true", help="without the exhaustive tests")
    parser.add_argument("--part", default="1/1", help="2/4: the second of four, side by side")
    parser.add_argument("--within-s", type=float, default=1e9, help="begin none after so long")
    parser.add_argument("--results", type=Path, default=Path("mutants.jsonl"))
    asked = parser.parse_args()

    until = time.monotonic() + asked.within_s
    every = rooms()
    if asked.bugs:
        room_of = {file: room for room, files in sources_of(every).items() for file in files}
        chosen = [(room_of[bug.file], bug.mutant) for bug in bugs(asked.bugs)]
    else:
        chosen = drawn(every, asked.rooms or list(every), asked.n, asked.seed, asked.only)
    part, parts = map(int, asked.part.split("/"))
    chosen = chosen[part - 1 :: parts]
    known = Outcomes(asked.results)
    reach = Reach(asked.results.with_suffix(".reach"), everyday=asked.everyday)
    reach.measure(_test_files(["tests/clients", "tests/core", "tests/daemon", "tests/protocol"]))
    preload()
    origin = asked.bugs or f"seed {asked.seed}"
    print(f"{len(chosen)} bugs, {origin}, in {asked.results}", flush=True)
    verdicts: dict[tuple[str, Mutant], Verdict] = {}
    kills: Counter[str] = Counter()
    with TemporaryDirectory(prefix="armrig-mutant-") as folder:
        trials = Trials(Path(folder), reach, kills, everyday=asked.everyday)
        for room, mutant in chosen:
            tests = trials.tests_of(every[room], mutant)
            verdict = known.verdict(mutant, tests)
            if verdict is None and time.monotonic() < until:
                verdict = trials.judged(every[room], mutant, tests)
                known.add(room, mutant, tests, verdict)
                _print(mutant, verdict)
            if verdict is not None:
                kills[verdict.by] += verdict.outcome is Outcome.CAUGHT
                verdicts[room, mutant] = verdict
    print(f"{len(chosen) - len(verdicts)} bugs are still to be tried")
    return report(verdicts, {name: room.least for name, room in every.items()})


def rooms() -> dict[str, Room]:
    """Return the rooms of the table."""
    table = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    return {name: Room(name=name, **room) for name, room in table.items()}


def sources_of(every: dict[str, Room]) -> dict[str, list[str]]:
    """Return the files of each room: a file belongs to the first that names its folder."""
    found: dict[str, list[str]] = {}
    taken: set[Path] = set()
    for name, room in every.items():
        suffix = {"page": "*.js", "c_core": "*.c"}.get(name, "*.py")
        files: set[Path] = set()
        for source in (ROOT / one for one in room.sources):
            files |= {source} if source.is_file() else set(source.rglob(suffix))
        mine = sorted(file for file in files - taken if not NOT_OURS & set(file.parts))
        taken |= set(mine)
        found[name] = [str(file.relative_to(ROOT)) for file in mine]
    return found


def sites(file: str, source: str) -> list[Mutant]:
    """Return the bugs that can be planted in a file."""
    return (python_sites if file.endswith(".py") else text_sites).sites(file, source)


def drawn(
    every: dict[str, Room], names: Iterable[str], n: int, seed: int, only: list[str]
) -> list[tuple[str, Mutant]]:
    """Draw from each room in proportion to its lines, in random order.

    A kind is drawn in proportion to the root of how often it could be planted, so that the rare
    ones come up, too.
    """
    texts = {
        name: {file: (ROOT / file).read_text(encoding="utf-8") for file in files}
        for name, files in sources_of(every).items()
        if name in names
    }
    lines = {name: sum(t.count("\n") for t in of.values()) for name, of in texts.items()}
    chosen: list[tuple[str, Mutant]] = []
    for name, of in texts.items():
        rng = random.Random(f"{seed} {name}")
        by_kind: defaultdict[str, list[Mutant]] = defaultdict(list)
        for mutant in (mutant for file, text in of.items() for mutant in sites(file, text)):
            by_kind[mutant.kind].append(mutant)
        if only:
            chosen += [
                (name, m)
                for all_ in by_kind.values()
                for m in all_
                if (m.file in only or f"{m.file}:{m.line}" in only) and _counts(of[m.file], m)
            ]
            continue
        wanted = round(n * lines[name] / sum(lines.values()))
        weights = {kind: sqrt(len(mutants)) for kind, mutants in by_kind.items()}
        while wanted and any(by_kind.values()):
            kind = rng.choices(list(weights), list(weights.values()))[0]
            if by_kind[kind]:
                mutant = by_kind[kind].pop(rng.randrange(len(by_kind[kind])))
                if _counts(of[mutant.file], mutant):
                    chosen.append((name, mutant))
                    wanted -= 1
    random.Random(seed).shuffle(chosen)
    return chosen


def _counts(source: str, mutant: Mutant) -> bool:
    return not mutant.file.endswith(".py") or python_sites.is_bug(source, mutant)


def preload() -> None:
    """Import once, for all children, what no bug is planted in."""
    for name in PRELOADED:
        import_module(name)
    gc.freeze()


def _test_files(paths: Iterable[str]) -> list[str]:
    found = []
    for path in paths:
        here = ROOT / path
        files = [here] if here.is_file() else sorted(here.rglob("test_*.py"))
        found += [str(file.relative_to(ROOT)) for file in files]
    return found


class Trials:
    """Shows bugs to tests: in a child of this process, or in a copy of the project."""

    def __init__(self, folder: Path, reach: Reach, kills: Counter[str], *, everyday: bool) -> None:
        self._folder, self._reach, self._kills = folder, reach, kills
        # `timed` and `machine` are not run here: they want a machine of their own.
        is_asked = not everyday and "exhaustive" in markers()
        self._markers = ("", *(["exhaustive"] if is_asked else []))

    def tests_of(self, room: Room, mutant: Mutant) -> list[str]:
        """Return the tests that a bug is shown to: those that reach it, the nearest first."""
        if room.build:
            return room.tests
        near = tuple(room.tests)

        def order(test: str) -> tuple[float, bool, float]:
            took_s = 0.05 + self._reach.tests[test].took_s
            # Those first that have seen others.
            return -(self._kills[test] / took_s), not test.startswith(near), took_s

        reaching = sorted(self._reach.tests_of(mutant.file, mutant.line), key=order)
        files = {test.partition("::")[0] for test in reaching if test.startswith(near)}
        # A fixture, or what is cached, has reached the line in the first test alone that uses it.
        others = [
            test
            for test in self._reach.tests
            if (test.partition("::")[0] in files if files else test.startswith(near))
        ]
        others = sorted(set(others) - set(reaching), key=order)
        return [*reaching, *others]

    def judged(self, room: Room, mutant: Mutant, tests: list[str]) -> Verdict:
        """Return what becomes of a bug."""
        source = planted((ROOT / mutant.file).read_text(encoding="utf-8"), mutant)
        began = time.monotonic()
        if room.build:
            verdict = self._judged_in_copy(room, mutant, source)
        else:
            verdict = self._judged_here(room, mutant, source, tests)
        return verdict._replace(took_s=round(time.monotonic() - began, 1))

    def _judged_here(self, room: Room, mutant: Mutant, source: str, tests: list[str]) -> Verdict:
        kept = self._folder / "mutant.json"
        environment = keep(kept, module_of(mutant.file), source)

        def plant() -> None:
            os.environ.update(environment)
            plant_kept(str(kept))

        for marker in self._markers:
            verdict = self._tried(tests, marker, plant)
            if verdict.outcome is Outcome.SURVIVED and room.processes:
                verdict = self._tried_on_processes(room, marker, plant)
            if verdict.outcome is not Outcome.SURVIVED:
                return verdict._replace(marker=marker)
        return verdict

    def _tried(self, tests: list[str], marker: str, plant: Callable[[], None]) -> Verdict:
        left = self._within_budget(test for test in tests if self._is(test, marker))
        for begin, end in pairwise((0, *STAGES, max(len(left), STAGES[-1] + 1))):
            if some := left[begin:end]:
                limit_s = 10.0 + 3 * self._took_s(some)
                verdict = tried(some, plant, limit_s)
                if verdict.outcome is not Outcome.SURVIVED:
                    return verdict
        return Verdict(Outcome.SURVIVED, "", 0.0)

    def _tried_on_processes(self, room: Room, marker: str, plant: Callable[[], None]) -> Verdict:
        """Return what tests of processes see that they see again, and not without the bug."""
        files = _test_files(room.processes)
        self._reach.measure(files, sources=False)
        of_files = [t for t in self._reach.tests if t.partition("::")[0] in files]
        order = sorted(
            of_files, key=lambda test: (-self._kills[test], files.index(test.partition("::")[0]))
        )
        left = self._within_budget(test for test in order if self._is(test, marker))
        while left:
            verdict = self._tried_slowly(left, plant)
            if verdict.outcome is not Outcome.CAUGHT or verdict.by not in left:
                return verdict
            again = self._tried_slowly([verdict.by], plant)
            if again.outcome is not Outcome.SURVIVED:
                without = self._tried_slowly([verdict.by], lambda: None)
                if without.outcome is Outcome.SURVIVED:
                    return again
            left = left[left.index(verdict.by) + 1 :]
        return Verdict(Outcome.SURVIVED, "", 0.0)

    def _tried_slowly(self, tests: list[str], plant: Callable[[], None]) -> Verdict:
        return tried(tests, plant, BUDGET_S, CLOCK_S + 3 * self._took_s(tests))

    def _is(self, test: str, marker: str) -> bool:
        return self._reach.tests[test].marker == marker

    def _took_s(self, tests: Iterable[str]) -> float:
        return sum(self._reach.tests[test].took_s for test in tests)

    def _within_budget(self, tests: Iterable[str]) -> list[str]:
        """Return the tests in their order that the budget allows; too long a test falls out."""
        chosen, left_s = [], BUDGET_S
        for test in tests:
            if (seconds := self._reach.tests[test].took_s) <= left_s:
                chosen.append(test)
                left_s -= seconds
        return chosen

    def _judged_in_copy(self, room: Room, mutant: Mutant, source: str) -> Verdict:
        copy = self._folder / "copy"
        if not copy.exists():
            left_out = shutil.ignore_patterns(".*", "__pycache__", "node_modules", "build", "docs")
            shutil.copytree(ROOT, copy, ignore=left_out)
        file = copy / mutant.file
        sound = file.read_text(encoding="utf-8")
        file.write_text(source, encoding="utf-8")
        try:
            build = [word.replace("{file}", mutant.file) for word in room.build]
            if subprocess.run(build, cwd=copy, capture_output=True, check=False).returncode:
                return Verdict(Outcome.NOT_BUILT, "", 0.0)
            for marker in self._markers:
                none = " and ".join(f"not {name}" for name in markers())
                verdict = tried_in(copy, room.tests, marker or none, COPIED_S)
                if verdict.outcome is not Outcome.SURVIVED:
                    return verdict._replace(marker=marker)
            return verdict
        finally:
            file.write_text(sound, encoding="utf-8")


def _print(mutant: Mutant, verdict: Verdict) -> None:
    where = f"{mutant.file}:{mutant.line} ({mutant.kind})"
    by = " ".join([verdict.by, verdict.marker]).strip()
    print(f"{verdict.outcome:9} {verdict.took_s:5.1f} s  {where}  {by}", flush=True)
    if verdict.outcome is Outcome.SURVIVED:
        print(difference((ROOT / mutant.file).read_text(encoding="utf-8"), mutant), flush=True)


def report(verdicts: dict[tuple[str, Mutant], Verdict], least: dict[str, float]) -> int:
    """Print what no test sees, and a table by room; return 1 if a room's share is too small."""
    by_room: defaultdict[str, Counter[str]] = defaultdict(Counter)
    for (room, mutant), verdict in sorted(verdicts.items()):
        if verdict.outcome is Outcome.SURVIVED:
            _print(mutant, verdict)
        if verdict.outcome is not Outcome.NOT_BUILT:
            seen = verdict.outcome is not Outcome.SURVIVED
            by_room[room] += Counter(drawn=1, seen=seen, everyday=seen and not verdict.marker)
    print(f"\n{'room':16} drawn  seen  unseen   share  in make test")
    for room, counts in [*sorted(by_room.items()), ("all", sum(by_room.values(), Counter()))]:
        n, seen = counts["drawn"], counts["seen"]
        share, everyday = seen / max(1, n), counts["everyday"] / max(1, seen)
        print(f"{room:16} {n:5} {seen:5} {n - seen:7}  {share:6.1%}  {everyday:12.1%}")
    enough = all(c["seen"] >= least[room] * c["drawn"] for room, c in by_room.items())
    return 0 if by_room and enough else 1


if __name__ == "__main__":
    sys.exit(main())
