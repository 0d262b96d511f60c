"""The emulated arm with its potentiometers."""

from __future__ import annotations

from dataclasses import replace
from math import radians, tau
from typing import Any

from armrig_core.rig.calibration import CALIBRATED

from armrig_daemon.emulator import plant
from armrig_daemon.emulator.sensors import REFERENCE_V, Potentiometer, wiper
from armrig_daemon.emulator.settings import EmulatorSettings


class Arm:
    """The arm or its first part alone, at rest at first, with its potentiometers."""

    def __init__(self, settings: EmulatorSettings) -> None:
        """Put the arm at rest."""
        arm = settings.arm_parameters()
        friction_nm = (settings.friction_v or 0.0) * arm.torque_per_volt
        self._intact, self._loose = (
            plant.build(
                replace(arm, K_lin=arm.K_lin * share),
                arm_removed=settings.arm_removed,
                coulomb_nm=settings.coulomb_nm + friction_nm,
                stiffening=settings.stiffening * share,
            )
            for share in (1.0, settings.loose_arm or 1.0)
        )
        first, second = CALIBRATED
        self._potentiometers = (
            _potentiometer(settings, first, wraps=True),
            _potentiometer(settings, second, wraps=False),
        )
        self.state = plant.REST
        """Angles of the arm and their rates."""
        self.rest_v = 0.0  # as while the driver is off
        self.is_loose = False
        """True while the spring has only the share `loose_arm` of its stiffness."""

    def advance(self, u: float, dt_ns: int) -> None:
        """Move under a constant voltage."""
        now = self._loose if self.is_loose else self._intact
        self.state = plant.advance(now, self.state, u, dt_ns)

    def wiper(self, channel: int) -> float | None:
        """Return the voltage of a wiper as a fraction of the reference; None in the dead band."""
        return wiper(self._potentiometers[channel], self.state[channel])


def _potentiometer(settings: EmulatorSettings, name: str, *, wraps: bool) -> Potentiometer:
    """Return the sensor of a channel, whose settings begin with the channel's name."""

    def of(key: str) -> Any:
        return getattr(settings, f"{name}_{key}")

    return Potentiometer(
        range_rad=radians(of("range_deg")) if settings.potentiometers else tau,
        zero_rad=radians(of("zero_deg")),
        wraps=wraps or not settings.potentiometers,
        low=of("low_v") / REFERENCE_V,
        high=of("high_v") / REFERENCE_V,
        sign=-1.0 if of("reversed") else 1.0,
    )
