"""Does recording hold the loop up? Its lateness at 1 kHz with a recording and without, in turn.

`PYTHONPATH=tests/integration python tests/benchmarks/recording_pauses.py [--seconds 8]`: a run is
played, which is recorded, then a voltage is held by hand, which is not, and so on. Lateness is of
each sample, from when it was due until the host asked for it.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from armrig.rig.client import Rig
from armrig_core.telemetry import Sample
from armrig_protocol.messages import Flag
from processes import Bench

_RENEWED_S = 0.03
_BETWEEN = 500  # samples: a longer break is the one between two rounds


def main() -> None:
    """Print the lateness of both."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=8.0)  # 10 000 samples are kept
    parser.add_argument("--rounds", type=int, default=4)
    asked = parser.parse_args()
    heard: dict[str, list[Sample]] = {"recorded": [], "not recorded": []}
    with tempfile.TemporaryDirectory(prefix="armrig-pauses-") as folder:
        bench = Bench(Path(folder))
        try:
            bench.configure(watchdog_ms=250)
            bench.emulate()
            bench.serve()
            with bench.rig() as rig:
                for _ in range(asked.rounds):
                    heard["recorded"] += _heard(rig, lambda: _play(rig, asked.seconds))
                    heard["not recorded"] += _heard(rig, lambda: _hold(rig, asked.seconds))
        finally:
            bench.end()
    for name, samples in heard.items():
        late_us = np.array([s.t_host_ns - s.t_sched_ns for s in samples]) / 1e3
        steps = np.diff([s.k for s in samples])
        skipped = int((steps[(steps > 0) & (steps < _BETWEEN)] - 1).sum())
        p50, p99, p999, most = np.percentile(late_us, [50, 99, 99.9, 100])
        print(
            f"{name}: {len(samples)} samples, {skipped} skipped; lateness p50 {p50:.1f}, ", end=""
        )
        print(f"p99 {p99:.1f}, p99.9 {p999:.1f}, max {most:.0f} us")


def _heard(rig: Rig, action: Callable[[], None]) -> list[Sample]:
    """Return each sample with the motor driven while something is done."""
    rig.arm("benchmark", Ts=0.001)
    with rig.arrivals("sample") as heard:
        action()
        samples: list[Sample] = heard()
    rig.stop()
    while rig.status().phase != "safe":
        time.sleep(0.05)
    return [s for s in samples if s.flags & Flag.RUN]


def _play(rig: Rig, seconds: float) -> None:
    rig.run(np.full(round(seconds * 1000), 2.0), pacing="exchange", experiment="benchmark")


def _hold(rig: Rig, seconds: float) -> None:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        rig.set(2.0)
        time.sleep(_RENEWED_S)


if __name__ == "__main__":
    main()
