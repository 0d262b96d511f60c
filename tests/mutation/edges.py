"""`python -m mutation.edges`: plant bugs in the daemon's edges, seen through real processes, too.

What became of each bug is written to a file at once; the next call goes on behind it.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from mutation.__main__ import drawn, named, preload, report
from mutation.outcomes import Outcomes
from mutation.planting import path_of, plant_in_started, plant_named
from mutation.sites import Site, planted, sites
from mutation.trial import Outcome, Verdict, timed, tried

TABLE = Path(__file__).with_suffix(".toml")
PROCESSES = "tests/integration/"
"""Tests of real processes: they come last."""
LIMIT_S = 60.0  # of the processor, of any one process
CLOCK_S = 30.0  # beside three times what the tests take without a bug: each may wait for one more


def main() -> int:
    """Draw, plant, run, report; 1 where fewer are caught than are asked for."""
    parser = argparse.ArgumentParser(prog="python -m mutation.edges", description=__doc__)
    parser.add_argument("--n", type=int, default=120, help="bugs to draw")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=[], help="these, as `service.runs:17`")
    parser.add_argument("--within-s", type=float, default=1e9, help="begin none after so long")
    parser.add_argument("--least", type=float, default=0.9, help="share to be caught")
    parser.add_argument("--state", type=Path, default=Path("mutants-edges.jsonl"))
    asked = parser.parse_args()

    table = tomllib.loads(TABLE.read_text())
    wanted, budget_s = table["tests"], table["budget_s"]
    preload()
    known = Outcomes(asked.state)
    until = time.monotonic() + asked.within_s
    found = [site for module in wanted for site in sites(module, _source(module))]
    chosen = named(found, asked.only) if asked.only else drawn(found, asked.n, asked.seed)
    print(f"{len(chosen)} of {len(found)} bugs, seed {asked.seed}, in {asked.state}", flush=True)
    verdicts: dict[Site, Verdict] = {}
    for site in chosen:
        source = _source(site.module)
        verdict = known.verdict(site, source)
        if verdict is None and time.monotonic() < until:
            tests = chosen_tests(_timed(wanted[site.module], known), budget_s)
            verdict = judged(site, tests, known)
            known.add(site, source, verdict)
            _print(site, verdict)
        if verdict is not None:
            verdicts[site] = verdict
    print(f"{len(chosen) - len(verdicts)} bugs are still to be tried")
    return report(verdicts, asked.least)


def chosen_tests(took_s: dict[str, float], budget_s: float) -> list[str]:
    """Return the tests in their order that the budget allows; one that is too long falls out."""
    chosen, left_s = [], budget_s
    for test, seconds in took_s.items():
        if seconds <= left_s:
            chosen.append(test)
            left_s -= seconds
    return chosen


def judged(site: Site, tests: list[str], known: Outcomes) -> Verdict:
    """Return what becomes of a bug: what a test shows it must show again, and not without it."""
    plant = _planting(site)
    began = time.monotonic()
    inside = [test for test in tests if not test.startswith(PROCESSES)]
    kills = Counter(v.by for v in known.verdicts() if v.outcome is Outcome.CAUGHT)
    outside = sorted((t for t in tests if t.startswith(PROCESSES)), key=lambda t: -kills[t])
    verdict = Verdict(Outcome.SURVIVED, "", 0.0)
    for left in (inside, outside):
        while left and verdict.outcome is Outcome.SURVIVED:
            verdict = _tried(left, plant, known)
            if verdict.outcome is not Outcome.CAUGHT or verdict.by not in left:
                break
            left = left[left.index(verdict.by) + 1 :]
            verdict = _looked_at_again(verdict.by, plant, known)
    return verdict._replace(took_s=time.monotonic() - began)


def nothing() -> None:
    """Plant nothing."""


def _looked_at_again(test: str, plant: Callable[[], None], known: Outcomes) -> Verdict:
    verdict = _tried([test], plant, known)
    if verdict.outcome is Outcome.CAUGHT:
        without = _tried([test], nothing, known)
        if without.outcome is not Outcome.SURVIVED:
            return Verdict(Outcome.SURVIVED, "", 0.0)
    return verdict


def _tried(tests: list[str], plant: Callable[[], None], known: Outcomes) -> Verdict:
    if not tests:
        return Verdict(Outcome.SURVIVED, "", 0.0)
    clock_s = CLOCK_S + 3 * sum(known.took_s[test] for test in tests)
    return tried(tests, plant, LIMIT_S, clock_s)


def _planting(site: Site) -> Callable[[], None]:
    def plant() -> None:
        os.environ.update(plant_in_started(site.name))
        plant_named(site.name)

    return plant


def _timed(wanted: list[str], known: Outcomes) -> dict[str, float]:
    """Return how long each of the tests takes without a bug; one that fails then is left out."""
    took_s: dict[str, float] = {}
    for some in wanted:
        if some not in known.timed:
            known.add_timed(some, *timed([some], 600.0))
        for test in known.timed[some]:
            took_s[test] = known.took_s[test]
    return took_s


def _source(module: str) -> str:
    return path_of(module).read_text(encoding="utf-8")


def _print(site: Site, verdict: Verdict) -> None:
    where = f"{site.name} line {site.line} ({site.kind})"
    print(f"{verdict.outcome:9} {verdict.took_s:5.1f} s  {where}  {verdict.by}", flush=True)
    if verdict.outcome is Outcome.SURVIVED:
        bug = planted(_source(site.module), site.number)
        print(f"    - {bug.before}\n    + {bug.after}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
