"""Lateness of the loop at 1 kHz, in recorded and in unrecorded runs.

`python -m tests.benchmarks.recording_pauses [--pairs 40]`: short runs of the same input, recorded
and not (`recording_daemon.py`), in the order ABBA, so that changing load meets both alike. The
lateness of a sample is the time from its due time to the host's request. Each pair of neighbours
gives a difference; the median of these has a 95 % interval by their order (no distribution is
assumed). An effect smaller than the interval is not excluded, a larger effect is.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from math import comb
from pathlib import Path

import numpy as np
from armrig.rig.client import Rig
from armrig_core.telemetry import Sample
from armrig_protocol.messages import Flag
from numpy.typing import NDArray

from tests.benchmarks.recording_daemon import UNRECORDED
from tests.integration.processes import Bench, wait_for

RECORDED = "recorded"
_LATE_US = (20.0, 100.0, 1000.0)
Window = dict[str, float]
"""Numbers of one run, by name."""


def main() -> None:
    """Print the numbers of both, and their differences."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=2.0, help="Of a run; up to 8.")
    parser.add_argument("--pairs", type=int, default=40)
    asked = parser.parse_args()
    late: dict[str, list[NDArray[np.float64]]] = {RECORDED: [], UNRECORDED: []}
    ended = {RECORDED: 0, UNRECORDED: 0}
    found: dict[str, list[Window]] = {RECORDED: [], UNRECORDED: []}
    with tempfile.TemporaryDirectory(prefix="armrig-pauses-") as folder:
        bench = Bench(Path(folder), terminal=True)
        try:
            with _served(bench) as rig:
                for i in range(asked.pairs):
                    order = (RECORDED, UNRECORDED) if i % 2 else (UNRECORDED, RECORDED)
                    pair = {kind: _heard(rig, asked.seconds, kind) for kind in order}
                    for kind, samples in pair.items():
                        ended[kind] += not samples
                    for kind, samples in pair.items() if all(pair.values()) else ():
                        window, late_us = _window(samples)
                        found[kind].append(window)
                        late[kind].append(late_us)
            size = sum(path.stat().st_size for path in bench.recordings.iterdir())
        finally:
            bench.end()
    print(f"load {os.getloadavg()[0]:.1f}, {size / 1e6:.1f} MB recorded")
    for kind, windows in late.items():
        every = np.concatenate(windows)
        p50, p99, p999, most = np.percentile(every, [50, 99, 99.9, 100])
        print(
            f"{kind}: {len(windows)} runs, {every.size} samples, lateness p50 {p50:.1f}, "
            f"p99 {p99:.1f}, p99.9 {p999:.1f}, max {most:.0f} us; ended early: {ended[kind]} more"
        )
    print(f"recorded less unrecorded, {len(found[RECORDED])} pairs: median (95 % interval); and")
    print("the median of the unrecorded")
    for name in found[RECORDED][0]:
        on, off = (np.array([w[name] for w in found[kind]]) for kind in (RECORDED, UNRECORDED))
        low, middle, high = _median_interval(on - off)
        print(f"  {name}: {middle:+.3g} ({low:+.3g} to {high:+.3g}), {np.median(off):.3g}")


def _served(bench: Bench) -> Rig:
    """Start the emulated rig and the daemon that can leave a run unrecorded."""
    bench.configure(watchdog_ms=250, more="tolerates_stalls = true")
    bench.emulate()
    env = {"PYTHONPATH": str(Path(__file__).parents[2])}
    program = "tests.benchmarks.recording_daemon"
    daemon = bench.start(program, "run", "--config", str(bench.config), env=env)
    wait_for(lambda: bench.phase() == "safe" or daemon.popen.poll() is not None)
    if daemon.popen.poll() is not None:
        raise SystemExit(daemon.said)
    return bench.rig()


def _heard(rig: Rig, seconds: float, kind: str) -> list[Sample]:
    """Return each sample of a run; none where the load of the machine ended it."""
    u = np.full(round(seconds * 1000), 2.0)
    with rig.arrivals("sample") as heard:
        try:
            rig.arm("benchmark", Ts=0.001)
            rig.run(u, pacing="exchange", experiment=kind)
        except RuntimeError:
            _patiently(rig.reset)
            return []
        samples: list[Sample] = heard()
    return [s for s in samples if s.flags & Flag.RUN]


def _patiently(action: Callable[[], object]) -> None:
    """Do something that a busy machine may make the daemon refuse for a while."""
    until = time.monotonic() + 10
    while True:
        try:
            action()
        except RuntimeError:
            if time.monotonic() > until:
                raise
            time.sleep(0.2)
        else:
            return


def _window(samples: list[Sample]) -> tuple[Window, NDArray[np.float64]]:
    """Return the numbers of one run, and the lateness of its samples in µs."""
    late_us = np.array([s.t_host_ns - s.t_sched_ns for s in samples]) / 1e3
    p50, p99, most = np.percentile(late_us, [50, 99, 100])
    window = {"p50 [us]": p50, "p99 [us]": p99, "max [us]": most}
    window["mean [us]"] = float(late_us.mean())
    for limit in _LATE_US:
        window[f"later than {limit:g} us [%]"] = 100 * float(np.mean(late_us > limit))
    window["skipped [%]"] = 100 * (1 - len(samples) / (samples[-1].k - samples[0].k + 1))
    return window, late_us


def _median_interval(values: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return the median of independent values between the ends of its 95 % interval.

    Between the values of ranks r and n + 1 - r it lies unless fewer than r of n fall on one of its
    sides, each with probability 1/2.
    """
    n, ordered = values.size, np.sort(values)
    r, below = 0, 0.0
    while (below := below + comb(n, r) / 2**n) <= 0.025:
        r += 1
    r = max(r, 1)
    return float(ordered[r - 1]), float(np.median(values)), float(ordered[n - r])


if __name__ == "__main__":
    main()
