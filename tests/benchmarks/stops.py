"""Time to 0 V after each event; it prints the tables of docs/safety.md.

Real processes, a pseudo-terminal, and the emulator's own witness of the voltage, Ts 5 ms, device
watchdog 100 ms. Each event occurs on a quiet machine, and next to busy programs: `python -m
tests.benchmarks.stops [n [event …]]`. The tables go to standard output, each event, as it happens,
to standard error.
"""

from __future__ import annotations

import contextlib
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import armrig

from tests.benchmarks.kernel_lateness import Control
from tests.benchmarks.stand import Stand
from tests.benchmarks.stop_rows import ROWS, Row
from tests.integration.processes import WITHIN_S, Burners

BUSY = 4
"""Programs that keep the machine busy, at ordinary priority."""
_DRIVEN_S = 0.5  # the device's queue is full by then
_PERIOD_S = 0.1  # of whatever comes again and again: a flush, a sign, a frame of setpoints
_TRIES = 10
COLUMNS = ("quiet", "loaded")


class Result(NamedTuple):
    """Times after one event, in ms."""

    stopped: float
    control: float
    """The worst lateness of the control until then."""
    age: float | None
    """Age of the newest sample in the file that remains."""
    ended: float | None
    """Time until the service ended, if the event ends it."""


class Machine(NamedTuple):
    """Base of the events."""

    control: Control
    burners: Burners
    again: list[str]
    """Events that were tried again."""


class NotDrivenError(RuntimeError):
    """The motor stood already: load had ended the run."""


def once(stand: Stand, row: Row, control: Control, phase: float) -> Result:
    """Let an event happen in a run; `phase` is when in the period, 0 to 1."""
    # Otherwise all events would follow the same flush by the same time.
    time.sleep(_DRIVEN_S + phase * _PERIOD_S)
    if stand.witness.look()[-1][1] == 0.0:
        raise NotDrivenError
    control.lateness()
    at_ns = time.monotonic_ns()
    row.act(stand)
    ended = None
    if row.ends_service:
        stand.daemon.popen.wait(WITHIN_S)
        ended = (time.monotonic_ns() - at_ns) / 1e6
    stopped = stand.witness.stopped_ms_after(at_ns)
    worst = control.lateness().worst_ms
    if stand.witness.volts_at(at_ns) == 0.0:
        raise NotDrivenError
    if row.mode == "dead-man":
        ended_by = stand.outcome()
        assert "its client went away" in ended_by, ended_by
    left = list(stand.bench.recordings.glob("*.active")) if row.leaves_file else []
    age = None
    if left:
        age = (at_ns - int(armrig.load(left[0]).samples["t_host_ns"][-1])) / 1e6
    return Result(stopped, worst, age, ended)


def tried(stand: Stand, name: str, machine: Machine, phase: float) -> Result:
    """Let an event happen, again where the load has ended the run before it.

    What fails after the event, such as a motor that does not stop, is never tried again.
    """
    for _ in range(_TRIES):
        stand.make_ready()
        if stand.begin(ROWS[name].mode):
            with contextlib.suppress(NotDrivenError), machine.burners:
                return once(stand, ROWS[name], machine.control, phase)
        say(f"{name}: not driven until then, once more")
        machine.again.append(name)
    raise RuntimeError(f"{name}: the motor was never driven for long enough in {_TRIES} tries")


def measured(names: list[str], n: int, machine: Machine) -> dict[str, list[Result]]:
    """Return the results of a column."""
    results: dict[str, list[Result]] = {}
    for has_line, group in groupby(names, lambda name: ROWS[name].has_line):
        with standing(has_line=has_line) as stand:
            for name in group:
                began_s, times = time.monotonic(), min(n, ROWS[name].most)
                results[name] = [tried(stand, name, machine, i / times) for i in range(times)]
                worst = max(results[name])
                say(
                    f"{name:26s} {told([r.stopped for r in results[name]])} ms, control then "
                    f"{worst.control:.2f} ms late at most; "
                    f"{(time.monotonic() - began_s) / times:.2f} s each"
                )
    return results


@contextlib.contextmanager
def standing(*, has_line: bool) -> Iterator[Stand]:
    """Give a rig, and end it."""
    with tempfile.TemporaryDirectory(prefix="armrig-bench-") as folder:
        stand = Stand(Path(folder), has_line=has_line)
        try:
            yield stand
        finally:
            stand.end()


def say(line: str) -> None:
    """Print the progress."""
    print(line, file=sys.stderr, flush=True)


def told(values: list[float]) -> str:
    """Return median and worst."""
    return f"{statistics.median(values):.1f}, {max(values):.1f}"


def cells(columns: list[list[float]]) -> str:
    """Return median and worst of each column as cells of a table."""
    parts = [
        f"{statistics.median(values):.1f} ms | {max(values):.1f} ms" if values else " | "
        for values in columns
    ]
    return " | ".join(parts)


def tables(names: list[str], columns: list[dict[str, list[Result]]]) -> Iterator[str]:
    """Give the lines of both tables."""
    heads = " | ".join(f"{column}: median | worst" for column in COLUMNS)
    yield f"| what happens | who stops the motor | bound | {heads} |"
    yield "|---" * 7 + "|"
    for name in names:
        row = ROWS[name]
        values = cells([[r.stopped for r in results[name]] for results in columns])
        fewer = f" (n = {len(columns[0][name])})" if len(columns[0][name]) == row.most else ""
        yield f"| {row.what}{fewer} | {row.who} | {row.bound} | {values} |"
    yield ""
    yield f"| other times | bound | {heads} |"
    yield "|---" * 6 + "|"
    for name in names:
        row = ROWS[name]
        if row.ends_service:
            ended = [[r.ended for r in c[name] if r.ended is not None] for c in columns]
            yield f"| {row.what}: the service is gone | 1 s | {cells(ended)} |"
        if row.leaves_file:
            ages = [[r.age for r in c[name] if r.age is not None] for c in columns]
            yield f"| {row.what}: age of the newest sample in the file | none | {cells(ages)} |"
    controls = [[r.control for results in c.values() for r in results] for c in columns]
    yield f"| the control's worst lateness in an event | | {cells(controls)} |"


def main() -> None:
    """Try each event so many times, 10 by default."""
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    names = sys.argv[2:] or list(ROWS)
    began_s, control, columns, loads = time.monotonic(), Control(), [], []
    again: list[str] = []
    try:
        for column, busy in zip(COLUMNS, (0, BUSY), strict=True):
            loads.append(f"{os.getloadavg()[0]:.1f}")
            say(f"-- {column}, beside {busy} busy programs, load {loads[-1]}")
            burners = Burners(busy)
            try:
                columns.append(measured(names, n, Machine(control, burners, again)))
            finally:
                burners.end()
            loads.append(f"{os.getloadavg()[0]:.1f}")
    finally:
        control.end()
    for line in tables(names, columns):
        print(line)
    say(f"{time.monotonic() - began_s:.0f} s in all")
    print(
        f"\nn = {n} each, on {os.cpu_count()} processors; loaded is beside {BUSY} busy programs of "
        "ordinary priority, from half a second before each event on. The control: "
        f"{control.policy}, woken each 1 ms. Load of the machine before and after each column: "
        f"{', '.join(loads)}. Load ended {len(again)} runs before their event: tried again."
    )


if __name__ == "__main__":
    main()
