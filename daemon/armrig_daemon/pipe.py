"""What passes between the loop and the service: records one way, orders the other, over pipes.

Both travel as `length u32, kind u8, payload`. A sample's payload is its protobuf bytes, untouched
from here to the subscriber and the file; everything else is msgpack, told apart by its tag.
"""

from __future__ import annotations

from math import nan
from struct import Struct
from typing import Any

import msgspec
from armrig_core.calibration import Calibration
from armrig_core.codes import OutcomeCode, RefusalCode

_HEAD = Struct("<IB")
_SAMPLE, _RECORD = 0, 1
_ENCODER = msgspec.msgpack.Encoder()


class Tagged(msgspec.Struct, frozen=True, kw_only=True, tag=True, gc=False):
    """Told apart by the name of its class."""


class Gap(Tagged, frozen=True, kw_only=True):
    """A break in k: samples that there are not, and the input that was held meanwhile."""

    k_first: int
    count: int
    t_from_ns: int
    t_to_ns: int
    u_held_v: float
    reason: str


class Log(Tagged, frozen=True, kw_only=True):
    """Something for a person to read."""

    t_host_ns: int
    level: str
    message: str
    fields: dict[str, str] = {}
    """What it is about, for programs: `rig`, `run`, `owner`, `command`, `cause`."""
    is_note: bool = False
    """A person has written the message; `fields` names the `owner`."""


class Distribution(Tagged, frozen=True, kw_only=True):
    """Percentiles of one quantity over the last second, and how often it was missed."""

    p50: float
    p90: float
    p99: float
    p999: float
    max: float
    n: int
    missed: int


class Timing(Tagged, frozen=True, kw_only=True):
    """How well the last second was paced."""

    t_host_ns: int
    wake_lateness_us: Distribution
    device_tick_error_us: Distribution
    link_round_trip_us: Distribution
    queue_depth: Distribution
    """In setpoints, not µs."""
    collections: int = 0
    """Garbage collections of the loop since its start."""
    cpu_pressure_percent: float = nan
    """Share of the second in which some task of the host waited for a processor."""
    run_queue: int = -1
    """Tasks of the host that were runnable."""


class Clock(Tagged, frozen=True, kw_only=True):
    """The device's clock against the host's monotonic one; nothing published is corrected by it."""

    t_host_ns: int
    offset_ns: int
    """Host's time less 1000 times the device's."""
    offset_std_ns: float
    drift_ppm: float
    """What the offset gains; positive where the device's clock is slow."""
    drift_std_ppm: float
    bound_ns: float
    """The most that a constant asymmetry of the way can hide in the offset."""


class State(Tagged, frozen=True, kw_only=True):
    """The state of the daemon, at each change and once a second."""

    t_host_ns: int
    phase: str
    reason: str
    owner: str
    ts_us: int
    device: dict[str, Any]
    fault: str = ""
    """Id of the fault (`armrig_daemon.decisions.faults.Id`); empty where there is none."""
    motor: str = ""
    """What is known of the motor, for a person."""
    remedy: str = ""
    """What to do about the fault."""
    line: str = ""
    """Why no device answers, and what to try; empty where one does."""
    owner_checked: str = ""
    """What the service has checked of the owner; see `Arm`."""


class Trace(Tagged, frozen=True, kw_only=True):
    """Steps of the core in a run; see `armrig_daemon.decisions.trace`."""

    t_host_ns: int
    number: int
    state: bytes
    steps: bytes
    version: int
    """Of the words in which state and steps are written."""


class RunStarted(Tagged, frozen=True, kw_only=True):
    """The samples from `k_first` on belong to the run."""

    run_id: str
    k_first: int
    count: int
    t_host_ns: int


class RunEnded(Tagged, frozen=True, kw_only=True):
    """No sample of the run comes after this."""

    run_id: str
    outcome: str
    outcome_code: OutcomeCode


class Answer(Tagged, frozen=True, kw_only=True):
    """The answer to the order with this number: a body, or an error for a person."""

    order: int
    body: dict[str, Any] = {}
    error: str = ""
    code: RefusalCode | None = None
    """Why, of an error; else None."""
    parameters: dict[str, str | int | float] = {}
    """What the error is about."""


class Host(Tagged, frozen=True, kw_only=True):
    """What the kernel gave the loop, and what it refused."""

    granted: dict[str, Any]


Record = Gap | Log | Timing | Clock | State | Trace | RunStarted | RunEnded | Answer | Host
"""What the loop tells the service, beside samples."""


class Order(Tagged, frozen=True, kw_only=True):
    """What the service asks of the loop; `order` numbers it."""

    order: int = 0


# The steps of a recorded run name orders by their tags: a new one makes a new trace version.
class Arm(Order, frozen=True, kw_only=True):
    """Arm for `owner`, who holds the lease that the service drew."""

    owner: str
    lease: str
    ts_us: int
    owner_checked: str = ""
    """What the service has checked of him, such as `certificate alice`; "" for nothing."""


class Leased(Order, frozen=True, kw_only=True):
    """An order of the lease's holder, with a strictly growing number."""

    lease: str
    n: int


class Disarm(Leased, frozen=True, kw_only=True):
    """Disarm."""


class Set(Leased, frozen=True, kw_only=True):
    """Have the motor at this code until the next one."""

    code: int


class Run(Leased, frozen=True, kw_only=True):
    """Play an experiment."""

    run_id: str
    codes: bytes
    """One u16, little-endian, for each sample."""
    scheduled: bool = False
    """The device paces it; else the host."""


class Stop(Order, frozen=True, kw_only=True):
    """Stop, lease or not."""

    reason: str = "stopped"
    """Outcome of the run that it ends, for a person."""
    outcome_code: OutcomeCode = OutcomeCode.STOPPED
    """And for programs."""


class Reset(Order, frozen=True, kw_only=True):
    """Leave a latched fault."""


class Calibrate(Order, frozen=True, kw_only=True):
    """Convert samples with this calibration from now on."""

    calibration: Calibration
    """Without how it was made: the core needs its figures only, and they fit into a trace."""


class Alive(Order, frozen=True, kw_only=True):
    """Nothing is asked: the service only shows that it can."""


class Quit(Order, frozen=True, kw_only=True):
    """Stop and exit."""

    reason: str


Orders = Arm | Disarm | Set | Run | Stop | Reset | Calibrate | Alive | Quit
"""What the service asks of the loop."""

_RECORDS = msgspec.msgpack.Decoder(Record)
_ORDERS = msgspec.msgpack.Decoder(Orders)


def sample_bytes(sample: bytes) -> bytes:
    """Return the pipe's bytes for an encoded sample."""
    return _HEAD.pack(len(sample), _SAMPLE) + sample


def record_bytes(record: Record | Orders) -> bytes:
    """Return the pipe's bytes for a record or an order."""
    payload = _ENCODER.encode(record)
    return _HEAD.pack(len(payload), _RECORD) + payload


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
    """Remove from `pending` what is whole, and return it: samples as bytes, records decoded."""
    return [t if kind == _SAMPLE else _RECORDS.decode(t) for kind, t in _cut(pending)]


def take_orders(pending: bytearray) -> list[Orders]:
    """Remove from `pending` the orders that are whole, and return them."""
    return [_ORDERS.decode(text) for _, text in _cut(pending)]
