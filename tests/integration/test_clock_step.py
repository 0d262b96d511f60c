"""The time of day is set during a recording."""

from __future__ import annotations

import subprocess
from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig_core.topics import topic
from mcap.reader import make_reader

from tests.integration.processes import Bench, wait_for
from tests.tools import require

HOUR_S = 3600
SAMPLES = topic("1", "sample")

# The daemon's own clock_gettime: an hour more on the real-time clock once the file is there.
STEP_C = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <time.h>
#include <unistd.h>
int clock_gettime(clockid_t id, struct timespec *ts) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    int result = real(id, ts);
    if (id == CLOCK_REALTIME && access(STEP_FILE, F_OK) == 0) ts->tv_sec += 3600;
    return result;
}
"""


@pytest.fixture
def stepped_clock(tmp_path: Path) -> tuple[Path, Path]:
    """Return a library to preload, and the file whose making steps the clock."""
    require("cc")
    step, source, library = tmp_path / "step", tmp_path / "step.c", tmp_path / "step.so"
    source.write_text(STEP_C)
    define = f'-DSTEP_FILE="{step}"'
    subprocess.run(["cc", "-shared", "-fPIC", define, "-o", library, source, "-ldl"], check=True)
    return library, step


@pytest.mark.exhaustive
def test_a_step_of_the_real_time_clock_is_not_in_the_recording(
    bench: Bench, stepped_clock: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An hour forward in the middle of a run."""
    library, step = stepped_clock
    bench.emulate()
    bench.forks = None  # a copy of an interpreter preloads nothing
    monkeypatch.setenv("LD_PRELOAD", str(library))
    bench.serve()
    monkeypatch.delenv("LD_PRELOAD")
    u = np.tile([1.0, 2.0], 150)

    def halfway(done: int, total: int) -> None:
        if done > total / 3:
            step.touch()

    with bench.rig() as rig:
        rig.arm("a test", Ts=0.005)
        path = rig.run(u, progress=halfway)
        wait_for(lambda: rig.status().phase == "safe")
        rig.arm("a test", Ts=0.005)
        again = rig.run(u[:20])

    assert step.exists()
    recording = armrig.load(path)
    assert recording.samples["k"].size == u.size
    assert np.diff(recording.samples["t_host_ns"]).max() < 1e9
    with path.open("rb") as file:
        times = [m.log_time for _, c, m in make_reader(file).iter_messages(topics=[SAMPLES])]
    assert (max(times) - min(times)) / 1e9 < 5
    # The clock was really stepped, for all that asked: the next run is of the new time.
    with again.open("rb") as file:
        _, _, first = next(iter(make_reader(file).iter_messages(topics=[SAMPLES])))
    assert first.log_time / 1e9 - max(times) / 1e9 > HOUR_S - 5
