"""Trips of an emulated rig under load, on a pseudo-terminal and on a Unix socket.

`python -m tests.benchmarks.emulated_line RESULTS [runs [seconds]]`: 100 runs of 5 s on each line by
default, as root; lines and pacings take turns. The four conditions are four busy programs with a
session each, or a flood of `status`, with and without the right to real-time priorities. Ts 5 ms;
device and emulator as of `run --emulate`.

Each run is a line of JSON in the file RESULTS. Started again, it goes on where it was interrupted.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import msgspec
from armrig.rig.client import Rig
from armrig.rig.session import RigError

from tests.benchmarks.stand import Stand
from tests.benchmarks.under_load import Pacing, flooding
from tests.integration.processes import burning

LINES = ("terminal", "socket")
RIGHTS = ("real-time", "ordinary")
_BLOCK = 10
"""Runs on each line before the next condition, because other load changes by the hour."""
_N_BUSY = 4
_Ts = 0.005
_WITHOUT_RIGHTS = ["setpriv", "--bounding-set", "-sys_nice", "--inh-caps", "-sys_nice"]


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """One run."""

    load: str
    rights: str
    line: str
    run: int
    seconds: float
    pacing: Pacing
    tripped: bool
    reason: str
    load_average: float


@contextlib.contextmanager
def busy(_endpoint: str) -> Iterator[None]:
    """Keep the machine busy by programs that the kernel gives a share each, as those of users."""
    with burning(_N_BUSY, apart=True):
        yield


LOADS_HERE = {"four busy programs": busy, "flood of status": flooding}


def played(stand: Stand, pacing: Pacing, seconds: float) -> str:
    """Play a run; return why it ended early, or nothing."""
    try:
        with Rig(connect=stand.endpoint) as rig:
            rig.arm("benchmark", Ts=_Ts)
            rig.run([1.0, 4.0] * round(seconds / _Ts / 2), pacing=pacing)
    except RigError as err:
        return str(err)
    return ""


def block(results: Path, load: str, rights: str, runs: range, seconds: float) -> None:
    """Play these runs on both lines in turn."""
    has_rights = rights == RIGHTS[0]
    with contextlib.ExitStack() as stack:
        stands: dict[str, Stand] = {}
        for line in LINES:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="armrig-bench-")))
            terminal = line == "terminal"
            stands[line] = Stand(folder, has_line=False, terminal=terminal, as_run_emulate=True)
            stack.callback(stands[line].end)
        for i in runs:
            pacing: Pacing = "scheduled" if i % 2 else "exchange"
            for line, stand in stands.items():
                stand.make_ready()
                policy = os.sched_getscheduler(stand.loop_pid)
                if (policy == os.SCHED_FIFO) != has_rights:
                    raise SystemExit(f"the loop has the policy {policy}: start this as root")
                with LOADS_HERE[load](stand.endpoint):
                    reason = played(stand, pacing, seconds)
                result = Result(
                    load=load,
                    rights=rights,
                    line=line,
                    run=i,
                    seconds=seconds,
                    pacing=pacing,
                    tripped=bool(reason),
                    reason=reason,
                    load_average=os.getloadavg()[0],
                )
                with results.open("ab") as file:
                    file.write(msgspec.json.encode(result) + b"\n")


def read(results: Path) -> list[Result]:
    """Return the runs so far; a line that an interruption has cut off is none."""
    if not results.exists():
        return []
    lines = results.read_bytes().split(b"\n")[:-1]
    return [msgspec.json.decode(line, type=Result) for line in lines if line.endswith(b"}")]


def done(results: Path, load: str, rights: str) -> int:
    """Return how many runs of a condition there are on both lines."""
    runs = {(r.line, r.run) for r in read(results) if (r.load, r.rights) == (load, rights)}
    n = Counter(line for line, _ in runs)
    return min(n[line] for line in LINES)


def table(results: Path) -> str:
    """Return how many runs of each condition tripped, as Markdown."""
    rows = ["| load | rights | line | exchange | scheduled | all |", "|---|---|---|---|---|---|"]
    runs = read(results)
    for load in LOADS_HERE:
        for rights in RIGHTS:
            for line in LINES:
                here = [r for r in runs if (r.load, r.rights, r.line) == (load, rights, line)]
                cells = [
                    [r for r in here if r.pacing in pacings]
                    for pacings in (["exchange"], ["scheduled"], ["exchange", "scheduled"])
                ]
                counts = [f"{sum(r.tripped for r in cell)} of {len(cell)}" for cell in cells]
                rows.append(f"| {load} | {rights} | {line} | {' | '.join(counts)} |")
    return "\n".join(rows)


def main() -> None:
    """Play the remaining runs, and print the table."""
    if sys.argv[1] == "--block":
        path, load, rights, first, end, seconds = sys.argv[2:]
        return block(Path(path), load, rights, range(int(first), int(end)), float(seconds))
    results = Path(sys.argv[1])
    runs, seconds = (*map(float, sys.argv[2:]), *(100.0, 5.0)[len(sys.argv) - 2 :])
    for end in range(_BLOCK, round(runs) + _BLOCK, _BLOCK):
        for load in LOADS_HERE:
            for rights in RIGHTS:
                first = done(results, load, rights)
                last = min(end, round(runs))
                if first >= last:
                    continue
                program = [sys.executable, "-m", "tests.benchmarks.emulated_line"]
                without = [] if rights == RIGHTS[0] else _WITHOUT_RIGHTS
                numbers = ["--block", str(results), load, rights, *map(str, (first, last, seconds))]
                subprocess.run([*without, *program, *numbers], check=True)
        print(f"{table(results)}\n", flush=True)
    return None


if __name__ == "__main__":
    main()
