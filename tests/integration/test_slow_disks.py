"""A daemon whose disk is slow or does not answer; a recorder that is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import armrig
import numpy as np
import pytest
import zenoh
from armrig.rig.replies import RunEndedError
from armrig.rig.session import open_session
from armrig_core.telemetry import decode_sample
from armrig_core.topics import stream_key

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
MOST_AGE_S = 0.2
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
@pytest.mark.parametrize("wait_us", [1_200_000, 2_000_000])
def test_a_run_on_a_slow_disk_is_complete(bench: Bench, served: Serve, wait_us: int) -> None:
    """An SD card, or a busy disk: fdatasync takes longer than the time between two syncs."""
    daemon = served(SLOW_C, wait_us)
    with bench.rig() as rig:
        rig.arm("a test", Ts=0.005)
        path = rig.run(np.full(1600, 1.0))
        last = rig.status().last_run

    assert last is not None
    assert (last.samples, last.synced, last.outcome) == (1600, 1600, "complete")
    assert armrig.load(path).samples.size == 1600
    assert daemon.end() == 0


@pytest.mark.exhaustive
@pytest.mark.parametrize("wait_us", [800_000, 2_000_000])
def test_a_kill_loses_no_more_on_a_slow_disk(bench: Bench, served: Serve, wait_us: int) -> None:
    """L1: the flushes go on during a sync."""
    daemon = served(SLOW_C, wait_us)
    published: list[int] = []

    def heard(message: zenoh.Sample) -> None:
        sample = decode_sample(message.payload.to_bytes())
        assert sample is not None
        published.append(sample.k)

    endpoint = f"unixsock-stream/{bench.folder}/armrig/1.sock"
    with driven(bench, samples=6000, Ts=0.005), open_session(endpoint, rig="1") as session:
        session.declare_subscriber(stream_key("1", "sample"), heard)
        wait_for(lambda: len(published) > 500)
        last_k = published[-1]
        daemon.popen.send_signal(signal.SIGKILL)
    (left,) = bench.recordings.glob("*.active")
    newest_k = int(armrig.load(left).samples["k"][-1])

    assert (last_k - newest_k) * 0.005 <= MOST_AGE_S


@pytest.mark.exhaustive
def test_a_disk_that_stops_for_good_is_reported_and_the_next_run_begins(
    bench: Bench, served: Serve
) -> None:
    daemon = served(DEAD_C)
    with bench.rig() as rig:
        for _ in range(2):
            rig.arm("a test", Ts=0.005)
            with pytest.raises(RunEndedError, match="up to 100 of 100 samples are lost"):
                rig.run(np.full(100, 1.0))
            wait_for(lambda: rig.status().phase == "safe")

    assert daemon.end() == 1
    assert daemon.said.count("the disk did not answer for 3") == 2
    assert all(not armrig.load(p).truncated for p in bench.recordings.glob("*.active"))


@pytest.mark.exhaustive
def test_sigterm_says_what_a_disk_that_does_not_answer_may_have_lost(
    bench: Bench, served: Serve
) -> None:
    daemon = served(DEAD_C)
    with driven(bench, samples=3000):
        begun_s = time.monotonic()
        daemon.popen.terminate()
        code = daemon.popen.wait(ENDS_S)

    assert code == 1
    assert time.monotonic() - begun_s < ENDS_S
    assert "samples are lost; `armrig recover` the others" in daemon.said


@pytest.mark.exhaustive
def test_a_recorder_that_is_killed_is_not_called_a_daemon(bench: Bench) -> None:
    bench.emulate()
    bench.serve()
    out = bench.folder / "remote.mcap"
    endpoint = f"unixsock-stream/{bench.folder}/armrig/1.sock"
    command = [sys.executable, "-m", "armrig", "record", "--from", endpoint, "-o", str(out)]
    with Path(os.devnull).open("wb") as nowhere:
        recorder = subprocess.Popen(command, stdout=nowhere, stderr=nowhere)
    active = out.with_name("remote.mcap.active")
    try:
        wait_for(lambda: active.exists() and active.stat().st_size > 0)
        wait_for(lambda: armrig.load(active).samples.size > 20)
    finally:
        recorder.kill()
        recorder.wait()

    recovered = bench.armrig("recover", str(bench.folder))
    shown = bench.armrig("info", str(out))

    assert "of 0 s" not in recovered.stdout
    assert "cut off: its recorder died or could not write" in shown.stdout
