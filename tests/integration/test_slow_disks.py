"""A daemon whose disk is slow or does not answer; a recorder that is killed."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig.rig.replies import RunEndedError

from tests.integration.driving import driven
from tests.integration.processes import Bench, Process, wait_for
from tests.tools import require

SLOW_C = """
#include <unistd.h>
#include <sys/syscall.h>
int fdatasync(int fd) { usleep(WAIT_US); return syscall(SYS_fdatasync, fd); }
"""
DEAD_C = """
#include <unistd.h>
int fdatasync(int fd) { for (;;) pause(); }
int fsync(int fd) { for (;;) pause(); }
"""
ENDS_S = 60.0
Serve = Callable[..., Process]


@pytest.fixture
def served(bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Serve:
    """Return a function that starts the daemon on the disk of a C program."""
    require("cc")

    def serve(program: str, wait_us: int = 0) -> Process:
        source, library = tmp_path / "disk.c", tmp_path / "disk.so"
        source.write_text(program)
        define = f"-DWAIT_US={wait_us}"
        subprocess.run(["cc", "-shared", "-fPIC", define, "-o", library, source], check=True)
        bench.emulate()
        bench.forks = None  # a copy of an interpreter preloads nothing
        monkeypatch.setenv("LD_PRELOAD", str(library))
        daemon = bench.serve()
        monkeypatch.delenv("LD_PRELOAD")
        return daemon

    return serve


@pytest.mark.exhaustive
def test_a_run_on_a_slow_disk_is_complete(bench: Bench, served: Serve) -> None:
    """An SD card, or a busy disk: fdatasync takes longer than the time between two syncs."""
    daemon = served(SLOW_C, 2_000_000)
    with bench.rig() as rig:
        rig.arm("a test", Ts=0.005)
        path = rig.run(np.full(1600, 1.0))
        last = rig.status().last_run

    assert last is not None
    assert (last.samples, last.synced, last.outcome) == (1600, 1600, "complete")
    assert armrig.load(path).samples.size == 1600
    assert daemon.end() == 0


@pytest.mark.exhaustive
def test_a_disk_that_stops_for_good_is_reported_and_the_next_run_begins_and_ends_by_sigterm(
    bench: Bench, served: Serve
) -> None:
    daemon = served(DEAD_C)
    with bench.rig() as rig:
        rig.arm("a test", Ts=0.005)
        with pytest.raises(RunEndedError, match="up to 100 of 100 samples are lost"):
            rig.run(np.full(100, 1.0))
        wait_for(lambda: rig.status().phase == "safe")
    with driven(bench, samples=3000):
        begun_s = time.monotonic()
        daemon.popen.terminate()
        code = daemon.popen.wait(ENDS_S)

    assert code == 1
    assert time.monotonic() - begun_s < ENDS_S
    assert daemon.said.count("the disk did not answer for 3") == 2
    assert "samples are lost; `armrig recover` the others" in daemon.said
    assert all(not armrig.load(p).truncated for p in bench.recordings.glob("*.active"))
