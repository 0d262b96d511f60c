"""Plan of the demonstration: its rig and three experiments."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armrig.excitation import step, telegraph

RIG = "demo"
Ts = 0.01
LOW, HIGH, SWITCH = 0.5, 4.5, 0.05
_STEP_S, _STEP_AT_S = 3.0, 0.5
_CONFIG = """\
# Configuration of the demonstration: an emulated rig, sampled at 100 Hz.
[rig]
id = "{rig}"

[device]
watchdog_ms = 250  # the longest: a busy machine stalls the emulator, too

[timing]
Ts = {Ts}

[recording]
directory = "{directory}"

[emulator]
seed = {seed}
"""


class Experiment(NamedTuple):
    """One run of the demonstration."""

    name: str
    u: NDArray[np.float64]
    """Motor voltage at each sample, in V."""
    request: dict[str, Any]
    """Other fields of the request to the daemon: kind and details."""

    @property
    def seconds(self) -> float:
        """Length, in s."""
        return Ts * self.u.size


def experiments(seconds: float, seed: int) -> list[Experiment]:
    """Return a step, a telegraph signal of `seconds`, and a telegraph signal for validation."""
    N = round(seconds / Ts)
    levels = {"low": LOW, "high": HIGH}
    up = step(round(_STEP_S / Ts), **levels, at=round(_STEP_AT_S / Ts))
    plan = [Experiment("step", up, {"experiment": "step", "details": {"input": "step", **levels}})]
    for name, number in (("telegraph", seed), ("validation", seed + 1)):
        details = {"input": "telegraph", **levels, "a": SWITCH, "seed": number}
        u = telegraph(N, SWITCH, LOW, HIGH, seed=number)
        plan.append(Experiment(name, u, {"experiment": "blackbox", "details": details}))
    return plan


def write_config(directory: Path, seed: int) -> Path:
    """Write the configuration of the demonstration's rig, and return its path."""
    path = directory / "armrig.toml"
    text = _CONFIG.format(rig=RIG, Ts=Ts, directory=_toml(directory.absolute()), seed=seed)
    path.write_text(text, encoding="utf-8")
    return path


def _toml(path: Path) -> str:
    return str(path).replace("\\", "\\\\").replace('"', '\\"')
