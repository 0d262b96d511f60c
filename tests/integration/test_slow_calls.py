"""Each call of the file system in a run waits 5 s, one at a time: no stop waits for it.

As SQLite's tests do, for every n: the n-th call of each kind, from `arm` to the end of the run.
"""

from __future__ import annotations

import ctypes
import mmap
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from armrig.rig.client import RigError

from tests.integration.driving import bring_to_rest
from tests.integration.processes import WITHIN_S, Bench, Process, wait_for
from tests.integration.watching import watched
from tests.tools import require

KINDS = ("open", "mkdir", "statvfs", "rename", "unlink", "fsync", "stat", "write")
EACH_TENTH = ("stat", "write")
STOPPED_S = 2.0
"""Threshold between a stop and no stop: the call waits 5 s."""
_RUN_S, _TS = 1.0, 0.01


class Shared(ctypes.Structure):
    """Memory that the daemon's library maps, too; see slow_calls.c."""

    _fields_ = (
        ("pid", ctypes.c_int),
        ("kind", ctypes.c_int),
        ("number", ctypes.c_int),
        ("waits", ctypes.c_int),
        ("count", ctypes.c_int * len(KINDS)),
    )


class SlowCalls:
    """A daemon with one call that waits."""

    def __init__(self, bench: Bench) -> None:
        require("cc")
        self.bench = bench
        library, file = bench.folder / "slow.so", bench.folder / "shared"
        source = Path(__file__).with_name("slow_calls.c")
        subprocess.run(["cc", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
        file.write_bytes(bytes(ctypes.sizeof(Shared)))
        self._file = file.open("r+b")
        self.shared = Shared.from_buffer(mmap.mmap(self._file.fileno(), 0))
        self._env = {"LD_PRELOAD": str(library), "SLOW_CALLS": str(file)}
        bench.emulate()
        bench.forks = None  # a copy of an interpreter preloads nothing
        self.serve()

    def serve(self) -> None:
        """Start the daemon."""
        self.shared.number = self.shared.pid = 0
        self.daemon: Process = self.bench.serve(self._env)

    def close(self) -> None:
        """Let no call wait any more."""
        self.shared.number = 0
        self._file.close()

    def choose(self, kind: str, number: int) -> None:
        """Let the call with this number wait, counted from now on; 0: none."""
        self.shared.number = 0
        self.shared.kind = KINDS.index(kind)
        self.shared.count = (ctypes.c_int * len(KINDS))()
        self.shared.pid = self.daemon.popen.pid
        self.shared.number = number

    def run(self) -> threading.Thread:
        """Begin a run in a thread, and return when the call waits or the run has ended."""
        thread = threading.Thread(target=self._run, daemon=True)
        thread.start()
        wait_for(lambda: self.shared.waits or not thread.is_alive())
        return thread

    def _run(self) -> None:
        with suppress(RigError), self.bench.rig() as rig:
            rig.arm("a test", Ts=_TS)
            rig.run(np.full(round(_RUN_S / _TS), 2.0))

    def rest(self, thread: threading.Thread) -> None:
        """End the wait and the run."""
        self.shared.number = 0
        thread.join(WITHIN_S)
        bring_to_rest(self.bench)


@pytest.fixture
def slow(bench: Bench) -> Iterator[SlowCalls]:
    """Give a daemon whose calls can wait."""
    with closing(SlowCalls(bench)) as slow:
        yield slow


def _stopped_s(slow: SlowCalls, stop: Callable[[], object]) -> float:
    """Return the time from a stop to 0 V; the call still waits then."""
    begun_ns = time.monotonic_ns()
    stop()
    wait_for(lambda: slow.bench.volts() == 0.0)
    assert slow.shared.waits
    last_ns = slow.bench.voltage_changes()[-1][0]
    return max(0.0, (last_ns - begun_ns) / 1e9)


@pytest.mark.timed
@pytest.mark.exhaustive
def test_no_call_of_the_file_system_delays_a_stop(slow: SlowCalls) -> None:
    took: dict[str, list[float]] = {kind: [] for kind in KINDS}
    with slow.bench.rig() as other:
        for kind in KINDS:
            number = 1
            while True:
                slow.choose(kind, number)
                thread = slow.run()
                if not slow.shared.waits:  # the run has no call with this number
                    slow.rest(thread)
                    break
                took[kind].append(_stopped_s(slow, other.stop))
                slow.rest(thread)
                number += 10 if kind in EACH_TENTH else 1
    for kind, times in took.items():
        print(f"{kind}: {len(times)} calls, 0 V after {max(times, default=0):.3f} s at most")
    assert sum(map(len, took.values())) >= 20
    assert max(max(times, default=0) for times in took.values()) < STOPPED_S


@pytest.mark.timed
@pytest.mark.exhaustive
@pytest.mark.parametrize("kind", KINDS)
def test_no_call_of_the_file_system_delays_the_page_or_a_signal(slow: SlowCalls, kind: str) -> None:
    """The first, middle and last call of a run."""
    slow.choose(kind, 0)
    slow.rest(slow.run())
    count = slow.shared.count[KINDS.index(kind)]
    numbers = sorted({1, (count + 1) // 2, count} - {0})
    with watched(slow.bench) as page:
        for number in numbers:
            slow.choose(kind, number)
            thread = slow.run()
            if slow.shared.waits:
                assert _stopped_s(slow, partial(page.ask, "/api/stop", {})) < STOPPED_S
            slow.rest(thread)
    for number in numbers:
        slow.choose(kind, number)
        thread = slow.run()
        if slow.shared.waits:
            assert _stopped_s(slow, slow.daemon.popen.terminate) < STOPPED_S
        slow.shared.number = 0
        thread.join(WITHIN_S)
        slow.daemon.end()
        slow.serve()
