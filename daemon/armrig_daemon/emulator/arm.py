"""The arm with its potentiometers, as the pins of the board meet it."""

from __future__ import annotations

from math import radians, tau

from armrig_daemon.emulator import plant
from armrig_daemon.emulator.sensors import REFERENCE_V, Potentiometer, wiper
from armrig_daemon.emulator.settings import EmulatorSettings


class Arm:
    """The arm, or the chassis alone, at rest at first."""

    def __init__(self, settings: EmulatorSettings) -> None:
        """Put the arm at rest."""
        self._plant = plant.build(
            settings.arm_parameters(),
            arm_removed=settings.arm_removed,
            coulomb_nm=settings.coulomb_nm,
            stiffening=settings.stiffening,
        )
        self._potentiometers = _potentiometers(settings)
        self.state = plant.REST
        """Angles of the arm and their rates."""

    def advance(self, u: float, dt_ns: int) -> None:
        """Move under a constant voltage."""
        self.state = plant.advance(self._plant, self.state, u, dt_ns)

    def wiper(self, channel: int) -> float | None:
        """Return the voltage of a wiper as a fraction of the reference; None in the dead band."""
        return wiper(self._potentiometers[channel], self.state[channel])


def _potentiometers(settings: EmulatorSettings) -> tuple[Potentiometer, Potentiometer]:
    """Return the sensors of theta_1 and of alpha."""
    zero_1, zero_2 = radians(settings.theta_1_zero_deg), radians(settings.alpha_zero_deg)
    range_1, range_2 = radians(settings.theta_1_range_deg), radians(settings.alpha_range_deg)
    if not settings.potentiometers:
        range_1 = range_2 = tau
    return (
        Potentiometer(
            range_rad=range_1,
            zero_rad=zero_1,
            wraps=True,
            low=settings.theta_1_low_v / REFERENCE_V,
            high=settings.theta_1_high_v / REFERENCE_V,
            sign=-1.0 if settings.theta_1_reversed else 1.0,
        ),
        Potentiometer(
            range_rad=range_2,
            zero_rad=zero_2,
            wraps=not settings.potentiometers,
            low=settings.alpha_low_v / REFERENCE_V,
            high=settings.alpha_high_v / REFERENCE_V,
            sign=-1.0 if settings.alpha_reversed else 1.0,
        ),
    )
