"""Times of the Uno's binary in simavr by its own cycles, and the performance of its host.

`python -m tests.benchmarks.uno [runs | speed | line | oe …]`, all
without an argument; `make fil` first. `line` alone is in real time, and so the machine's, too.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from itertools import count, pairwise
from pathlib import Path
from statistics import median, quantiles

import serial
from armrig_daemon.config import Config, Device
from armrig_daemon.emulator.harness import CYCLES_PER_US
from armrig_daemon.pipe import RunEnded, RunStarted
from armrig_protocol import decoder
from armrig_protocol.frame import encode
from armrig_protocol.messages import (
    SCHEMA_HASH,
    VERSION,
    Exchange,
    Hello,
    HelloReply,
    Message,
    Ping,
    Pong,
    Sample,
    Status,
)

from tests.firmware.test_uno_identification import error_of_oe
from tests.firmware.test_uno_runs import UnoBench, index_of_hold, telegraph
from tests.firmware.uno_host import PERIOD_NS, powered

N = 300
"""Questions over the line."""
_SECONDS = 10
_BOOT_S = 10.0


def runs() -> None:
    """Play 10 s of a telegraph at 500 Hz and at 1 kHz, scheduled, with PING and STATUS."""
    for ts_us in (2000, 1000):
        bench = UnoBench(Config(device=Device(watchdog_ms=250)))
        with closing(bench.uno):
            told = _statuses(bench)
            volts = telegraph(_SECONDS * 1_000_000 // ts_us)
            bench.run(volts, ts_us)
            (ended,) = bench.of(RunEnded)
            assert ended.outcome == "complete", ended
            holds = _holds_of_run(bench, len(volts))
            jitter_us = max(abs(b - a - ts_us * 1000) for a, b in pairwise(holds)) / 1000
            after_us = _from_hold_to_pin(bench, holds)
            off_us = bench.uno.harness.figures().interrupts_off_max / CYCLES_PER_US
            print(
                f"{1e6 / ts_us:.0f} Hz, {len(volts)} samples: jitter at most {jitter_us:.2f} us; "
                f"hold to pin {min(after_us):.1f} to {max(after_us):.1f} us "
                f"({len(after_us)} changes, {sum(us > 64 for us in after_us)} over 64); "
                f"interrupts off at most {off_us:.1f} us; "
                f"stack left {told[-1].stack_free} B; bytes lost {told[-1].rx_lost}, "
                f"frames not sent {told[-1].tx_dropped}, samples late {told[-1].late}"
            )


def _statuses(bench: UnoBench) -> list[Status]:
    """Return where each STATUS of the device will be put."""
    told: list[Status] = []

    def read(data: bytes) -> bytes:
        told.extend(m for m in decoder.feed(b"", data)[1] if isinstance(m, Status))
        return data

    bench.ports.from_device = read
    return told


def _holds_of_run(bench: UnoBench, n: int) -> list[int]:
    """Return when theta_1 was held for each sample of the run."""
    (started,) = bench.of(RunStarted)
    first = index_of_hold(bench, next(s for s in bench.samples if s.k == started.k_first))
    return bench.holds[first : first + n]


def _from_hold_to_pin(bench: UnoBench, holds: list[int]) -> list[float]:
    """Return the time from the hold to each new duty at the pin, in µs.

    A period that the motor's end cuts short began before the hold, and does not count.
    """
    changes = deque(bench.uno.ns(d.cycle) for d in bench.uno.duties)
    found = []
    for hold, end in pairwise(holds):
        while changes and changes[0] < hold:
            changes.popleft()
        if changes and changes[0] < end - PERIOD_NS:
            found.append((changes[0] - hold) / 1000)
    return found


def speed() -> None:
    """Print the speed of the harness, as a multiple of real time."""
    with powered() as host:
        began = time.perf_counter()
        host.wait(10_000)
        idle = 10 / (time.perf_counter() - began)
    bench = UnoBench(Config(device=Device(watchdog_ms=250)))
    with closing(bench.uno):
        began = time.perf_counter()
        bench.run(telegraph(5000), 1000)
        busy = 5.5 / (time.perf_counter() - began)
    print(f"times real time: {idle:.0f} idle, {busy:.1f} at 1 kHz with loop, core and arm")


def line() -> None:
    """Send N questions over a pseudo-terminal, one after the other, in real time."""
    with emulated() as port, closing(serial.Serial(str(port), 500_000, timeout=0.005)) as wire:
        answered = _asker(wire)
        end = time.monotonic() + _BOOT_S
        seq = count(1)
        while not answered(Hello(0, next(seq), VERSION, SCHEMA_HASH), HelloReply, 0.2):
            assert time.monotonic() < end, "no answer"
        for kind, reply in ((Ping, Pong), (Exchange, Sample)):
            took_ms = []
            for i in range(1, N + 1):
                time.sleep(0.003)  # whatever else it has to say has been said
                question = Ping(0, next(seq), i) if kind is Ping else Exchange(0, next(seq), i, 0)
                ms = answered(question, reply, 2.0)
                assert ms, f"{kind.__name__} {i} was not answered"
                took_ms.append(ms)
            p99 = quantiles(took_ms, n=100)[98]
            told = f"{median(took_ms):.2f} ms, p99 {p99:.2f} ms, worst {max(took_ms):.2f} ms"
            print(f"{kind.__name__.upper()}: {told} (n = {N})")


def _asker(wire: serial.Serial) -> Callable[[Message, type, float], float | None]:
    """Return a function that returns the ms until the answer; None without one."""
    pending = b""

    def answered(question: Message, kind: type, within_s: float) -> float | None:
        nonlocal pending
        began = time.perf_counter()
        wire.write(b"\0" + encode(question))
        while time.perf_counter() - began < within_s:
            pending, received = decoder.feed(pending, wire.read(max(1, wire.in_waiting)))
            if any(isinstance(one, kind) for one in received):
                return (time.perf_counter() - began) * 1000
        return None

    return answered


@contextmanager
def emulated() -> Iterator[Path]:
    """Emulate a rig with the firmware; give its port."""
    with tempfile.TemporaryDirectory() as folder:
        port = Path(folder) / "uno"
        command = [sys.executable, "-m", "armrig_daemon", "emulate", "--firmware", "--port"]
        emulator = subprocess.Popen([*command, str(port)], stderr=subprocess.DEVNULL)
        try:
            while not port.exists():
                assert emulator.poll() is None, "armrigd emulate --firmware has ended"
                time.sleep(0.01)
            yield port
        finally:
            emulator.terminate()
            emulator.wait()


def oe() -> None:
    """Identify the arm from 30 s at 100 Hz on the binary, in both modes."""
    for pacing in ("scheduled", "exchange"):
        with tempfile.TemporaryDirectory() as folder:
            print(f"OE, {pacing}: {100 * error_of_oe(pacing, Path(folder)):.2f} % rms")


PARTS = {"runs": runs, "speed": speed, "line": line, "oe": oe}

if __name__ == "__main__":
    for name in sys.argv[1:] or PARTS:
        PARTS[name]()
