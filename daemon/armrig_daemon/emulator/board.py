"""The board: the pin that drives the motor, the converter's inputs, and the arm on them.

Here, and only here, the terminal voltage is made. That it stays in [0, 5] V (S1) is asserted at
each change, in the model of the device, whatever the layers above let through.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import radians, tau
from typing import NamedTuple

import numpy as np
from armrig_core.volts import applied_code, duty
from armrig_protocol.messages import CODE_FULL_SCALE, FULL_SCALE_MV, Cause, State

from armrig_daemon.emulator import plant
from armrig_daemon.emulator.sensors import CODE_BITS, Potentiometer, convert, wiper
from armrig_daemon.emulator.settings import EmulatorSettings

_RUN = State.RUN
FULL_SCALE_V = FULL_SCALE_MV / 1000
BROWN_OUT_MV = 3500


class VoltageError(Exception):
    """The terminal voltage would have left [0, 5] V: the rig would be destroyed (S1)."""


class Change(NamedTuple):
    """The terminal voltage changed."""

    t_ns: int
    volts: float
    state: State
    """State that drives it from now on."""
    cause: Cause


Witness = Callable[[Change], None]


@lru_cache
def reported(code: int, pwm_bits: int) -> int:
    """Return the code of what the pin really gives for `code`."""
    return applied_code(code, pwm_bits) if pwm_bits else code


@lru_cache
def volts(code: int, pwm_bits: int) -> float:
    """Return the mean terminal voltage for `code` behind an ideal driver."""
    if not pwm_bits:
        return FULL_SCALE_V * code / CODE_FULL_SCALE
    return FULL_SCALE_V * duty(code, pwm_bits) / (1 << pwm_bits)


def driven(volts: float, gain: float, offset_v: float) -> float:
    """Return the terminal voltage behind a driver; its supply ends at 0 and 5 V, and 0 V is off."""
    if not volts or (gain == 1.0 and offset_v == 0.0):
        return volts  # an ideal one hides nothing: what is too much is still too much at the motor
    return min(max(gain * volts + offset_v, 0.0), FULL_SCALE_V)


class Board:
    """The rig as the firmware's pins see it; time is given, and never goes back."""

    def __init__(
        self,
        settings: EmulatorSettings,
        now_ns: int,
        rng: np.random.Generator,
        witness: Witness | None = None,
    ) -> None:
        """Start at rest, with the pin low.

        Parameters
        ----------
        rng : numpy.random.Generator
            Noise of the readings.
        witness : callable, optional
            Is told of each change of the voltage.
        """
        self._plant = plant.build(
            settings.arm_parameters(),
            arm_removed=settings.arm_removed,
            coulomb_nm=settings.coulomb_nm,
            stiffening=settings.stiffening,
        )
        self._theta_1, self._alpha = _potentiometers(settings)
        self._adc_bits = settings.adc_bits or CODE_BITS
        self._noise_v = settings.adc_noise_v
        self._pwm_bits = settings.pwm_bits
        self._driver = (settings.driver_gain, settings.driver_offset_v)
        self._rng = rng
        self._witness = witness
        self._now_ns = now_ns
        self._supply_mv = round(settings.supply_v * 1000)
        self._brown_out_ns = now_ns + round(settings.brown_out_s * 1e9)
        self._browns_out = settings.brown_out_s > 0
        self._x = plant.REST
        self._volts = 0.0
        self.code = 0
        """Code of what the motor gets, 0 while the pin is off."""

    @property
    def volts(self) -> float:
        """Terminal voltage."""
        return self._volts

    def motion(self, now_ns: int) -> plant.State:
        """Return where the arm is now, and how fast."""
        if now_ns == self._now_ns:
            return self._x  # as at each latch: theta_1 was held at the same instant
        self._x = plant.advance(self._plant, self._x, self._volts, now_ns - self._now_ns)
        self._now_ns = now_ns
        return self._x

    def latch(self, now_ns: int, code: int, cause: Cause) -> None:
        """Give the motor the voltage of `code` from now on; only RUN does this."""
        if not 0 <= code <= CODE_FULL_SCALE:
            raise VoltageError(f"code {code} at the pin; it must be from 0 to {CODE_FULL_SCALE}")
        self.code = reported(code, self._pwm_bits)
        terminal_v = driven(volts(code, self._pwm_bits), *self._driver)
        self._apply(now_ns, terminal_v, _RUN, cause)

    def release(self, now_ns: int, state: State, cause: Cause) -> None:
        """Disconnect the pin, drive it and the enable line low: 0 V."""
        self.code = 0
        self._apply(now_ns, 0.0, state, cause)

    def supply_mv(self, now_ns: int) -> int:
        """Return the supply, in mV."""
        low = self._browns_out and now_ns >= self._brown_out_ns
        return BROWN_OUT_MV if low else self._supply_mv

    def drive(self, now_ns: int, share: float, state: State, cause: Cause) -> None:
        """Give the motor the share of the full voltage that was measured at a real pin.

        It is known after the period in which it began, when the arm may have moved on: the voltage
        then changes where the arm is.
        """
        terminal_v = driven(FULL_SCALE_V * share, *self._driver)
        self._apply(max(now_ns, self._now_ns), terminal_v, state, cause)

    def theta_1(self, now_ns: int) -> int:
        """Return the reading of theta_1."""
        return self._read(self._theta_1, self.motion(now_ns)[0])

    def alpha(self, now_ns: int) -> int:
        """Return the reading of alpha."""
        return self._read(self._alpha, self.motion(now_ns)[1])

    def _read(self, pot: Potentiometer, angle: float) -> int:
        return convert(wiper(pot, angle), self._adc_bits, self._noise_v, self._rng)

    def _apply(self, now_ns: int, terminal_v: float, state: State, cause: Cause) -> None:
        if not 0.0 <= terminal_v <= FULL_SCALE_V:
            raise VoltageError(f"{terminal_v} V at the motor; it must be from 0 to {FULL_SCALE_V}")
        if terminal_v == self._volts:
            return
        self.motion(now_ns)
        self._volts = terminal_v
        if self._witness:
            self._witness(Change(now_ns, terminal_v, state, cause))


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
            low=settings.theta_1_low_v / FULL_SCALE_V,
            high=settings.theta_1_high_v / FULL_SCALE_V,
            sign=-1.0 if settings.theta_1_reversed else 1.0,
        ),
        Potentiometer(
            range_rad=range_2,
            zero_rad=zero_2,
            wraps=not settings.potentiometers,
            low=settings.alpha_low_v / FULL_SCALE_V,
            high=settings.alpha_high_v / FULL_SCALE_V,
            sign=-1.0 if settings.alpha_reversed else 1.0,
        ),
    )
