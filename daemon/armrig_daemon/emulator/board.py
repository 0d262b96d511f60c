"""The board: the pin that drives the motor, the converter's inputs, and the rig.

Only this module sets the terminal voltage. It asserts at each change that the voltage is in
[0, 5] V (S1 of ARCHITECTURE.md), independently of the layers above.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import radians, tau
from typing import Any, NamedTuple

import numpy as np
from armrig_core.rig.calibration import CALIBRATED
from armrig_core.rig.description import Description, builtin
from armrig_core.rig.volts import device_code, duty
from armrig_protocol.messages import CODE_FULL_SCALE, FULL_SCALE_MV, Cause, State

from armrig_daemon.emulator import plant
from armrig_daemon.emulator.described_rig import DescribedRig
from armrig_daemon.emulator.faulty_rig import FaultyRig
from armrig_daemon.emulator.sensors import (
    CODE_BITS,
    REFERENCE_V,
    EmulatedPotentiometer,
    convert,
    wiper,
)
from armrig_daemon.emulator.settings import EmulatorSettings

_RUN = State.RUN
FULL_SCALE_V = FULL_SCALE_MV / 1000
BROWN_OUT_MV = 3500


class VoltageError(Exception):
    """The terminal voltage would leave [0, 5] V and destroy the rig (S1)."""


class Change(NamedTuple):
    """A change of the terminal voltage."""

    t_ns: int
    volts: float
    state: State
    """State of the device after the change."""
    cause: Cause


Witness = Callable[[Change], None]


@lru_cache
def pin_code(code: int, pwm_bits: int) -> int:
    """Return the code that the pin applies for `code`."""
    return device_code(code, pwm_bits) if pwm_bits else code


@lru_cache
def volts(code: int, pwm_bits: int) -> float:
    """Return the mean terminal voltage for `code` with an ideal driver."""
    if not pwm_bits:
        return FULL_SCALE_V * code / CODE_FULL_SCALE
    return FULL_SCALE_V * duty(code, pwm_bits) / (1 << pwm_bits)


def driver_volts(volts: float, gain: float, offset_v: float) -> float:
    """Return the output of a driver that is off at `volts` = 0, and saturates at 0 and 5 V."""
    if not volts or (gain == 1.0 and offset_v == 0.0):
        return volts  # an ideal driver does not saturate: a wrong voltage remains visible
    return min(max(gain * volts + offset_v, 0.0), FULL_SCALE_V)


class EmulatedArm:
    """The arm or its first part alone, at rest at first, with its potentiometers."""

    def __init__(self, settings: EmulatorSettings) -> None:
        """Put the arm at rest."""
        arm = settings.arm_parameters()
        friction_nm = (settings.friction_v or 0.0) * arm.torque_per_volt
        self._intact, self._loose = (
            plant.build(
                arm,
                arm_removed=settings.arm_removed,
                coulomb_nm=settings.coulomb_nm + friction_nm,
                stiffening=settings.stiffening,
                spring_share=share,
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


def _potentiometer(settings: EmulatorSettings, name: str, *, wraps: bool) -> EmulatedPotentiometer:
    """Return the sensor of a channel, whose settings begin with the channel's name."""

    def of(key: str) -> Any:
        return getattr(settings, f"{name}_{key}")

    return EmulatedPotentiometer(
        range_rad=radians(of("range_deg")) if settings.potentiometers else tau,
        zero_rad=radians(of("zero_deg")),
        wraps=wraps or not settings.potentiometers,
        low=of("low_v") / REFERENCE_V,
        high=of("high_v") / REFERENCE_V,
        sign=-1.0 if of("reversed") else 1.0,
    )


class Board:
    """The rig that the firmware's pins control; time is an argument and never decreases."""

    def __init__(
        self,
        settings: EmulatorSettings,
        now_ns: int,
        rng: np.random.Generator,
        witness: Witness | None = None,
        description: Description | None = None,
    ) -> None:
        """Put the rig at rest; `rng` is the source of noise, `witness` gets each new voltage."""
        self._rig: EmulatedArm | DescribedRig | FaultyRig
        if description is None or description.arm:
            self._rig = EmulatedArm(settings)
        else:
            self._rig = DescribedRig(description, rng)
        if settings.has_faults:
            self._rig = FaultyRig(self._rig, settings, description or builtin("arm"))
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
        self._volts, self._acting_v = 0.0, self._rig.rest_v
        self.code = 0
        """Code of the motor's voltage; 0 while the pin is off."""

    @property
    def volts(self) -> float:
        """Terminal voltage."""
        return self._volts

    def motion(self, now_ns: int) -> tuple[float, ...]:
        """Return the state of the rig; the arm's are its angles and their rates."""
        if now_ns != self._now_ns:  # equal at each latch, because channel 0 was just read
            self._rig.advance(self._acting_v, now_ns - self._now_ns)
            self._now_ns = now_ns
        return self._rig.state

    def latch(self, now_ns: int, code: int, cause: Cause) -> None:
        """Apply the voltage of `code` from now on; called only in RUN."""
        if not 0 <= code <= CODE_FULL_SCALE:
            raise VoltageError(f"code {code} at the pin: must be from 0 to {CODE_FULL_SCALE}")
        self.code = pin_code(code, self._pwm_bits)
        terminal_v = driver_volts(volts(code, self._pwm_bits), *self._driver)
        self._apply(now_ns, terminal_v, _RUN, cause, enabled=True)

    def release(self, now_ns: int, state: State, cause: Cause) -> None:
        """Set the motor to 0 V: disconnect the pin, and drive the pin and the enable line low."""
        self.code = 0
        self._apply(now_ns, 0.0, state, cause, enabled=False)

    def supply_mv(self, now_ns: int) -> int:
        """Return the supply voltage, in mV."""
        low = self._browns_out and now_ns >= self._brown_out_ns
        return BROWN_OUT_MV if low else self._supply_mv

    def drive(
        self, now_ns: int, share: float, state: State, cause: Cause, *, enabled: bool = True
    ) -> None:
        """Apply the measured duty of a simulated board's pin, a share of the full voltage.

        The duty is known only at the end of its PWM period. If the motion of the rig has already
        been computed beyond `now_ns`, the voltage changes at the end of this motion.
        """
        terminal_v = driver_volts(FULL_SCALE_V * share, *self._driver)
        now_ns = max(now_ns, self._now_ns)
        self._apply(now_ns, terminal_v, state, cause, enabled=enabled)

    def reading(self, channel: int, now_ns: int) -> int:
        """Return the reading of a channel, in counts."""
        self.motion(now_ns)
        return convert(self._rig.wiper(channel), self._adc_bits, self._noise_v, self._rng)

    def _apply(
        self, now_ns: int, terminal_v: float, state: State, cause: Cause, *, enabled: bool
    ) -> None:
        if not 0.0 <= terminal_v <= FULL_SCALE_V:
            raise VoltageError(f"{terminal_v} V at the motor: must be from 0 to {FULL_SCALE_V}")
        if isinstance(self._rig, FaultyRig):
            self.motion(now_ns)
            self._rig.note_drive(is_running=state is _RUN)
        acting_v = terminal_v if enabled else self._rig.rest_v
        if (terminal_v, acting_v) == (self._volts, self._acting_v):
            return
        self.motion(now_ns)
        self._volts, self._acting_v = terminal_v, acting_v
        if self._witness:
            self._witness(Change(now_ns, terminal_v, state, cause))
