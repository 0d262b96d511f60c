"""What can be asked of the daemon, and what it answers: JSON, checked field by field."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, get_args

import msgspec
from msgspec import Meta

from armrig_core import version_1
from armrig_core.calibration import Calibration
from armrig_core.codes import OutcomeCode, RefusalCode
from armrig_core.errors import InputError
from armrig_core.printable import printable
from armrig_core.rehearsal import Rehearsal
from armrig_core.volts import U_MAX_V

Volts = Annotated[float, Meta(ge=0, le=U_MAX_V, description="V")]
Seconds = Annotated[float, Meta(gt=0, le=1, description="s")]
Owner = Annotated[
    str, Meta(min_length=1, max_length=80, description="1 to 80 characters that print")
]
Lease = Annotated[str, Meta(min_length=32, max_length=32)]
Name = Annotated[str, Meta(pattern=r"^[a-z0-9-]{1,40}\Z", description="a-z, 0-9 and -")]
Counter = Annotated[int, Meta(ge=0, lt=2**53)]
Fact = str | int | float | bool | list[str | int | float | bool] | None
"""What a daemon tells of a device or a host: nothing that is nested deeper."""


MOST_SAMPLES = 4_000_000
"""Longest run: more than an hour at 1 kHz."""
MOST_NOTE = 500
"""Longest note, in characters."""


class Request(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A command without fields."""

    name: ClassVar[str]


class Arm(Request, frozen=True, kw_only=True):
    """Take the rig, at 0 V, for one owner; answered by a `LeaseGranted`."""

    name: ClassVar[str] = "arm"
    owner: Owner
    """Who takes it, for a person to read: of characters that print, and not of blanks alone."""
    Ts: Seconds | None = None
    """Sampling time, in s; the configured one where it is left out."""


class Leased(Request, frozen=True, kw_only=True):
    """A command of the owner; only a valid one renews the lease."""

    lease: Lease
    """As granted."""
    n: Counter
    """Strictly growing with each command of this lease."""


class Disarm(Leased, frozen=True, kw_only=True):
    """Give the rig back, at 0 V."""

    name: ClassVar[str] = "disarm"


class Set(Leased, frozen=True, kw_only=True):
    """Hold a voltage until the next `set`, a stop, or the end of the lease."""

    name: ClassVar[str] = "set"
    u: Volts
    """Motor voltage, in V."""


class Run(Leased, frozen=True, kw_only=True):
    """Play and record an experiment; answered by a `RunAccepted`."""

    name: ClassVar[str] = "run"
    u: Annotated[list[Volts], Meta(min_length=1, max_length=MOST_SAMPLES)]
    """Motor voltage at each sample, in V."""
    pacing: Literal["scheduled", "exchange"] = "scheduled"
    """Who makes the samples: the device's timer, or the host at each tick."""
    experiment: Name = "run"
    """Kind of experiment; part of the recording's name."""
    details: dict[str, Any] = {}
    """What the experiment was made of, such as its seed; kept in the recording."""
    dead_man: Annotated[float, Meta(ge=0.5, le=60, description="s")] | None = None
    """The run is stopped when no `renew` has come for so long, in s; left out, it plays on."""


class Renew(Leased, frozen=True, kw_only=True):
    """Show that the client of the run in hand is still there."""

    name: ClassVar[str] = "renew"


class Stop(Request, frozen=True, kw_only=True, omit_defaults=True):
    """Go to 0 V. Taken from anybody who may command, lease or not."""

    name: ClassVar[str] = "stop"
    by: str = ""
    """Who stops it, for the recording; of any length, as a stop is not refused for a name."""


class Note(Request, frozen=True, kw_only=True, omit_defaults=True):
    """Write a line into the recording of the run in hand. Taken from anybody who may stop."""

    name: ClassVar[str] = "note"
    text: Annotated[str, Meta(min_length=1, max_length=MOST_NOTE, description="prints")]
    """What happened, such as that somebody touched the arm."""
    owner: str = ""
    """Author of the note; more than 80 characters are cut off."""


class Reset(Request, frozen=True, kw_only=True):
    """Leave a latched fault, disarmed."""

    name: ClassVar[str] = "reset"


class Calibrate(Request, frozen=True, kw_only=True):
    """Use a measured calibration from now on; taken only while the rig is safe."""

    name: ClassVar[str] = "calibrate"
    calibration: Calibration
    """As in the file that `armrig calibrate` writes."""
    raw: bytes = b""
    """The samples that it was estimated from, compressed, as base64."""


class Status(Request, frozen=True, kw_only=True):
    """Ask how things are; answered by a `StatusReport`."""

    name: ClassVar[str] = "status"


MOST_REMOTE_BYTES = (8 << 20) - (64 << 10)
"""Longest command over a network, in B: 8 MiB less what zenoh writes around it."""
MOST_DETAILS = 1 << 20
"""Longest `details` of a run, as JSON in B."""
Requests = Arm | Disarm | Run | Renew | Set | Stop | Note | Reset | Calibrate | Status
"""Any command."""
REQUESTS: dict[str, type[Requests]] = {r.name: r for r in get_args(Requests)}
"""Class of each command."""


class LeaseGranted(msgspec.Struct, frozen=True, kw_only=True):
    """The rig is armed, at 0 V."""

    lease: Lease
    """To be carried by each command."""
    period_s: float
    """A held voltage falls to 0 V when no valid command came for so long, in s."""
    Ts: Seconds
    """Sampling time in force, in s."""
    u_min: Volts
    """Lowest voltage taken, in V."""
    u_max: Volts
    """Highest voltage taken, in V."""


class RunAccepted(msgspec.Struct, frozen=True, kw_only=True):
    """The experiment begins."""

    run_id: str
    """Names this run in the recording, in events and in `StatusReport`."""
    recording: str
    """Path of the recording once it is finished."""
    rehearsal: Rehearsal | None = None
    """What the model of the rig does under the input."""


class Done(msgspec.Struct, frozen=True, kw_only=True):
    """The command was carried out."""

    done: bool
    """False where there was nothing to do."""


class LastRun(msgspec.Struct, frozen=True, kw_only=True):
    """The newest recording."""

    run_id: str
    recording: str
    """Path; ends in .active while it is written."""
    finished: bool
    """Whether it is complete on the disk."""
    samples: Counter
    """Samples taken so far."""
    synced: Counter = 0
    """Samples that are on the disk, whatever dies: counted once a second, at the end all."""
    outcome: str
    """`complete`, or why it ended early; empty while it runs."""
    code: str = ""
    """How it ended, for programs: an `OutcomeCode`; empty while it runs, and from a daemon of
    version 1."""

    @property
    def is_complete(self) -> bool:
        """Whether the run has ended with its last sample."""
        return (self.code or version_1.outcome_code(self.outcome)) == OutcomeCode.COMPLETE


class StatusReport(msgspec.Struct, frozen=True, kw_only=True):
    """How the daemon is."""

    rig: str
    version: str
    phase: str
    reason: str
    """Why it is in a fault; empty elsewhere."""
    fault: str = ""
    """Id of the fault, for programs; empty where there is none."""
    motor: str = ""
    """What is known of the motor."""
    remedy: str = ""
    """What to do about the fault."""
    owner: str
    Ts: Seconds
    u_min: Volts
    u_max: Volts
    endpoint: str
    """Where zenoh peers connect."""
    device: dict[str, Fact]
    """What the device said of itself."""
    line: str = ""
    """Why no device answers, and what to try; empty where one does."""
    host: dict[str, Fact]
    """What the host allows: scheduling, locked memory."""
    last_run: LastRun | None
    recordings: str
    """Directory of the recordings."""
    calibration: str = ""
    """File and date of the calibration in force; empty where the daemon does not say."""
    calibration_sha256: str = ""
    """Hash of the calibration in force, as its recordings carry it."""
    calibration_file: str = ""
    """File that the daemon's configuration names, in force or not; empty where it names none."""
    arm_removed: bool = False
    """Whether the configuration says that the rotating part is taken off."""
    owner_checked: str = ""
    """What the daemon has checked of the owner, such as `certificate alice`; empty for nothing."""


_FILLERS = "\u115f\u1160\u3164\uffa0"


class Refused(msgspec.Struct, frozen=True, kw_only=True):
    """The command had no effect."""

    error: str
    """What came, what is allowed, what to do; for a person."""
    code: str = ""
    """Why, for programs: a `RefusalCode`; empty from a daemon that sends none."""
    passes: bool | None = None
    """Whether it passes by itself; None from a daemon that sends no code."""
    parameters: dict[str, Fact] = {}
    """What the sentence is about, by name, such as the owner who holds the rig."""


def refused(code: RefusalCode, error: str, **parameters: Fact) -> Refused:
    """Return a refusal for a reason that has a code."""
    return Refused(error=error, code=code, passes=code.passes, parameters=parameters)


class CommandRefusedError(InputError):
    """A command is refused for a reason that has a code."""

    def __init__(self, refusal: Refused) -> None:
        """Take the refusal, whose sentence is the message."""
        super().__init__(refusal.error)
        self.refusal = refusal


def parse(name: str, payload: bytes) -> Requests:
    """Return the command `name` with its fields from JSON.

    Raises
    ------
    ValueError
        No such command, no JSON, or a field that is not allowed; the message names it.
    """
    kind = REQUESTS.get(name)
    if kind is None:
        raise InputError(f"command {name!r}: allowed are {', '.join(REQUESTS)}")
    try:
        request = msgspec.json.decode(payload or b"{}", type=kind)
    except msgspec.DecodeError as err:  # ValidationError is one of them
        raise InputError(f"{name}: {err}") from err
    except RecursionError as err:
        raise InputError(f"{name}: nested too deeply") from err
    if isinstance(request, Arm) and not _is_name(request.owner):
        # It is shown to all who ask for the state: an escape sequence would reach their terminals.
        raise InputError(
            f"arm: owner '{printable(request.owner)}': allowed are 1 to 80 characters that print, "
            "one of them a letter or a digit"
        )
    if isinstance(request, Note):
        check_note(request.text)
    if isinstance(request, Run) and len(msgspec.json.encode(request.details)) > MOST_DETAILS:
        raise InputError(
            f"run: details take more than the {MOST_DETAILS} B of JSON that are allowed"
        )
    return request


def check_note(text: str) -> None:
    """Raise ValueError if a text is not allowed as a note."""
    if len(text) > MOST_NOTE or not text.isprintable() or not text.strip(f" {_FILLERS}"):
        raise InputError(
            f"note: text '{printable(text)}': allowed are 1 to {MOST_NOTE} characters that "
            "print, on one line, and not blanks alone"
        )


def _is_name(owner: str) -> bool:
    """Tell whether an owner can be read: Hangul's fillers are letters that show nothing."""
    return owner.isprintable() and any(c.isalnum() and c not in _FILLERS for c in owner)


def json_schema(name: str) -> bytes:
    """Return the JSON Schema of a command's fields."""
    return msgspec.json.encode(msgspec.json.schema(REQUESTS[name]))
