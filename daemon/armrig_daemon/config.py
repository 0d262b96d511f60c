"""The daemon's configuration: layers of TOML, with a check of each key.

Each layer overrides the layers after it in this list: command line, `ARMRIG_<TABLE>_<KEY>`,
`$XDG_CONFIG_HOME/armrig/armrig.toml`, `/etc/armrig/<id>.toml`, `/etc/armrig/armrig.toml`. A file
named on the command line replaces all these files.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import replace
from math import isfinite, tau
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
from armrig_core.access.client_settings import ClientSettings
from armrig_core.access.emulator_socket import socket_path
from armrig_core.access.endpoint import check_listen, network_address, resolve_paths
from armrig_core.commands.commands import OutputRange
from armrig_core.errors import FileError, InputError
from armrig_core.process.bounded import CONFIGURATION_LIMIT, read_text
from armrig_core.process.printable import printable
from armrig_core.process.toml_file import TomlTable, convert, toml_tables
from armrig_core.recording_file.recording_directory import SYSTEM, configuration_files, of_rig
from armrig_core.rig.calibration import Calibration
from armrig_core.rig.calibration_file import tables_of
from armrig_core.rig.channels import DeviceChannel
from armrig_core.rig.description import (
    BLIND_S,
    Description,
    Output,
    Turns,
    builtin,
    check_turns,
    path_of,
    read_description,
)
from armrig_core.rig.emulated import is_emulated
from armrig_core.rig.firmware_image import IMAGES, image_crcs
from armrig_core.rig.volts import U_MAX_V, code_of
from armrig_core.telemetry.topics import check_own_id
from armrig_protocol.messages import (
    CODE_FULL_SCALE,
    WATCHDOG_DEFAULT_MS,
    WATCHDOG_MAX_MS,
    WATCHDOG_MIN_MS,
)
from msgspec import UNSET, Meta, UnsetType

from armrig_daemon.decisions.budget import check
from armrig_daemon.decisions.output_limits import too_slow
from armrig_daemon.decisions.state import Image, OutputLimit, Rules
from armrig_daemon.emulator.layout import LAYOUTS
from armrig_daemon.emulator.settings import HARNESS_VARIABLE as HARNESS
from armrig_daemon.emulator.settings import EmulatorSettings

if TYPE_CHECKING:
    import numpy as np
    from armrig_core.commands.commands import Rehearsal
    from armrig_core.control.control_law import ControlLaw
    from armrig_core.control.evaluation import Latch
    from armrig_core.rig.arm import ArmParameters
    from numpy.typing import NDArray

    Vector = NDArray[np.float64]

EX_CONFIG = 78
"""Exit code of a failed start if a person must correct the cause (sysexits.h)."""
# Variables of the tests and of the simulated Uno, which are not keys of the configuration.
_OTHER_VARIABLES = {"ARMRIG_REQUIRE_ALL", "ARMRIG_REFERENCE_DATA", HARNESS}

Volts = Annotated[float, Meta(ge=0, le=U_MAX_V)]


class RigIdentity(TomlTable, frozen=True, kw_only=True):
    """`[rig]`: the identity of the rig."""

    id: str = "1"
    """Name of the rig in keys, topics and files, of a-z, 0-9 and -."""
    file: str | UnsetType = UNSET
    """File that describes the rig, or a name of `armrig rigs`.

    A path is relative to the folder of the configuration file. The default is the description of
    the arm.
    """

    def __post_init__(self) -> None:
        """Refuse a name that zenoh does not allow in a key, or that `armrig play` uses."""
        check_own_id(self.id)


class DeviceTable(TomlTable, frozen=True, kw_only=True):
    """`[device]`: the line to the rig's device."""

    port: str = "/dev/armrig"
    """Serial port of the rig, or `unix:PATH`, the socket of an emulated rig."""
    baud: Annotated[int, Meta(ge=9600, le=4_000_000)] = 500_000
    """Speed of the line, in bit/s."""
    watchdog_ms: Annotated[int, Meta(ge=WATCHDOG_MIN_MS, le=WATCHDOG_MAX_MS)] = WATCHDOG_DEFAULT_MS
    """Time without a frame after which the device stops the motor by itself, in ms.

    `run --emulate` has the largest allowed value as its default.
    """
    oversampling: Annotated[int, Meta(ge=1, le=255)] = 1
    """Number of conversions averaged in a reading of a channel; all must fit into Ts."""
    rail_ticks: Annotated[int, Meta(ge=0, le=65535)] = 0
    """Number of consecutive samples at a rail that stop a run; 0 is no guard."""

    def __post_init__(self) -> None:
        """Refuse an unprintable port, and a wrong path of a socket."""
        if not self.port.isprintable():
            raise InputError(f"port = '{printable(self.port)}' must have only printable characters")
        socket_path(self.port)


class TimingTable(TomlTable, frozen=True, kw_only=True):
    """`[timing]`: the sampling time, and the scheduling of the loop."""

    Ts: Annotated[float, Meta(ge=0.0005, le=1)] = 0.01
    """Default sampling time of experiments, in s; a whole number of µs."""
    priority: Annotated[int, Meta(ge=0, le=95)] = 80
    """SCHED_FIFO priority of the loop; 0 is the ordinary policy."""
    cpu: Annotated[int, Meta(ge=0)] | None = None
    """Processor core of the loop; without this key, the system chooses."""
    stop_after: Annotated[int, Meta(ge=0, le=1_000_000)] = 0
    """Number of consecutive missed ticks after which the motor is stopped; 0 is no limit."""
    spin_us: Annotated[float, Meta(ge=0, le=500)] = 120
    """Time for which the loop spins before a deadline, in µs; only under SCHED_FIFO."""

    def __post_init__(self) -> None:
        """Refuse a sampling time that is not a whole number of µs."""
        if round(self.Ts * 1e6, 3) % 1:
            raise InputError(f"Ts = {self.Ts} must be a whole number of microseconds")


class Limits(TomlTable, frozen=True, kw_only=True):
    """`[limits]`: limits of voltage and motion; they can only narrow the limits of the rig."""

    u_min_v: Volts = 0.0
    """Lowest motor voltage that a command may contain, in V."""
    u_max_v: Volts = U_MAX_V
    """Highest motor voltage that a command may contain, in V; default: as the rig's description."""
    slew_v: Volts = 0.0
    """Largest change of the voltage from sample to sample, in V; 0 is no limit."""
    revolutions: Turns = 0.0
    """Largest rotation of the chassis in one run, in turns, in steps of 0.01; 0 adds no limit."""
    alpha_rad: Annotated[float, Meta(ge=0, le=100)] = 0.0
    """Largest deflection of the arm in a run and its rehearsal, in rad; 0 adds no limit."""

    def __post_init__(self) -> None:
        """Refuse an empty range of voltages, and turns with more than two decimals."""
        check_turns("revolutions", self.revolutions)
        if self.u_min_v > self.u_max_v:
            raise InputError(f"u_min_v = {self.u_min_v} must not be above u_max_v = {self.u_max_v}")


_Parameter = Annotated[float, Meta(gt=0, le=1e6)] | None


class ArmSettings(TomlTable, frozen=True, kw_only=True):
    """`[arm]`: the model on which runs are rehearsed; the defaults are the handout's values."""

    J_1: _Parameter = None
    """Inertia of motor, gear and chassis, seen at the chassis, in kg m²."""
    J_2: _Parameter = None
    """Inertia of the arm, in kg m²."""
    N: _Parameter = None
    """Gear ratio."""
    K_lin: _Parameter = None
    """Stiffness of the two springs together, in Nm/rad."""
    R_m: _Parameter = None
    """Resistance of the armature, in Ω."""
    K_m: _Parameter = None
    """Torque constant, in Nm/A, and back-EMF constant, in Vs/rad."""
    b_1: Annotated[float, Meta(ge=0, le=1e6)] | None = None
    """Viscous friction of the chassis, in Nms/rad."""
    removed: bool = False
    """True if the rotating part is removed: the chassis turns alone, and alpha is ignored."""

    @property
    def turns_per_volt_s(self) -> float:
        """Steady speed of the chassis at a constant voltage of 1 V, in turns/s."""
        p = self.parameters()
        return p.torque_per_volt / p.damping / tau

    def parameters(self) -> ArmParameters:
        """Return the parameters of the rig."""
        # Imported here: the emulator and the command line read configurations without scipy.
        from armrig_core.rig.arm import ArmParameters

        settings = msgspec.structs.asdict(self)
        del settings["removed"]
        return ArmParameters(**{key: value for key, value in settings.items() if value is not None})


class RecordingTable(TomlTable, frozen=True, kw_only=True):
    """`[recording]`: the recordings of runs."""

    directory: str = ""
    """Folder of the recordings; default: armrig/recordings in $XDG_DATA_HOME (~/.local/share)."""
    part_minutes: Annotated[float, Meta(ge=0, le=1e6)] = 60.0
    """Longest file, in minutes; a longer run is recorded in several files; 0 is no limit."""
    keep_days: Annotated[float, Meta(ge=0, le=1e5)] = 0.0
    """Age at which a complete recording of this rig is removed, in days; 0 keeps all."""
    keep_gb: Annotated[float, Meta(ge=0, le=1e6)] = 0.0
    """Largest size of this rig's recordings, in GB; the oldest runs are removed; 0 is no limit."""


class Access(TomlTable, frozen=True, kw_only=True):
    """`[access]`: network access; without this table, clients connect only by the Unix socket."""

    listen: str = ""
    """Endpoint for clients, in addition to the Unix socket, such as tls/0.0.0.0:7447."""
    certificate: str = ""
    """File with the rig's key and certificates for tls/ or a router, from `armrig pki rig`."""
    names: str = ""
    """File with the access list from `armrig pki`: the clients that may drive or watch."""
    router: str = ""
    """Endpoint of the laboratory's router, such as tls/lab.example.edu:7447; default: no router."""

    def __post_init__(self) -> None:
        """Refuse endpoints without TLS."""
        if self.listen:
            check_listen(self.listen)
        if self.router and not (self.router.startswith("tls/") and network_address(self.router)):
            raise InputError(
                f"router = {self.router!r} must be tls/HOST:PORT, such as tls/lab.local:7447"
            )


class Config(TomlTable, frozen=True, kw_only=True):
    """The whole configuration."""

    rig: RigIdentity = RigIdentity()
    device: DeviceTable = DeviceTable()
    timing: TimingTable = TimingTable()
    limits: Limits = Limits()
    arm: ArmSettings = ArmSettings()
    recording: RecordingTable = RecordingTable()
    access: Access = Access()
    client: ClientSettings = ClientSettings()
    calibration: Calibration = Calibration()
    """`[calibration]`: conversion of readings to angles and of codes to volts, by file or keys."""
    emulator: EmulatorSettings = EmulatorSettings()

    @property
    def calibration_sentence(self) -> str:
        """Return a text: file and date of the calibration, or that it was not measured."""
        made = self.calibration.made
        if made is not None:
            return f"{made.file or 'given in the configuration'}, made {made.date}"
        if self.calibration == Calibration():
            return "none: the default values; `armrig calibrate` measures a calibration"
        return "given in the configuration, not measured"

    @property
    def calibration_sha256(self) -> str:
        """Return the SHA-256 of the calibration's JSON text, as attached to recordings."""
        return hashlib.sha256(msgspec.json.encode(self.calibration)).hexdigest()

    @property
    def ts_us(self) -> int:
        """Sampling time in µs."""
        return round(self.timing.Ts * 1e6)

    def channels(self, description: Description) -> tuple[DeviceChannel, ...]:
        """Return the channels of the rig that are read, without those of a removed part."""
        if not description.is_calibrated:
            return description.channels
        calibrated = zip(description.channels, self.calibration.channels, strict=True)
        channels = tuple(channel._replace(turns=meter.wraps) for channel, meter in calibrated)
        return channels[:1] if self.arm.removed else channels

    def rehearsal(
        self, u: Vector, Ts: float, description: Description, start_rad: float | None
    ) -> Rehearsal | None:
        """Return the response of the rig's model to a run; None for a rig without a model.

        `start_rad` is the angle of the turning shaft of an arm. Raises InputError if the response
        is outside the limits.
        """
        # Imported here: the emulator and the command line read configurations without numpy.
        from armrig_core.commands.rehearsal import rehearse_outputs

        if description.model is None:
            return None
        return rehearse_outputs(
            u,
            Ts,
            self.narrow_description(description),
            parameters=self.arm.parameters() if description.arm else None,
            arm_removed=self.arm.removed or description.arm_removed,
            start_rad=start_rad,
        )

    def control_rehearsal(
        self,
        law: ControlLaw,
        reference: Vector,
        description: Description,
        start_rad: float | None,
        *,
        unstable: bool,
    ) -> Rehearsal | None:
        """Return the response of the rig's model under a law; None for a rig without a model.

        `start_rad` is the angle of the turning shaft of an arm. Raises InputError if the response
        is outside the limits, or the closed loop is unstable without being permitted to be so.
        """
        from armrig_core.commands.control_rehearsal import rehearse_control

        if description.model is None:
            return None
        return rehearse_control(
            law,
            reference,
            self.narrow_description(description),
            parameters=self.arm.parameters() if description.arm else None,
            arm_removed=self.arm.removed or description.arm_removed,
            start_rad=start_rad,
            latch=self._latch(description),
            unstable=unstable,
        )

    def _latch(self, description: Description) -> Latch:
        """Return the limits of the codes, and their resolution on the rig's board."""
        from armrig_core.control.evaluation import Latch

        rules, bits = self.rules(description), LAYOUTS[description.rig.image].pwm_bits
        return Latch(rules.rest_code, bits, rules.code_min, rules.code_max, rules.slew)

    def narrow_description(self, description: Description) -> Description:
        """Return the description with the limits of `[limits]`, which narrow those of its outputs.

        Raises InputError if the rig has no output with such a limit.
        """
        limits, outputs = self.limits, dict(description.outputs)
        first, *others = outputs
        if limits.revolutions:
            _require_limit("revolutions", description, fits=outputs[first].turning)
            turns = min(filter(None, (limits.revolutions, outputs[first].turns)))
            outputs[first] = msgspec.structs.replace(outputs[first], turns=turns)
        if limits.alpha_rad and not (self.arm.removed or description.arm_removed):
            _require_limit("alpha_rad", description, fits=description.is_calibrated)
            (second,), most = others, limits.alpha_rad
            low, high = max(outputs[second].low, -most), min(outputs[second].high, most)
            try:
                outputs[second] = msgspec.structs.replace(outputs[second], low=low, high=high)
            except InputError as err:
                raise InputError(f"limits.alpha_rad = {most:g}: {err}") from err
        return replace(description, outputs=outputs)

    def check_limits(self, description: Description, sources: Mapping[str, str]) -> None:
        """Refuse a key of `[limits]` that is wider than the same limit of the description.

        `sources` names the file, or another source, of each key that was given. A key that was not
        given, or is 0 where 0 adds no limit, leaves the description's limit in force.

        Raises InputError.
        """
        first, *others = description.outputs.values()
        widest = [("u_max_v", description.input.u_max_v, "input.u_max_v")]
        if first.turns:
            widest.append(
                ("revolutions", first.turns, f"turns of {next(iter(description.outputs))}")
            )
        if description.is_calibrated and not (self.arm.removed or description.arm_removed):
            largest = max(-others[0].low, others[0].high)
            widest.append(("alpha_rad", largest, "low and high of alpha"))
        rest_v, limits = description.input.rest_v, self.limits
        if rest_v and not limits.u_min_v <= rest_v <= limits.u_max_v:
            raise InputError(
                f"limits.u_min_v = {limits.u_min_v:g}, u_max_v = {limits.u_max_v:g}: rig "
                f"{description.rig.name} rests at {rest_v:g} V, which the limits must allow"
            )
        for key, most, name in widest:
            value = getattr(self.limits, key)
            if key in sources and value > most:
                raise InputError(
                    f"{sources[key]}: limits.{key} = {value:g}: expected at most {most:g}, as "
                    f"{name} in the description of rig {description.rig.name}; [limits] can only "
                    "narrow the description: give a smaller value, or leave the key out"
                )

    def ranges(self, description: Description) -> dict[str, OutputRange]:
        """Return the limits of the outputs that are read and have a limit, for the status."""
        rig = self.narrow_description(description)
        outputs = {channel.name: rig.outputs[channel.name] for channel in self.channels(rig)}
        return {
            name: OutputRange(
                low=output.low if isfinite(output.low) else None,
                high=output.high if isfinite(output.high) else None,
                turns=output.turns,
            )
            for name, output in outputs.items()
            if output.turns or isfinite(output.low) or isfinite(output.high)
        }

    def rules(self, description: Description | None = None) -> Rules:
        """Return the limits and constants that the core needs; default: the arm's description."""
        limits, rig = self.limits, self.narrow_description(description or builtin("arm"))
        read = {channel.name: rig.outputs[channel.name] for channel in self.channels(rig)}
        # CONFIG has one number for both channels, so the core counts beside a valid rail.
        rail_ticks = self.device.rail_ticks
        in_core = rail_ticks if any(output.valid_rail for output in read.values()) else 0
        return Rules(
            code_min=code_of(limits.u_min_v),
            code_max=code_of(limits.u_max_v),
            rest_code=code_of(rig.input.rest_v),
            # One code more, because a step of exactly the limit may round up.
            slew=min(code_of(limits.slew_v) + 1, CODE_FULL_SCALE) if limits.slew_v else 0,
            ts_us=self.ts_us,
            watchdog_ms=self.device.watchdog_ms,
            baud=self.device.baud,
            stop_after=self.timing.stop_after,
            turns=round(next(iter(read.values())).turns * 100),
            rail_ticks=rail_ticks - in_core,
            oversampling=self.device.oversampling,
            calibration=msgspec.structs.replace(self.calibration, made=None),
            described=UNSET if rig.is_calibrated else rig.conversions,
            is_emulated=is_emulated(uid="", port=self.device.port),
            image=image_of(rig),
            limits=output_limits(read, in_core),
        )


def _require_limit(key: str, description: Description, *, fits: bool) -> None:
    if not fits:
        raise InputError(
            f"limits.{key} is for the arm: give rig {description.rig.name} limits by low, high or "
            "turns of its outputs in its description"
        )


def image_of(description: Description) -> Image | UnsetType:
    """Return the image of the rig's firmware, as the core needs it; UNSET for the arm."""
    name = description.rig.image
    if name != IMAGES[0]:
        return Image(name, image_crcs()[name])
    if description.is_calibrated:
        return UNSET  # its traces keep their bytes, and no shield's image drives its motor
    return Image(name, 0, tuple(crc for other, crc in image_crcs().items() if other != name))


def output_limits(
    outputs: Mapping[str, Output], rail_samples: int = 0
) -> tuple[OutputLimit, ...] | UnsetType:
    """Return the limits of a rig's measured outputs, as the core needs them.

    `rail_samples` is the number of samples at a rail that stop a run, if the core counts them.
    """
    limits = tuple(
        OutputLimit(
            channel,
            name,
            output.unit,
            output.low if isfinite(output.low) else None,
            output.high if isfinite(output.high) else None,
            output.samples,
            round((BLIND_S if output.default_blind else output.blind_s or 0.0) * 1e9),
            output.default_blind,
            output.sides_of_rails,
            rail_samples,
        )
        for channel, (name, output) in enumerate(outputs.items())
        if output.limited or rail_samples
    )
    return limits or UNSET


def description_of(config: Config) -> Description:
    """Return the description of the rig: that of `[rig] file`, or the arm's.

    Raises InputError if the file cannot be read, or describes no allowed rig.
    """
    if not config.rig.file:
        return builtin("arm")
    try:
        return read_description(Path(config.rig.file))
    except FileError as err:
        raise InputError(f"[rig] file: {err}") from err


def load(
    paths: list[Path],
    environ: Mapping[str, str],
    overrides: Mapping[str, Mapping[str, Any]],
    *,
    below: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> Config:
    """Return the configuration from defaults, files, environment and command line.

    A value of a later source overrides the value of an earlier source. All TOML files in `paths`
    must exist. Only variables of `environ` that begin with `ARMRIG_` are read. `overrides` are the
    values of the command line, and `below` the defaults, both by table and key.

    Raises InputError if a file cannot be read, a key or value is not allowed, or a limit is wider
    than that of the rig's description.
    """
    tables = dict(below)
    layers: list[tuple[Mapping[str, Any], str]] = [(below, "defaults")]
    for path in paths:
        directory = path.absolute().parent
        layer = _include_calibration(_anchor_paths(_read(path), directory), directory, str(path))
        _check(layer, str(path))
        layers.append((layer, str(path)))
        tables = _merge(tables, layer)
    environment_tables = _anchor_paths(_from_environment(environ), Path.cwd())
    layer = _include_calibration(environment_tables, Path.cwd(), "environment")
    _check(layer, "environment")
    tables = _merge(tables, layer)
    _check(overrides, "command line")
    tables = _merge(tables, overrides)
    layers += [(layer, "environment"), (overrides, "command line")]
    where = ", ".join(map(str, paths)) or "configuration"
    tables = _merge(_description_layer(_check(tables, where)), tables)
    config = _check(tables, where)
    try:
        check(config.ts_us, config.device.baud, oversampling=config.device.oversampling)
    except ValueError as err:
        raise InputError(f"[timing] {err}") from err
    description = description_of(config)
    config.emulator.check_rig(description)
    config.check_limits(
        description, {key: source for layer, source in layers for key in layer.get("limits", ())}
    )
    if error := too_slow(config.rules(description).limits or (), config.ts_us):
        raise InputError(f"[rig] file: {error}")
    return config


def load_installed(
    environ: Mapping[str, str],
    overrides: Mapping[str, Mapping[str, Any]],
    *,
    system: bool = False,
    below: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> Config:
    """Return the configuration of the installed files, including the rig's own file.

    If `system` is True, only the machine's files are read; the rig's own file must then exist.
    The other arguments are those of `load`.

    Raises InputError as `load`, and if the rig's own file is missing or belongs to another rig.
    """
    first = load(configuration_files(system=system), environ, overrides, below=below)
    path = of_rig(first.rig.id)
    if path == SYSTEM or not path.exists():
        if system:
            raise InputError(
                f"{path}: there is no such file; write it with at least [device] port; "
                "`armrigd config --example` prints all keys"
            )
        return first
    named = load([path], {}, {}, below={"rig": {"id": first.rig.id}}).rig.id
    if named != first.rig.id:
        raise InputError(f"{path}: rig.id = {named!r}: the file belongs to rig {first.rig.id!r}")
    return load(configuration_files(first.rig.id, system=system), environ, overrides, below=below)


def _anchor_paths(tables: Mapping[str, Any], directory: Path) -> dict[str, Any]:
    """Return `tables` with absolute paths; `[rig] file` may name a shipped description."""
    layer = resolve_paths(tables, directory)
    rig = tables.get("rig")
    if isinstance(rig, Mapping) and isinstance(file := rig.get("file"), str) and file:
        shipped_file = path_of(Path(file))
        if shipped_file != Path(file) and not Path(layer["rig"]["file"]).exists():
            layer["rig"] = {**layer["rig"], "file": str(shipped_file)}
    return layer


def _description_layer(config: Config) -> dict[str, Any]:
    """Return the lowest layer of the configuration: what the rig's description determines."""
    if not config.rig.file:
        return {}
    described = description_of(config)
    layer: dict[str, Any] = {
        "limits": {"u_max_v": described.input.u_max_v},
        "emulator": {"pwm_bits": LAYOUTS[described.rig.image].pwm_bits},
    }
    if described.arm_removed:
        return _merge(layer, {"arm": {"removed": True}, "emulator": {"arm_removed": True}})
    if not described.is_calibrated:
        return layer
    return layer | {
        "calibration": {
            name: {
                "zero_counts": output.zero_counts,
                "rad_per_count": output.per_count,
                "wraps": output.turning,
            }
            for name, output in described.outputs.items()
        }
    }


def _include_calibration(layer: dict[str, Any], directory: Path, where: str) -> dict[str, Any]:
    """Return a layer with the calibration that is in the file `file`, relative to `directory`."""
    table = layer.get("calibration")
    if not isinstance(table, Mapping) or "file" not in table:
        return layer
    file, others = table["file"], [key for key in table if key != "file"]
    if not isinstance(file, str) or not file:
        raise InputError(
            f"{where}: calibration.file = {file!r}: must be the path of a calibration file"
        )
    if others:
        raise InputError(
            f"{where}: calibration.{others[0]} and calibration.file are given: give one of them"
        )
    try:
        path = directory / Path(file).expanduser()
        calibration = tables_of(path)
        _check({"calibration": calibration}, str(path))
    except (FileError, RuntimeError) as err:
        raise InputError(f"{where}: calibration.file = {file!r}: {err}") from err
    return {**layer, "calibration": calibration}


def _read(path: Path) -> dict[str, Any]:
    text = ""
    try:
        text = read_text(path, CONFIGURATION_LIMIT)
        return toml_tables(text + "\n")  # with "\n", an error at the end also has a line number
    except FileNotFoundError as err:
        raise InputError(f"{path}: there is no such file") from err
    except PermissionError as err:
        raise InputError(f"{path}: {err.strerror}; let the daemon's user read it") from err
    except OSError as err:
        raise InputError(f"{path}: {err.strerror}") from err
    except FileError as err:
        raise InputError(f"{path}: {_duplicate(text, str(err.__cause__)) or err}") from err


def _duplicate(text: str, error: str) -> str:
    """Return a message about a key that is given twice; "" for another error."""
    kinds = r"Cannot overwrite a value|Cannot declare .* twice|Duplicate inline table key .*"
    match = re.match(rf"(?:{kinds}) \(at line (\d+)", error)
    if match is None:
        return ""
    number = int(match[1])
    line = text.splitlines()[number - 1].strip()
    return f"line {number}: {line}: given twice; give each key once"


def _check(tables: Mapping[str, Any], where: str) -> Config:
    try:
        return convert(dict(tables), Config)
    except InputError as err:
        raise InputError(f"{where}: {err}") from err


def _merge(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        if key == "calibration" and "made" in value:
            merged[key] = value  # measured as a whole: it replaces all keys of another calibration
            continue
        both = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = _merge(merged[key], value) if both else value
        if key == "calibration" and value:
            merged[key].pop("made", None)  # the merged values are not those of the measurement
    return merged


def _from_environment(environ: Mapping[str, str]) -> dict[str, Any]:
    tables: dict[str, Any] = {}
    for name, text in environ.items():
        if not name.startswith("ARMRIG_") or name in _OTHER_VARIABLES:
            continue
        table, _, key = name.removeprefix("ARMRIG_").lower().partition("_")
        fields = _fields_of(table)
        field_names = {field.lower(): field for field in fields}
        if not key or not field_names:
            allowed = ", ".join(Config.__struct_fields__)
            raise InputError(
                f"environment: {name}={text!r}: must be ARMRIG_<TABLE>_<KEY>; tables: {allowed}"
            )
        variable, name = name, field_names.get(key, key)
        if name in tables.get(table, {}):
            raise InputError(
                f"environment: {variable}={text!r}: {table}.{name} is given twice; once is allowed"
            )
        tables.setdefault(table, {})[name] = text if fields.get(name) is str else _value(text)
    return tables


def _fields_of(table: str) -> dict[str, Any]:
    for field in msgspec.structs.fields(Config):
        if field.name == table:
            kind: Any = field.type
            return {f.name: f.type for f in msgspec.structs.fields(kind)}
    return {}


def _value(text: str) -> Any:
    """Return the value of a text that is TOML; otherwise return the text itself."""
    try:
        return toml_tables(f"value = {text}")["value"]
    except FileError:
        return text
