"""The demonstration in real time: daemon and emulator run as separate processes.

This module needs zenoh; the demonstration in virtual time does not.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from armrig_core.commands.codes import TRY_AGAIN
from rich.console import Console

from armrig.rig.client import Rig
from armrig.rig.collection import bar, timing_note
from armrig.rig.local_daemon import running
from armrig.rig.replies import BusyError, RefusedError, RunEndedError
from armrig.rig.session import RigError
from armrig.rig.status import scheduling_sentences

if TYPE_CHECKING:
    from armrig.cli.demo import Experiment

MAX_ENDED_RUNS = 3
"""If stalls have ended this number of runs, the demonstration continues in virtual time."""
MAX_REAL_TIME_S = 150.0
"""Time in s after which the demonstration changes to virtual time.

The value is for experiments with a total duration of `_USUAL_S`; longer experiments have more time.
"""
_USUAL_S = 63.0
_SAFE_TIMEOUT_S = 30.0


class TooBusyError(RigError):
    """The machine stalls too often for an emulated rig in real time."""


class Patience:
    """Limits on the time and the repetitions of a demonstration in real time."""

    def __init__(self, plan: Sequence[Experiment]) -> None:
        """Start the clock."""
        self._left_s = sum(experiment.seconds for experiment in plan)
        more_s = max(0.0, self._left_s - _USUAL_S)
        self._until_s = time.monotonic() + MAX_REAL_TIME_S + more_s
        self._ended = 0

    def recorded(self, experiment: Experiment) -> None:
        """Reduce the remaining time after an experiment was recorded."""
        self._left_s -= experiment.seconds

    def run_ended(self) -> None:
        """Count a run that a stall ended."""
        self._ended += 1

    @property
    def is_over(self) -> bool:
        """True if another attempt would exceed a limit."""
        return self._ended >= MAX_ENDED_RUNS or time.monotonic() + self._left_s > self._until_s


def record_in_real_time(
    plan: Sequence[Experiment], rig_id: str, config: Path, console: Console, done: list[Path]
) -> None:
    """Play experiments on an emulated rig; append the recordings to `done`.

    If the daemon does not start, or refuses a request, a RigError is raised. If the machine stalls
    too often, it is a TooBusyError.
    """
    patience = Patience(plan)
    log = config.with_name("armrigd.log")
    arguments = ["--config", str(config), "--emulate"]
    with running(arguments, rig=rig_id, log=log), Rig(rig_id) as rig:
        wait_until_safe(rig)
        seconds = sum(experiment.seconds for experiment in plan)
        console.print(
            f"an emulated rig and its daemon run; {len(plan)} experiments take {seconds:.0f} s",
            highlight=False,
        )
        for line in scheduling_sentences(rig.status().host):
            console.print(f"  {line}", highlight=False, markup=False)
        for experiment in plan:
            done.append(recorded(rig, experiment, console, patience))
            patience.recorded(experiment)


def recorded(rig: Rig, experiment: Experiment, console: Console, patience: Patience) -> Path:
    """Arm and run an experiment; if a stall of the emulator ends the run, repeat the experiment."""
    while True:
        wait_until_safe(rig)
        try:
            rig.arm("armrig demo", experiment.Ts)
            with (
                timing_note(rig, experiment.u.size) as note,
                bar(experiment.name, console, note=note) as progress,
            ):
                return rig.run(experiment.u, progress=progress, **experiment.request)
        except (RunEndedError, RefusedError) as err:
            has_tripped = rig.status().phase == "fault"
            has_ended = has_tripped or isinstance(err, RunEndedError)
            if not (has_ended or isinstance(err, BusyError)):
                raise
            if has_ended:
                patience.run_ended()
            why = err.why if isinstance(err, RunEndedError) else str(err)
            if patience.is_over:
                raise TooBusyError(why) from err
            again = f"  {experiment.name} again: {why.removesuffix(TRY_AGAIN)}"
            console.print(again, highlight=False, markup=False, soft_wrap=True)
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
