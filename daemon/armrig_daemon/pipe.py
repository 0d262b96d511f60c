"""Messages over pipes: records from the loop to the service, and orders from it to the loop.

Each message is `length u32, kind u8, payload`. The payload of a sample is its protobuf bytes, which
reach the subscribers and the file unchanged. All other payloads are msgpack with a tag.
"""

from __future__ import annotations

from math import nan
from struct import Struct
from typing import Any

import msgspec
from armrig_core.commands.codes import GapCode, OutcomeCode, RefusalCode
from armrig_core.control.evaluation import Program
from armrig_core.rig.calibration import Calibration
from armrig_core.telemetry.telemetry import SAMPLE_LENGTH
from msgspec import UNSET, UnsetType

_HEAD = Struct("<IB")
_SAMPLE_KIND, _RECORD_KIND = 0, 1
_SAMPLE_HEAD = _HEAD.pack(SAMPLE_LENGTH, _SAMPLE_KIND)
_ENCODER = msgspec.msgpack.Encoder()


class Tagged(msgspec.Struct, frozen=True, kw_only=True, tag=True, gc=False):
    """A message; its tag is the name of its class."""


class Gap(Tagged, frozen=True, kw_only=True):
    """A gap in k: missing samples, and the voltage that was held during the gap."""

    k_first: int
    count: int
    t_from_ns: int
    t_to_ns: int
    u_held_v: float
    reason: str
    code: GapCode
    """Reason, for programs."""


class Log(Tagged, frozen=True, kw_only=True):
    """A message for the user."""

    t_host_ns: int
    level: str
    message: str
    fields: dict[str, str] = {}
    """Subject of the message, for programs: `rig`, `run`, `owner`, `command`, `cause`."""
    is_note: bool = False
    """True if a person wrote the message; `fields` contains the `owner`."""
    emulator_stall_ns: int = 0
    """Time for which the clock of an emulated rig stood still, in ns; 0 in other messages."""


class Distribution(Tagged, frozen=True, kw_only=True):
    """Percentiles of a quantity over the last second, and the number of missed ticks."""

    p50: float
    p90: float
    p99: float
    p999: float
    max: float
    n: int
    missed: int


class Timing(Tagged, frozen=True, kw_only=True):
    """Timing of the last second."""

    t_host_ns: int
    wake_lateness_us: Distribution
    device_tick_error_us: Distribution
    link_round_trip_us: Distribution
    queue_depth: Distribution
    """Depth of the device's queue, in setpoints."""
    collections: int = 0
    """Number of the loop's garbage collections since its start."""
    cpu_pressure_percent: float = nan
    """Share of the second during which at least one task waited for a processor, in percent."""
    run_queue: int = -1
    """Number of runnable tasks of the host."""


class Clock(Tagged, frozen=True, kw_only=True):
    """Fit of the device's clock to the host's; published device times are not corrected."""

    t_host_ns: int
    offset_ns: int
    """Time of the host, in ns, minus 1000 times the time of the device, in µs."""
    offset_std_ns: float
    drift_ppm: float
    """Rate of change of the offset; positive if the device's clock is slow."""
    drift_std_ppm: float
    bound_ns: float
    """Largest error of the offset, in ns, that a constant asymmetry of the line's delays causes."""


class State(Tagged, frozen=True, kw_only=True):
    """State of the daemon, sent at each change and once a second."""

    t_host_ns: int
    phase: str
    reason: str
    owner: str
    ts_us: int
    device: dict[str, Any]
    fault: str = ""
    """Id of the fault (`armrig_daemon.decisions.faults.Id`); empty without a fault."""
    motor: str = ""
    """Text about the known state of the motor, for the user."""
    remedy: str = ""
    """Remedy of the fault."""
    line: str = ""
    """Reason why no device answers, and advice; empty if a device answers."""
    owner_checked: str = ""
    """Verified identity of the owner; see `Arm`."""
    device_cause: int = 0
    """Cause that the device reported for the fault, an `armrig_protocol.messages.Cause`."""


class Trace(Tagged, frozen=True, kw_only=True):
    """Steps of the core during a run; see `armrig_daemon.decisions.trace`."""

    t_host_ns: int
    number: int
    state: bytes
    steps: bytes
    version: int
    """Version of the encoding of state and steps."""


class RunStarted(Tagged, frozen=True, kw_only=True):
    """Beginning of a run: the samples from `k_first` on belong to the run."""

    run_id: str
    k_first: int
    count: int
    t_host_ns: int


class RunEnded(Tagged, frozen=True, kw_only=True):
    """End of a run: no sample of this run follows."""

    run_id: str
    outcome: str
    outcome_code: OutcomeCode


class Answer(Tagged, frozen=True, kw_only=True):
    """Answer to the order with the number `order`: a body, or an error text for the user."""

    order: int
    body: dict[str, Any] = {}
    error: str = ""
    code: RefusalCode | None = None
    """Reason of an error; None without an error."""
    parameters: dict[str, str | int | float] = {}
    """Values in the error, by name."""


class Host(Tagged, frozen=True, kw_only=True):
    """Real-time properties that the kernel granted to the loop, and properties that it refused."""

    granted: dict[str, Any]


class Control(Tagged, frozen=True, kw_only=True):
    """Decision of a control law, or of a controller of the client's own, for one sample."""

    t_host_ns: int
    k: int
    r: float
    """Reference, in the unit of the law."""
    v: float
    """Voltage before the limits, in V."""
    u_v: float
    """Commanded voltage, in V."""
    is_low: bool = False
    """True if v is below the lowest voltage."""
    is_high: bool = False
    """True if v is above the highest voltage."""
    is_slewed: bool = False
    """True if the change of the voltage was limited."""
    predicted: int
    """Number of samples that had not arrived, and that the law predicted; without a law, number of
    deadlines that the client has missed in this run."""
    reference_n: int = 0
    """Number of the command that set r; 0 for the reference with which the run began."""


Record = (
    Gap | Log | Timing | Clock | State | Trace | RunStarted | RunEnded | Answer | Host | Control
)
"""Messages of the loop to the service, except samples."""


class Order(Tagged, frozen=True, kw_only=True):
    """A request of the service to the loop; `order` is its number."""

    order: int = 0


# A recorded run contains the tags of orders, so a new kind of order needs a new trace version.
class Arm(Order, frozen=True, kw_only=True):
    """Arm the rig for `owner`; the service has generated the lease."""

    owner: str
    lease: str
    ts_us: int
    owner_checked: str = ""
    """Verified identity of the owner, such as `certificate alice`; "" if none was verified."""


class Leased(Order, frozen=True, kw_only=True):
    """An order of the lease's holder; its number must increase."""

    lease: str
    n: int


class Disarm(Leased, frozen=True, kw_only=True):
    """Disarm the rig."""


class Set(Leased, frozen=True, kw_only=True):
    """Hold the motor at this code until the next order."""

    code: int


class SetReference(Leased, frozen=True, kw_only=True):
    """Follow another reference from the next sample on, in the unit of the law."""

    r: float


class Run(Leased, frozen=True, kw_only=True):
    """Play an experiment, or control the rig by a law."""

    run_id: str
    codes: bytes
    """One u16, little-endian, for each sample; empty in control."""
    scheduled: bool = False
    """True if the device paces the run; false if the host paces the run."""
    law: Program | UnsetType = UNSET
    """Law that determines the code of each sample, in exchange mode."""
    reference: bytes | UnsetType = UNSET
    """Reference, in control: one float64, little-endian, for each sample. Without a law, `Set`
    determines the code of each sample."""
    r_range: tuple[float, float] = (0.0, 0.0)
    """Least and largest value of the reference that was rehearsed with the law."""


class Stop(Order, frozen=True, kw_only=True):
    """Stop the motor; the order needs no lease."""

    reason: str = "stopped"
    """Outcome of the run that the stop ends, as a text for the user."""
    outcome_code: OutcomeCode = OutcomeCode.STOPPED
    """Code of the outcome, for programs."""


class Reset(Order, frozen=True, kw_only=True):
    """Clear a latched fault."""


class Calibrate(Order, frozen=True, kw_only=True):
    """Use this calibration for samples from now on."""

    calibration: Calibration
    """Calibration without its origin, so that the order fits into a trace."""


class Alive(Order, frozen=True, kw_only=True):
    """Sign of life of the service, which requests nothing."""

    lease: str = ""
    """Lease whose client waits for the preparation of its run: the rig stays armed, at 0 V."""


class Quit(Order, frozen=True, kw_only=True):
    """Stop the motor and end the loop."""

    reason: str


Orders = Arm | Disarm | Set | SetReference | Run | Stop | Reset | Calibrate | Alive | Quit
"""Messages of the service to the loop."""

_RECORDS = msgspec.msgpack.Decoder(Record)
_ORDERS = msgspec.msgpack.Decoder(Orders)


def sample_bytes(sample: bytes) -> bytes:
    """Return the bytes of the pipe's message that contains an encoded sample."""
    return _SAMPLE_HEAD + sample


def record_bytes(record: Record | Orders) -> bytes:
    """Return the bytes of the pipe's message that contains a record or an order."""
    payload = _ENCODER.encode(record)
    return _HEAD.pack(len(payload), _RECORD_KIND) + payload


def _cut(pending: bytearray) -> list[tuple[int, bytes]]:
    at, texts = 0, []
    while len(pending) - at >= _HEAD.size:
        length, kind = _HEAD.unpack_from(pending, at)
        end = at + _HEAD.size + length
        if end > len(pending):
            break
        texts.append((kind, bytes(pending[at + _HEAD.size : end])))
        at = end
    del pending[:at]
    return texts


def take_records(pending: bytearray) -> list[bytes | Record]:
    """Remove complete messages from `pending` and return them, samples as bytes."""
    return [t if kind == _SAMPLE_KIND else _RECORDS.decode(t) for kind, t in _cut(pending)]


def take_orders(pending: bytearray) -> list[Orders]:
    """Remove the complete orders from `pending` and return them."""
    return [_ORDERS.decode(text) for _, text in _cut(pending)]
