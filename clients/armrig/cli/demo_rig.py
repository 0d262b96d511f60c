"""The demonstration in real time: daemon and emulator run as separate processes.

This module needs zenoh; the demonstration in virtual time does not.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from armrig_core.commands.codes import TRY_AGAIN

from armrig.cli.printing import inform
from armrig.numerics.quantities import plural
from armrig.rig.client import Rig
from armrig.rig.collection import on_the_terminal
from armrig.rig.local_daemon import running
from armrig.rig.replies import BusyError, RefusedError, RunEndedError
from armrig.rig.session import RigError
from armrig.rig.status import scheduling_line

if TYPE_CHECKING:
    from armrig.excitation.demonstration import DemonstrationRun

MAX_ENDED_RUNS = 3
"""If stalls have ended this number of runs of an experiment, the demonstration continues in virtual
time."""
MAX_REAL_TIME_S = 150.0
"""Time in s after which the demonstration changes to virtual time.

The value is for experiments with a total duration of `_USUAL_S`; longer experiments have more time.
"""
_USUAL_S = 63.0
_SAFE_TIMEOUT_S = 30.0


def record_in_real_time(
    plan: Sequence[DemonstrationRun], rig_id: str, config: Path, done: list[Path]
) -> None:
    """Play experiments on an emulated rig; append the recordings to `done`.

    Raises RigError if the daemon does not start or refuses a request, or if the machine stalls too
    often.
    """
    left_s = sum(experiment.seconds for experiment in plan)
    end_s = time.monotonic() + MAX_REAL_TIME_S + max(0.0, left_s - _USUAL_S)
    log = config.with_name("armrigd.log")
    arguments = ["--config", str(config), "--emulate"]
    with running(arguments, rig=rig_id, log=log), Rig(rig_id) as rig:
        wait_until_safe(rig)
        inform(
            f"an emulated rig and its daemon run; {plural(len(plan), 'experiment')} take "
            f"{left_s:.0f} s"
        )
        inform(scheduling_line(rig.status().host))
        for experiment in plan:
            done.append(record_experiment(rig, experiment, end_s - left_s))
            left_s -= experiment.seconds


def record_experiment(rig: Rig, experiment: DemonstrationRun, until_s: float) -> Path:
    """Arm and run an experiment; if a stall of the emulator ends the run, repeat the experiment.

    Raises RigError if stalls have ended `MAX_ENDED_RUNS` runs, or if an attempt fails after
    `until_s` of the monotonic clock.
    """
    ended = 0
    while True:
        wait_until_safe(rig)
        try:
            rig.arm("armrig demo", experiment.Ts)
            with on_the_terminal(rig, experiment.name, experiment.u.size) as progress:
                return rig.run(experiment.u, progress=progress, **experiment.request)
        except (RunEndedError, RefusedError) as err:
            has_tripped = rig.status().phase == "fault"
            has_ended = has_tripped or isinstance(err, RunEndedError)
            if not (has_ended or isinstance(err, BusyError)):
                raise
            ended += has_ended
            why = err.why if isinstance(err, RunEndedError) else str(err)
            if ended >= MAX_ENDED_RUNS or time.monotonic() > until_s:
                raise RigError(why) from err
            inform(f"{experiment.name} again: {why.removesuffix(TRY_AGAIN)}")
            if not has_tripped:
                rig.stop()  # releases a rig that is still armed


def wait_until_safe(rig: Rig) -> None:
    """Wait until the rig can be armed; clear a fault if there is one."""
    until = time.monotonic() + _SAFE_TIMEOUT_S
    while (status := rig.status()).phase != "safe":
        if time.monotonic() > until:
            why = status.reason or status.line or status.phase
            raise RigError(f"the emulated rig is not ready after {_SAFE_TIMEOUT_S:g} s: {why}")
        if status.phase == "fault":
            rig.reset()
        time.sleep(0.05)
