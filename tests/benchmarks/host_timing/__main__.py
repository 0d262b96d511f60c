"""`make timing`: this host's timing against the targets. `make timing ARGS=--help` says how."""

from __future__ import annotations

import os
import platform
import re
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer
from armrig.lab.host import governors, load, preemption, probe_rights, text, virtual
from armrig_core.errors import ArmrigError
from rich.console import Console

from tests.benchmarks.host_timing.targets import DEFINITIONS, Rate, against_targets
from tests.benchmarks.host_timing.turns import ROUNDS, measure, ticks_of_a_turn


def main(
    seconds: Annotated[
        float, typer.Option(help="Time of each program at each rate, over 4 rounds, in s.")
    ] = 20.0,
    rates: Annotated[
        str, typer.Option(metavar="HZ,…", help="Sampling rates, in Hz.")
    ] = "100,500,1000,2000",
) -> None:
    """Measure this host's timing: cyclictest, bare loop, bare zenoh and daemon in turn.

    The exit code is 0 if everything was measured, also if a target is not met.
    """
    try:
        rates_hz = [int(rate) for rate in rates.split(",")]
    except ValueError as err:
        raise typer.BadParameter(f"--rates {rates}: give whole numbers of Hz: 100,1000") from err
    ticks = {rate_hz: ticks_of_a_turn(rate_hz, seconds) for rate_hz in rates_hz}
    print("\n".join(machine(seconds)), flush=True)
    with Console(stderr=True).status("measuring") as status:
        measured = measure(ticks, status.update)
    print("\n".join(lines(measured, seconds)))


def machine(seconds: float, root: Path = Path("/")) -> Iterator[str]:
    """Yield lines that describe the machine and the measurement."""
    cpuinfo = text(root / "proc/cpuinfo")
    model = re.search(r"^(?:model name|Model)\s*:\s*(.+)$", cpuinfo, re.MULTILINE)
    cpus = f"{len(os.sched_getaffinity(0))} to use{', virtual' if virtual(root) else ''}"
    governor = ", ".join(governors(root)) or "none: the kernel scales no frequency"
    yield f"kernel      {text(root / 'proc/sys/kernel/osrelease')}, preemption {preemption(root)}"
    yield f"processor   {model[1] if model else 'unknown'}, {cpus}; governor {governor}"
    built = f"{platform.python_compiler()}, {sysconfig.get_config_var('OPT')}"
    yield f"python      {platform.python_version()} of {platform.python_build()[1]}, {built}"
    yield f"SCHED_FIFO  {'allowed' if probe_rights()[0] else 'NOT allowed'}"
    yield f"load        {load(root):g} before the measurement"
    yield f"rounds      {ROUNDS}, together {seconds:g} s for each program and rate"


def lines(rates: Sequence[Rate], seconds: float) -> Iterator[str]:
    """Yield the results line by line."""
    for rate in rates:
        heads = "".join(f"{name:>10}" for name in ("n", "p50", "p99", "p99.9", "max"))
        yield f"\n{rate.rate_hz} Hz, times in µs".ljust(35) + heads
        for name, (n, *tail) in rate.tails().items():
            yield f"  {name:32}{n:>10.0f}" + "".join(f"{v:>10.1f}" for v in tail)
        for name, count in rate.counts.items():
            yield f"  {name:32}{count:>10}"
        yield from (f"  {remark}" for remark in dict.fromkeys(rate.remarks))
    yield f"\n{'against the targets':40}{'Hz':>6}{'measured':>12}{'at most':>10}"
    for rate in rates:
        for t in against_targets(rate, seconds):
            value = f"{t.value:.3g} {t.unit}"
            yield f"  {t.what:38}{rate.rate_hz:>6}{value:>12}{t.limit:>10g}  {t.verdict}"
    yield ""
    yield from (f"{name}: {definition}" for name, definition in DEFINITIONS.items())
    yield "own work per tick: median of the daemon's CPU time per tick less the bare loop's"


def run(arguments: list[str]) -> int:
    """Measure, or print why this is not possible, and return the exit code."""
    app = typer.Typer(add_completion=False)
    app.command()(main)
    try:
        return app(arguments, standalone_mode=False) or 0  # 130 after Ctrl-C
    except (ArmrigError, typer.BadParameter) as err:
        print(f"host_timing: {err}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
