"""Draws the figures of docs/experiments.md beside itself, from an emulated rig in virtual time."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from struct import pack
from typing import Any

import armrig
import matplotlib as mpl
import msgspec
import numpy as np
from armrig.excitation.named_signals import realisations
from armrig.plots.layout import save
from armrig_core.commands.codes import COMPLETE
from armrig_core.recording_file.manifest import CALIBRATION, Manifest
from armrig_core.recording_file.recorder import ActiveRecording
from armrig_core.rig.volts import code_of
from armrig_core.telemetry.telemetry import Outgoing, decode_sample
from armrig_daemon.config import Config
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.pipe import Arm, Run, RunStarted
from armrig_daemon.virtual import VirtualRig
from matplotlib.axes import Axes
from numpy.typing import NDArray

mpl.use("Agg")
FOLDER = Path(__file__).parent
LEASE = "a" * 32
REALISATIONS = 4


def record(
    path: Path,
    u: NDArray[np.float64],
    Ts: float,
    experiment: str,
    seed: int = 1,
    *,
    arm_removed: bool = False,
    **about: Any,
) -> Path:
    """Play an input to the demo's emulator, paced by the device, and record it.

    `about` takes the place of fields of the manifest.
    """
    config = Config()
    settings = EmulatorSettings(seed=seed, arm_removed=arm_removed)
    rig = VirtualRig(config.rules(), settings)
    rig.run_until(300_000_000)
    rig.order(Arm(order=1, owner="docs", lease=LEASE, ts_us=round(Ts * 1e6)))
    rig.run_until(400_000_000)
    codes = pack(f"<{u.size}H", *map(code_of, u))
    rig.order(Run(order=2, lease=LEASE, n=0, run_id="r", codes=codes, scheduled=True))
    rig.run_until(1_500_000_000 + round(u.size * Ts * 1e9))
    (started,) = (r for r in rig.records if isinstance(r, RunStarted))
    fields = {
        **{"rig": "1", "run_id": "r", "experiment": experiment, "pacing": "scheduled"},
        **{"Ts": Ts, "samples": u.size, "started": "2026-01-01T00:00:00+00:00"},
        **{"clock_offset_ns": 0, "armrig": "0", "protocol": "2"},
        "device": {"firmware": "emulator", "adc_bits": settings.adc_bits},
    }
    manifest = Manifest(**(fields | about))
    recording = ActiveRecording.create(
        path,
        manifest,
        {CALIBRATION: msgspec.json.encode(config.calibration)},
        t_first_ns=started.t_host_ns,
        changed=threading.Event().set,
    )
    samples = ((data, decode_sample(data)) for data in rig.records if isinstance(data, bytes))
    recording.add(
        [
            Outgoing("sample", s.t_host_ns, s.t_sched_ns, s.k, data)
            for data, s in samples
            if s is not None and 0 <= s.k - started.k_first < u.size
        ]
    )
    recording.finish(COMPLETE)
    recording.join(30)
    return path


def record_all(folder: Path) -> None:
    """Record what the page speaks of, under the names that it gives."""
    record(folder / "first.mcap", armrig.step(5000, at=500), 0.002, "step")
    for seed, name in ((1, "estimation"), (2, "validation")):
        u = armrig.telegraph(3000, 0.05, seed=seed)
        record(folder / f"{name}.mcap", u, 0.01, "blackbox", seed)
    drawn = realisations(2500, REALISATIONS, 0.5, 4.5, 1, periods=5)
    for r, u in enumerate(drawn, 1):
        record(folder / f"bla-{r}.mcap", u, 0.01, "bla", r)


def draw(name: str, size: tuple[float, float], *plots: Callable[[Axes], Any]) -> None:
    """Write one figure with a panel for each plot."""
    from matplotlib import pyplot as plt

    with mpl.rc_context({"font.size": 9}):
        figure, every = plt.subplots(
            1, len(plots), figsize=size, squeeze=False, layout="constrained"
        )
        for plot, ax in zip(plots, every[0], strict=True):
            plot(ax)
        save(figure, FOLDER / name)
        plt.close(figure)


def main() -> None:
    """Draw all of them."""
    with tempfile.TemporaryDirectory() as folder:
        record_all(Path(folder))
        first, data = (
            armrig.load(Path(folder) / f"{name}.mcap").dataset() for name in ("first", "estimation")
        )
        periodic = [
            armrig.load(Path(folder) / f"bla-{r}.mcap").dataset()
            for r in range(1, REALISATIONS + 1)
        ]
    found, choice = armrig.step_analysis(first), armrig.sampling_time(first)
    draw(
        "experiments-sampling.svg",
        (11, 4.4),
        lambda ax: found.plot(ax=ax),
        lambda ax: choice.plot(ax=ax),
    )
    wide = (11, 4.2)
    draw("experiments-data.svg", wide, *(_data(data, kind) for kind in ("time", "spectrum")))
    response, link = armrig.impulse_response(data), armrig.correlation(data)
    draw(
        "experiments-impulse.svg",
        wide,
        lambda ax: response.plot(ax=ax),
        lambda ax: link.plot(ax=ax),
    )
    smooth, best = armrig.spa(data, "log"), armrig.bla(periodic)
    draw(
        "experiments-spectra.svg",
        (11, 4.8),
        lambda ax: smooth.plot(ax=ax),
        lambda ax: best.plot(ax=ax),
    )
    hints = armrig.structure_hints(data)
    draw("experiments-structure.svg", (6, 4.8), lambda ax: hints.plot(ax=ax))


def _data(data: armrig.Dataset, kind: Any) -> Callable[[Axes], Axes]:
    return lambda ax: data.plot(kind, ax=ax)


if __name__ == "__main__":
    main()
