"""State of the core (`step.step`) as one immutable value; events and actions of the core."""

from __future__ import annotations

from enum import StrEnum
from typing import Any, NamedTuple

import msgspec
from armrig_core.commands.codes import Ending, GapCode, OutcomeCode
from armrig_core.control.evaluation import Latch, LawState, Program, ReferenceValues
from armrig_core.rig.calibration import Calibration, Potentiometer
from armrig_core.rig.channels import Conversion
from armrig_core.rig.emulated import EMULATOR_UID
from armrig_core.telemetry.telemetry import Sample
from armrig_protocol.messages import Config, Flag, HelloReply, Mode, Underrun
from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from armrig_daemon.decisions.clockmap import ClockMap
from armrig_daemon.decisions.faults import Fault
from armrig_daemon.pipe import Order, Record, Run


class Phase(StrEnum):
    """Phase of the daemon; see ARCHITECTURE.md."""

    INIT = "init"
    """The daemon waits for a device to answer and to accept its configuration."""
    SAFE = "safe"
    """Sampling at 0 V; no owner holds the rig."""
    ARMED = "armed"
    """An owner holds the rig, at 0 V."""
    ACTIVE = "active"
    """The input drives the motor."""
    FAULT = "fault"
    """Latched at 0 V until a reset."""


class RequestKind(StrEnum):
    """Kind of a request to the device."""

    HELLO = "HELLO"
    CONFIGURE = "CONFIG"
    ARM = "ARM"
    START = "START"
    STOP = "STOP"
    CLEAR = "CLEAR_FAULT"


class Value(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """Value that a trace contains as a list; it is created in a third of a named tuple's time."""


class OutputLimit(Value, frozen=True):
    """Limit of a measured output, fixed at the start."""

    channel: int
    name: str
    unit: str
    low: float | None
    """Lowest allowed value; None without a limit, because JSON has no infinite number."""
    high: float | None
    """Highest allowed value; None without a limit."""
    samples: int
    """Number of consecutive valid samples outside `low` to `high` after which the rig stops."""
    blind_ns: int
    """Time without a valid sample after which the rig stops, in ns; 0 is no limit."""
    blind_grows: bool = False
    """True if the blind time is at least 5 sampling times."""
    sides_of_rails: tuple[str, str] = ("", "")
    """Side of the limits, "below" or "above", on which a reading at the low and at the high end of
    the range is; "" for no value."""
    rail_samples: int = 0
    """Number of consecutive samples without a value, at an end of the range, after which the rig
    stops; 0 is no limit. The device counts them if no end of a range is a value."""

    def blind_after_ns(self, ts_us: int) -> int:
        """Return the time without a valid sample after which the rig stops, in ns; 0 is none."""
        return max(self.blind_ns, 5_000 * ts_us) if self.blind_grows else self.blind_ns


class OutputWatch(Value, frozen=True):
    """State of a limited output."""

    outside: int
    """Number of consecutive valid samples outside the limits, at most `OutputLimit.samples`."""
    valid_ns: int
    """Time at which the newest valid sample was requested, in ns."""
    value: float
    """Newest valid value; NaN before the first one. It is infinite for a reading at an end of the
    range that is outside the limits."""
    at_rail: int = 0
    """Number of consecutive samples without a value, at an end of the range, at most
    `OutputLimit.rail_samples`."""


class Image(Value, frozen=True):
    """Image of the firmware that the rig needs, fixed at the start."""

    name: str
    crc: int
    """CRC in HELLO_R; 0 if a firmware that armrig does not know is allowed, too."""
    others: tuple[int, ...] = ()
    """CRC of each image for other pins, which is refused."""

    def fits(self, crc: int) -> bool:
        """Return whether a firmware, by its CRC, drives the pins of the rig; 0 is no CRC."""
        return crc != 0 and crc not in self.others and self.crc in (0, crc)


_RUN = int(Flag.RUN)  # int: `&` of two Flags takes 0.5 µs
Conversions = tuple[Conversion, Conversion] | tuple[Potentiometer, Potentiometer]


class Rules(msgspec.Struct, frozen=True, kw_only=True):
    """Configuration of the core, fixed at the start except for the calibration."""

    code_min: int
    """Lowest code that a command may contain."""
    code_max: int
    """Highest code that a command may contain."""
    rest_code: int = 0
    """Code at which the actuator does nothing; every code that no command contains is this one."""
    slew: int
    """Largest change of the code in one sample; 0 is no limit."""
    ts_us: int
    """Sampling time, in µs, if a command contains no sampling time."""
    watchdog_ms: int
    """Time after which the device's watchdog stops the motor, in ms."""
    baud: int
    """Speed of the wire, in bit/s."""
    turns: int
    """Largest rotation of channel 0 in a run, in hundredths of a turn; 0 is no limit."""
    rail_ticks: int
    """Consecutive samples at a rail after which a run ends with FAULT(ADC_RAIL); 0 is no limit."""
    oversampling: int = 1
    """Number of conversions averaged in one reading; 1 in a trace without this field."""
    calibration: Calibration
    described: tuple[Conversion, Conversion] | UnsetType = UNSET
    """Conversions of a rig that is described in a file; without them, `calibration` converts."""
    limits: tuple[OutputLimit, ...] | UnsetType = UNSET
    """Limits of measured outputs; without them, no measured output stops the motor."""
    is_emulated: bool = False
    """True if the port shows that the rig is emulated."""
    image: Image | UnsetType = UNSET
    """Firmware that the rig needs; without it, any firmware with this protocol is driven."""
    service_ns: int = 0
    """Silence of the service after which the motor is stopped, in ns; 0 without a service."""

    stop_after: int
    """Number of consecutive missed ticks after which the motor is stopped; 0 is no limit."""

    @property
    def rest(self) -> str:
        """Return where the input is while nothing drives the rig, as text for a person."""
        return "rest" if self.rest_code else "0 V"

    def acting_code(self, code: int, flags: int) -> int:
        """Return the code that acts on the rig, by the code and the flags of a sample.

        Outside RUN the device reports 0, its driver is off, and the rig rests.
        """
        return code if code or flags & _RUN else self.rest_code

    @property
    def conversions(self) -> Conversions:
        """Return the conversions of the channels, in the order of the device's readings."""
        return self.described or self.calibration.channels

    def age_ns(self, ts_us: int, *, scheduled: bool = False) -> int:
        """Return the age of the last round trip, in ns, beyond which the motor is stopped.

        A device in a scheduled run continues without the host until its watchdog stops the motor.
        """
        return self._watchdog_ns if scheduled else max(50_000_000, 3_000 * ts_us)

    def pause_ns(self, ts_us: int, *, scheduled: bool = False) -> int:
        """Return the time between two ticks, in ns, beyond which the motor is stopped."""
        return self._watchdog_ns if scheduled else max(50_000_000, 5_000 * ts_us)

    @property
    def _watchdog_ns(self) -> int:
        return self.watchdog_ms * 1_000_000

    def allows(self, before: int, code: int) -> bool:
        """Return whether `code` is within the limits and may follow the code `before`."""
        inside = self.code_min <= code <= self.code_max
        return inside and (self.slew == 0 or abs(code - before) <= self.slew)

    def lease_ns(self, ts_us: int) -> int:
        """Return the time, in ns, for which a voltage set by hand is held without a new command."""
        return max(100_000_000, 5_000 * ts_us)

    def config(self, ts_us: int, seq: int, *, scheduled: bool) -> Config:
        """Return the CONFIG message that requests a configuration of the device."""
        return Config(
            state=0,
            seq=seq,
            ts_us=ts_us,
            # Rest is always allowed, because the input rests between START and the first sample.
            u_min=min(self.code_min, self.rest_code),
            u_max=self.code_max,
            u_rest=self.rest_code,
            slew=self.slew,
            watchdog_ms=self.watchdog_ms,
            mode=Mode.SCHEDULED if scheduled else Mode.EXCHANGE,
            underrun=Underrun.ZERO,
            hold=0,
            oversampling=self.oversampling,
            rail_ticks=self.rail_ticks,
            turns=self.turns,
        )


class PendingRequest(NamedTuple):
    """Request to the device that has had no effect yet."""

    want: RequestKind
    sent_ns: int
    seq: int
    tries: int
    ts_us: int
    """Sampling time that CONFIG requests, in µs."""
    scheduled: bool
    """True if CONFIG requests scheduled mode."""
    order: Order | None
    """Order that is answered when the request takes effect; None if no order caused the request."""


class Traffic(NamedTuple):
    """Numbers of bytes and frames that have arrived since the first unanswered HELLO."""

    bytes: int = 0
    frames: int = 0
    """Frames without an error."""


class Sent(Value, frozen=True):
    """EXCHANGE whose SAMPLE has not arrived."""

    seq: int
    k: int
    sched_ns: int
    sent_ns: int
    code: int
    device_seq: int | None = None
    """`LinkState.device_seq` when the EXCHANGE was sent. The number of the answer must be newer."""


class PendingGap(NamedTuple):
    """Missing samples: detected at a tick, and reported before the next sample."""

    k: int
    n: int
    reason: str
    code: int | None
    """Code latched during the samples, as far as known; None if the code before was held."""
    t_from_ns: int
    t_to_ns: int
    reason_code: GapCode


class Lease(msgspec.Struct, frozen=True, gc=False):
    """Lease of the rig, and its owner."""

    lease: str
    owner: str
    ts_us: int
    """Sampling time that the owner requested."""
    n: int
    """Number of the newest command."""
    renewed_ns: int
    owner_checked: str = ""
    """Identity of the owner that the service has verified; empty if none was verified."""


class ChangedReference:
    """Reference of a run after commands that have set another one."""

    __slots__ = ("_attached", "_changes")

    def __init__(self, attached: memoryview[float], changes: tuple[tuple[int, float], ...]) -> None:
        """Take the attached reference, and the first sample and r of each command."""
        self._attached, self._changes = attached, changes

    def __getitem__(self, k: int) -> float:
        """Return r[k]: that of the newest command for this sample, or the attached one."""
        for first, r in reversed(self._changes):
            if k >= first:
                return r
        return self._attached[k]


class RunLaw(msgspec.Struct, frozen=True, gc=False):
    """Law of a run in control, with its reference and its state."""

    law: Program
    latch: Latch
    reference: bytes
    """Attached reference: one float64, little-endian, for each sample."""
    state: LawState
    r_range: tuple[float, float] = (0.0, 0.0)
    """Least and largest value of the reference that was rehearsed."""
    reference_n: int = 0
    """Number of the command that set the reference; 0 for that of the run's beginning."""
    changes: tuple[tuple[int, float], ...] = ()
    """References that commands have set: the first sample of each, ascending, and r. A reference
    that no later sample needs is left out."""

    @property
    def values(self) -> ReferenceValues:
        """Return the reference as numbers, in the order of bytes of this machine."""
        attached = memoryview(self.reference).cast("d")
        return ChangedReference(attached, self.changes) if self.changes else attached

    def with_reference(self, r: float, n: int, first: int) -> RunLaw:
        """Return this law with the reference r, of command number n, from sample `first` on.

        The time does not depend on the length of the run, because a tick may be due.
        """
        earlier = [change for change in self.changes if change[0] < first]
        in_force = max((i for i, (k, _) in enumerate(earlier) if k <= self.state.k), default=0)
        changes = (*earlier[in_force:], (first, r))
        return replace(self, changes=changes, reference_n=n)


class OwnControl(msgspec.Struct, frozen=True, gc=False):
    """Run whose voltages its client sets: the reference, and the state at the newest tick."""

    reference: bytes
    """One float64, little-endian, for each sample."""
    code: int
    n: int
    """Number of the newest command of the lease."""
    missed: int = 0
    """Number of ticks so far without a new command."""


class ActiveRun(msgspec.Struct, frozen=True, gc=False):
    """Experiment that is planned or running."""

    run_id: str
    codes: bytes
    """One u16, little-endian, for each sample; empty in control."""
    k_first: int
    """Number k of the run's first sample; -1 before the first sample."""
    scheduled: bool = False
    """True if the device's timer paces the run."""
    due: int = 0
    """Index of the next sample to arrive in a scheduled run, or to request in exchange mode."""
    t_zero_ns: int = 0
    """In a scheduled run: the host's estimate of the time at which sample 0 was due."""
    control: RunLaw | UnsetType = UNSET
    """Law that determines each code of the run; without it, the code is one of `codes`."""
    own: OwnControl | UnsetType = UNSET
    """Set if each code is that of a `set` of the client."""

    @property
    def samples(self) -> int:
        """Return the length of the experiment in samples."""
        controlled = self.control or self.own
        return len(controlled.reference) // 8 if controlled else len(self.codes) // 2

    def code(self, i: int) -> int:
        """Return u[i]."""
        return self.codes[2 * i] | self.codes[2 * i + 1] << 8

    def code_before(self, i: int, rest_code: int) -> int:
        """Return u[i - 1]; the rest code before the first sample."""
        return self.code(i - 1) if i else rest_code


class Queue(msgspec.Struct, frozen=True, gc=False):
    """Setpoints of a scheduled run on their way to the device."""

    order: Run | None
    """Order of the run; None after the answer to the order."""
    base: int = 0
    """Index of the next sample that the device takes."""
    held: int = 0
    """The device has all setpoints before this index."""
    sent: int = 0
    """All setpoints before this index were sent."""
    moved_ns: int = 0
    """Time at which `held` last grew, or at which a frame that begins at `held` was last sent."""
    asked_ns: int = 0
    """Time of the run's order."""


class Unechoed(Value, frozen=True):
    """Frame whose echo has not arrived; the echo proves that the device has received the frame."""

    seq: int
    sent_ns: int


# The names of the fields are keys in a trace; `name=` keeps the earlier key of a renamed field.
class LinkState(msgspec.Struct, frozen=True, gc=False):
    """State of the link to the device while the port is open."""

    pending: bytes = b""
    """Bytes of an unfinished frame from the device."""
    seq: int = 0
    """Sequence number of the next frame to the device."""
    last_send_ns: int = msgspec.field(default=0, name="any_ns")
    """Time of the last frame to the device."""
    device_seq: int | None = None
    """Sequence number of the newest frame from the device; None before its first frame."""
    sent: tuple[Sent, ...] = ()
    beats: tuple[Unechoed, ...] = ()
    """In a scheduled run: frames whose echo has not arrived yet."""
    last_round_trip_ns: int = msgspec.field(default=0, name="fresh_ns")
    """Send time of the newest frame that the device has answered or echoed (S4)."""
    ping_ns: int = 0
    """Time of the last PING."""
    came: Traffic = Traffic()
    """Traffic from the device, counted while HELLO has no answer."""
    device_state: int = 0
    """Number of the state that the device last reported."""
    token: int = 0

    def is_ahead(self, echo: int) -> bool:
        """Return whether another host sent the frame `echo`, or this host on an earlier link."""
        return (echo - self.seq) & 0xFFFF < 0x8000


def is_newer(seq: int, other: int) -> bool:
    """Return whether a frame was sent after another one of the same sender, by their numbers."""
    return 0 < (seq - other) & 0xFFFF < 0x8000


class Configuration(msgspec.Struct, frozen=True, gc=False):
    """Configuration that the device accepted last."""

    ts_us: int
    scheduled: bool
    config_crc: int
    nonce: int
    """Nonce that ARM and START must contain."""
    asked_ns: int = 0
    """Time at which the CONFIG of this configuration was sent."""


class ClockComparison(msgspec.Struct, frozen=True, gc=False):
    """Comparison of the device's clock with the host's, within one boot of the device."""

    boot_id: int
    compared_ns: int = 0
    """Host's time of the last comparison."""
    device_us: int = 0
    """Device's time of the last comparison, without wraps."""
    map: ClockMap = ClockMap()


class DecisionState(msgspec.Struct, frozen=True, gc=False):
    """Complete state of the core; replacing fields of a struct is fast (docs/decisions)."""

    rules: Rules
    phase: Phase = Phase.INIT
    fault: Fault | None = None
    """Fault that is latched; None in every phase except FAULT."""
    quitting: bool = False
    link: LinkState | None = None
    """None while no port is open."""
    device: HelloReply | None = None
    device_uid: int = 0
    """Identity of the newest device that answered HELLO, even if it is silent now."""
    asked: PendingRequest | None = None
    configuration: Configuration | None = None
    """None until a device has accepted a configuration."""
    clock: ClockComparison | None = None
    """None until a device has answered HELLO."""
    pace_us: int = 0
    """Period of the loop's ticks, in µs; the device's timer paces a scheduled run."""
    tick_ns: int = 0
    """Time of the last tick."""
    service_ns: int = 0
    """Time of the last order of the service."""
    k: int = -1
    """Number of the last tick."""
    last_reported_k: int = msgspec.field(default=-1, name="told")
    """Number of the last sample that was published or reported missing."""
    absent: tuple[PendingGap, ...] = ()
    """Samples after `last_reported_k` that are known to be missing."""
    applied: int = 0
    """Code that the device last reported as latched; the rest code outside RUN."""
    t_us: int = 0
    """Device's time of the last sample, without wraps."""
    sampled_ns: int = 0
    """Time at which the newest sample was requested (in a scheduled run: arrived); 0 at first."""
    lease: Lease | None = None
    run: ActiveRun | None = None
    queue: Queue | None = None
    outcome: str = ""
    """Outcome of the run, as a sentence; the run ends when the device has stopped."""
    code: int = 0
    """Code that the newest `set` command holds; otherwise the rest code."""
    outcome_code: OutcomeCode | None = None
    """Outcome of the run, for programs; None while `outcome` is empty."""
    watch: tuple[OutputWatch, ...] | UnsetType = UNSET
    """State of each output in `Rules.limits`; unset before the first sample."""

    @property
    def ending(self) -> Ending:
        """Return the outcome of the run; STOPPED if no other outcome is known."""
        return Ending(self.outcome_code or OutcomeCode.STOPPED, self.outcome)

    @property
    def ts_us(self) -> int:
        """Return the sampling time in force, in µs."""
        configuration = self.configuration
        return self.rules.ts_us if configuration is None else configuration.ts_us

    @property
    def scheduled(self) -> bool:
        """Return whether the configuration in force has scheduled mode."""
        return self.configuration is not None and self.configuration.scheduled

    @property
    def device_state(self) -> int:
        """Return the number of the state that the device last reported."""
        return 0 if self.link is None else self.link.device_state

    @property
    def is_stopping(self) -> bool:
        """Return whether the device must stop; it must then get no setpoint and no KEEPALIVE."""
        asked = self.asked
        return self.phase is Phase.FAULT or (asked is not None and asked.want is RequestKind.STOP)

    @property
    def is_emulated(self) -> bool:
        """Return whether the port or the newest device is that of an emulated rig."""
        return self.rules.is_emulated or self.device_uid == EMULATOR_UID

    @property
    def reason(self) -> str:
        """Return the cause of the fault, or an empty text."""
        return self.fault.cause if self.fault else ""

    def linked(self, **changes: Any) -> DecisionState:
        """Return the state with changes in its link; a state without a link does not change."""
        link = self.link
        return self if link is None else replace(self, link=replace(link, **changes))

    def ending_with(self, outcome: str, code: OutcomeCode) -> DecisionState:
        """Return the state with the outcome of its run; an outcome that is stored is kept."""
        if self.outcome or not outcome:
            return self
        return replace(self, outcome=outcome, outcome_code=code)


class Arrived(Value, frozen=True):
    """Sample that was due and has arrived."""

    sample: Sample
    code: int
    """Code that was commanded for the sample."""
    expected: int
    """Code that the device must have applied."""
    link: LinkState
    run: ActiveRun | None
    """Run after this sample."""
    answered: Sent | None = None
    """EXCHANGE that the sample answers; None in a scheduled run."""
    unanswered: tuple[Sent, ...] = ()
    """Earlier EXCHANGEs, which the device will not answer any more."""


class Send(Value, frozen=True):
    """Action: write these bytes to the device."""

    data: bytes


class Publish(Value, frozen=True):
    """Action: pass this sample to the service."""

    sample: Sample
    queued: int = -1
    """Number of setpoints in the device after this sample; -1 without a queue."""


class RoundTrip(Value, frozen=True):
    """Action: add this round-trip time, in ns, to the timing of the loop."""

    ns: int


class Emit(Value, frozen=True):
    """Action: pass this record to the service."""

    record: Record


class SetPeriod(Value, frozen=True):
    """Action: tick with this period, in µs, from tick `k` on."""

    period_us: int
    k: int


class Exit(Value, frozen=True):
    """Action: end the process, after all records have been passed on."""


Action = Send | Publish | RoundTrip | Emit | SetPeriod | Exit


class Tick(Value, frozen=True):
    """Event: the timer's tick `k`, which was due at `sched_ns`."""

    k: int
    sched_ns: int


class Wakeup(Value, frozen=True):
    """Event: the time of `step.wake_ns` was reached without another event."""


class Received(Value, frozen=True):
    """Event: bytes from the device arrived."""

    data: bytes


class Ordered(Value, frozen=True):
    """Event: an order from the service arrived."""

    order: Order


class LinkUp(Value, frozen=True):
    """Event: the port is open."""


class LinkDown(Value, frozen=True):
    """Event: the port is gone."""

    reason: str


class ServiceGone(Value, frozen=True):
    """Event: the service's pipes have ended."""


Event = Tick | Wakeup | Received | Ordered | LinkUp | LinkDown | ServiceGone
