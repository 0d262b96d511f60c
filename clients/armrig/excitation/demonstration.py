"""Experiments of the demonstration: a step and two telegraph signals, for any described rig."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from armrig_core.commands.commands import EVERY
from numpy.typing import NDArray

from armrig.excitation.pace import Pace


class DemonstrationRun(NamedTuple):
    """One run of the demonstration."""

    name: str
    u: NDArray[np.float64]
    """Voltage at each sample of the sampling time, in V."""
    request: dict[str, Any]
    """Other fields of the request to the daemon: kind and details."""
    Ts: float = Pace().Ts
    """Sampling time, in s."""
    every: int = 1
    """Number of samples of the device in a Ts."""

    @property
    def seconds(self) -> float:
        """Length, in s."""
        return self.Ts * self.u.size

    def of_the_device(self) -> dict[str, Any]:
        """Return the request with the voltage at each sample of the device."""
        request = self.request
        if self.every > 1:
            request = {**request, "details": {**request["details"], EVERY: self.every}}
        return {"u": self.u.repeat(self.every).tolist(), **request}


def experiments(pace: Pace, seed: int) -> list[DemonstrationRun]:
    """Return a step, a telegraph signal, and a telegraph signal for validation."""
    levels = {"low": pace.low, "high": pace.high}
    asked = {"experiment": "step", "details": {"input": "step", **levels}}
    plan = [DemonstrationRun("step", pace.step(), asked, pace.Ts, pace.every)]
    for name, number in (("telegraph", seed), ("validation", seed + 1)):
        details = {"input": "telegraph", **levels, "a": pace.switch, "seed": number}
        request = {"experiment": "blackbox", "details": details}
        plan.append(DemonstrationRun(name, pace.telegraph(number), request, pace.Ts, pace.every))
    return plan
