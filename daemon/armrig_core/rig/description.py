"""The description of a rig in a TOML file: its input, its outputs and, if known, its model."""

from __future__ import annotations

import ast
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self, TypeVar

import msgspec
from msgspec import Meta

from armrig_core.errors import FileError, InputError
from armrig_core.process.bounded import read_bounded
from armrig_core.process.printable import plural, printable
from armrig_core.process.toml_file import TomlTable, convert, toml_tables
from armrig_core.rig.calibration import BODY, CALIBRATED, ArmModel
from armrig_core.rig.channels import (
    COUNTS,
    MAX_CHANNELS,
    MAX_VALUE,
    NO_CONVERSION,
    RAIL_COUNTS,
    Conversion,
    DeviceChannel,
    Points,
    Rail,
    channel,
    check_points,
    sample_names,
)
from armrig_core.rig.firmware_image import IMAGES, WITH_ENABLE_LINE
from armrig_core.rig.saved_model import Matrix, System, read_system
from armrig_core.rig.volts import U_MAX_V

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

LIMIT_BYTES = 1 << 16
"""Largest size of a description, in B."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}")
_RESERVED = {"k", "t", "u", "flags", "present", "valid", "outputs", "signals"}
_RESERVED |= {"value_0", "value_1"}
# The options of Rig.run, which takes the input by its name.
_OPTIONS = {"accepted", "dead_man", "details", "experiment", "pacing", "progress", "tell"}
_MAX_TEXT = 80
_MAX_STATES = 40
_MAX_DELAY_S = 3600.0
_ROUNDING = 1e-9  # of the real part of a pole at 0, in 1/s
BLIND_S = 1.0
"""Default time without a valid sample that stops a run with a limited output, in s."""
_MAX_OFFSET_V = 1e6  # at a larger offset the value has too few digits for the PWM's steps
_NEAR_END = 0.05  # share of the range of readings
_SIDES = {"low": "below", "high": "above"}
_SHIPPED = Path(__file__).parents[1] / "rigs"
_TABLES = ("rig", "input", "outputs", "model")
T = TypeVar("T", bound=msgspec.Struct)
T_Volts = TypeVar("T_Volts", float, "NDArray[np.float64]")
Turns = Annotated[float, Meta(ge=0, le=655)]
"""Rotation in turns, which the device has in hundredths of a turn."""


def _check_name(key: str, name: str) -> None:
    reserved = _RESERVED - {"u"} | _OPTIONS if key == "input name" else _RESERVED
    if not _NAME.fullmatch(name) or name in reserved:
        raise InputError(
            f"{key} = '{printable(name[:_MAX_TEXT])}': a name has 1 to 32 letters a-z, A-Z, digits "
            f"and _, begins with a letter, and is none of {', '.join(sorted(reserved))}"
        )


def _check_text(key: str, text: str) -> None:
    if not text.isprintable() or len(text) > _MAX_TEXT or "$" in text:  # $: a formula in figures
        raise InputError(
            f"{key} = '{printable(text[:_MAX_TEXT])}': at most {_MAX_TEXT} printable characters "
            "other than $"
        )


def check_turns(key: str, turns: float) -> None:
    """Refuse a rotation that is not a whole number of hundredths of a turn."""
    if round(turns * 100, 6) % 1:
        raise InputError(f"{key} = {turns} must be a whole number of hundredths")


class RigTable(TomlTable, frozen=True, kw_only=True):
    """`[rig]`: the names of the rig, and its firmware."""

    name: str
    """Name of the rig, of letters, digits and _."""
    title: str = ""
    """Name of the rig for people, on one line."""
    image: str = "uno"
    """Firmware image of the device, by its name in `armrig flash --image`."""

    def __post_init__(self) -> None:
        """Refuse names that cannot be printed or used in a file's name."""
        _check_name("name", self.name)
        _check_text("title", self.title)
        if self.image not in IMAGES:
            raise InputError(f"image = {self.image!r}: allowed are {', '.join(IMAGES)}")


class Input(TomlTable, frozen=True, kw_only=True):
    """`[input]`: the input as people call it; commands and files have it in V."""

    name: str = "u"
    unit: str = "V"
    per_volt: float = 1.0
    """Change of the input's value by 1 V at the pin, in its unit."""
    offset: float = 0.0
    """Value of the input at 0 V, in its unit: value = offset + per_volt · u."""
    rest_v: Annotated[float, Meta(ge=0, le=U_MAX_V)] = 0.0
    """Voltage at which the actuator does nothing, in V. Outside a run the pin is at 0 V and the
    enable line switches the driver off, so a rest other than 0 needs an image with this line."""
    u_max_v: Annotated[float, Meta(gt=0, le=U_MAX_V)] = U_MAX_V
    """Highest voltage that a command may contain, in V; `[limits] u_max_v` can only lower it."""

    def __post_init__(self) -> None:
        """Refuse a name or a unit that cannot be printed, and a factor of 0."""
        _check_name("input name", self.name)
        _check_text("unit", self.unit)
        if not (isfinite(self.per_volt) and self.per_volt):
            raise InputError(f"per_volt = {self.per_volt!r} must be finite and not 0")
        if not abs(self.offset) <= _MAX_OFFSET_V * abs(self.per_volt):  # NaN fails this, too
            raise InputError(
                f"offset = {self.offset!r}: the input would go from {self.value(0):g} to "
                f"{self.value(self.u_max_v):g} {self.unit}; offset is the value at 0 V"
            )
        if self.rest_v > self.u_max_v:
            raise InputError(f"rest_v = {self.rest_v:g} must be at most u_max_v = {self.u_max_v:g}")

    @property
    def is_scaled(self) -> bool:
        """True if the value of the input is not the voltage at the pin in V."""
        return self.unit != "V" or self.per_volt != 1 or self.offset != 0

    def value(self, u: T_Volts) -> T_Volts:
        """Return the value of a voltage at the pin, in the input's unit."""
        return self.offset + self.per_volt * u

    def volts(self, value: T_Volts) -> T_Volts:
        """Return the voltage at the pin of a value, in V."""
        return (value - self.offset) / self.per_volt

    def both(self, low: float, high: float) -> str:
        """Return the values of two voltages in the input's unit, and the voltages, as text."""
        low_, high_ = sorted((self.value(low), self.value(high)))
        range_text = f"{self.name} {low_:.4g} to {high_:.4g} {self.unit}"
        return f"{range_text}, {low:.4g} to {high:.4g} V at the pin"


class Output(TomlTable, frozen=True, kw_only=True):
    """`[outputs.NAME]`: an output of the rig, in the order of the device's channels."""

    unit: str
    zero_counts: float = 0.0
    """Reading at the value 0, in counts; full scale is 65536 counts."""
    per_count: float = 0.0
    """Change of the value by one count, in the unit; negative if the value falls with counts."""
    points: Points = ()
    """Pairs [counts, value] in place of `zero_counts` and `per_count`, joined by straight lines."""
    turning: bool = False
    """True if the shaft turns through a dead band, so that its turns are counted."""
    rate: str = ""
    """Name of the output's rate if the rate is an output, too; otherwise empty."""
    body: str = ""
    """Part of the rig whose motion the output shows, for sentences; otherwise empty."""
    low: float = -inf
    """Lowest value of a run, in the unit."""
    high: float = inf
    """Highest value of a run, in the unit."""
    samples: Annotated[int, Meta(ge=1, le=1000)] = 2
    """Number of consecutive samples outside the limits that stop a run."""
    blind_s: Annotated[float, Meta(gt=0, le=3600)] | None = None
    """Time without a valid sample that stops a run, in s.

    The default is no limit. For an output with low or high that does not turn, it is 1 s, or 5
    sampling times if they are longer.
    """
    valid_rail: Rail = ""
    """End of the converter's range, "low" (0 V) or "high", at which a reading is valid; without
    this key a reading at either end counts as a broken wire."""
    rail_is_outside: bool | None = None
    """True if a reading at the end of the range counts as outside the limit before this end;
    default: true for a limit within 5 % of the range from this end."""
    turns: Turns = 0.0
    """Largest rotation in one run, in turns, in steps of 0.01; 0 is no limit."""

    def __post_init__(self) -> None:
        """Refuse a conversion or a limit that no reading can have."""
        _check_text("unit", self.unit)
        _check_text("body", self.body)
        if self.points:
            if self.per_count or self.zero_counts or self.turning:
                raise InputError(
                    "points: give no per_count, zero_counts or turning with a table of points"
                )
            check_points(self.points)
        elif not (isfinite(self.per_count) and self.per_count):
            raise InputError(
                f"per_count = {self.per_count!r} must be finite and not 0; without it, give points"
            )
        if not abs(self.zero_counts) <= 100 * COUNTS:
            raise InputError(f"zero_counts = {self.zero_counts!r} must be within ±{100 * COUNTS}")
        if self.rate:
            _check_name("rate", self.rate)
        if self.turning and self.unit != "rad":
            raise InputError(f"turning = true needs unit = 'rad', not '{self.unit}'")
        check_turns("turns", self.turns)
        if self.turns and not self.turning:
            raise InputError(f"turns = {self.turns:g} needs turning = true; give low and high")
        if not self.low < self.high:  # NaN fails this, too
            raise InputError(f"low = {self.low!r} must be below high = {self.high!r}")
        ends = self.read_range
        if not all(abs(end) <= MAX_VALUE for end in ends):  # no reading may pass a limit as NaN
            raise InputError(f"{ends[0]:g} to {ends[1]:g} is read; ±{MAX_VALUE:g} is allowed")
        if self.low > ends[1] or self.high < ends[0]:
            raise InputError(
                f"low = {self.low:g}, high = {self.high:g}: every reading breaks a limit; the "
                f"converter reads {ends[0]:.4g} to {ends[1]:.4g}"
            )
        if self.turning and self.valid_rail:
            raise InputError("valid_rail: a turning output reads an end in its dead band")
        self._check_reached()

    def _check_reached(self) -> None:
        """Refuse a limit that no reading breaks."""
        first = 0 if self.valid_rail == "low" else RAIL_COUNTS
        last = COUNTS - 1 - (0 if self.valid_rail == "high" else RAIL_COUNTS)
        least, most = sorted((self.value(first), self.value(last)))
        never = {"low": self.low <= least, "high": self.high >= most}
        for key, side in _SIDES.items():
            limit: float = getattr(self, key)
            if isfinite(limit) and never[key] and side not in self.sides_of_rails:
                raise InputError(
                    f"{key} = {limit:g}: no reading is {side} this limit; the sensor reads "
                    f"{least:.4g} to {most:.4g} {self.unit}. Give a limit in this range, or "
                    "rail_is_outside = true to stop at the end of the range"
                )

    @property
    def read_range(self) -> tuple[float, float]:
        """Smallest and largest value at the ends of the converter's range."""
        low, high = sorted((self.value(0), self.value(COUNTS - 1)))
        return low, high

    @property
    def sides_of_rails(self) -> tuple[str, str]:
        """Side of the limits on which a reading at counts 0 and at full scale is; "" for inside."""
        ends = self.read_range
        near, forced = _NEAR_END * (ends[1] - ends[0]), self.rail_is_outside
        first, second = (
            side
            if isfinite(limit) and (abs(limit - end) <= near if forced is None else forced)
            else ""
            for side, limit, end in zip(_SIDES.values(), (self.low, self.high), ends, strict=True)
        )
        return (first, second) if self.value(0) < self.value(COUNTS - 1) else (second, first)

    @property
    def is_bounded(self) -> bool:
        """True if a value can stop a run."""
        return isfinite(self.low) or isfinite(self.high)

    @property
    def default_blind(self) -> bool:
        """True if the time without a value that stops a run is the default."""
        return self.is_bounded and self.blind_s is None and not self.turning

    @property
    def limited(self) -> bool:
        """True if a value or the time without a value can stop a run."""
        return self.is_bounded or self.blind_s is not None

    @property
    def limits(self) -> str:
        """Return the limits as text; empty without any."""
        turns = f"after {plural(self.turns, 'turn')}" if self.turns else ""
        parts = [f"above {self.high:g} {self.unit}"] if isfinite(self.high) else []
        parts += [f"below {self.low:g} {self.unit}"] if isfinite(self.low) else []
        ends = f"{' or '.join(parts)} in {plural(self.samples, 'sample')} in a row" if parts else ""
        blind = f"blind for {self.blind_s:g} s" if self.blind_s else ""
        if self.default_blind:
            blind = f"blind for {BLIND_S:g} s or 5 Ts"
        return ", or ".join(text for text in (turns, ends, blind) if text)

    @property
    def conversion(self) -> Conversion:
        """Conversion of readings in counts to values in the output's unit."""
        return Conversion(self.zero_counts, self.per_count, self.points, self.valid_rail)

    def value(self, counts: float) -> float:
        """Return the value of a reading in counts, in the output's unit."""
        return self.conversion.value(counts)


class Model(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[model]`: what the emulator and the rehearsal simulate, by matrices, by file or by kind.

    x' = A x + B v(t - delay_s), y = C x + offset, with v = u - rest_v in V and y in the units of
    the outputs.
    """

    A: Matrix = []
    B: Matrix = []
    C: Matrix = []
    offset: list[float] = []
    """Values of the outputs at rest; default: 0, or those of a saved model."""
    noise: list[float] = []
    """Standard deviations of the outputs' noise; default: 0."""
    delay_s: Annotated[float, Meta(ge=0, le=_MAX_DELAY_S)] = 0.0
    """Dead time of the input, in s."""
    unstable: bool = False
    """True to allow a pole in the right half-plane."""
    file: str = ""
    """Model that `armrig identify --save` wrote, or a Python file with own equations, whose states
    are 0 at first; relative to the description."""
    kind: ArmModel = ""

    def __post_init__(self) -> None:
        """Refuse no way or two ways of giving the model, and matrices that do not fit."""
        ways = [key for key in ("A", "file", "kind") if getattr(self, key)]
        if len(ways) != 1:
            names = " and ".join(ways) or "none"
            raise InputError(f"{names} is given: give A, B and C, or file, or kind")
        if self.A:
            self._check_matrices()

    def _check_matrices(self) -> None:
        n = len(self.A)
        if n > _MAX_STATES:
            raise InputError(f"A has {plural(n, 'row')}; at most {_MAX_STATES} are allowed")
        for name, rows, wide in (("A", n, n), ("B", n, 1), ("C", len(self.C), n)):
            matrix: Matrix = getattr(self, name)
            if len(matrix) != rows or not rows or any(len(row) != wide for row in matrix):
                shape = f"{plural(len(matrix), 'row')} of {sorted({len(row) for row in matrix})}"
                raise InputError(f"{name} has {shape} numbers; with A it must be {rows} by {wide}")
        for name in ("A", "B", "C"):
            if not all(isfinite(x) for row in getattr(self, name) for x in row):
                raise InputError(f"{name} has a number that is not finite")
        if not self.unstable:
            _check_stable("A", self.A)


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """A rig, as its file describes it."""

    rig: RigTable
    input: Input
    outputs: dict[str, Output]
    """Outputs by name, in the order of the device's channels."""
    model: Model | None
    """Model of the emulator and the rehearsal; None if none is given."""
    text: bytes
    """Contents of the file, as attached to recordings."""
    system: System | None = None
    """Matrices that the emulator and the rehearsal simulate; None for the arm, or without any."""
    equations: Path | None = None
    """File with own equations that the emulator and the rehearsal simulate, if a person has named
    the description on this machine; None for the description of a recording."""

    @property
    def sha256(self) -> str:
        """Hash of the file."""
        return hashlib.sha256(self.text).hexdigest()

    @property
    def title(self) -> str:
        """Name of the rig for people."""
        return self.rig.title or self.rig.name

    def rows(self) -> list[tuple[str, str]]:
        """Return what the description says, as names and texts."""
        port = self.input
        volts = f", {port.per_volt:g} {port.unit} per volt" if port.is_scaled else ""
        volts += f" from {port.offset:g} {port.unit}" if port.offset else ""
        note = ""
        if port.rest_v:
            u0 = f"{port.value(port.rest_v):g} {port.unit}"
            note = f"; it rests at {port.rest_v:g} V" + (f" ({u0})" if port.is_scaled else "")
        rows = [
            ("described", self.title),
            ("input", f"{port.name}{volts}, 0 to {port.u_max_v:g} V{note}"),
        ]
        if self.rig.image != IMAGES[0]:
            rows.append(("image", self.rig.image))
        for name, output in self.outputs.items():
            low, high = output.read_range
            kind = "turns through a dead band" if output.turning else "a value"
            rate = f"; its rate is {output.rate}" if output.rate else ""
            text = f"{low:.4g} to {high:.4g} {output.unit}, {kind}{rate}"
            stop = f"; a run stops {output.limits}" if output.limits else ""
            rows.append((name, text + stop))
        model = "none: no emulation, and no rehearsal before a run"
        if self.model is not None:
            model = self.model.file or f"the {self.arm}, with the parameters in [arm]"
        if self.system is not None:
            when = "continuous time" if self.system.Ts is None else f"Ts = {self.system.Ts:g} s"
            model = f"{plural(len(self.system.A), 'state')}, {when}"
        both = self.text + (self.equations.read_bytes() if self.equations else b"")
        return [*rows, ("model", model), ("sha256", hashlib.sha256(both).hexdigest())]

    @property
    def longest_sample_s(self) -> float:
        """Longest time between two samples, in s: 1 s, and a fifth of each given blind time."""
        return min([1.0, *(o.blind_s / 5 for o in self.outputs.values() if o.blind_s)])

    @property
    def arm(self) -> str:
        """Kind of the model with the parameters of [arm]; empty for every other rig."""
        return self.model.kind if self.model else ""

    @property
    def arm_removed(self) -> bool:
        """True if the model is that of the arm's first part alone."""
        return self.arm == BODY

    @property
    def channels(self) -> tuple[DeviceChannel, ...]:
        """Channels of the outputs, in the order of the device's readings."""
        return tuple(
            channel(number, name, o.unit, turns=o.turning, rate=o.rate, body=o.body)
            for number, (name, o) in enumerate(self.outputs.items())
        )

    @property
    def is_calibrated(self) -> bool:
        """True if a `Calibration` converts the outputs: the angles of the arm's potentiometers."""
        units = {output.unit for output in self.outputs.values()}
        return tuple(self.outputs) == CALIBRATED and units == {"rad"}

    @property
    def conversions(self) -> tuple[Conversion, Conversion]:
        """Conversions of the device's readings."""
        described = [output.conversion for output in self.outputs.values()]
        first, second = (*described, NO_CONVERSION)[:MAX_CHANNELS]
        return first, second

    @classmethod
    def of(cls, text: bytes) -> Self:
        """Return the description in the contents of a file.

        Raises
        ------
        FileError
            The text is longer than `LIMIT_BYTES`, or is no TOML in UTF-8.
        InputError
            A key or a value is not allowed.
        """
        if len(text) > LIMIT_BYTES:
            raise FileError(f"{len(text)} B: a description has at most {LIMIT_BYTES} B")
        try:
            tables = toml_tables(text.decode())
        except UnicodeDecodeError as err:
            raise FileError(
                f"no text in UTF-8: byte {err.start} is {text[err.start]:#04x}"
            ) from err
        unknown = next((key for key in tables if key not in _TABLES), "")
        if unknown or not tables.keys() >= {"rig", "outputs"}:
            fault = (
                f"[{printable(unknown)}]: no such table"
                if unknown
                else "[rig] or [outputs] is missing"
            )
            raise InputError(f"{fault}; allowed are {', '.join(f'[{key}]' for key in _TABLES)}")
        outputs = {
            name: _table(f"outputs.{name}", table, Output)
            for name, table in _output_tables(tables["outputs"]).items()
        }
        model_table = tables.get("model")
        model = None if model_table is None else _table("model", model_table, Model)
        described = cls(
            rig=_table("rig", tables["rig"], RigTable),
            input=_table("input", tables.get("input", {}), Input),
            outputs=outputs,
            model=model,
            text=text,
            system=System(model.A, model.B, model.C, None) if model and model.A else None,
        )
        described._check_signals()
        return described

    def _check_signals(self) -> None:
        """Refuse a name that stands twice, and a model of other outputs."""
        rates = (output.rate for output in self.outputs.values() if output.rate)
        names = [self.input.name, *self.outputs, *rates]
        if twice := next((name for name in names if names.count(name) > 1), ""):
            raise InputError(f"{twice}: names two signals; give each signal a name of its own")
        fields = sample_names(self.channels)
        columns = {*fields} - {c.value_field for c in self.channels}
        columns |= {c.valid for c in self.channels}
        if taken := next((name for name in names if name in columns), ""):
            raise InputError(f"{taken}: a column of recordings has this name; rename the signal")
        if clash := next((field for field in fields if fields.count(field) > 1), ""):
            raise InputError(
                f"{clash}: this field of a sample, made of name and unit, would exist twice; "
                "rename the output"
            )
        if counted := next((name for name, o in [*self.outputs.items()][1:] if o.turns), ""):
            raise InputError(f"{counted}: turns: the device counts those of the first output only")
        if self.input.rest_v and self.rig.image not in WITH_ENABLE_LINE:
            raise InputError(
                f"input.rest_v = {self.input.rest_v:g}: the image {self.rig.image} has no enable "
                "line. In a reset its pin falls to 0 V, which would not be this rig's rest; use "
                f"{', '.join(WITH_ENABLE_LINE)}"
            )
        if self.input.rest_v and self.input.name == "u":
            raise InputError(
                f"input.rest_v = {self.input.rest_v:g}: give the input a name other than u, "
                "because a number without a name is a voltage at the pin, and 0 V is not its rest"
            )
        if self.arm and (self.input.is_scaled or self.input.rest_v):
            raise InputError(
                f"model.kind = '{self.arm}': its input is the voltage at the pin, so leave unit, "
                "per_volt, offset and rest_v out of [input]"
            )
        if self.is_calibrated and any(output.valid_rail for output in self.outputs.values()):
            raise InputError("valid_rail: a calibration converts these outputs; leave it out")
        if self.model is not None:
            _check_outputs(self.model, self.outputs)
            if not self.model.file:  # the file may say what the rig reads at rest
                self.check_rest(self.model.offset or [0.0] * len(self.outputs))

    def check_rest(self, rest_y: Sequence[float]) -> None:
        """Refuse values at rest that the sensors do not read, or that break a limit."""
        for (name, output), y in zip(self.outputs.items(), rest_y, strict=True):
            where = f"outputs.{name}: the rig reads {y:g} {output.unit} at rest"
            if not output.low <= y <= output.high:
                raise InputError(
                    f"{where}, outside {output.low:g} to {output.high:g}; correct the limits, or "
                    "model.offset"
                )
            counts, last = round(output.conversion.counts(y)), COUNTS - 1
            if output.turning or RAIL_COUNTS <= counts <= last - RAIL_COUNTS:
                continue
            least, most = output.read_range
            end = "low" if counts < RAIL_COUNTS else "high"
            if not -RAIL_COUNTS <= counts <= last + RAIL_COUNTS:
                raise InputError(
                    f"{where}; the sensor reads {least:.4g} to {most:.4g}: correct model.offset or "
                    "the conversion"
                )
            if output.valid_rail != end:
                raise InputError(
                    f"{where}, an end of the sensor's range, where a torn wire reads the same: set "
                    f"valid_rail = '{end}' if the sensor rests there"
                )


@cache
def builtin(name: str) -> Description:
    """Return a description that comes with armrig, by a name of `armrig rigs`."""
    return read_description(_SHIPPED / f"{name}.toml")


def builtin_files() -> list[Path]:
    """Return the files of the descriptions that come with armrig."""
    return sorted(_SHIPPED.glob("*.toml"))


def path_of(file: Path) -> Path:
    """Return the file of a description; a name without suffix may be that of a shipped one."""
    path = _SHIPPED / f"{file}.toml"
    return path if len(file.parts) == 1 and path.is_file() and not file.is_file() else file


def require_model(description: Description, cpu_s: int = 0) -> tuple[Model, System]:
    """Return the model of a rig with its matrices, or with a new process of its own equations.

    The process may have `cpu_s` seconds of processor time; 0 is no limit.

    Raises InputError if the rig has no model.
    """
    model, system = description.model, description.system
    if model is not None and description.equations:
        from armrig_core.rig.equations_file import EquationsProcess

        rest_v = description.input.rest_v
        process = EquationsProcess(description.equations, [*description.outputs], cpu_s, rest_v)
        offset = model.offset or [0.0] * len(process.rest)
        rest_y = [a + b for a, b in zip(offset, process.rest, strict=True)]
        description.check_rest(rest_y)
        A, B, C = process.matrices
        delay_s = model.delay_s + process.delay_s
        model = msgspec.structs.replace(model, offset=rest_y, delay_s=delay_s)
        return model, System(A, B, C, None, process=process)
    if model is None or system is None:
        raise InputError(
            f"the rig '{description.title}' cannot be emulated without [model]: give A, B and C, "
            "or the file of a model from `armrig identify --save`, or of own equations"
        )
    return model, system


def read_description(path: Path) -> Description:
    """Return the rig that the file at `path` describes; raise FileError, which names the file."""
    try:
        described = Description.of(read_bounded(path, LIMIT_BYTES))
        if described.model is None or not described.model.file:
            return described
        file = path.parent / described.model.file
        if file.suffix == ".py":
            if not file.is_file():
                raise InputError(f"model.file = '{file}': no regular file")
            try:
                ast.parse(read_bounded(file, LIMIT_BYTES))
            except (SyntaxError, ValueError) as err:
                raise InputError(f"model.file = '{file}': no Python: {err}") from err
            return replace(described, equations=file)
        port = described.input
        system = read_system(
            file, tuple(described.outputs), (port.name, port.unit), port.value, port.rest_v
        )
        if not described.model.unstable:
            _check_stable("model.file", system.A, discrete=system.Ts is not None)
        model = msgspec.structs.replace(
            described.model,
            delay_s=described.model.delay_s + system.delay_s,
            offset=described.model.offset or [*system.rest],
        )
        described.check_rest(model.offset or [0.0] * len(described.outputs))
        return replace(described, model=model, system=system)
    except OSError as err:
        raise FileError(f"{path}: {err.strerror}") from err
    except InputError as err:
        raise FileError(f"{path}: {err}") from err


def _output_tables(outputs: object) -> dict[str, object]:
    """Return the tables of the outputs; refuse too many outputs, and names that cannot be used."""
    if not isinstance(outputs, dict) or not 1 <= len(outputs) <= MAX_CHANNELS:
        raise InputError(f"[outputs.NAME]: 1 to {MAX_CHANNELS} tables are allowed, one each output")
    for name in outputs:
        _check_name("outputs", name)
    return outputs


def _table(key: str, table: object, kind: type[T]) -> T:
    """Return a table of the file as a value; the message of an InputError begins with the key."""
    if not isinstance(table, dict):
        raise InputError(f"{key}: must be a table, [{key}]")
    try:
        return convert(table, kind)
    except InputError as err:
        raise InputError(f"{key}: {err}") from err


def _check_outputs(model: Model, outputs: dict[str, Output]) -> None:
    """Refuse a model of another number of outputs."""
    for name in ("C", "offset", "noise"):
        numbers: list[object] = getattr(model, name)
        if numbers and len(numbers) != len(outputs):
            raise InputError(
                f"model.{name} has {plural(len(numbers), 'row')}; the rig has "
                f"{plural(len(outputs), 'output')}"
            )
    if (
        not all(isfinite(x) for x in (*model.offset, *model.noise))
        or min(model.noise, default=0) < 0
    ):
        raise InputError("model.offset and model.noise must be finite, and noise not below 0")


def _check_stable(key: str, A: Matrix, *, discrete: bool = False) -> None:
    """Refuse an eigenvalue of A that belongs to a growing motion."""
    # Imported here: a description without matrices is read without numpy.
    import numpy as np

    poles = np.linalg.eigvals(np.array(A))
    size = np.abs(poles) - 1 if discrete else poles.real
    if not size.max() <= _ROUNDING:  # NaN fails this, too
        pole = poles[np.argmax(size)]
        place = f"of modulus {abs(pole):.4g}" if discrete else f"with real part {pole.real:.3g} 1/s"
        raise InputError(
            f"{key} has a pole {place}: the rig is unstable; correct {key}, or set unstable = true"
        )
