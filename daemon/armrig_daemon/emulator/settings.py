"""Settings of the emulator: the table `[emulator]` of a TOML, checked key by key."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from armrig_core.bounded import CONFIGURATION_LIMIT
from armrig_core.errors import InputError
from armrig_core.toml_file import read_toml
from armrig_protocol.messages import QUEUE_CAPACITY, SETPOINTS_PER_FRAME

from armrig_daemon.tables import convert

if TYPE_CHECKING:
    from armrig_core.arm import ArmParameters

# Allowed range of each number, both ends included.
RANGES: dict[str, tuple[float, float]] = {
    "seed": (0, 2**63 - 1),
    "boot_ms": (0, 10_000),
    "baud": (9_600, 4_000_000),
    "conversion_us": (12, 1_000),
    "clock_ppm": (-500, 500),
    "adc_noise_v": (0, 0.5),
    "coulomb_nm": (0, 10),
    "stiffening": (0, 1_000),
    "theta_1_range_deg": (180, 360),
    "theta_1_zero_deg": (0, 360),
    "alpha_range_deg": (10, 3_600),
    "alpha_zero_deg": (0, 3_600),
    "theta_1_low_v": (0, 2),
    "theta_1_high_v": (3, 5),
    "alpha_low_v": (0, 2),
    "alpha_high_v": (3, 5),
    "driver_gain": (0.5, 1.5),
    "driver_offset_v": (-1, 1),
    "queue": (2 * SETPOINTS_PER_FRAME, QUEUE_CAPACITY),
    "supply_v": (2.7, 5.5),
    "brown_out_s": (0, 86_400),
}
CHOICES: dict[str, tuple[int, ...]] = {
    "pwm_bits": (0, 8, 9, 10, 11, 12, 13, 14, 15, 16),
    "adc_bits": (0, 10, 12),
}


class EmulatorSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the emulated rig is like; the defaults are the demo's."""

    seed: int = 1
    """Seed of all noise and of the boot ids."""
    boot_ms: float = 50.0
    """From reset to the first frame, in ms; a real Uno's boot loader takes about 1500."""
    baud: int = 500_000
    """Speed of the emulated wire, in bit/s."""
    model_baud: bool = True
    """Bytes take their time on the wire."""
    conversion_us: float = 104.0
    """One conversion, in µs: 13 clocks of the ATmega328P's ADC at 125 kHz."""
    clock_ppm: float = 0.0
    """How slow the device's oscillator is, in parts per million: its µs last 1 + clock_ppm 1e-6 µs.

    So does whatever it times by itself: Ts, conversions, the watchdog; not the bits on the wire.
    """
    tolerates_stalls: bool = False
    """The device's clock stops while its process is stalled by more than 10 ms.

    Where nobody says it, that of `run --emulate` does so. A real device cannot.
    """
    pwm_bits: int = 10
    """Resolution of the duty; 0 is none."""
    adc_bits: int = 10
    """Resolution of the converter; 0 is all 16 bits of the code."""
    adc_noise_v: float = 0.0025
    """Standard deviation of the converter's noise, in V; 0.0025 is half a step of 10 bits."""
    potentiometers: bool = True
    """Tracks with ends and a dead band; off is an ideal sensor of 360° on both joints."""
    theta_1_range_deg: float = 352.0
    """Electrical range of theta_1's track, in degrees; the rest of the turn is dead."""
    theta_1_zero_deg: float = 176.0
    """Wiper's place on the track at theta_1 = 0, in degrees."""
    alpha_range_deg: float = 352.0
    """Electrical range of alpha's track, in degrees; it does not turn on."""
    alpha_zero_deg: float = 176.0
    """Wiper's place on the track at alpha = 0, in degrees."""
    theta_1_low_v: float = 0.0
    """Wiper's voltage at the beginning of theta_1's track, in V."""
    theta_1_high_v: float = 5.0
    """Wiper's voltage at the end of theta_1's track, in V."""
    theta_1_reversed: bool = False
    """The wiper goes towards its track's beginning when theta_1 grows."""
    alpha_low_v: float = 0.0
    """Wiper's voltage at the beginning of alpha's track, in V."""
    alpha_high_v: float = 5.0
    """Wiper's voltage at the end of alpha's track, in V."""
    alpha_reversed: bool = False
    """The wiper goes towards its track's beginning when alpha grows."""
    driver_gain: float = 1.0
    """Terminal volts for one volt of the duty."""
    driver_offset_v: float = 0.0
    """Terminal voltage that comes on top of it where the duty is not 0; within 0 to 5 V."""
    queue: int = QUEUE_CAPACITY
    """Setpoints that it holds in scheduled mode; an Uno has room for 256."""
    supply_v: float = 5.0
    """Its supply, in V; below 4 V it does not drive the motor."""
    brown_out_s: float = 0.0
    """Time after which its supply is 3.5 V, in s; 0 is never."""
    arm_removed: bool = False
    """The rotating part is taken off."""
    coulomb_nm: float = 0.0
    """Coulomb friction of the chassis, in Nm; 0 is none."""
    stiffening: float = 0.0
    """Cubic part of the spring, in Nm/rad³; 0 is none."""
    arm: dict[str, float] = {}
    """Parameters of the arm that differ from the handout's, by name; b_1 is viscous friction."""

    def __post_init__(self) -> None:
        """Refuse a value out of its range."""
        for key, (least, greatest) in RANGES.items():
            value = getattr(self, key)
            if not least <= value <= greatest:
                raise InputError(f"{key}={value!r} must be from {least} to {greatest}")
        for key, choices in CHOICES.items():
            if getattr(self, key) not in choices:
                allowed = ", ".join(map(str, choices))
                raise InputError(f"{key}={getattr(self, key)!r} must be one of {allowed}")
        if self.alpha_zero_deg > self.alpha_range_deg:
            raise InputError(
                f"alpha_zero_deg={self.alpha_zero_deg!r} must lie on the track, "
                f"from 0 to alpha_range_deg={self.alpha_range_deg!r}"
            )
        if self.arm:
            self.arm_parameters()

    def arm_parameters(self) -> ArmParameters:
        """Return the handout's parameters with those of `arm` in their place."""
        # Here, not above: the daemon's configuration holds these settings, and its loop, which
        # reads it, must not load scipy for an arm that it does not know.
        from armrig_core.arm import ArmParameters

        allowed = ArmParameters.__dataclass_fields__
        for key in self.arm:
            if key not in allowed:
                raise InputError(
                    f"arm.{key}={self.arm[key]!r}: no such key; allowed are {', '.join(allowed)}"
                )
        try:
            return ArmParameters(**self.arm)
        except ValueError as err:
            raise InputError(f"arm.{err}") from err


class _File(msgspec.Struct, frozen=True, kw_only=True):
    emulator: EmulatorSettings


def load(path: Path) -> EmulatorSettings:
    """Return the settings in the table `[emulator]` of the TOML at `path`.

    Other tables are ignored; a key that is left out has its default.

    Raises
    ------
    InputError
        The file cannot be read, is no TOML, or holds a key or value that is not allowed.
    """
    try:
        tables = read_toml(path, CONFIGURATION_LIMIT)
        return convert({"emulator": tables.get("emulator", {})}, _File).emulator
    except OSError as err:
        raise InputError(f"{path}: {err.strerror}") from err
    except ValueError as err:
        raise InputError(f"{path}: {err}") from err
