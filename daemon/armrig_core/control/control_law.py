"""Control laws: a linear controller as data, in a file that is checked and hashed.

The input u[k] is latched together with sample k, so u[k] can depend on y up to y[k-1]. With the
difference Δ of a signal from the law's operating point, the law is

    x[k+1] = A x[k] + B w[k],    w[k] = (r[k], Δu[k-d], Δy1[k], Δy2[k]),    x[0] = x0
    v[k]   = C x[k] + D r[k] + u0,    u[k] = slew(sat(v[k], lo, hi))

u is the voltage that the device latched, and d the `input_delay` in samples. The input in w is
therefore the limited one, which is the law's anti-windup. A missing y is replaced by F x, or by the
prediction of the law's monitor. `evaluation.py` evaluates a law, and `monitor.py` its monitor.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from math import ceil, floor, isfinite, tau
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import msgspec
from msgspec import Meta

from armrig_core.control.evaluation import Program
from armrig_core.control.monitor import DEVIATIONS, RANGE_SHARE, MonitorProgram
from armrig_core.control.sums import Row, Rows
from armrig_core.errors import FileError, InputError
from armrig_core.process.bounded import read_bounded
from armrig_core.process.printable import plural, printable
from armrig_core.rig.channels import COUNTS
from armrig_core.rig.description import Description, Output
from armrig_core.rig.volts import CODES_PER_V, U_MAX_V

MAX_STATES = 8
"""Largest number of states of a law."""
MAX_MONITOR_STATES = 10
"""Largest number of states of a monitor."""
MAX_PRELUDE = 10_000
"""Longest prelude, in samples."""
MAX_DELAY = 200
"""Largest dead time of the input in a law, in samples."""
LIMIT_BYTES = 1 << 18
"""Largest size of a law's file, in B."""
MAX_DESIGN_BYTES = 1 << 16
"""Largest size of the `design` of a law, in B."""
MIN_TS_US, MAX_TS_US = 5_000, 1_000_000
"""Shortest and longest sampling time of a law, in µs."""
_ROUNDING_CODES = 1e-6
_PAST_DEAD_BAND_RAD = 0.1
"""Turn beyond a dead band, in rad, after which an angle counts as lost."""

Volts = Annotated[float, Meta(ge=0, le=U_MAX_V)]
Text = Annotated[str, Meta(max_length=80)]


class LawOutput(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A measured output that a law uses."""

    name: Text
    """Name of the output in the rig's description."""
    unit: Text
    y0: float = 0.0
    """Value of the output at the operating point, in its unit; 0 for a turning output."""
    turning: bool = False
    """True if the output is an angle of a turning shaft. The law then counts the angle, with its
    turns, from the law's own prediction at the first valid sample."""


class Reference(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The reference r of a law."""

    name: Text
    unit: Text
    low: float
    """Lowest value that a run may request, in the unit."""
    high: float
    """Highest value that a run may request, in the unit."""


class Tracking(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Bound of the control error, beyond which a run ends.

    The tracked value is `row` · (x[k], Δy1[k-1], Δy2[k-1]) + `offset`, in the unit of r.
    """

    row: Row
    offset: float = 0.0
    most: Annotated[float, Meta(gt=0)]
    """Largest difference of reference and tracked value, in the unit of r."""
    samples: Annotated[int, Meta(ge=1, le=1_000_000)]
    """Number of consecutive samples with a larger difference after which the run ends."""


def _most_turned(output: Output) -> float | None:
    """Return the turn after which a turning output is lost, in rad; None if it does not turn."""
    if not output.turning:
        return None
    return max(tau - COUNTS * abs(output.per_count), 0.0) + _PAST_DEAD_BAND_RAD


class Monitor(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Copy of the plant's model, which stops a run whose outputs differ from its predictions.

    `armrig_core.control.monitor` has the equations and the two gates.
    """

    A: Rows
    """(m, m)."""
    B: Row
    """(m,): the column of Δu."""
    C: Rows
    """(ny, m): predictions of the law's outputs, in the law's order."""
    L: Rows
    """(m, ny): gains of the innovations."""
    x0: Row
    """(m,): states at rest."""
    u0: float = 0.0
    """Voltage of the operating point of the model, in V."""
    deviations: Row
    """(ny,): standard deviation of each innovation, in the unit of its output; above 0."""
    settling: tuple[bool, ...]
    """(ny,): True for an output that settles, which the simulation gate compares, too."""
    input_delay: Annotated[int, Meta(ge=0, le=MAX_DELAY)] = 0
    """Dead time of the input in the model, in samples."""
    prelude: Annotated[int, Meta(ge=0, le=MAX_PRELUDE)]
    """Number of samples of feed-forward at the beginning of a run, before the loop closes."""
    forward: tuple[float, float]
    """Feed-forward: v[k] = forward[0] r[k] + forward[1], in V."""

    def shapes(self, ny: int) -> dict[str, tuple[Rows, int, int]]:
        """Return each matrix with the shape that it must have, by its key in the file."""
        m = len(self.x0)
        return {
            "monitor.A": (self.A, m, m),
            "monitor.B": ((self.B,), 1, m),
            "monitor.C": (self.C, ny, m),
            "monitor.L": (self.L, m, ny),
            "monitor.deviations": ((self.deviations,), 1, ny),
            "monitor.settling": ((tuple(map(float, self.settling)),), 1, ny),
        }

    def program(self, law: ControlLaw, rig: Description) -> MonitorProgram:
        """Return the monitor of a law as the core evaluates it for a rig."""
        rows = zip(self.A, self.B, self.L, strict=True)
        return MonitorProgram(
            outputs=tuple(output.name for output in law.outputs),
            rows=tuple((*a, b, *gains) for a, b, gains in rows),
            predictions=self.C,
            x0=self.x0,
            u0=self.u0,
            deviations=self.deviations,
            settling=self.settling,
            input_delay=self.input_delay,
            prelude=self.prelude,
            forward=self.forward,
            most_blind=law.most_blind,
            most_turned=tuple(_most_turned(rig.outputs[o.name]) for o in law.outputs),
        )


class ControlLaw(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A control law, as in its file.

    Examples
    --------
    A heater at 10 °C above 23 °C by proportional control, with 1 s between two samples:

    >>> law = ControlLaw(
    ...     Ts_us=1_000_000, input="power", u0=2.5, hi=5.0,
    ...     outputs=(LawOutput(name="T1", unit="degC", y0=33.0),),
    ...     reference=Reference(name="T1", unit="degC", low=23.0, high=60.0),
    ...     A=((0.0,),), B=((0.2, 0.0, -0.2),), C=(1.0,), x0=(0.0,),
    ... )
    >>> law.order, len(law.sha256)
    (1, 64)
    """

    format: Literal["armrig control law"] = "armrig control law"
    Ts_us: Annotated[int, Meta(ge=MIN_TS_US, le=MAX_TS_US)]
    """Sampling time, in µs; that of the run must be equal."""
    input: Text = "u"
    """Name of the rig's input; the law has its voltage at the pin."""
    outputs: Annotated[tuple[LawOutput, ...], Meta(min_length=1, max_length=2)]
    reference: Reference
    A: Rows
    """(n, n)."""
    B: Rows
    """(n, 2 + ny): columns for r, Δu, Δy1 and Δy2."""
    C: Row
    """(n,), in V."""
    D: float = 0.0
    """Direct term of r, in V per unit of r; r itself is no difference."""
    F: Rows | None = None
    """(ny, n): prediction of Δy[k] from x[k]. A turning output requires it or a monitor. Without
    both, a missing y is replaced by the newest valid one."""
    x0: Row
    """(n,): states at the beginning of each run."""
    u0: float = 0.0
    """Voltage of the operating point, in V."""
    lo: Volts = 0.0
    """Lowest voltage of the law, in V."""
    hi: Volts = U_MAX_V
    """Highest voltage of the law, in V."""
    slew: Annotated[float, Meta(ge=0, le=U_MAX_V)] = 0.0
    """Largest change of the voltage in one sample, in V; 0 is no limit."""
    input_delay: Annotated[int, Meta(ge=0, le=MAX_DELAY)] = 0
    """Dead time of the input in the law's model, in samples."""
    most_blind: Annotated[int, Meta(ge=1, le=1000)] = 20
    """Number of consecutive samples without a valid output after which the run ends."""
    most_limited: Annotated[int, Meta(ge=0, le=1_000_000)] = 0
    """Number of consecutive samples at `lo` or `hi` after which the run ends; 0 is no limit."""
    tracking: Tracking | None = None
    """Bound of the control error; None for no bound."""
    monitor: Monitor | None = None
    """Monitor of the outputs; a law without one runs only with the word `unmonitored`."""
    design: dict[str, Any] = {}
    """Origin of the law: method, weights, hash of the model, predicted margins."""

    @property
    def order(self) -> int:
        """Number n of states."""
        return len(self.x0)

    @property
    def text(self) -> bytes:
        """Contents of the law's file, the same for a number that was given as 1 or as 1.0."""
        law = msgspec.json.decode(msgspec.json.encode(self), type=ControlLaw)
        return msgspec.json.format(msgspec.json.encode(law)) + b"\n"

    @property
    def sha256(self) -> str:
        """Hash of the law's text."""
        return hashlib.sha256(self.text).hexdigest()

    def __post_init__(self) -> None:
        """Refuse a law that cannot be evaluated."""
        n, ny = self.order, len(self.outputs)
        if n > MAX_STATES:
            raise InputError(
                f"the law has {plural(n, 'state')}; at most {MAX_STATES} are allowed: design it "
                "with a model of lower order"
            )
        shapes = {"A": (self.A, n, n), "B": (self.B, n, 2 + ny), "C": ((self.C,), 1, n)}
        if self.F is not None:
            shapes["F"] = (self.F, ny, n)
        if self.tracking is not None:
            shapes["tracking.row"] = ((self.tracking.row,), 1, n + ny)
        if self.monitor is not None:
            if (order := len(self.monitor.x0)) > MAX_MONITOR_STATES:
                raise InputError(
                    f"the monitor has {plural(order, 'state')}; at most {MAX_MONITOR_STATES} are "
                    "allowed: use a model of lower order"
                )
            shapes |= self.monitor.shapes(ny)
        for key, (rows, high, wide) in shapes.items():
            if len(rows) != high or any(len(row) != wide for row in rows):
                widths = " or ".join(map(str, sorted({*map(len, rows)}))) or "0"
                states = len(self.monitor.x0) if self.monitor and "monitor" in key else n
                raise InputError(
                    f"{key} has {len(rows)} x {widths} numbers; with {plural(states, 'state')} in "
                    f"x0 and {plural(ny, 'output')} it must have {high} x {wide}"
                )
        r, bound = self.reference, self.tracking
        numbers = {key: [x for row in rows for x in row] for key, (rows, *_) in shapes.items()}
        numbers |= {"x0": [*self.x0], "D": [self.D], "u0": [self.u0]}
        numbers |= {"reference": [r.low, r.high], "outputs": [o.y0 for o in self.outputs]}
        numbers |= {"tracking": [bound.offset, bound.most]} if bound else {}
        if m := self.monitor:
            numbers |= {"monitor.x0": [*m.x0], "monitor.forward": [*m.forward, m.u0]}
        for key, values in numbers.items():
            if wrong := [x for x in values if not isfinite(x)]:
                raise InputError(
                    f"{key} of the law has the number {wrong[0]}; all numbers must be finite: "
                    "repeat the design, and look at its model"
                )
        if m and not all(s > 0 for s in m.deviations):
            raise InputError(
                f"monitor.deviations are {', '.join(f'{s:g}' for s in m.deviations)}: each must be "
                "above 0"
            )
        texts = [self.input, r.name, r.unit]
        texts += [text for output in self.outputs for text in (output.name, output.unit)]
        if wrong_texts := [text for text in texts if not text.isprintable()]:
            text = printable(wrong_texts[0])
            raise InputError(f"'{text}': a name or a unit of the law must be printable")
        if (size := len(msgspec.json.encode(self.design))) > MAX_DESIGN_BYTES:
            raise InputError(f"design has {size} B; at most {MAX_DESIGN_BYTES} B are allowed")
        if not self.lo < self.hi:
            raise InputError(f"lo = {self.lo:g} V must be below hi = {self.hi:g} V")
        if not r.low <= r.high:
            raise InputError(f"reference.low = {r.low:g} must be at most high = {r.high:g}")
        names = [o.name for o in self.outputs]
        if len({*names}) < ny:
            raise InputError(f"outputs: {names[0]} is given twice; give each output once")
        for output in self.outputs:
            if output.turning and output.y0:
                raise InputError(f"{output.name} turns, so its y0 must be 0, not {output.y0:g}")
            if output.turning and self.F is None and m is None:
                raise InputError(
                    f"{output.name} turns through a dead band, so the law needs F, its prediction "
                    "of the output, or a monitor; `armrig.control.control_law(C, model=…)` adds one"
                )

    @classmethod
    def of(cls, text: bytes) -> Self:
        """Return the law in the contents of a file; raise InputError if it is no law.

        Examples
        --------
        >>> ControlLaw.of(b"{}")
        Traceback (most recent call last):
            ...
        armrig_core.errors.InputError: no control law: Object missing required field `Ts_us`
        """
        try:
            return msgspec.json.decode(text, type=cls)
        except (msgspec.DecodeError, RecursionError) as err:
            raise InputError(f"no control law: {printable(str(err))}") from err

    def check_reference(self, values: Sequence[float]) -> None:
        """Refuse a reference with a value that is outside the law's range, or not finite.

        Examples
        --------
        >>> law = ControlLaw(
        ...     Ts_us=10_000, outputs=(LawOutput(name="alpha", unit="rad"),), A=(), B=(), C=(),
        ...     D=1.0, x0=(), reference=Reference(name="u", unit="V", low=0.0, high=4.0),
        ... )
        >>> law.check_reference([1.0, 4.0])
        """
        low, high = self.reference.low, self.reference.high
        for k, r in enumerate(values):
            if not low <= r <= high:  # NaN fails this, too
                raise InputError(
                    f"r[{k}] = {r:g} {self.reference.unit}: the law allows {low:g} to {high:g}; "
                    "change this value, or low and high of the law's reference"
                )

    def monitor_doubt(self, rig: Description) -> str:
        """Return why the law's monitor would see no stuck sensor on a rig; "" if it would.

        The innovation gate of an output must be at most a quarter of what its sensor reads.

        Examples
        --------
        >>> from armrig_core.rig.description import builtin
        >>> law = ControlLaw(
        ...     Ts_us=10_000, outputs=(LawOutput(name="alpha", unit="rad"),), A=(), B=(), C=(),
        ...     D=1.0, x0=(), reference=Reference(name="u", unit="V", low=0.0, high=4.0),
        ... )
        >>> law.monitor_doubt(builtin("arm"))
        'the law has no monitor, so a stuck sensor drives the rig to full input'
        """
        if self.monitor is None:
            return "the law has no monitor, so a stuck sensor drives the rig to full input"
        for output, deviation in zip(self.outputs, self.monitor.deviations, strict=True):
            low, high = rig.outputs[output.name].read_range
            if DEVIATIONS * deviation > RANGE_SHARE * (high - low):
                return (
                    f"the monitor of {output.name} trips beyond {DEVIATIONS * deviation:.3g} "
                    f"{output.unit}, and its sensor reads {high - low:.3g} {output.unit} in all, "
                    "so a stuck sensor drives the rig to full input"
                )
        return ""

    def check_rig(self, rig: Description, Ts_us: int, u_min_v: float, u_max_v: float) -> None:
        """Refuse a law of another rig, another sampling time or wider limits.

        `u_min_v` and `u_max_v` are the limits of the configuration, in V.

        Examples
        --------
        >>> from armrig_core.rig.description import builtin
        >>> law = ControlLaw(
        ...     Ts_us=10_000, outputs=(LawOutput(name="alpha", unit="rad"),), A=(), B=(), C=(),
        ...     D=1.0, x0=(), reference=Reference(name="u", unit="V", low=0.0, high=4.0),
        ... )
        >>> law.check_rig(builtin("arm"), 10_000, 0.0, 5.0)
        """
        if self.Ts_us != Ts_us:
            raise InputError(
                f"the law has Ts = {self.Ts_us / 1e6:g} s, and the run {Ts_us / 1e6:g} s: run with "
                "the law's Ts, or design the law for this one"
            )
        if self.input != rig.input.name:
            raise InputError(
                f"the law drives {self.input}, and the rig's input is {rig.input.name}: design the "
                "law for this rig"
            )
        for output in self.outputs:
            described = rig.outputs.get(output.name)
            if described is None:
                raise InputError(
                    f"the law uses {output.name}, and the rig has {', '.join(rig.outputs)}: design "
                    "the law for these outputs"
                )
            if (output.unit, output.turning) != (described.unit, described.turning):
                turns = {True: ", turning", False: ""}
                raise InputError(
                    f"the law's {output.name} is in {output.unit}{turns[output.turning]}, and the "
                    f"rig's in {described.unit}{turns[described.turning]}: design the law in the "
                    "rig's unit"
                )
        rest_v = rig.input.rest_v
        low, high = max(u_min_v, 0.0), min(u_max_v, rig.input.u_max_v)
        if not low <= self.lo < self.hi <= high:
            raise InputError(
                f"the law's limits are {self.lo:g} to {self.hi:g} V; the rig allows {low:g} to "
                f"{high:g} V: narrow lo and hi of the law"
            )
        if not self.lo <= rest_v <= self.hi:
            raise InputError(
                f"the law's limits are {self.lo:g} to {self.hi:g} V, and the rig rests at "
                f"{rest_v:g} V, which must lie between them: widen lo and hi of the law"
            )

    def program(self, rig: Description) -> Program:
        """Return the law as the core evaluates it for a rig.

        Examples
        --------
        >>> from armrig_core.rig.description import builtin
        >>> law = ControlLaw(
        ...     Ts_us=10_000, outputs=(LawOutput(name="alpha", unit="rad"),), A=(), B=(), C=(),
        ...     D=1.0, x0=(), reference=Reference(name="u", unit="V", low=0.0, high=4.0),
        ... )
        >>> law.program(builtin("arm")).channels
        (1,)
        """
        channels = [*rig.outputs]
        return Program(
            law_sha256=self.sha256,
            Ts_us=self.Ts_us,
            rows=tuple((*a, *b) for a, b in zip(self.A, self.B, strict=True)),
            v_row=(*self.C, self.D),
            u0=self.u0,
            x0=self.x0,
            predictions=self.F,
            channels=tuple(channels.index(output.name) for output in self.outputs),
            y0=tuple(output.y0 for output in self.outputs),
            turning=tuple(output.turning for output in self.outputs),
            lo_code=ceil(self.lo * CODES_PER_V - _ROUNDING_CODES),
            hi_code=floor(self.hi * CODES_PER_V + _ROUNDING_CODES),
            slew=floor(self.slew * CODES_PER_V + _ROUNDING_CODES),
            input_delay=self.input_delay,
            most_blind=self.most_blind,
            most_limited=self.most_limited,
            tracked=(*self.tracking.row, self.tracking.offset) if self.tracking else None,
            most_error=self.tracking.most if self.tracking else 0.0,
            most_astray=self.tracking.samples if self.tracking else 0,
            monitor=self.monitor.program(self, rig) if self.monitor else None,
        )


def load_law(path: str | Path) -> ControlLaw:
    """Return the law in a file.

    Raises
    ------
    FileError
        The file cannot be read, or contains no law; the message names the file.

    Examples
    --------
    >>> import pathlib
    >>> law = ControlLaw(
    ...     Ts_us=10_000, outputs=(LawOutput(name="y", unit="V"),), A=(), B=(), C=(), D=1.0, x0=(),
    ...     reference=Reference(name="u", unit="V", low=0.0, high=5.0),
    ... )
    >>> _ = pathlib.Path("law.json").write_bytes(law.text)
    >>> load_law("law.json") == law
    True
    """
    try:
        return ControlLaw.of(read_bounded(Path(path), LIMIT_BYTES))
    except OSError as err:
        raise FileError(f"{path}: {err.strerror}") from err
    except InputError as err:
        raise FileError(f"{path}: {err}") from err
