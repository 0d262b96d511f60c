"""Runs and kills next to other work, and the share of trips that the machine forced.

`python -m tests.benchmarks.under_load [runs [kills [seconds [1]]]]`: so many of each during a flood
of `status` with one busy program, and next to four busy programs. A 1 at the end gives the kernel's
workers the real-time priority 79 meanwhile. Ts 5 ms, device watchdog 100 ms.

A control at a higher priority than the loop's measures the machine: its lateness, and the time of a
byte through a pseudo-terminal of its own. The kernel's trace measures the wait of any terminal's
bytes for a kernel worker (root only; otherwise the control alone judges).
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
from typing import Literal, NamedTuple

import armrig
from armrig.rig.client import Rig
from armrig.rig.session import RigError

from tests.benchmarks.kernel_lateness import Control, Lateness
from tests.benchmarks.kernel_worker import KernelWorker, raised
from tests.benchmarks.stand import Stand
from tests.integration.processes import burning

FORCED_MS = {"exchange": 25.0, "scheduled": 50.0}
"""A machine that was late by so much may have forced a trip: half of what a round trip may take,
for a byte goes either way. Until START the rig is read in exchange mode."""
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
    """Have strangers request the status without end, next to one busy program."""
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


class Machine:
    """The control and the kernel's trace: measurements of the machine since the last question."""

    def __init__(self) -> None:
        self.control = Control()
        self._worker: KernelWorker | None = None
        try:
            self._worker = KernelWorker()
        except OSError as err:
            print(f"without the kernel's trace: {err}; the control alone judges", flush=True)

    def asked(self) -> Told:
        """Return the measurements since the last call."""
        worker_ms = float("nan") if self._worker is None else self._worker.slowest_ms()
        return Told(self.control.lateness(), worker_ms)

    def end(self) -> None:
        """Look no more."""
        self.control.end()
        if self._worker is not None:
            self._worker.end()


class Told(NamedTuple):
    """Measurements of the machine, in ms."""

    control: Lateness
    worker_ms: float
    """NaN where the kernel's trace may not be used."""

    def __str__(self) -> str:
        control = f"control {self.control.worst_ms:.1f} ms late"
        own = f"a byte of its own {self.control.delivery_ms:.1f}"
        return f"{control}, {own}, a kernel worker {self.worker_ms:.1f}"

    def may_have_led_to_a_trip(self, mode: Pacing) -> bool:
        """Return whether the machine alone may have led to a trip."""
        times_ms = (self.control.worst_ms, self.control.delivery_ms, self.worker_ms)
        return any(ms >= FORCED_MS[mode] for ms in times_ms)


def woken(path: Path, pacing: Pacing) -> str:
    """Return how late the loop woke in a run that it paced."""
    samples = armrig.load(path).samples
    if pacing == "scheduled":
        return ""
    late_ms = (samples["t_host_ns"] - samples["t_sched_ns"]) / 1e6
    return f", the loop {late_ms.max():.1f} ms late"


def runs(stand: Stand, machine: Machine, n: int, seconds: float) -> tuple[int, int]:
    """Play runs in either mode in turn; return how many tripped, and how many of these unforced."""
    tripped = unforced = 0
    for i in range(n):
        stand.make_ready()
        pacing: Pacing = "scheduled" if i % 2 else "exchange"
        machine.asked()
        trip, host, had_begun = "", "", False
        try:
            with Rig(connect=stand.endpoint) as rig:
                rig.arm("benchmark", Ts=_Ts)
                u = [1.0, 4.0] * round(seconds / _Ts / 2)
                host = woken(rig.run(u, pacing=pacing), pacing)
        except RigError as err:
            trip, had_begun = f": {err}", "the run ended" in str(err)
        did = machine.asked()
        tripped += bool(trip)
        at_the_time: Pacing = pacing if had_begun else "exchange"
        unforced += bool(trip) and not did.may_have_led_to_a_trip(at_the_time)
        print(f"   run {i + 1:2d} {pacing:9s} {did}{host}{trip}", flush=True)
    return tripped, unforced


def kills(stand: Stand, machine: Machine, n: int, rng: random.Random) -> tuple[float, int]:
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
        machine.asked()
        at_ns = time.monotonic_ns()
        whom[name]()
        ms = stand.witness.stopped_ms_after(at_ns)
        did = machine.asked()
        worst = max(worst, ms)
        beyond += ms > BOUND_MS and not did.may_have_led_to_a_trip(mode)
        print(
            f"   kill {i + 1:2d} {name:8s} {mode:9s} 0 V after {ms:.1f} ms, {did}",
            flush=True,
        )
    return worst, beyond


def main() -> None:
    """Play 20 runs of 5 s and 24 kills under each load, by default."""
    given = [float(argument) for argument in sys.argv[1:]]
    n_runs, n_kills, seconds, is_raised = (*given, *(20.0, 24.0, 5.0, 0.0)[len(given) :])
    machine = Machine()
    print(f"control: {machine.control.policy}; {os.cpu_count()} processors", flush=True)
    try:
        for name, load in LOADS.items():
            print(f"-- beside {name}, load {os.getloadavg()[0]:.1f} before", flush=True)
            with tempfile.TemporaryDirectory(prefix="armrig-bench-") as folder:
                stand = Stand(Path(folder), has_line=False)
                try:
                    stand.make_ready()
                    with load(stand.endpoint), raised() if is_raised else contextlib.nullcontext():
                        tripped, unforced = runs(stand, machine, round(n_runs), seconds)
                        worst, beyond = kills(stand, machine, round(n_kills), random.Random(1))
                finally:
                    stand.end()
            print(
                f"-- {name}: {tripped} of {n_runs:g} runs tripped, {unforced} of them not forced "
                f"by the machine; {n_kills:g} kills, 0 V after {worst:.0f} ms at most, {beyond} "
                f"beyond {BOUND_MS:g} ms not forced; load {os.getloadavg()[0]:.1f} after",
                flush=True,
            )
    finally:
        machine.end()


if __name__ == "__main__":
    main()
