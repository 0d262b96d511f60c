"""Settings of the emulator, read from the table `[emulator]`, and the files of a simulated Uno."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
from armrig_core.errors import FileError, InputError, OperationError
from armrig_core.process.bounded import CONFIGURATION_LIMIT
from armrig_core.process.toml_file import convert, read_toml
from armrig_core.rig.firmware_image import image_path, read_image
from armrig_protocol.messages import QUEUE_CAPACITY, SETPOINTS_PER_FRAME
from msgspec import UNSET, Meta, UnsetType

if TYPE_CHECKING:
    from armrig_core.rig.arm import ArmParameters
    from armrig_core.rig.description import Description

_SensorFault = Literal["stuck", "stuck_when_moving", "low", "high", "reversed"]
HARNESS_VARIABLE = "ARMRIG_FIL"
_PROTOCOL = Path(__file__).parents[3] / "firmware_protocol"  # of a checkout


class EmulatorSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Properties of the emulated rig; the defaults describe the rig of the demonstration."""

    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 1
    """Seed of all noise and of the boot ids."""
    boot_ms: Annotated[float, Meta(ge=0, le=10_000)] = 50.0
    """Time from reset to the first frame, in ms; a real Uno's boot loader takes about 1500."""
    baud: Annotated[int, Meta(ge=9_600, le=4_000_000)] = 500_000
    """Speed of the emulated line, in bit/s."""
    model_baud: bool = True
    """True if `baud` determines the time of bytes on the line; false if bytes take no time."""
    conversion_us: Annotated[float, Meta(ge=12, le=1_000)] = 104.0
    """Time of one conversion, in µs; 104 is 13 clocks of the ATmega328P's ADC at 125 kHz."""
    clock_ppm: Annotated[float, Meta(ge=-500, le=500)] = 0.0
    """Error of the device's oscillator, in ppm: 1 µs of the device lasts 1 + clock_ppm 1e-6 µs.

    The error affects Ts, conversions and the watchdog, but not the bits on the line.
    """
    tolerates_stalls: bool = False
    """True to stop the device's clock while its process is stalled by more than 10 ms.

    The default of `run --emulate` is true. A real device cannot stop its clock.
    """
    pwm_bits: Literal[0, 8, 9, 10, 11, 12, 13, 14, 15, 16] = 10
    """Resolution of the duty, in bits; 0 is unlimited."""
    adc_bits: Literal[0, 10, 12] = 10
    """Resolution of the converter, in bits; 0 is all 16 bits of the code."""
    adc_noise_v: Annotated[float, Meta(ge=0, le=0.5)] = 0.0025
    """Standard deviation of the converter's noise, in V; 0.0025 is half a step of 10 bits."""
    potentiometers: bool = True
    """True for tracks with ends and a dead band; false for ideal sensors of 360° on both joints."""
    theta_1_range_deg: Annotated[float, Meta(ge=180, le=360)] = 352.0
    """Electrical range of theta_1's track, in degrees; the rest of the turn is the dead band."""
    theta_1_zero_deg: Annotated[float, Meta(ge=0, le=360)] = 176.0
    """Position of the wiper on the track at theta_1 = 0, in degrees."""
    alpha_range_deg: Annotated[float, Meta(ge=10, le=3_600)] = 352.0
    """Electrical range of alpha's track, in degrees; the shaft stops at its ends."""
    alpha_zero_deg: Annotated[float, Meta(ge=0, le=3_600)] = 176.0
    """Position of the wiper on the track at alpha = 0, in degrees."""
    theta_1_low_v: Annotated[float, Meta(ge=0, le=2)] = 0.0
    """Wiper's voltage at the beginning of theta_1's track, in V."""
    theta_1_high_v: Annotated[float, Meta(ge=3, le=5)] = 5.0
    """Wiper's voltage at the end of theta_1's track, in V."""
    theta_1_reversed: bool = False
    """True if the wiper moves towards its track's beginning with increasing theta_1."""
    alpha_low_v: Annotated[float, Meta(ge=0, le=2)] = 0.0
    """Wiper's voltage at the beginning of alpha's track, in V."""
    alpha_high_v: Annotated[float, Meta(ge=3, le=5)] = 5.0
    """Wiper's voltage at the end of alpha's track, in V."""
    alpha_reversed: bool = False
    """True if the wiper moves towards its track's beginning with increasing alpha."""
    driver_gain: Annotated[float, Meta(ge=0.5, le=1.5)] = 1.0
    """Terminal voltage per volt of the duty, before `driver_offset_v` is added."""
    driver_offset_v: Annotated[float, Meta(ge=-1, le=1)] = 0.0
    """Voltage added at the terminals if the duty is not 0, in V; the sum stays in 0 to 5 V."""
    queue: Annotated[int, Meta(ge=2 * SETPOINTS_PER_FRAME, le=QUEUE_CAPACITY)] = QUEUE_CAPACITY
    """Capacity of the queue in scheduled mode, in setpoints; an Uno has 256."""
    supply_v: Annotated[float, Meta(ge=2.7, le=5.5)] = 5.0
    """Supply voltage, in V; below 4 V, the device does not drive the motor."""
    brown_out_s: Annotated[float, Meta(ge=0, le=86_400)] = 0.0
    """Time after which the supply drops to 3.5 V, in s; 0 for no drop."""
    arm_removed: bool = False
    """True if the rotating part is removed."""
    coulomb_nm: Annotated[float, Meta(ge=0, le=10)] = 0.0
    """Coulomb friction of the chassis, in Nm; 0 for no friction."""
    stiffening: Annotated[float, Meta(ge=0, le=1_000)] = 0.0
    """Cubic part of the spring, in Nm/rad³; 0 for a linear spring."""
    friction_v: Annotated[float, Meta(ge=0, le=5)] | UnsetType = UNSET
    """Friction, as a voltage: Coulomb friction of the arm in addition to `coulomb_nm` (0.12 V are
    0.02 Nm), or a dead zone around the rest of another rig's input, in V."""
    motor_reversed: bool | UnsetType = UNSET
    """True if the wires of the motor are swapped."""
    loose_arm: Annotated[float, Meta(gt=0, le=1)] | UnsetType = UNSET
    """Share of the spring's stiffness that is left; for the arm only."""
    faulty_sensor: str | UnsetType = UNSET
    """Name of the output with the `sensor_fault`."""
    sensor_fault: _SensorFault | UnsetType = UNSET
    """The sensor sticks at its value, or when its output has moved by 1 % of the range. It reads an
    end of the range, or it falls as its output rises."""
    fault_s: Annotated[float, Meta(ge=0, le=1e6)] | UnsetType = UNSET
    """Time in each run after which `motor_reversed`, `loose_arm` and `sensor_fault` begin, in s.

    At the end of the run the rig is repaired. Without this key, the faults always exist.
    """
    arm: dict[str, float] = {}
    """Parameters of the arm that differ from the handout's, by name; b_1 is viscous friction."""

    def __post_init__(self) -> None:
        """Refuse values that do not fit each other."""
        if self.alpha_zero_deg > self.alpha_range_deg:
            raise InputError(
                f"alpha_zero_deg={self.alpha_zero_deg!r} must be on the track, "
                f"from 0 to alpha_range_deg={self.alpha_range_deg!r}"
            )
        if bool(self.faulty_sensor) != bool(self.sensor_fault):
            raise InputError("faulty_sensor and sensor_fault: give both keys, or neither")
        if self.arm:
            self.arm_parameters()

    @property
    def has_faults(self) -> bool:
        """True if the rig has a fault."""
        return bool(self.friction_v or self.motor_reversed or self.loose_arm or self.faulty_sensor)

    def check_rig(self, description: Description) -> None:
        """Raise InputError if a rig with this description cannot have the faults."""
        rig, sensor = description.rig.name, self.faulty_sensor
        if sensor and sensor not in description.outputs:
            allowed = ", ".join(description.outputs)
            raise InputError(f"faulty_sensor = {sensor!r}: rig {rig} has only {allowed}")
        if self.loose_arm and (not description.arm or description.arm_removed or self.arm_removed):
            raise InputError(f"loose_arm = {self.loose_arm:g}: rig {rig} has no arm: omit the key")

    def arm_parameters(self) -> ArmParameters:
        """Return the handout's parameters, overridden by `arm`."""
        # Imported here: the daemon's configuration contains these settings, and the loop, which
        # reads the configuration, must not load scipy.
        from armrig_core.rig.arm import ArmParameters

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


def in_dead_band(baud: int) -> EmulatorSettings:
    """Return settings with theta_1 in the dead band, to test the guard over the rails.

    With this resistance the motor never turns theta_1 out of the dead band.
    """
    return EmulatorSettings(baud=baud, theta_1_zero_deg=356.0, arm={"R_m": 1e9})


class _EmulatorFile(msgspec.Struct, frozen=True, kw_only=True):
    emulator: EmulatorSettings


def load(path: Path) -> tuple[EmulatorSettings, Path | None]:
    """Return the settings in the table `[emulator]` of a TOML file, and the file in `[rig] file`.

    Other tables are ignored; a missing key has its default, and a missing file is None.

    Raises InputError if the file cannot be read, is not TOML, or contains a key or value that is
    not allowed.
    """
    tables = read_toml(path, CONFIGURATION_LIMIT)
    rig = tables.get("rig")
    file = rig.get("file") if isinstance(rig, dict) else None
    try:
        settings = convert({"emulator": tables.get("emulator", {})}, _EmulatorFile).emulator
    except ValueError as err:
        raise InputError(f"{path}: {err}") from err
    return settings, path.parent / str(file) if file else None


def harness_program(environ: Mapping[str, str], checkout: Path = _PROTOCOL) -> Path:
    """Return the path of the harness: the value of ARMRIG_FIL, or the program in the checkout.

    Raises OperationError if the program does not exist; the message shows how to build it.
    """
    program = Path(environ.get(HARNESS_VARIABLE) or checkout / "simavr" / "fil")
    if not program.is_file():
        raise OperationError(
            f"{program}: no such program; build it in a checkout by `make fil` (Debian's "
            f"libsimavr-dev), or set {HARNESS_VARIABLE} to its path"
        )
    return program


def firmware_image(image: Path | None) -> Path:
    """Return the path of the firmware: `image`, or the shipped firmware of the Uno.

    Raises OperationError if the file does not exist, cannot be read, or is not a complete Intel HEX
    file.
    """
    path = image or image_path()
    if not path.is_file():
        raise OperationError(f"{path}: no such firmware; `make firmware` builds it in a checkout")
    try:
        read_image(path)  # simavr would also run an incomplete file
    except FileError as err:
        raise OperationError(str(err)) from err
    except OSError as err:
        raise OperationError(f"{path}: {err.strerror}") from err
    return path
