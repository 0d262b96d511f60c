"""Time from an event to 0 V at the motor, on a quiet and on a loaded machine.

Real processes, a pseudo-terminal, and the voltages that the emulator recorded; Ts 5 ms, device
watchdog 100 ms. `python -m tests.benchmarks.stops [n [event …]]` repeats each event n times, 10 by
default, each time with new processes and at another phase between two flushes. On the loaded
machine four busy programs run during the event. The control wakes each 1 ms above the loop's
priority: its lateness is due to the kernel or the host, not to armrig.
"""

from __future__ import annotations

import math
import os
import resource
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from armrig.rig.client import Rig

from tests.integration.driving import begin
from tests.integration.processes import Bench, Burners
from tests.integration.relay import Relay

BUSY_PROGRAMS = 4
DRIVEN_S = 0.5  # the device's queue is full by then
FLUSH_S = 0.1
MAX_TRIES = 10
CLIENT = """
import sys, time
from armrig.rig.client import Rig
from armrig_core.control.control_law import ControlLaw, LawOutput, Reference
with Rig(connect=sys.argv[1]) as rig:
    rig.arm("benchmark", Ts=0.005)
    mode = sys.argv[2]
    while mode == "hand":
        for volts in (1.0, 4.0):
            rig.set(volts)
            time.sleep(0.02)
    if mode == "control":
        law = ControlLaw(
            Ts_us=5_000, outputs=(LawOutput(name="alpha", unit="rad"),),
            reference=Reference(name="u", unit="V", low=0, high=5),
            A=(), B=(), C=(), D=1.0, x0=(), F=((),),
        )
        rig.control(law, [1.0, 4.0] * 2000, unmonitored=True)
    pacing = "exchange" if mode == "exchange" else "scheduled"
    rig.run([1.0, 4.0] * 2000, pacing=pacing, dead_man=1.0 if mode == "dead-man" else None)
"""
CONTROL = """
import os, select, time
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(81))  # the loop has 80
except PermissionError:
    pass
worst, due = 0.0, time.monotonic()
while True:
    due += 0.001
    if select.select([0], [], [], max(0.0, due - time.monotonic()))[0]:
        break
    worst, due = max(worst, time.monotonic() - due), max(due, time.monotonic())
print(1e3 * worst)
"""


class Setup(NamedTuple):
    """A driven rig and its processes."""

    bench: Bench
    pids: dict[str, int]
    rig: Rig
    """A second client."""
    line: Relay | None


class Event(NamedTuple):
    """An event, and the time within which the motor must be at 0 V."""

    bound_ms: float
    act: Callable[[Setup], object]
    mode: str = "scheduled"
    """Pacing of the run, a run with a dead-man or in control, or a voltage held by hand."""
    has_line: bool = False
    """A line that can fail connects daemon and device."""


def send(number: signal.Signals, *names: str) -> Callable[[Setup], object]:
    """Return the event that sends a signal to processes."""
    return lambda setup: [os.kill(setup.pids[name], number) for name in names]


def fill_disk(setup: Setup) -> None:
    """Leave the service no space for its recording."""
    (active,) = setup.bench.recordings.glob("*.active")
    limits = (active.stat().st_size, resource.RLIM_INFINITY)
    resource.prlimit(setup.pids["service"], resource.RLIMIT_FSIZE, limits)


def on_line(fault: str, mode: str = "scheduled", bound_ms: float = 110.0) -> Event:
    """Return the event that the line between daemon and device fails."""
    return Event(bound_ms, lambda setup: setup.line and setup.line.do(fault), mode, has_line=True)


KILL, FREEZE = signal.SIGKILL, signal.SIGSTOP
EVENTS = {
    "armrig stop": Event(5, lambda setup: setup.rig.stop()),
    "SIGTERM": Event(5, send(signal.SIGTERM, "service")),
    "SIGINT": Event(5, send(signal.SIGINT, "service")),
    "SIGTERM, exchange": Event(5, send(signal.SIGTERM, "service"), "exchange"),
    "kill service": Event(10, send(KILL, "service")),
    "kill loop": Event(110, send(KILL, "loop")),
    "kill loop, exchange": Event(110, send(KILL, "loop"), "exchange"),
    "kill both": Event(110, send(KILL, "loop", "service")),
    "freeze loop": Event(110, send(FREEZE, "loop")),
    "freeze loop, exchange": Event(110, send(FREEZE, "loop"), "exchange"),
    "freeze service": Event(3005, send(FREEZE, "service")),
    "kill client by hand": Event(210, send(KILL, "client"), "hand"),
    "freeze client by hand": Event(210, send(FREEZE, "client"), "hand"),
    "kill client with dead-man": Event(1005, send(KILL, "client"), "dead-man"),
    "freeze client with dead-man": Event(1005, send(FREEZE, "client"), "dead-man"),
    "armrig stop, control": Event(5, lambda setup: setup.rig.stop(), "control"),
    "kill service, control": Event(10, send(KILL, "service"), "control"),
    "kill loop, control": Event(110, send(KILL, "loop"), "control"),
    "kill both, control": Event(110, send(KILL, "loop", "service"), "control"),
    "kill client, control": Event(1005, send(KILL, "client"), "control"),
    "disk full": Event(math.inf, fill_disk),
    "recordings removed": Event(math.inf, lambda setup: shutil.rmtree(setup.bench.recordings)),
    "unplug": on_line("unplug"),
    "unplug, exchange": on_line("unplug", "exchange"),
    "device does not read": on_line("stop_reading", "exchange"),
    "device is not heard": on_line("stop_answering", "exchange"),
    "device reset": on_line("reset", bound_ms=1),
}


@contextmanager
def driven(event: Event) -> Iterator[Setup]:
    """Have a client drive a rig."""
    with tempfile.TemporaryDirectory(prefix="armrig-bench-") as directory:
        bench = Bench(Path(directory), terminal=True)
        bench.configure(watchdog_ms=100)
        line, client, pids = None, None, dict[str, int]()
        try:
            bench.emulate()
            if event.has_line:
                line, bench.port = Relay(bench.port, bench.folder / "line"), bench.folder / "line"
                bench.configure(watchdog_ms=100)
            service = bench.serve()
            pids |= {"service": service.popen.pid, "loop": bench.loop_pid(service)}
            with bench.rig() as rig:
                client = begin(bench, 1, CLIENT, event.mode)
                yield Setup(bench, pids | {"client": client.pid}, rig, line)
        finally:
            for pid in pids.values():
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGCONT)
            if client is not None:
                client.kill()
                client.wait()
            if line is not None:
                line.end()
            bench.end()


def stop_times_ms(event: Event, phase: float, burners: Burners) -> tuple[float, float]:
    """Return the time from the event to 0 V, and the greatest lateness of the control."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    for _ in range(MAX_TRIES):
        with driven(event) as setup, burners:
            control = subprocess.Popen([sys.executable, "-c", CONTROL], **pipes)
            time.sleep(DRIVEN_S + phase * FLUSH_S)
            if setup.bench.volts() == 0.0:  # the load has already ended the run
                control.communicate()
                continue
            at_ns = time.monotonic_ns()
            event.act(setup)
            stopped_s = setup.bench.went_to_0_v_after(at_ns)
            return 1e3 * stopped_s, float(control.communicate()[0])
    raise RuntimeError(f"the load ended {MAX_TRIES} runs before the event")


def main() -> None:
    """Print a row for each event."""
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    print(f"n = {n}, in ms: median and worst; greatest lateness of the control\n")
    print("| event | bound | quiet: median | worst | control | loaded: median | worst | control |")
    print("|---" * 8 + "|")
    columns = [Burners(0), Burners(BUSY_PROGRAMS)]
    try:
        for name in sys.argv[2:] or EVENTS:
            cells = [f"{EVENTS[name].bound_ms:g}"]
            for burners in columns:
                found = [stop_times_ms(EVENTS[name], k / n, burners) for k in range(n)]
                stopped, late = zip(*found, strict=True)
                cells += [f"{x:.1f}" for x in (statistics.median(stopped), max(stopped), max(late))]
            print(f"| {name} | {' | '.join(cells)} |", flush=True)
    finally:
        for burners in columns:
            burners.end()


if __name__ == "__main__":
    main()
