"""The benchmark's result: as JSON, as a table, and as a figure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.benchmarks.host_timing import targets
from tests.benchmarks.host_timing.machine import Machine
from tests.benchmarks.host_timing.rounds import ROUNDS, Plan
from tests.benchmarks.host_timing.targets import Rate, Target

_ABOVE_ONE = ("p50", "p99", "p99.9", "max")


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """One run of the benchmark."""

    machine: Machine
    plan: Plan
    rates: Sequence[Rate]

    def targets(self) -> list[Target]:
        """Return all numbers that have a target."""
        seconds = self.plan.seconds
        return [t for rate in self.rates for t in targets.against_targets(rate, seconds)]

    def facts(self) -> dict[str, Any]:
        """Return all of it but the single times, for JSON."""
        return {
            "machine": asdict(self.machine),
            "plan": asdict(self.plan) | {"rounds": ROUNDS},
            "rates": [
                {
                    "rate_hz": rate.rate_hz,
                    "times_us": {name: asdict(tail) for name, tail in rate.tails().items()},
                    "counts": rate.counts,
                    "remarks": rate.remarks,
                }
                for rate in self.rates
            ],
            "verdicts": [asdict(target) for target in self.targets()],
            "definitions": targets.DEFINITIONS,
        }


def lines(result: Result) -> Iterator[str]:
    """Give the result as text, line by line."""
    yield from _machine_lines(result)
    for rate in result.rates:
        yield ""
        yield f"{rate.rate_hz} Hz, times in µs".ljust(34) + "".join(
            f"{name:>10}" for name in ("n", *_ABOVE_ONE)
        )
        for name, tail in rate.tails().items():
            values = (tail.p50, tail.p99, tail.p999, tail.max)
            yield f"  {name:32}{tail.n:>10}" + "".join(f"{v:>10.1f}" for v in values)
        for name, count in rate.counts.items():
            yield f"  {name:32}{count:>10}"
        for remark in dict.fromkeys(rate.remarks):
            yield f"  {remark}"
    yield ""
    yield f"{'against the targets':40}{'Hz':>6}{'measured':>12}{'at most':>10}"
    for t in result.targets():
        met = {True: "met", False: "NOT MET", None: "-"}[t.met]
        value = f"{t.value:.3g} {t.unit}"
        yield f"  {t.what:38}{t.rate_hz:>6}{value:>12}{t.limit:>10g}  {met:8}{t.remark}".rstrip()
    yield ""
    measured = {name for rate in result.rates for name in rate.tails()}
    for name, text in targets.DEFINITIONS.items():
        if name in measured:
            yield f"{name}: {text}"
    yield (
        "own work per tick: median of the daemon's CPU time per tick less the bare loop's, which "
        "has the same sleep, spin, write and read"
    )
    if any(rate.rate_hz > 1000 for rate in result.rates):
        yield (
            "above 1000 Hz the device's timer makes the samples and no tick of the host defines a "
            "lateness: loss, place, delivery and the device's tick error are told instead"
        )


def _machine_lines(result: Result) -> Iterator[str]:
    m, plan = result.machine, result.plan
    below = ", virtual" if m.virtual else ""
    yield f"kernel      {m.kernel}, preemption {m.preemption}"
    yield f"processor   {m.processor}, {m.cpus} to use{below}; governor {m.governor}"
    granted = "allowed" if m.fifo else "NOT allowed: all run under the ordinary policy"
    yield f"SCHED_FIFO  {granted}; `armrig doctor` says what costs timing"
    busy = f"; {plan.burners} burners beside everybody" if plan.burners else ""
    yield f"load        {m.load:g} before it began{busy}"
    yield f"rounds      {ROUNDS}, together {plan.seconds:g} s for each contestant and rate"


def write_figure(result: Result, path: Path) -> None:
    """Write the share of times above each time: lateness, and the way to a subscriber."""
    from armrig.plots.layout import BLUE, GREEN, INK, ORANGE, VERMILION, finish, letter
    from matplotlib.figure import Figure

    late = (
        (targets.REFERENCE, INK, "-"),
        (targets.STAND_IN, INK, "-"),
        (targets.BARE, BLUE, "--"),
        (targets.DAEMON, VERMILION, "-"),
        (targets.DELIVERY, ORANGE, ":"),
    )
    way = ((targets.PUT, BLUE, "--"), (targets.SUBSCRIBER, GREEN, "-"))
    rows = len(result.rates)
    figure = Figure(figsize=(8.0, 0.6 + 2.2 * rows), layout="constrained")
    grid = figure.subplots(rows, 2, squeeze=False)
    for row, rate in zip(grid, result.rates, strict=True):
        for ax, curves in zip(row, (late, way), strict=True):
            for name, colour, dash in curves:
                x = np.sort(np.maximum(rate.pooled(name), 0.1))
                if x.size:
                    share = 1 - np.arange(x.size) / x.size
                    ax.step(x, share, where="post", color=colour, ls=dash, lw=1.2, label=name)
            ax.set(xscale="log", yscale="log", xlabel="time [µs]", ylabel="share above")
            ax.set_title(f"{rate.rate_hz} Hz", fontsize="small")
            finish(ax)
    # Once for all panels, and outside: the curves need all the room that a panel has.
    handles = {line.get_label(): line for ax in grid.flat for line in ax.lines}
    figure.legend(handles=list(handles.values()), loc="outside lower center", ncols=3, fontsize=8)
    m = result.machine
    load = f"load {m.load:g}, {result.plan.burners} burners"
    figure.suptitle(f"{m.kernel}, {m.cpus} × {m.processor}, {load}", fontsize="small")
    letter(figure)
    figure.savefig(path, dpi=150)
