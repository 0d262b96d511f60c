"""Deviation of the emulated rig's true output from the prediction of its closed loop.

For each seed, a rig is recorded in virtual time, identified, and controlled by a law of this model.
The prediction of `armrig.control.compare_loop` is compared with the true output of the emulator,
without the noise of the converter.
`python -m tests.benchmarks.loop_study [seeds] [arm|friction|heater …]` prints a line for
each run: deviation in percent of the step, and overshoot, true and predicted.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any, NamedTuple

import armrig
import msgspec
import numpy as np
from armrig.control.loop_comparison import _rate
from armrig.models.fit import Fit
from armrig_core.commands.commands import ControlRequest, RunRequest
from armrig_core.control.control_law import ControlLaw
from armrig_core.rig.description import Description, builtin, read_description
from armrig_daemon.config import Config, TimingTable
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.service.virtual_service import LEASE, VirtualService
from msgspec.structs import replace
from numpy.typing import NDArray

POLES = (-18 + 18j, -18 - 18j, -42)
FRICTION_V = 0.12


class Case(NamedTuple):
    """A rig, its experiment, and its law."""

    Ts: float
    settings: EmulatorSettings
    description: Description | None
    u: Callable[[int], NDArray[np.float64]]
    fit: Callable[[armrig.Recording], Fit]
    law: Callable[[Fit], ControlLaw]
    reference: tuple[float, float, int]
    """r before and after the step, in the unit of the law, and the samples of each level."""
    true: Callable[[tuple[float, ...]], float]
    """Function of the emulator's state, or of the outputs of own equations, that returns the output
    that follows r, or its angle."""
    is_rate: bool


def _arm(friction_v: float) -> Case:
    orders: dict[str, Any] = {"nb": [[4], [3]], "nf": 3, "shared": "denominator"}
    return Case(
        Ts=0.01,
        settings=EmulatorSettings(friction_v=friction_v) if friction_v else EmulatorSettings(),
        description=None,
        u=lambda seed: armrig.telegraph(3000, 0.1, low=0.5, high=4.5, seed=seed),
        fit=lambda run: armrig.oe(run.signals(), integrator="theta_1", **orders),
        law=lambda fit: armrig.control.place(fit, POLES),
        reference=(2.0, 4.0, 150),
        true=lambda state: state[0],
        is_rate=True,
    )


def _heater() -> Case:
    rig = builtin("tclab")
    hotter = {name: replace(output, high=90.0) for name, output in rig.outputs.items()}
    rig = dataclasses.replace(rig, outputs=hotter)
    assert rig.model is not None
    offset = rig.model.offset[0]

    def law(fit: Fit) -> ControlLaw:
        return armrig.control.pid(fit, time_constant=60, rig=rig)

    return Case(
        Ts=1.0,
        settings=EmulatorSettings(),
        description=rig,
        u=lambda seed: np.repeat(np.random.default_rng(seed).choice([0.3, 1.8], 40), 60),
        fit=lambda run: armrig.process(run.dataset("T1"), "P1D", offset=True),
        law=law,
        reference=(35.0, 50.0, 900),
        true=lambda state: state[0] + offset,
        is_rate=False,
    )


def _tank() -> Case:
    """Return a tank whose outflow is that of a hole: its gain depends on the level."""
    folder = Path(mkdtemp())
    (folder / "tank.py").write_text(TANK_EQUATIONS)
    (folder / "tank.toml").write_text(TANK)
    rig = read_description(folder / "tank.toml")

    def law(fit: Fit) -> ControlLaw:
        # The linear model of the operating point is not that of an empty tank.
        return msgspec.structs.replace(
            armrig.control.pid(fit, time_constant=30, rig=rig), monitor=None
        )

    return Case(
        Ts=1.0,
        settings=EmulatorSettings(),
        description=rig,
        u=lambda seed: np.concatenate(
            [np.ones(600), np.repeat(np.random.default_rng(seed).choice([0.85, 1.15], 40), 60)]
        ),
        fit=lambda run: armrig.oe(run.dataset("level")[600:], nb=1, nf=1, offset=True),
        law=law,
        reference=(15.0, 17.0, 900),
        true=lambda state: state[0],
        is_rate=False,
    )


TANK_EQUATIONS = """
import numpy as np
import armrig

model = armrig.Ode(
    f=lambda t, x, u, p: [0.2 * u[0] - 0.05 * np.sqrt(np.maximum(x[0], 0.0) + 1e-6)],
    output=lambda t, x, u, p: x[0],
    states=["level"],
    parameters={},
)
"""
TANK = """
[rig]
name = "tank"
[input]
name = "pump"
[outputs.level]
unit = "cm"
per_count = 0.001
high = 60
valid_rail = "low"
[model]
file = "tank.py"
"""
CASES = {
    "arm": lambda: _arm(0.0),
    "friction": lambda: _arm(FRICTION_V),
    "heater": _heater,
    "tank": _tank,
}


def study(case: Case, seed: int, folder: Path) -> tuple[float, float, float]:
    """Return the deviation in percent of the step, and the true and the predicted overshoot."""
    config = replace(Config(), timing=replace(TimingTable(), Ts=case.Ts), emulator=case.settings)

    def service() -> VirtualService:
        switch_on = partial(Device, description=case.description)
        return VirtualService(
            config, folder, seed=seed, switch_on=switch_on, description=case.description
        )

    run = RunRequest(lease=LEASE, n=0, u=case.u(seed).tolist(), pacing="exchange")
    fit = case.fit(armrig.load(service().record(run)))
    law = case.law(fit)
    low, high, length = case.reference
    rig, seen = service(), []
    board = rig._rig.ports.device.board
    reading = board.reading

    def watched(channel: int, now_ns: int) -> int:
        counts = reading(channel, now_ns)
        if channel == 0:
            state = board.motion(now_ns)
            has_equations = getattr(board._rig, "_process", None) is not None
            seen.append(case.true(board._rig._y if has_equations else state))
        return counts

    board.reading = watched
    reference = [low] * length + [high] * length
    request = ControlRequest(lease=LEASE, n=0, law=law, reference=reference, unmonitored=True)
    path = rig.record(request)
    recording = armrig.load(path)
    found = armrig.control.compare_loop(recording, fit, draws=0)
    true = _aligned(np.array(seen), recording[recording.first])
    z = _rate(true, case.Ts) if case.is_rate else true
    after = slice(length - 50, None)
    error = (z - found.predicted[0])[after]
    error = error[np.isfinite(error)]

    def overshoot(x: NDArray[np.float64]) -> float:
        return 100 * max(float(np.nanmax(x[length:]) - high) / (high - low), 0.0)

    deviation = 100 * float(np.sqrt(np.mean(error**2))) / (high - low)
    return deviation, overshoot(z), overshoot(found.predicted[0])


def _aligned(seen: NDArray[np.float64], measured: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the true outputs of the samples of a run; readings before and after it are left out.

    The emulator's angle has its turns, and another zero than the measured one.
    """
    shifts = range(seen.size - measured.size + 1)
    parts = [seen[s : s + measured.size] - measured for s in shifts]
    first = int(np.argmin([np.nanstd(part) for part in parts]))
    return seen[first : first + measured.size]


def main() -> None:
    """Print a line for each run, and the largest deviations of each case."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    for name in sys.argv[2:] or CASES:
        rows = []
        for seed in range(1, seeds + 1):
            with TemporaryDirectory() as folder:
                rows.append(study(CASES[name](), seed, Path(folder)))
            print(name, seed, *(f"{x:.2f}" for x in rows[-1]), flush=True)
        deviation, true, predicted = np.array(rows).T
        print(
            f"{name}, n {seeds}: deviation median {np.median(deviation):.2f} %, most "
            f"{deviation.max():.2f} % of the step; overshoot differs by at most "
            f"{np.abs(true - predicted).max():.2f} points"
        )


if __name__ == "__main__":
    main()
