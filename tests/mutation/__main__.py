"""`python -m mutation`: plant bugs, and say which of them no test sees."""

from __future__ import annotations

import argparse
import gc
import json
import random
import sys
import time
import tomllib
from collections import Counter, defaultdict
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from pkgutil import walk_packages

from mutation.planting import PACKAGE, path_of, plant
from mutation.reach import Reach, measured, tests_of
from mutation.sites import Site, planted, sites
from mutation.trial import Outcome, Verdict, tried

ROOT = Path(__file__).parents[2]
PRELOADED = ("numpy", "scipy.linalg", "scipy.signal", "msgspec", "hypothesis", "pytest")
LIBRARIES = ("armrig_protocol", "armrig_core")
"""What no bug is planted in is imported once, and not again in each child."""
STAGES = (2, 12)
"""Tests that are tried before the rest is even collected: most bugs fall to the first."""
LEAST = 4
"""Bugs drawn in each module, where it has so many."""


def main() -> int:
    """Draw, plant, run, report; 1 where fewer are caught than are asked for."""
    parser = argparse.ArgumentParser(prog="python -m mutation", description=__doc__)
    parser.add_argument("--n", type=int, default=300, help="bugs to draw")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--skip", type=int, default=0, help="bugs drawn that were tried already")
    parser.add_argument("--only", nargs="*", default=[], help="these, as `core:17`, or modules")
    parser.add_argument("--tests", nargs="*", default=["tests/daemon", "tests/protocol"])
    parser.add_argument("--budget-s", type=float, default=60.0, help="of tests against one bug")
    parser.add_argument("--within-s", type=float, default=1e9, help="stop drawing after so long")
    parser.add_argument("--least", type=float, default=0.95, help="share to be caught")
    parser.add_argument("--reach", type=Path, help="file that keeps which test reaches what")
    asked = parser.parse_args()

    reach = _reach(asked.reach, asked.tests)
    preload()
    found = [site for module in modules() for site in sites(module, path_of(module).read_text())]
    chosen = named(found, asked.only) if asked.only else drawn(found, asked.n, asked.seed)
    print(f"{len(chosen)} of {len(found)} bugs, seed {asked.seed}", flush=True)
    sound = min(reach.took_s, key=reach.took_s.__getitem__)
    if tried([sound], lambda: None, 60.0).outcome is not Outcome.SURVIVED:
        print(f"{sound} fails without a bug: nothing can be said", file=sys.stderr)
        return 2
    until = time.monotonic() + asked.within_s
    verdicts: dict[Site, Verdict] = {}
    kills: Counter[str] = Counter()
    for site in chosen[asked.skip :]:
        if time.monotonic() > until:
            break
        verdicts[site] = _judged(site, reach, asked.budget_s, kills)
    return report(verdicts, asked.least)


def modules() -> list[str]:
    """Return the modules that bugs are planted in: those whose every branch is covered."""
    text = (ROOT / "tests" / "coverage.toml").read_text()
    paths = tomllib.loads(text)["tool"]["coverage"]["report"]["include"]
    return [path.removeprefix("*/").removesuffix(".py").replace("/", ".") for path in paths]


def drawn(found: list[Site], n: int, seed: int) -> list[Site]:
    """Draw from each module by its size, in random order."""
    rng = random.Random(seed)
    by_module: defaultdict[str, list[Site]] = defaultdict(list)
    for site in found:
        by_module[site.module].append(site)
    chosen = []
    for of_module in by_module.values():
        share = max(LEAST, round(n * len(of_module) / len(found)))
        chosen += rng.sample(of_module, min(share, len(of_module)))
    rng.shuffle(chosen)
    return chosen


def preload() -> None:
    """Import once, for all children, what no bug is planted in."""
    for name in PRELOADED:
        import_module(name)
    for name in LIBRARIES:
        for module in walk_packages(import_module(name).__path__, f"{name}."):
            import_module(module.name)
    gc.freeze()


def named(found: list[Site], names: list[str]) -> list[Site]:
    """Return the bugs of these names, or of the modules of these names."""
    return [s for s in found if s.name in names or s.name.rpartition(":")[0] in names]


def _reach(kept: Path | None, tests: list[str]) -> Reach:
    if kept is not None and kept.exists():
        lines, took_s = json.loads(kept.read_text())
        return Reach(
            {path: {int(at): names for at, names in of.items()} for path, of in lines.items()},
            took_s,
        )
    reach = measured(tests, PACKAGE, 3600.0)
    if kept is not None:
        kept.write_text(json.dumps(reach))
    return reach


def _judged(site: Site, reach: Reach, budget_s: float, kills: Counter[str]) -> Verdict:
    path = path_of(site.module)
    bug = planted(path.read_text(), site.number)
    tests = tests_of(reach, str(path), site.line, budget_s)
    if not tests:
        verdict = Verdict(Outcome.NOT_REACHED, "", 0.0)
    else:
        # Those first that have caught others.
        tests.sort(key=lambda test: -kills[test] / (0.05 + reach.took_s.get(test, 0.0)))
        for begin, end in pairwise((0, *STAGES, len(tests))):
            some = tests[begin:end]
            if not some:
                continue
            limit_s = 3.0 + 3 * sum(reach.took_s.get(test, 0.0) for test in some)
            verdict = tried(some, lambda: plant(site.module, bug.tree), limit_s)
            if verdict.outcome is not Outcome.SURVIVED:
                break
    if verdict.outcome is Outcome.CAUGHT:
        kills[verdict.by] += 1
    where = f"{site.name} line {site.line} ({site.kind})"
    print(f"{verdict.outcome:9} {verdict.took_s:5.1f} s  {where}  {verdict.by}", flush=True)
    if verdict.outcome in (Outcome.SURVIVED, Outcome.NOT_REACHED):
        print(f"    - {bug.before}\n    + {bug.after}", flush=True)
    return verdict


def report(verdicts: dict[Site, Verdict], least: float) -> int:
    """Print what became of the bugs; return 1 where fewer than the least share were caught."""
    by_module: defaultdict[str, Counter[Outcome]] = defaultdict(Counter)
    for site, verdict in verdicts.items():
        by_module[site.module][verdict.outcome] += 1
    print()
    for module, counts in sorted(by_module.items()):
        print(f"{module:40} " + ", ".join(f"{n} {what}" for what, n in sorted(counts.items())))
    counts = sum(by_module.values(), Counter())
    n = sum(counts.values())
    caught = counts[Outcome.CAUGHT] + counts[Outcome.TIMED_OUT]
    told = ", ".join(f"{n} {what}" for what, n in sorted(counts.items()))
    print(f"{n} bugs: {told}; {caught / max(1, n):.1%} seen")
    return 0 if n and caught >= least * n else 1


if __name__ == "__main__":
    sys.exit(main())
