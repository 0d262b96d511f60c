"""Many schedules on all cores, and what they came to."""

from __future__ import annotations

import gc
import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import ceil
from multiprocessing import get_context
from time import perf_counter, process_time

from simulator.options import END_NS, KINDS, MS, draw
from simulator.rig import Outcome, simulate

LEAST_DRIVING = 0.4
"""Share of the sampling times at which a motor must have been off rest, else nothing was tried."""
LEAST_FAULTS = 100
"""How often each fault must have struck in a thousand schedules or more."""
_CHUNK = 8


@dataclass(slots=True, kw_only=True)
class Campaign:
    """What schedules came to, added up."""

    schedules: int = 0
    violations: list[tuple[int, str, int, str]] = field(default_factory=list)
    """Seed, invariant, time and text of each."""
    faults: Counter[str] = field(default_factory=Counter)
    seen: Counter[str] = field(default_factory=Counter)
    worst: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Longest time to 0 V in ns, and its seed."""
    driving: int = 0
    ticks: int = 0
    cpu_s: float = 0.0
    wall_s: float = 0.0

    def add(self, outcome: Outcome) -> None:
        """Add what one schedule came to."""
        self.schedules += 1
        if outcome.violation:
            self.violations.append((outcome.seed, *outcome.violation))
        else:
            # A schedule that was cut short says little of how much was driven.
            self.driving += outcome.driving
            self.ticks += outcome.ticks
        self.faults.update(outcome.faults)
        self.seen.update(outcome.seen)
        for kind, ns in outcome.worst_ns.items():
            if ns > self.worst.get(kind, (-1, 0))[0]:
                self.worst[kind] = (ns, outcome.seed)

    def emptiness(self) -> list[str]:
        """Return why the absence of violations would mean nothing; empty where it means something.

        Fewer than a thousand schedules need as many fewer faults.
        """
        share = self.driving / self.ticks if self.ticks else 0.0
        said = []
        if share < LEAST_DRIVING:
            said.append(f"driven off rest at {share:.0%} of the ticks: {LEAST_DRIVING:.0%} needed")
        least = ceil(LEAST_FAULTS * min(1.0, self.schedules / 1000))
        for kind in KINDS:
            if self.faults[kind] < least:
                said.append(f"{kind} struck {self.faults[kind]} times: {least} needed")
        return said

    def lines(self) -> list[str]:
        """Return all of it for a person."""
        simulated_s = self.schedules * END_NS / 1e9
        share = self.driving / self.ticks if self.ticks else 0.0
        shown = [
            f"{self.schedules} schedules, {simulated_s:.0f} s of firmware time in "
            f"{self.wall_s:.1f} s: {simulated_s / max(self.cpu_s, 1e-9):.0f} x real time per core",
            f"driven off rest at {share:.1%} of the ticks",
            "time to 0 V at worst:",
        ]
        for kind, (ns, seed) in sorted(self.worst.items()):
            n = self.seen[f"to 0 V: {kind}"]
            shown.append(f"  {kind:24} {ns / MS:7.1f} ms  (n = {n}, seed {seed})")
        shown.append("trips by cause:")
        trips = {k: n for k, n in self.seen.items() if k.startswith("trip")}
        shown += [f"  {n:8}  {kind[6:]}" for kind, n in sorted(trips.items(), key=_most)]
        shown.append("checks that had something to judge, and other counts:")
        rest = {k: n for k, n in self.seen.items() if not k.startswith(("trip", "to 0 V"))}
        shown += [f"  {n:8}  {kind}" for kind, n in sorted(rest.items(), key=_most)]
        shown.append("faults:")
        shown += [f"  {self.faults[kind]:8}  {kind}" for kind in KINDS]
        shown.append(f"violations: {len(self.violations)}")
        return shown


def _most(item: tuple[str, int]) -> tuple[int, str]:
    return -item[1], item[0]


def run(
    seeds: Iterable[int],
    *,
    only: Sequence[str] = KINDS,
    workers: int | None = None,
    enough: Callable[[Campaign], bool] = lambda _: False,
) -> Campaign:
    """Run a schedule for each seed.

    Parameters
    ----------
    only : sequence of str
        Faults that are drawn from.
    workers : int, optional
        Processes; one for each core unless given; 0 runs all in this one.
    enough : callable
        Ends the campaign as soon as it says so.
    """
    campaign = Campaign()
    began = perf_counter()
    one = partial(_one, only)
    if workers == 0:
        results = map(one, seeds)
        _gather(campaign, results, enough)
    else:
        with get_context("fork").Pool(workers or os.cpu_count()) as pool:
            _gather(campaign, pool.imap_unordered(one, seeds, _CHUNK), enough)
    campaign.wall_s = perf_counter() - began
    campaign.violations.sort()
    return campaign


def _gather(
    campaign: Campaign,
    results: Iterable[tuple[Outcome, float]],
    enough: Callable[[Campaign], bool],
) -> None:
    for outcome, cpu_s in results:
        campaign.add(outcome)
        campaign.cpu_s += cpu_s
        if enough(campaign):
            return


def _one(only: Sequence[str], seed: int) -> tuple[Outcome, float]:
    began = process_time()
    gc.disable()  # values without cycles: the collector would only look
    outcome = simulate(draw(seed, only=only))
    gc.enable()
    return outcome, process_time() - began
