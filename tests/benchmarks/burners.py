"""500 Hz next to two processes that burn both cores, in both modes; draws docs/timing/*.png.

Each figure has the sampling by the device's timer, by the host's pacing, and the delay that a model
finds in each.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import armrig
import matplotlib as mpl
import numpy as np

from tests.integration.processes import Bench, burning

mpl.use("Agg")
Ts, SECONDS = 0.002, 20


def record(bench: Bench, pacing: str) -> armrig.Recording:
    """Play a telegraph and return its recording, also of a failed run."""
    from armrig.rig.replies import RunEndedError

    u = armrig.telegraph(round(SECONDS / Ts), 0.02, low=0.5, high=4.5, seed=1)
    with bench.rig() as rig:
        if rig.status().phase == "fault":
            rig.reset()
        rig.arm("benchmark", Ts=Ts)
        try:
            return armrig.load(rig.run(u, pacing=pacing, experiment=f"burners-{pacing}"))  # type: ignore[arg-type]
        except RunEndedError as err:
            print(f"{pacing}: {err}")
            return armrig.load(err.recording)


def tell(recording: armrig.Recording) -> None:
    """Print the numbers."""
    manifest, samples = recording.manifest, recording.samples
    k = samples["k"].astype(np.int64)
    t = samples["t_device_us"].astype(np.int64)
    apart = np.diff(t)[np.diff(k) == 1] - Ts * 1e6
    applied = np.abs(samples["u_applied_v"] - samples["u_cmd_v"]) < 5 / 1024
    p = np.percentile(np.abs(apart), [50, 99, 99.9])
    print(
        f"{manifest.pacing}: {samples.size} of {manifest.samples} samples, "
        f"{recording.missing} missing, u as commanded in {np.count_nonzero(applied)}; "
        f"|interval - Ts| p50 {p[0]:.0f}, p99 {p[1]:.0f}, p99.9 {p[2]:.0f}, "
        f"max {np.abs(apart).max():.0f} µs"
    )
    data = recording.dataset(output="theta_1")
    losses = {nk: armrig.oe(data, nb=3, nf=4, nk=nk, integrator=True).loss for nk in (1, 2, 3)}
    best = min(losses, key=lambda nk: losses[nk])
    text = ", ".join(f"nk={nk} {loss:.4g}" for nk, loss in losses.items())
    print(f"  OE loss (rad²): {text}: nk = {best}")


def main() -> None:
    """Record, print and draw both modes."""
    from armrig.plots import plot_timing
    from matplotlib import pyplot as plt

    bench = Bench(Path(tempfile.mkdtemp(prefix="armrig-bench-")), terminal=True)
    bench.configure(baud=500_000, watchdog_ms=250)
    try:
        bench.emulate()
        bench.serve()
        with burning(2):
            recordings = [record(bench, pacing) for pacing in ("scheduled", "exchange")]
    finally:
        for process in reversed(bench.processes):
            process.end()
    figure, axes = plt.subplots(
        1, 2, figsize=(9, 3.2), layout="constrained", sharex=True, sharey=True
    )
    for recording, ax in zip(recordings, axes, strict=True):
        tell(recording)
        plot_timing(recording, ax=ax)
        ax.set_title(recording.manifest.pacing, loc="left")
    figure.suptitle(f"{SECONDS} s at {1 / Ts:.0f} Hz beside two burners on two cores")
    if len(sys.argv) > 1:
        figure.savefig(sys.argv[1], dpi=130)


if __name__ == "__main__":
    main()
