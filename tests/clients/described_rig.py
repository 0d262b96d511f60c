"""Recordings of a described rig in virtual time, as `armrig collect` makes them."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from armrig.cli.runs import InputChoice, _ExperimentOptions, plan_runs
from armrig.excitation import step
from armrig.recordings.files.recording_summary import VALIDATION_OF
from armrig_core.commands.commands import RunRequest
from armrig_core.rig.description import Description
from armrig_daemon.config import Config, TimingTable
from armrig_daemon.emulator.device import Device
from armrig_daemon.service.virtual_service import LEASE, VirtualService

Lengths = tuple[float, float]
"""Length of an experiment, and its sampling time, in s."""


def record_all(
    folder: Path,
    described: Description,
    name: str,
    *,
    plant: Description,
    first: Lengths,
    random: Lengths,
) -> list[Path]:
    """Record `collect step --name first` and `collect blackbox --validation --name NAME`.

    The device is that of `plant`, whose model the description need not have.
    """
    switch_on = partial(Device, description=plant)

    def service(Ts: float, seed: int) -> VirtualService:
        timing = Config(timing=TimingTable(Ts=Ts))
        return VirtualService(timing, folder, seed=seed, switch_on=switch_on, description=described)

    seconds, Ts = first
    N = round(seconds / Ts)
    up = step(N, low=0.5, high=4.5, at=round(1 / Ts))
    details = {"input": "step", "low": 0.5, "high": 4.5}
    run = RunRequest(lease=LEASE, n=1, u=up.tolist(), experiment="step-first", details=details)
    files, of = [service(Ts, 1).record(run)], ""
    seconds, Ts = random
    both = service(Ts, 2)
    for one in plan_runs(
        "blackbox", InputChoice(seconds=seconds, validation=True), _ExperimentOptions()
    ):
        u = one.make(round(seconds / Ts), Ts).tolist()
        details = one.details | ({VALIDATION_OF: of} if one.is_validation else {})
        experiment = f"{one.experiment}-{name}"
        files.append(
            both.record(RunRequest(lease=LEASE, n=1, u=u, experiment=experiment, details=details))
        )
        of = files[-1].stem.split("-")[-1]
    return files
