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

from tests.firmware.uno_host import harness
from tests.simulator.checks import COMMANDER_GONE, LINK_GONE
from tests.simulator.law_judge import BOUNDS
from tests.simulator.options import END_NS, KINDS, MS, draw
from tests.simulator.rig import Outcome, simulate
from tests.simulator.watched import build

LEAST_DRIVING = 0.4
"""Least share of sampling times with the motor off rest, for a meaningful schedule."""
LEAST_FAULTS = 100
"""Least strikes of each fault in a thousand schedules or more."""
TRIPS = (
    "no answer from the device",
    "the lease ran out",
    "the host paused",
    "# ticks in a row were missed",
    "link lost",
    "the device was reset",
    "the device is in FAULT",
    "the device stopped by itself: WATCHDOG",
    "the device stopped by itself: ADC_RAIL",
    "the device stopped by itself: REV_LIMIT",
    "the device stopped by itself: SLEW",
    "the device has received frame",
    "the service is frozen",
    "the law",
    "y = ",
    "z = ",
    "y has had no valid sample",
    "z has had no valid sample",
)
"""Beginnings of the causes of trips that a campaign must contain.

"The device applied code" is not among them, because it is rare: an old frame must arrive just
before the daemon's own frame with the same seq and k. tests/daemon/decisions/test_sampling.py tests
this cause.
"""
LAWS = {
    "law: schedules": 300,
    "law: codes at a limit": 1_000,
    "law: codes within the slew": 1_000,
    "law: codes without the newest sample": 100,
    "law: runs with a monitor": 500,
    "law: codes with a monitor that counts turns": 500,
    "law: codes of a prelude": 2_000,
    "law: loops closed after a prelude": 200,
    "law: tripped, innovation": 200,
    "law: tripped, simulation": 50,
    **{f"law: ended, {code}": 10 for code in BOUNDS},
}
"""Least counts of control runs in a thousand schedules or more."""
LEAST_TRIPS = 5
"""Least trips of each cause in a thousand schedules or more."""
DEFAULT = "watchdog 100 ms, Ts 5 ms: "
BOUNDS_NS = {DEFAULT + COMMANDER_GONE: 210 * MS, DEFAULT + LINK_GONE: 110 * MS}
"""Documented longest times to 0 V: 100 + 100 + 2 · 5 ms, and 100 + 2 · 5 ms."""
_CHUNK = 8


@dataclass(slots=True, kw_only=True)
class Campaign:
    """Sums over schedules."""

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

    def lateness(self) -> list[str]:
        """Return the time to 0 V above its documented bound; each kept its own bound (S2, S3)."""
        return [
            f"{kind}: {ns / MS:.1f} ms to 0 V, {BOUNDS_NS[kind] / MS:.0f} ms are told (seed {seed})"
            for kind, (ns, seed) in self.worst.items()
            if ns > BOUNDS_NS.get(kind, ns)
        ]

    def emptiness(self) -> list[str]:
        """Return why the absence of violations would mean nothing; empty where it means something.

        Fewer than a thousand schedules need as many fewer faults.
        """
        share = self.driving / self.ticks if self.ticks else 0.0
        said = []
        if share < LEAST_DRIVING:
            said.append(f"driven off rest at {share:.0%} of the ticks: {LEAST_DRIVING:.0%} needed")
        part = min(1.0, self.schedules / 1000)
        least = ceil(LEAST_FAULTS * part)
        for kind in KINDS:
            if self.faults[kind] < least:
                said.append(f"{kind} struck {self.faults[kind]} times: {least} needed")
        least = int(LEAST_TRIPS * part)
        for cause in TRIPS:
            n = sum(v for k, v in self.seen.items() if k.startswith(f"trip: {cause}"))
            if n < least:
                said.append(f'"{cause} ..." tripped {n} times: {least} needed')
        said += [
            f"{kind}: {self.seen[kind]}, {int(n * part)} needed"
            for kind, n in LAWS.items()
            if self.seen[kind] < int(n * part)
        ]
        said += [f"{kind}: never" for kind in BOUNDS_NS if least and kind not in self.worst]
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
        for kind, (ns, seed) in sorted(self.worst.items(), key=_default_first):
            n = self.seen[f"to 0 V, {kind}"]
            told = f", {BOUNDS_NS[kind] / MS:.0f} ms told" if kind in BOUNDS_NS else ""
            shown.append(f"  {kind:60} {ns / MS:7.1f} ms  (n = {n}, seed {seed}{told})")
        shown.append("trips by cause:")
        trips = {k: n for k, n in self.seen.items() if k.startswith("trip: ")}
        shown += [f"  {n:8}  {kind[6:]}" for kind, n in sorted(trips.items(), key=_most)]
        shown.append("checks that had something to judge, and other counts:")
        rest = {k: n for k, n in self.seen.items() if not k.startswith(("trip: ", "to 0 V"))}
        shown += [f"  {n:8}  {kind}" for kind, n in sorted(rest.items(), key=_most)]
        shown.append("faults:")
        shown += [f"  {self.faults[kind]:8}  {kind}" for kind in (*KINDS, "stall")]
        shown.append(f"violations: {len(self.violations)}")
        return shown


def _default_first(item: tuple[str, tuple[int, int]]) -> tuple[bool, str]:
    return not item[0].startswith(DEFAULT), item[0]


def _most(item: tuple[str, int]) -> tuple[int, str]:
    return -item[1], item[0]


def run(
    seeds: Iterable[int],
    *,
    only: Sequence[str] = KINDS,
    stalls: bool | None = None,
    c_core: bool = False,
    uno: str = "",
    workers: int | None = None,
    enough: Callable[[Campaign], bool] = lambda _: False,
) -> Campaign:
    """Run a schedule for each seed.

    Parameters
    ----------
    only : sequence of str
        Faults to draw from.
    stalls : bool, optional
        The emulator is also stalled, and tolerates it or does not.
    c_core : bool
        The device's firmware is the C core.
    uno : str
        The device is an Uno in simavr with this image.
    workers : int, optional
        Processes; one for each core unless given; 0 runs all in this one.
    enough : callable
        Ends the campaign as soon as it returns True.
    """
    campaign = Campaign()
    began = perf_counter()
    one = partial(_one, only, stalls, c_core, uno)
    if c_core:
        build()  # before the fork: each process would build its own
    if uno:
        harness()
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


def _one(
    only: Sequence[str], stalls: bool | None, c_core: bool, uno: str, seed: int
) -> tuple[Outcome, float]:
    began = process_time()
    gc.disable()  # values without cycles: the collector would only look
    outcome = simulate(draw(seed, only=only, stalls=stalls, c_core=c_core, uno=uno))
    gc.enable()
    return outcome, process_time() - began
