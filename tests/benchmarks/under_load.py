"""Runs and kills beside other work, and whether a trip was forced by the machine.

`PYTHONPATH=tests/integration python tests/benchmarks/under_load.py [runs [kills [seconds]]]`: so
many of each beside a flood of `status` with one busy program, and beside four busy programs. Ts
5 ms, device watchdog 100 ms. A control at a higher priority than the loop's tells what the machine
did meanwhile: how late it woke, and how long a byte took through a pseudo-terminal of its own.
"""

from __future__ import annotations

import contextlib
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import armrig
from armrig.rig.client import Rig
from armrig.rig.session import RigError
from control import Control, Lateness
from processes import burning
from stand import Stand

FORCED_MS = {"exchange": 25.0, "scheduled": 50.0}
"""A machine that was late by so much may have forced a trip: half of what a round trip may take,
for a byte goes either way."""
BOUND_MS = 110.0
STRANGERS, QUERIES_HZ = 2, 2500
Pacing = Literal["exchange", "scheduled"]
_Ts = 0.005
_STRANGER = """
import sys, time, zenoh
config = zenoh.Config.from_json5('{mode: "client", connect: {endpoints: ["%s"]}}' % sys.argv[1])
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
rate, sent, began = float(sys.argv[2]), 0, time.monotonic()
while True:
    while sent < rate * (time.monotonic() - began):
        session.get("rig/1/cmd/status", lambda reply: None, timeout=5)
        sent += 1
    if time.monotonic() - began > 1:
        print(round(sent / (time.monotonic() - began)), flush=True)
        sent, began = 0, time.monotonic()
    time.sleep(0.005)
"""


@contextlib.contextmanager
def flooding(endpoint: str) -> Iterator[None]:
    """Have strangers ask for the status without end, beside one busy program."""
    program = [sys.executable, "-c", _STRANGER, endpoint]
    strangers = [
        subprocess.Popen([*program, str(QUERIES_HZ / STRANGERS)], stdout=subprocess.PIPE)
        for _ in range(STRANGERS)
    ]
    try:
        rates = [int(s.stdout.readline()) for s in strangers if s.stdout is not None]
        print(f"   {sum(rates)} queries a second", flush=True)
        with burning(1):
            yield
    finally:
        for stranger in strangers:
            stranger.kill()
            stranger.communicate()


@contextlib.contextmanager
def four(_endpoint: str) -> Iterator[None]:
    """Keep the machine busy."""
    with burning(4):
        yield


LOADS: dict[str, Callable[[str], contextlib.AbstractContextManager[None]]] = {
    "flood of status": flooding,
    "four busy programs": four,
}


def told(late: Lateness) -> str:
    """Return what the machine did, in words."""
    return f"control {late.worst_ms:.1f} ms late, a byte {late.delivery_ms:.1f} ms on its way"


def is_forced(late: Lateness, mode: Pacing) -> bool:
    """Return whether the machine alone may have led to a trip."""
    return max(late.worst_ms, late.delivery_ms) >= FORCED_MS[mode]


def woken(path: Path, pacing: Pacing) -> str:
    """Return how late the loop woke in a run that it paced."""
    samples = armrig.load(path).samples
    if pacing == "scheduled":
        return ""
    late_ms = (samples["t_host_ns"] - samples["t_sched_ns"]) / 1e6
    return f", the loop {late_ms.max():.1f} ms late"


def runs(stand: Stand, control: Control, n: int, seconds: float) -> tuple[int, int]:
    """Play runs in either mode in turn; return how many tripped, and how many of these unforced."""
    tripped = unforced = 0
    for i in range(n):
        stand.make_ready()
        pacing: Pacing = "scheduled" if i % 2 else "exchange"
        control.lateness()
        trip, host = "", ""
        try:
            with Rig(connect=stand.endpoint) as rig:
                rig.arm("benchmark", Ts=_Ts)
                u = [1.0, 4.0] * round(seconds / _Ts / 2)
                host = woken(rig.run(u, pacing=pacing), pacing)
        except RigError as err:
            trip = f": {err}"
        late = control.lateness()
        tripped += bool(trip)
        unforced += bool(trip) and not is_forced(late, pacing)
        print(f"   run {i + 1:2d} {pacing:9s} {told(late)}{host}{trip}", flush=True)
    return tripped, unforced


def kills(stand: Stand, control: Control, n: int, rng: random.Random) -> tuple[float, int]:
    """Kill what drives at random moments; return the longest time to 0 V, and how many too long."""
    worst, beyond = 0.0, 0
    whom: dict[str, Callable[[], object]] = {
        "loop": stand.kill_loop,
        "service": lambda: stand.daemon.kill(),
        "both": stand.kill_both,
    }
    for i in range(n):
        name = list(whom)[i % len(whom)]
        mode: Pacing = "exchange" if i % 2 else "scheduled"
        stand.make_ready()
        while not stand.begin(mode):
            stand.make_ready()
        time.sleep(rng.uniform(0.2, 1.0))
        if stand.witness.look()[-1][1] == 0.0:
            print(f"   kill {i + 1:2d} {name}: the run had ended before", flush=True)
            continue
        control.lateness()
        at_ns = time.monotonic_ns()
        whom[name]()
        ms = stand.witness.stopped_ms_after(at_ns)
        late = control.lateness()
        worst = max(worst, ms)
        beyond += ms > BOUND_MS and not is_forced(late, mode)
        print(
            f"   kill {i + 1:2d} {name:8s} {mode:9s} 0 V after {ms:.1f} ms, {told(late)}",
            flush=True,
        )
    return worst, beyond


def main() -> None:
    """Play 20 runs of 5 s and 24 kills beside each load, by default."""
    given = [float(argument) for argument in sys.argv[1:]]
    n_runs, n_kills, seconds = (*given, *(20.0, 24.0, 5.0)[len(given) :])
    control = Control()
    print(f"control: {control.policy}; {os.cpu_count()} processors", flush=True)
    try:
        for name, load in LOADS.items():
            print(f"-- beside {name}, load {os.getloadavg()[0]:.1f} before", flush=True)
            with tempfile.TemporaryDirectory(prefix="armrig-bench-") as folder:
                stand = Stand(Path(folder), has_line=False)
                try:
                    stand.make_ready()
                    with load(stand.endpoint):
                        tripped, unforced = runs(stand, control, round(n_runs), seconds)
                        worst, beyond = kills(stand, control, round(n_kills), random.Random(1))
                finally:
                    stand.end()
            print(
                f"-- {name}: {tripped} of {n_runs:g} runs tripped, {unforced} of them not forced "
                f"by the machine; {n_kills:g} kills, 0 V after {worst:.0f} ms at most, {beyond} "
                f"beyond {BOUND_MS:g} ms not forced; load {os.getloadavg()[0]:.1f} after",
                flush=True,
            )
    finally:
        control.end()


if __name__ == "__main__":
    main()
