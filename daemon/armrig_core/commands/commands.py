"""Commands to the daemon and the replies of the daemon: JSON texts with checked fields."""

from __future__ import annotations

from math import ceil, degrees
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_args

import msgspec
from msgspec import UNSET, Meta, UnsetType

from armrig_core.commands.codes import OutcomeCode, RefusalCode
from armrig_core.control.control_law import ControlLaw
from armrig_core.errors import InputError, ParameterError
from armrig_core.process.printable import printable
from armrig_core.rig.calibration import Calibration
from armrig_core.rig.description import Description, builtin
from armrig_core.rig.volts import U_MAX_V

Volts = Annotated[float, Meta(ge=0, le=U_MAX_V, description="V")]
Seconds = Annotated[float, Meta(gt=0, le=1, description="s")]
Owner = Annotated[
    str, Meta(min_length=1, max_length=80, description="1 to 80 characters that print")
]
Lease = Annotated[str, Meta(min_length=32, max_length=32)]
Name = Annotated[str, Meta(pattern=r"^[a-z0-9-]{1,40}\Z", description="a-z, 0-9 and -")]
Counter = Annotated[int, Meta(ge=0, lt=2**53)]
_T = TypeVar("_T")
Time = Annotated[int, Meta(ge=0, lt=2**62, description="ns")]
Fact = str | int | float | bool | list[str | int | float | bool] | None
"""A value that a daemon reports about a device or a host; no deeper nesting is allowed."""


MOST_SAMPLES = 4_000_000
"""Longest run, in samples: more than an hour at 1 kHz."""
MOST_REFERENCES = 1_000_000
"""Longest run in control, in samples: 2.7 hours at 100 Hz."""
LONGEST_TS, LONGEST_SAMPLE_S = 60.0, 1.0
"""Longest sampling time, and longest time between two samples of a device, in s."""
EVERY = "every"
"""Name of a detail of a run: the number of samples in which a client plays each voltage, so that
the sampling time is above 1 s."""
UNTIL = "until"
"""Name of a detail of a run that its client stops when the outputs have settled."""
MOST_NOTE_LENGTH = 500
"""Longest note, in characters."""


class Rehearsal(msgspec.Struct, frozen=True, kw_only=True, repr_omit_defaults=True):
    """Response of the model to an input, from standstill."""

    revolutions: float = 0.0
    """Largest rotation of the chassis from its start, in either direction, in turns."""
    alpha_rad: float = 0.0
    """Largest deflection of the arm, in either direction, in rad."""
    turned_rad: float = 0.0
    """Rotation of the chassis at the end, from its start, in rad."""
    theta_1_rad: float | None = None
    """Angle of the chassis at the end, turns included, in rad; None if the start is unknown."""
    outputs: dict[str, tuple[float, float, str]] | UnsetType = UNSET
    """Lowest and highest value of each output, and its unit, for a rig with a model of its own."""

    @property
    def deflects(self) -> bool:
        """True if the model has an arm that the input deflects."""
        return self.alpha_rad > 0


def rehearsal_sentence(rehearsal: Rehearsal) -> str:
    """Return the result as a line for a person."""
    if rehearsal.outputs:
        ranges = (
            f"{name} from {low:.3g} to {high:.3g} {unit}"
            for name, (low, high, unit) in rehearsal.outputs.items()
        )
        return f"rehearsed on the model: {', '.join(ranges)}"
    return (
        f"rehearsed on the model: the chassis turns {rehearsal.revolutions:.1f} times and ends "
        f"{degrees(rehearsal.turned_rad):.0f}° from its start; "
        f"the arm deflects by up to {degrees(rehearsal.alpha_rad):.1f}°"
    )


class DaemonRequest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A command without fields."""

    name: ClassVar[str]


class ArmRequest(DaemonRequest, frozen=True, kw_only=True):
    """Reserve the rig, at 0 V, for one owner; the reply is a `LeaseGranted`."""

    name: ClassVar[str] = "arm"
    owner: Owner
    """Name of the owner, for people to read: printable, with at least one letter or digit."""
    Ts: Seconds | None = None
    """Sampling time, in s; default: the configured sampling time."""


class LeasedRequest(DaemonRequest, frozen=True, kw_only=True, omit_defaults=True):
    """A command of the owner; only a valid command renews the lease."""

    lease: Lease
    """Lease from `LeaseGranted`."""
    n: Counter
    """Number of the command; it must increase with each command of this lease."""
    valid_until_ns: Time | None = None
    """Time until which the client waits for the reply, on the clock of `LeaseGranted.now_ns`.

    A later command is refused, so that no motor moves for a client that has given up. A command
    over a network needs this time, except `disarm`.
    """


class DisarmRequest(LeasedRequest, frozen=True, kw_only=True):
    """Release the rig, at 0 V."""

    name: ClassVar[str] = "disarm"


class SetRequest(LeasedRequest, frozen=True, kw_only=True):
    """Hold a voltage until the next `set`, a stop, or the end of the lease."""

    name: ClassVar[str] = "set"
    u: Volts
    """Motor voltage, in V."""


class SetReferenceRequest(LeasedRequest, frozen=True, kw_only=True):
    """Follow another reference from the next sample to the end of a run under a law."""

    name: ClassVar[str] = "set_reference"
    r: float
    """Reference, in the unit of the law, inside the range of the rehearsed reference."""


class RunOptions(LeasedRequest, frozen=True, kw_only=True):
    """Command `run` without its input."""

    name: ClassVar[str] = "run"
    pacing: Literal["scheduled", "exchange"] = "scheduled"
    """Source of the sampling instants: the device's timer, or the host at each tick."""
    experiment: Name = "run"
    """Kind of experiment; part of the recording's name."""
    details: dict[str, Any] = {}
    """Parameters of the experiment, such as its seed; the recording contains them."""
    dead_man: Annotated[float, Meta(ge=0.5, le=60, description="s")] | None = None
    """Longest time without a `renew`, in s, after which the run stops; None: no limit."""


class RunRequest(RunOptions, frozen=True, kw_only=True):
    """Play and record an experiment; the reply is a `RunAccepted`.

    The reply may take long, because the input is rehearsed on the model of the rig. Meanwhile the
    client sends `renew`, with the new time until which it waits.
    """

    u: Annotated[list[Volts], Meta(min_length=1, max_length=MOST_SAMPLES)]
    """Motor voltage at each sample, in V."""


class ControlOptions(RunOptions, frozen=True, kw_only=True):
    """Command `control` without its reference."""

    name: ClassVar[str] = "control"
    pacing: Literal["exchange"] = "exchange"
    experiment: Name = "control"
    dead_man: Annotated[float, Meta(ge=0.5, le=60, description="s")] = 1.0
    law: ControlLaw | None = None
    """Law, as in its file; without a law, the client sets each voltage with `set`."""
    unstable: bool = False
    """True to allow a closed loop whose rehearsal is unstable, inside the limits of the outputs."""
    unmonitored: bool = False
    """True to allow a law without a monitor."""


class ControlRequest(ControlOptions, frozen=True, kw_only=True):
    """Control the rig by a law or by the client, and record it; the reply is a `RunAccepted`.

    The reply may take long, as that of `run`, because the closed loop is rehearsed.
    """

    reference: Annotated[list[float], Meta(min_length=1, max_length=MOST_REFERENCES)]
    """Reference at each sample, in the unit of the law."""


class Renew(LeasedRequest, frozen=True, kw_only=True):
    """Show that the client of the current run, or of the run in preparation, is still alive."""

    name: ClassVar[str] = "renew"


class StopRequest(DaemonRequest, frozen=True, kw_only=True, omit_defaults=True):
    """Go to 0 V. Every client that may send commands may send a stop, with or without a lease."""

    name: ClassVar[str] = "stop"
    by: str = ""
    """Name of the client, for the recording. A name of any length is allowed, because a name must
    not prevent a stop."""


class NoteRequest(DaemonRequest, frozen=True, kw_only=True, omit_defaults=True):
    """Write a line into the current run's recording.

    Every client that may send a stop may send a note.
    """

    name: ClassVar[str] = "note"
    text: Annotated[str, Meta(min_length=1, max_length=MOST_NOTE_LENGTH, description="prints")]
    """Text of the note, such as "touched the arm"."""
    owner: str = ""
    """Author of the note; characters after the 80th are cut off."""


class ResetRequest(DaemonRequest, frozen=True, kw_only=True, omit_defaults=True):
    """Clear a latched fault; the rig is then disarmed."""

    name: ClassVar[str] = "reset"
    fault: str | None = None
    """Id of the fault that is cleared; another fault stays. Required over a network."""
    valid_until_ns: Time | None = None
    """As in `LeasedRequest`: a late command would clear a newer fault. Required over a network."""


class CalibrateRequest(DaemonRequest, frozen=True, kw_only=True, omit_defaults=True):
    """Use a measured calibration from now on; accepted only while the rig is safe."""

    name: ClassVar[str] = "calibrate"
    replaces: str | None = None
    """Hash of the calibration that is replaced; another one stays. Required over a network."""
    valid_until_ns: Time | None = None
    """As in `LeasedRequest`. Required over a network."""
    calibration: Calibration
    """Contents of the file that `armrig calibrate` writes."""
    raw: bytes = b""
    """Samples from which the calibration was estimated, compressed, as base64."""


class Status(DaemonRequest, frozen=True, kw_only=True):
    """Request the state of the daemon and the rig; the reply is a `StatusReport`."""

    name: ClassVar[str] = "status"


MOST_REMOTE_BYTES = (8 << 20) - (64 << 10)
"""Longest command over a network, in B: 8 MiB minus zenoh's own part of the message."""
MOST_DETAILS_BYTES = 1 << 20
"""Longest JSON text of a run's `details`, in B."""
Requests = (
    ArmRequest
    | DisarmRequest
    | RunRequest
    | ControlRequest
    | Renew
    | SetRequest
    | SetReferenceRequest
    | StopRequest
    | NoteRequest
    | ResetRequest
    | CalibrateRequest
    | Status
)
"""Any command."""
REQUESTS: dict[str, type[Requests]] = {r.name: r for r in get_args(Requests)}
"""Class of each command, by the command's name."""


class LeaseGranted(msgspec.Struct, frozen=True, kw_only=True):
    """Reply to `arm`: the rig is armed, at 0 V."""

    lease: Lease
    """Lease that each command must contain."""
    period_s: float
    """Time without a valid command after which a held voltage falls to 0 V, in s."""
    Ts: Seconds
    """Current sampling time, in s."""
    u_min: Volts
    """Lowest accepted voltage, in V."""
    u_max: Volts
    """Highest accepted voltage, in V."""
    now_ns: Time = 0
    """Time of the reply on the daemon's clock, in ns (CLOCK_BOOTTIME); 0 in an older release."""
    rest_v: Volts = 0.0
    """Voltage at which the actuator does nothing, in V."""


class RunAccepted(msgspec.Struct, frozen=True, kw_only=True):
    """Reply to `run`: the experiment begins."""

    run_id: str
    """Id of the run in the recording, in events and in `StatusReport`."""
    recording: str
    """Path of the finished recording."""
    rehearsal: Rehearsal | None = None
    """Response of the rig's model to the input."""


class Done(msgspec.Struct, frozen=True, kw_only=True):
    """Reply to a command that was carried out."""

    done: bool
    """False if the command changed nothing."""


class LastRun(msgspec.Struct, frozen=True, kw_only=True):
    """The newest recording."""

    run_id: str
    recording: str
    """Path of the file; it ends in .active while the daemon writes the file."""
    finished: bool
    """True if the file is complete on the disk."""
    samples: Counter
    """Number of samples of the run so far."""
    synced: Counter = 0
    """Number of samples that are safely on the disk; updated once a second and at the end."""
    outcome: str
    """`complete`, or the reason of an early end; empty during the run."""
    code: str = ""
    """Outcome for programs, an `OutcomeCode`; empty during the run."""

    @property
    def is_complete(self) -> bool:
        """True if the run has ended with its last sample."""
        return self.code == OutcomeCode.COMPLETE


class OutputRange(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Limits of an output: a value outside, or a rotation of `turns`, ends a run."""

    low: float | None = None
    """Lowest value, in the output's unit."""
    high: float | None = None
    """Highest value, in the output's unit."""
    turns: float = 0.0
    """Largest rotation from the start of a run, in turns; 0 is no limit."""


class StatusReport(msgspec.Struct, frozen=True, kw_only=True):
    """State of the daemon, the rig and the newest recording."""

    rig: str
    version: str
    phase: str
    reason: str
    """Reason of the fault; empty without a fault."""
    fault: str = ""
    """Id of the fault, for programs; empty without a fault."""
    motor: str = ""
    """State of the motor, as far as the daemon knows it."""
    remedy: str = ""
    """Remedy of the fault."""
    owner: str
    Ts: Seconds
    u_min: Volts
    u_max: Volts
    endpoint: str
    """Endpoint to which zenoh peers connect."""
    device: dict[str, Fact]
    """Properties that the device reported."""
    line: str = ""
    """Reason why no device answers, and advice; empty if a device answers."""
    host: dict[str, Fact]
    """Properties of the host: scheduling, locked memory."""
    last_run: LastRun | None
    recordings: str
    """Directory of the recordings."""
    calibration: str = ""
    """File and date of the current calibration; empty if the daemon does not report them."""
    calibration_sha256: str = ""
    """Hash of the current calibration, as in the daemon's recordings."""
    calibration_file: str = ""
    """Path of the configured calibration file, even if it is not in use; empty if none is set."""
    arm_removed: bool = False
    """True if the configuration states that the rotating part is removed."""
    owner_checked: str = ""
    """Verified identity of the owner, such as `certificate alice`; empty if none was verified."""
    limits: dict[str, OutputRange] = {}
    """Limits in force, by the name of the output; an output without a limit is absent."""
    now_ns: Time = 0
    """Time of the report on the daemon's clock, as in `LeaseGranted`."""
    description: str | UnsetType = UNSET
    """Description of the rig, as in its file; absent for the arm."""

    @property
    def described(self) -> Description:
        """Description of the rig."""
        return Description.of(self.description.encode()) if self.description else builtin("arm")


_FILLERS = "\u115f\u1160\u3164\uffa0"  # Hangul fillers: letters without a visible glyph


class Refused(msgspec.Struct, frozen=True, kw_only=True):
    """Reply to a command that had no effect."""

    error: str
    """Reason, allowed values and remedy, for a person."""
    code: str = ""
    """Reason for programs, a `RefusalCode`; empty if the reply is not the daemon's own."""
    passes: bool = False
    """True if the refusal is temporary."""
    parameters: dict[str, Fact] = {}
    """Values in the sentence `error`, by name, such as the owner of the rig."""


def build_refusal(code: RefusalCode, error: str, **parameters: Fact) -> Refused:
    """Return a refusal with a code."""
    return Refused(error=error, code=code, passes=code.passes, parameters=parameters)


class CommandRefusedError(InputError):
    """A command was refused, with a code."""

    def __init__(self, refusal: Refused) -> None:
        """Use the refusal's sentence as the message."""
        super().__init__(refusal.error)
        self.refusal = refusal


def parse(name: str, payload: bytes) -> Requests:
    """Return the command `name` with its fields decoded from JSON.

    Raises ValueError if the command is unknown, the payload is not JSON, or a field is not allowed;
    the message names the cause.
    """
    kind = REQUESTS.get(name)
    if kind is None:
        raise InputError(f"command {name!r}: allowed are {', '.join(REQUESTS)}")
    request = decode(name, payload, kind)
    if isinstance(request, ArmRequest) and not _is_name(request.owner):
        # Clients print the name of the owner: an escape sequence in it would reach their terminals.
        raise InputError(
            f"arm: owner '{printable(request.owner)}': allowed are 1 to 80 printable characters, "
            "one of them a letter or a digit"
        )
    if isinstance(request, NoteRequest):
        check_note(request.text)
    if isinstance(request, RunOptions):
        check_details(request.details)
    return request


def decode(name: str, payload: bytes | bytearray, kind: type[_T]) -> _T:
    """Decode the JSON of the command `name`; raise InputError, which names the command."""
    try:
        return msgspec.json.decode(payload or b"{}", type=kind)
    except msgspec.DecodeError as err:  # ValidationError is one of them
        raise InputError(f"{name}: {err}") from err
    except RecursionError as err:
        raise InputError(f"{name}: nested too deeply") from err


def check_details(details: dict[str, Any]) -> None:
    """Raise InputError if the details of a run are too long."""
    if len(msgspec.json.encode(details)) > MOST_DETAILS_BYTES:
        raise InputError(f"run: details have more than {MOST_DETAILS_BYTES} B of JSON")


def check_note(text: str) -> None:
    """Raise ValueError if a text is not allowed as a note."""
    if len(text) > MOST_NOTE_LENGTH or not text.isprintable() or not text.strip(f" {_FILLERS}"):
        raise InputError(
            f"note: text '{printable(text)}': allowed are 1 to {MOST_NOTE_LENGTH} printable "
            "characters on one line, not only blanks"
        )


def _is_name(owner: str) -> bool:
    """Return whether an owner's name is printable, with at least one letter or digit."""
    return owner.isprintable() and any(c.isalnum() and c not in _FILLERS for c in owner)


def json_schema(name: str) -> bytes:
    """Return the JSON Schema of a command's fields."""
    return msgspec.json.encode(msgspec.json.schema(REQUESTS[name]))


def samples_of(Ts: float, longest_s: float = LONGEST_SAMPLE_S) -> int:
    """Return the number of samples, at most `longest_s` apart, in which each voltage is played.

    The time between two samples is a whole number of microseconds, if one is possible.

    Raises
    ------
    ParameterError
        The sampling time is not allowed.

    Examples
    --------
    >>> samples_of(0.01), samples_of(2.5)
    (1, 4)
    """
    if not 0 < Ts <= LONGEST_TS:
        allowed = f"must be more than 0 and at most {LONGEST_TS:g}, in seconds; 10 ms are 0.01"
        raise ParameterError("Ts", f"{Ts:g}", allowed)
    least = ceil(Ts / longest_s - 1e-9)
    counts = (n for n in range(least, 2 * least) if round(Ts * 1e6) % n == 0)
    return next(counts, least)
