"""How soon the motor stands at 0 V after what may happen; the table of docs/safety.md.

Real processes, a pseudo-terminal, and the emulator's own witness of the voltage, Ts 5 ms:
`PYTHONPATH=tests/integration python tests/benchmarks/stops.py [n [event …]]`.
"""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import armrig
from armrig.rig import Rig
from processes import WITHIN_S, Bench, Process, wait_for
from relay import Relay

RUNNER = """
import sys
from armrig.rig import Rig
with Rig(connect=sys.argv[1]) as rig:
    rig.arm("benchmark", Ts=0.005)
    rig.run([1.0, 4.0] * 2000, pacing=sys.argv[2])
"""
HAND = """
import sys, time
from armrig.rig import Rig
with Rig(connect=sys.argv[1]) as rig:
    rig.arm("benchmark", Ts=0.005)
    while True:
        for volts in (1.0, 4.0):
            rig.set(volts)
            time.sleep(0.02)
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """What there is when it happens."""

    bench: Bench
    daemon: Process
    loop_pid: int
    client: subprocess.Popen[bytes]
    relay: Relay | None
    rig: Rig

    def line(self, what: str) -> None:
        """Let something happen to the line."""
        assert self.relay is not None
        self.relay.do(what)

    def both(self) -> None:
        """Kill loop and service."""
        os.kill(self.loop_pid, signal.SIGKILL)
        self.daemon.kill()

    def fill_disk(self) -> None:
        """Leave the service no room in its recording."""
        (active,) = self.bench.recordings.glob("*.active")
        pid, size = self.daemon.popen.pid, active.stat().st_size
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


class Event(NamedTuple):
    """Something that happens while the motor is driven."""

    act: Callable[[Scene], object]
    mode: str = "scheduled"
    """Who drives: a run in that mode, or a hand."""
    has_line: bool = False
    """Whether a line that can fail lies between daemon and device."""


class Result(NamedTuple):
    """Times in ms."""

    stopped: float
    age: float | None
    """Of the newest sample in a file left behind."""
    ended: float | None
    """Until the service was gone, where it was told to end."""


def _kill_loop(scene: Scene) -> None:
    os.kill(scene.loop_pid, signal.SIGKILL)


def _freeze_loop(scene: Scene) -> None:
    os.kill(scene.loop_pid, signal.SIGSTOP)


EVENTS = {
    "armrig stop": Event(lambda s: s.rig.stop()),
    "SIGTERM": Event(lambda s: s.daemon.kill(signal.SIGTERM)),
    "SIGINT": Event(lambda s: s.daemon.kill(signal.SIGINT)),
    "SIGTERM, exchange": Event(lambda s: s.daemon.kill(signal.SIGTERM), "exchange"),
    "kill service": Event(lambda s: s.daemon.kill()),
    "kill loop": Event(_kill_loop),
    "kill loop, exchange": Event(_kill_loop, "exchange"),
    "kill both": Event(Scene.both),
    "freeze loop": Event(_freeze_loop),
    "freeze loop, exchange": Event(_freeze_loop, "exchange"),
    "kill who holds by hand": Event(lambda s: s.client.kill(), "hand"),
    "freeze who holds by hand": Event(lambda s: s.client.send_signal(signal.SIGSTOP), "hand"),
    "unplug": Event(lambda s: s.line("unplug"), has_line=True),
    "unplug, exchange": Event(lambda s: s.line("unplug"), "exchange", has_line=True),
    "device does not read": Event(lambda s: s.line("stop_reading"), "exchange", has_line=True),
    "device is not heard": Event(lambda s: s.line("stop_answering"), "exchange", has_line=True),
    "device reset": Event(lambda s: s.line("reset"), has_line=True),
    "disk full": Event(Scene.fill_disk),
}


def once(name: str) -> Result:
    """Let an event happen once."""
    event = EVENTS[name]
    bench = Bench(Path(tempfile.mkdtemp(prefix="armrig-bench-")))
    bench.emulate()
    relay = None
    if event.has_line:
        relay = Relay(bench.port, bench.folder / "line")
        bench.port = bench.folder / "line"
        bench.configure()
    daemon = bench.serve()
    loop_pid = bench.loop_pid(daemon)
    endpoint = f"unixsock-stream/{bench.folder}/armrig/1.sock"
    program = HAND if event.mode == "hand" else RUNNER
    client = subprocess.Popen(
        [sys.executable, "-c", program, endpoint, event.mode], stderr=subprocess.DEVNULL
    )
    try:
        wait_for(lambda: len(bench.voltage_changes()) > (20 if event.mode == "hand" else 150))
        with bench.rig() as rig:
            scene = Scene(
                bench=bench, daemon=daemon, loop_pid=loop_pid, client=client, relay=relay, rig=rig
            )
            at_ns = time.monotonic_ns()
            event.act(scene)
            ended = None
            if name.startswith("SIG"):
                daemon.popen.wait(WITHIN_S)
                ended = (time.monotonic_ns() - at_ns) / 1e6
            stopped = 1e3 * bench.went_to_0_v_after(at_ns)
        with contextlib.suppress(ProcessLookupError):
            os.kill(loop_pid, signal.SIGCONT)
        left = list(bench.recordings.glob("*.active"))
        age = None
        if name in ("kill service", "kill both") and left:
            newest_ns = int(armrig.load(left[0]).samples["t_host_ns"][-1])
            age = (at_ns - newest_ns) / 1e6
        return Result(stopped, age, ended)
    finally:
        client.kill()
        client.wait()
        if relay is not None:
            relay.end()
        for process in reversed(bench.processes):
            process.end()


def told(what: str, values: list[float]) -> str:
    """Return median and worst."""
    return f"{what} {statistics.median(values):.1f} ms, worst {max(values):.1f}"


def main() -> None:
    """Try each so many times, 10 by default."""
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    for name in sys.argv[2:] or EVENTS:
        results = [once(name) for _ in range(n)]
        texts = [told("0 V after", [result.stopped for result in results])]
        if ages := [result.age for result in results if result.age is not None]:
            texts.append(told("newest sample old", ages))
        if ended := [result.ended for result in results if result.ended is not None]:
            texts.append(told("gone after", ended))
        print(f"{name:24s} {'; '.join(texts)} (n = {n})", flush=True)


if __name__ == "__main__":
    main()
