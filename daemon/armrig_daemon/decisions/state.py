"""The state of the core: what the daemon knows and holds, as one immutable value."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

import msgspec
from armrig_core.calibration import Calibration
from armrig_core.codes import Ending, OutcomeCode
from armrig_core.telemetry import Sample
from armrig_protocol.messages import HelloReply

from armrig_daemon.decisions.clockmap import ClockMap
from armrig_daemon.decisions.faults import Fault
from armrig_daemon.pipe import Order, Record, Run


class Phase(StrEnum):
    """Where the daemon is; see ARCHITECTURE.md."""

    INIT = "init"
    """No device that we know and that knows us."""
    SAFE = "safe"
    """Sampling, 0 V, nobody holds the rig."""
    ARMED = "armed"
    """Held by an owner, 0 V."""
    ACTIVE = "active"
    """The input drives the motor."""
    FAULT = "fault"
    """Latched at 0 V until a reset."""


class Want(StrEnum):
    """What was asked of the device and is not yet there."""

    HELLO = "HELLO"
    CONFIGURE = "CONFIG"
    ARM = "ARM"
    START = "START"
    STOP = "STOP"
    CLEAR = "CLEAR_FAULT"


class Rules(msgspec.Struct, frozen=True, kw_only=True):
    """What the core is told once, at the start."""

    code_min: int
    """Lowest code that a command may ask for."""
    code_max: int
    """Highest code that a command may ask for."""
    slew: int
    """Largest change of the code in one sample; 0 is none."""
    ts_us: int
    """Sampling time where no command asks for another, in µs."""
    watchdog_ms: int
    """The device's watchdog, in ms."""
    baud: int
    """Speed of the wire, in bit/s."""
    turns: int
    """Turns of theta_1 allowed in a run, in turns/100; 0 is no limit."""
    rail_ticks: int
    """Samples in a row at a rail that are FAULT(ADC_RAIL) in a run; 0 is no limit."""
    oversampling: int = 1
    """Conversions averaged in one reading of each channel; a trace without it has 1."""
    calibration: Calibration
    service_ns: int = 0
    """Silence of the service after which the motor is stopped; 0 where there is none to watch."""

    stop_after: int
    """Ticks missed in a row after which the motor is stopped; 0 goes on."""

    def age_ns(self, ts_us: int, *, scheduled: bool = False) -> int:
        """Return the age of the last round trip beyond which the motor is stopped.

        A device that paces itself goes on without us for as long as its watchdog allows.
        """
        return self._watchdog_ns if scheduled else max(50_000_000, 3_000 * ts_us)

    def pause_ns(self, ts_us: int, *, scheduled: bool = False) -> int:
        """Return the gap between two ticks beyond which the motor is stopped."""
        return self._watchdog_ns if scheduled else max(50_000_000, 5_000 * ts_us)

    @property
    def _watchdog_ns(self) -> int:
        return self.watchdog_ms * 1_000_000

    def allows(self, before: int, code: int) -> bool:
        """Return whether `code` may follow `before`: within the limits, and not too far from it."""
        inside = self.code_min <= code <= self.code_max
        return inside and (self.slew == 0 or abs(code - before) <= self.slew)

    def lease_ns(self, ts_us: int) -> int:
        """Return how long a voltage held by hand outlives the command for it."""
        return max(100_000_000, 5_000 * ts_us)


class Asked(NamedTuple):
    """A request to the device that has not had its effect yet."""

    want: Want
    sent_ns: int
    seq: int
    tries: int
    ts_us: int
    """Sampling time that CONFIG asks for."""
    scheduled: bool
    """Pacing that CONFIG asks for."""
    order: Order | None
    """Whose wish it is, and who is answered."""


class Traffic(NamedTuple):
    """What the line has brought since the device was first asked who it is, and did not say."""

    bytes: int = 0
    frames: int = 0
    """Sound ones."""


class Sent(NamedTuple):
    """An EXCHANGE whose SAMPLE has not come."""

    seq: int
    k: int
    sched_ns: int
    sent_ns: int
    code: int


class Absent(NamedTuple):
    """Samples that will not come: found at a tick, told before the next sample that does."""

    k: int
    n: int
    reason: str
    code: int | None
    """Latched there as far as is known; None where the one before was held."""
    t_from_ns: int
    t_to_ns: int


class Lease(msgspec.Struct, frozen=True, gc=False):
    """Who holds the rig."""

    lease: str
    owner: str
    ts_us: int
    """Sampling time that the owner asked for."""
    n: int
    """Number of the newest command."""
    renewed_ns: int
    owner_checked: str = ""
    """What the service has checked of the owner."""


class ActiveRun(msgspec.Struct, frozen=True, gc=False):
    """An experiment that is played."""

    run_id: str
    codes: bytes
    """One u16, little-endian, for each sample."""
    k_first: int
    """Index under which its first sample is published; -1 before that."""
    scheduled: bool = False
    """The device paces it."""
    due: int = 0
    """Index of the next sample: scheduled, to come; else, to be asked for."""
    t_zero_ns: int = 0
    """Scheduled: host's estimate of when sample 0 was due."""

    @property
    def samples(self) -> int:
        """Return the length of the experiment in samples."""
        return len(self.codes) // 2

    def code(self, i: int) -> int:
        """Return u[i]; standstill before the first."""
        return self.codes[2 * i] | self.codes[2 * i + 1] << 8 if i >= 0 else 0


class Queue(msgspec.Struct, frozen=True, gc=False):
    """The setpoints of a scheduled run on their way to the device."""

    order: Run | None
    """Whose run it is, until it has been answered."""
    base: int = 0
    """Index of the next sample that the device takes."""
    held: int = 0
    """The device has all setpoints before this index."""
    sent: int = 0
    """All setpoints before this index were sent."""
    moved_ns: int = 0
    """When `held` last grew, or the first frame behind it was sent."""
    asked_ns: int = 0
    """When the run was ordered."""


class Unechoed(NamedTuple):
    """A frame whose echo will tell that the device has heard it."""

    seq: int
    sent_ns: int


class Link(msgspec.Struct, frozen=True, gc=False):
    """What an open port has brought and taken."""

    pending: bytes = b""
    """Bytes of a frame that has not ended."""
    seq: int = 0
    """Of the next frame to the device."""
    any_ns: int = 0
    """When the last frame was sent."""
    sent: tuple[Sent, ...] = ()
    beats: tuple[Unechoed, ...] = ()
    """Scheduled: frames whose echo has not come yet."""
    fresh_ns: int = 0
    """When the newest frame was sent that the device has shown to have heard (S4)."""
    ping_ns: int = 0
    """When the device was last asked for its clock."""
    came: Traffic = Traffic()
    """Counted while HELLO is asked."""
    device_state: int = 0
    """What the device last said of its own state, as the wire numbers it."""
    token: int = 0


class Configuration(msgspec.Struct, frozen=True, gc=False):
    """What the device has accepted last."""

    ts_us: int
    scheduled: bool
    config_crc: int
    nonce: int
    """What ARM and START carry."""
    asked_ns: int = 0
    """When its CONFIG was sent."""


class Clock(msgspec.Struct, frozen=True, gc=False):
    """The device's clock against ours, in one boot of it."""

    boot_id: int
    compared_ns: int = 0
    """When they were last compared."""
    device_us: int = 0
    """The device's clock then, wraps undone."""
    map: ClockMap = ClockMap()


class State(msgspec.Struct, frozen=True, gc=False):
    """All that the core knows; a struct for speed (docs/decisions/0003)."""

    rules: Rules
    phase: Phase = Phase.INIT
    fault: Fault | None = None
    """Why the rig is latched; None in every other phase."""
    quitting: bool = False
    link: Link | None = None
    """None while no port is open."""
    device: HelloReply | None = None
    asked: Asked | None = None
    configuration: Configuration | None = None
    """None until a device has accepted one."""
    clock: Clock | None = None
    """None until a device has been met."""
    pace_us: int = 0
    """Period of our ticks, in µs; a device that paces itself has ticks of its own."""
    tick_ns: int = 0
    """When the last tick was done."""
    service_ns: int = 0
    """When the service was last heard of."""
    k: int = -1
    """The last tick done."""
    told: int = -1
    """Up to here each sample was published or told as a gap."""
    absent: tuple[Absent, ...] = ()
    """What is known of the samples behind `told`."""
    applied: int = 0
    """Code that the device last said it latched."""
    t_us: int = 0
    """Device clock of the last sample, wraps undone."""
    sampled_ns: int = 0
    """When the newest sample was asked for, or came by itself; 0 where this link has seen none."""
    lease: Lease | None = None
    run: ActiveRun | None = None
    queue: Queue | None = None
    outcome: str = ""
    """How the run ends; it has ended once the device has stopped."""
    code: int = 0
    """Held by hand."""
    outcome_code: OutcomeCode | None = None
    """How the run ends, for programs; None where `outcome` says nothing yet."""

    @property
    def ending(self) -> Ending:
        """Return how the run ends; it was stopped if nothing else is known."""
        return Ending(self.outcome_code or OutcomeCode.STOPPED, self.outcome)

    @property
    def ts_us(self) -> int:
        """Return the sampling time in force, in µs."""
        configuration = self.configuration
        return self.rules.ts_us if configuration is None else configuration.ts_us

    @property
    def scheduled(self) -> bool:
        """Return whether the configuration in force is of scheduled mode."""
        return self.configuration is not None and self.configuration.scheduled

    @property
    def device_state(self) -> int:
        """Return what the device last said of its own state, as the wire numbers it."""
        return 0 if self.link is None else self.link.device_state

    @property
    def reason(self) -> str:
        """Return the cause of the fault, or nothing."""
        return self.fault.cause if self.fault else ""


class Send(NamedTuple):
    """Write these bytes to the device."""

    data: bytes


class Publish(NamedTuple):
    """Hand this sample to the service."""

    sample: Sample
    queued: int = -1
    """Setpoints that the device holds behind it; -1 where it has no queue."""


class RoundTrip(NamedTuple):
    """A question to the device came back after so long."""

    ns: int


class Emit(NamedTuple):
    """Hand this record to the service."""

    record: Record


class Repace(NamedTuple):
    """Tick with this period from now on, in µs, beginning with tick `k`."""

    period_us: int
    k: int


class Exit(NamedTuple):
    """All is said; end the process."""


Action = Send | Publish | RoundTrip | Emit | Repace | Exit


class Tick(NamedTuple):
    """Tick `k`, due at `sched_ns`, is now."""

    k: int
    sched_ns: int


class Beat(NamedTuple):
    """Nothing happened until the time that the core asked to be woken at."""


class Received(NamedTuple):
    """Bytes came from the device."""

    data: bytes


class Ordered(NamedTuple):
    """The service asks for something."""

    order: Order


class LinkUp(NamedTuple):
    """The port is open."""


class LinkDown(NamedTuple):
    """The port is gone."""

    reason: str


class ServiceGone(NamedTuple):
    """The service's pipes have ended."""


Event = Tick | Beat | Received | Ordered | LinkUp | LinkDown | ServiceGone
