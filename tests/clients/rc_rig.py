"""The rig for 20 € of docs/hardware.md: two RC stages in place of the arm, on an emulated board.

Node 1 (A0) hangs on D9 by 10 kΩ, on 10 µF, and on 100 kΩ to either rail; node 2 (A1) on node 1 by
100 kΩ, and on 1 µF. Everything else is the daemon's own in virtual time: loop, core, recorder.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from armrig.cli.runs import InputChoice, chosen_inputs
from armrig.excitation import step
from armrig.recordings.files.recording_summary import VALIDATION_OF
from armrig_core.commands.commands import Run
from armrig_daemon.config import Config
from armrig_daemon.emulator.board import FULL_SCALE_V, Board, Witness
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.sensors import convert
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.service.virtual_service import LEASE, VirtualService
from msgspec.structs import replace
from numpy.typing import NDArray

Vector = NDArray[np.float64]
R_1, R_2, R_BIAS = 10e3, 100e3, 100e3
C_1, C_2 = 10e-6, 1e-6
A = np.array(
    [
        [-(1 / R_1 + 2 / R_BIAS + 1 / R_2) / C_1, 1 / R_2 / C_1],
        [1 / R_2 / C_2, -1 / R_2 / C_2],
    ]
)
"""In 1/s; the state is the voltage of the two nodes."""
B_U = np.array([1 / R_1 / C_1, 0.0])
B_RAIL = np.array([FULL_SCALE_V / R_BIAS / C_1, 0.0])


class RcBoard(Board):
    """A board with the RC circuit on its pins."""

    def __init__(
        self,
        settings: EmulatorSettings,
        now_ns: int,
        rng: np.random.Generator,
        witness: Witness | None = None,
    ) -> None:
        super().__init__(settings, now_ns, rng, witness)
        self._at_ns = now_ns
        self._v: Vector = np.linalg.solve(-A, B_RAIL)
        self._rates, self._modes = np.linalg.eig(A)
        self._inverse = np.linalg.inv(self._modes)

    def motion(self, now_ns: int) -> Any:
        """Charge the capacitors until now."""
        steady = np.linalg.solve(-A, B_RAIL + B_U * self.volts)
        passed = np.exp(self._rates * (now_ns - self._at_ns) * 1e-9)
        self._v = steady + self._modes @ (passed * (self._inverse @ (self._v - steady)))
        self._at_ns = now_ns
        return (*self._v.tolist(), 0.0, 0.0)

    def reading(self, channel: int, now_ns: int) -> int:
        """Return the reading of a node."""
        volts = self.motion(now_ns)[channel]
        return convert(volts / FULL_SCALE_V, self._adc_bits, self._noise_v, self._rng)


class RcDevice(Device):
    """The emulated device with that board."""

    def __init__(
        self, settings: EmulatorSettings, now_ns: int, witness: Witness | None = None
    ) -> None:
        super().__init__(settings, now_ns, witness)
        noise = np.random.default_rng(settings.seed)
        self._board = self._fw.board = RcBoard(settings, now_ns, noise, witness)


def record_all(folder: Path, config: Config, switch_on: Any = RcDevice) -> list[Path]:
    """Record what `armrig collect step` and `armrig collect blackbox --validation` play."""
    service = VirtualService(_with_ts(config, 0.002), folder, seed=1, switch_on=switch_on)
    up = step(5000, low=0.5, high=4.5, at=500)
    details = {"input": "step", "low": 0.5, "high": 4.5}
    first = service.record(
        Run(lease=LEASE, n=1, u=up.tolist(), experiment="step-first", details=details)
    )
    service = VirtualService(_with_ts(config, 0.01), folder, seed=2, switch_on=switch_on)
    played = chosen_inputs("blackbox", InputChoice(seconds=30.0, validation=True), 0.01)
    files, of = [first], ""
    for one in played:
        details = one.details | ({VALIDATION_OF: of} if one.is_validation else {})
        u = one.make(3000, 0.01).tolist()
        files.append(
            service.record(
                Run(lease=LEASE, n=1, u=u, experiment=f"{one.experiment}-rc", details=details)
            )
        )
        of = files[-1].stem.split("-")[-1]
    return files


def _with_ts(config: Config, Ts: float) -> Config:
    return replace(config, timing=replace(config.timing, Ts=Ts))
