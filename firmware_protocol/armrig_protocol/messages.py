"""What the wire carries; generated from schema.toml, not edited.

`python -m armrig_protocol.generate` makes this file. Fields are raw integers.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import NamedTuple

VERSION = 2
"""Version of the protocol."""
SCHEMA_HASH = 0xF7128A84
"""CRC-32 of the schema; both ends must have the same."""
MAX_DECODED = 64
"""Longest decoded frame, header and CRC included, in bytes."""
QUEUE_CAPACITY = 512
"""Most setpoints that a device may hold ahead in scheduled mode; HELLO_R says in `queue` what it does hold."""
SETPOINTS_PER_FRAME = 24
"""Places for codes in one SETPOINTS frame."""
CODE_FULL_SCALE = 65535
"""Code of the full-scale voltage; 0 is 0 V, linear between."""
FULL_SCALE_MV = 5000
"""Full-scale motor voltage, in mV. Above it the rig is destroyed."""
WATCHDOG_MIN_MS = 20
"""Shortest watchdog that a device accepts, in ms."""
WATCHDOG_MAX_MS = 250
"""Longest watchdog that a device accepts, in ms. There is no off."""
WATCHDOG_DEFAULT_MS = 100
"""Watchdog that a host asks for unless told otherwise, in ms."""
MAX_UNECHOED = 2
"""EXCHANGE frames that a host may have sent and not yet seen echoed."""


class State(IntEnum):
    """State of the device, in byte 1 of each of its frames."""

    HOST = 0
    """The sender is the host."""
    BOOT = 1
    """Starting up; 0 V."""
    IDLE = 2
    """No configuration accepted; 0 V."""
    READY = 3
    """Configured; 0 V."""
    ARMED = 4
    """Bound to a host; 0 V, watchdog on."""
    RUN = 5
    """The input drives the motor, watchdog on."""
    FAULT = 6
    """Latched; 0 V; left by CLEAR_FAULT with its token."""
    ESTOP = 7
    """Latched on request; 0 V; left as FAULT is."""


class Cause(IntEnum):
    """Why a device changed its state."""

    NONE = 0
    """No cause to tell."""
    POWER_ON = 1
    """Reset by power or by the port being opened."""
    REQUEST = 2
    """A host asked for it."""
    END = 3
    """The last sample asked for was taken."""
    WATCHDOG = 4
    """No valid host frame for watchdog_ms."""
    RANGE = 5
    """A code outside [u_min, u_max]."""
    SLEW = 6
    """A code further from the last than slew."""
    ADC_RAIL = 7
    """A potentiometer out of its range for too long."""
    REV_LIMIT = 8
    """More turns than allowed."""
    UNDERRUN = 9
    """The setpoint queue ran dry."""
    VCC_LOW = 10
    """Supply too low."""
    INTERNAL = 11
    """A check of the firmware on itself failed."""


class Code(IntEnum):
    """Answer to a request."""

    OK = 0
    """Done."""
    UNKNOWN_TYPE = 1
    """No such message."""
    WRONG_STATE = 2
    """Not in this state; nothing changed."""
    UNSUPPORTED = 3
    """This device does not do that; see `capabilities`."""
    BAD_VALUE = 4
    """A field is out of its range; nothing changed."""
    WRONG_BOOT = 5
    """Boot_id is not that of this boot."""
    WRONG_CONFIG = 6
    """Config_crc is not that of the configuration in force."""
    WRONG_TOKEN = 7
    """Not the token of this fault."""
    STALE = 8
    """Seq or k is not newer than the last accepted; nothing changed."""
    WRONG_NONCE = 9
    """Not the nonce of the newest CONFIG accepted: sent again from before."""


class Mode(IntEnum):
    """Who paces the samples."""

    EXCHANGE = 0
    """The host: one SAMPLE for each EXCHANGE."""
    SCHEDULED = 1
    """The device's timer, from a queue of setpoints."""


class Underrun(IntEnum):
    """What a device latches when its queue is dry."""

    ZERO = 0
    """U_rest at once."""
    HOLD = 1
    """The last code for `hold` ticks, then u_rest."""


class Flag(IntFlag):
    """What a device has to say of one sample."""

    RUN = 0x0001
    """U_k drives the motor."""
    ARMED = 0x0002
    """ARMED or RUN."""
    UNDERRUN = 0x0004
    """No setpoint for this k."""
    WATCHDOG = 0x0008
    """Latched by the watchdog."""
    RANGE = 0x0010
    """Latched by a code out of range."""
    SLEW = 0x0020
    """Latched by a change of the input that is too large."""
    ADC0_RAIL = 0x0040
    """Theta_1 at a rail: dead band or broken wire."""
    ADC1_RAIL = 0x0080
    """Alpha at a rail."""
    TICK_LATE = 0x0100
    """This sample was taken late."""
    ESTOP = 0x0200
    """In ESTOP."""
    CRC_ERR = 0x0400
    """A spoilt frame came since the last sample."""
    RX_OVERFLOW = 0x0800
    """Received bytes were lost since the last sample."""
    TX_DROP = 0x1000
    """Frames to the host were dropped since the last sample."""
    REV_LIMIT = 0x2000
    """Latched by too many turns."""
    VCC_LOW = 0x4000
    """Supply below 4000 mV when last measured."""


class Capability(IntFlag):
    """What a device can do."""

    EXCHANGE = 0x0001
    """Exchange mode."""
    SCHEDULED = 0x0002
    """Scheduled mode."""
    CAL = 0x0004
    """CAL."""
    ENABLE_LINE = 0x0008
    """Drives the motor driver's enable line."""


class Hello(NamedTuple):
    """Ask who is there; also re-synchronises seq."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    version: int
    """Protocol version of the host."""
    schema: int
    """Schema hash of the host."""


class Config(NamedTuple):
    """Set the run's parameters, in IDLE or READY."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    ts_us: int
    """Sampling time, in µs."""
    u_min: int
    """Lowest code accepted, in code."""
    u_max: int
    """Highest code accepted, in code."""
    u_rest: int
    """Code of standstill, where RUN begins and a dry queue ends; other than 0 only with an enable line, in code."""
    slew: int
    """Largest change from one sample to the next; 0 is none, in code."""
    watchdog_ms: int
    """Silence of the host before FAULT(WATCHDOG), in ms."""
    mode: int
    """Who paces (`Mode`)."""
    underrun: int
    """Policy for a dry queue (`Underrun`)."""
    hold: int
    """Length of HOLD, in ticks."""
    oversampling: int
    """Conversions averaged in one reading of each channel, at least 1."""
    rail_ticks: int
    """Samples in a row at a rail before FAULT(ADC_RAIL) in RUN; 0 is none, in samples."""
    turns: int
    """Turns of theta_1 since START before FAULT(REV_LIMIT); 0 is none, in turns/100."""


class Arm(NamedTuple):
    """READY to ARMED, bound to this boot, this configuration and its nonce."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    boot_id: int
    """As in HELLO_R."""
    config_crc: int
    """As in CONFIG_R."""
    nonce: int
    """As in CONFIG_R."""


class Start(NamedTuple):
    """ARMED to RUN."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    k_stop: int
    """Scheduled mode: samples to take, 0 until STOP; exchange mode: 0."""
    nonce: int
    """As in ARM."""


class Stop(NamedTuple):
    """To IDLE from READY, ARMED and RUN; taken whatever its seq."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""


class ClearFault(NamedTuple):
    """FAULT or ESTOP to IDLE; never sent by a program on its own."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    token: int
    """As in the EVENT or HELLO_R that told of the fault."""


class Estop(NamedTuple):
    """To ESTOP from any state; taken whatever its seq; sent three times."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""


class Exchange(NamedTuple):
    """Sample now, then latch u. In any state; only RUN drives the motor."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    k: int
    """The host's tick index."""
    u: int
    """Input from this sample on, in code."""


class Setpoints(NamedTuple):
    """Scheduled mode: u[k0] … u[k0 + n - 1]. Idempotent; overlaps must agree."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    k0: int
    """Sample index of the first."""
    n: int
    """How many of u count, at most 24."""
    zero: int
    """0."""
    u: tuple[int, ...]
    """Codes; padded with 0, in code."""


class Ping(NamedTuple):
    """Ask for the device's clock."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    host_ns: int
    """The host's clock when it sent this; given back, in ns."""


class Keepalive(NamedTuple):
    """Feeds the watchdog, nothing else."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""


class Cal(NamedTuple):
    """Raw readings of one channel, at 0 V only."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    channel: int
    """0 theta_1, 1 alpha."""
    zero: int
    """0."""
    n: int
    """Readings, 1 to 1024."""


class HelloReply(NamedTuple):
    """Who is there."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    version: int
    """Protocol version of the device."""
    schema: int
    """Schema hash of the device."""
    uid: int
    """Of this piece of hardware."""
    boot_id: int
    """Drawn anew at each boot."""
    firmware: int
    """CRC-32 of the firmware's image."""
    token: int
    """What CLEAR_FAULT must carry; 0 outside FAULT and ESTOP."""
    ts_min_us: int
    """Shortest sampling time of the device itself, with oversampling 1, in µs."""
    full_scale_mv: int
    """Voltage of code 65535, in mV."""
    queue: int
    """Setpoints it can hold."""
    capabilities: int
    """What it can do (`Capability`)."""
    skew_us: int
    """Alpha is sampled this long before theta_1, rounded up; so far apart are conversions, in µs."""
    hold_us: int
    """From the trigger (t_us) to the sampling of theta_1 and the latch of u, in µs."""
    adc_bits: int
    """Of the converter; readings are left-justified to 16."""
    pwm_bits: int
    """Of the duty; 16 if not quantised."""
    cause: int
    """Of the last change of state (`Cause`)."""
    reset: int
    """Reset flags of the processor as it gives them (MCUSR)."""


class ConfigReply(NamedTuple):
    """What was accepted: the configuration in force, after a refusal too."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    code: int
    """OK or why not (`Code`)."""
    zero: int
    """0."""
    config_crc: int
    """CRC-32 of the CONFIG body in force, 0 where none is."""
    ts_us: int
    """As CONFIG, in µs."""
    u_min: int
    """As CONFIG, in code."""
    u_max: int
    """As CONFIG, in code."""
    u_rest: int
    """As CONFIG, in code."""
    slew: int
    """As CONFIG, in code."""
    watchdog_ms: int
    """As CONFIG, in ms."""
    mode: int
    """As CONFIG (`Mode`)."""
    underrun: int
    """As CONFIG (`Underrun`)."""
    hold: int
    """As CONFIG, in ticks."""
    oversampling: int
    """As CONFIG."""
    rail_ticks: int
    """As CONFIG, in samples."""
    turns: int
    """As CONFIG, in turns/100."""
    nonce: int
    """What ARM and START must carry; 0 where no configuration is in force."""


class Ack(NamedTuple):
    """Answer to ARM, START, STOP, CLEAR_FAULT, ESTOP, and to any frame that had no effect."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    of_type: int
    """Type of the frame answered."""
    code: int
    """OK or why not (`Code`)."""
    of_seq: int
    """Seq of the frame answered."""


class Event(NamedTuple):
    """The state changed."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    boot: int
    """Low half of boot_id."""
    was: int
    """State before (`State`)."""
    cause: int
    """Why (`Cause`)."""
    t_us: int
    """Device clock, in µs."""
    token: int
    """What CLEAR_FAULT must carry; 0 outside FAULT and ESTOP."""
    detail: int
    """RANGE and SLEW: the code refused; VCC_LOW: the supply in mV; else 0."""


class Status(NamedTuple):
    """Counters since boot, once a second."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    boot: int
    """Low half of boot_id."""
    vcc_mv: int
    """Supply, as measured last; 0 where it is not measured, in mV."""
    uptime_ms: int
    """Since boot, in ms."""
    frames: int
    """Valid frames received."""
    spoilt: int
    """Frames dropped for COBS, length or CRC."""
    refused: int
    """Valid frames without effect."""
    rx_lost: int
    """Bytes lost in reception."""
    tx_dropped: int
    """Frames not sent."""
    late: int
    """Samples taken late."""
    underruns: int
    """Samples without a setpoint."""
    isr_max_us: int
    """Longest interrupt, in µs."""
    stack_free: int
    """Least stack left, in B."""


class Sample(NamedTuple):
    """Both potentiometers at one instant, and the input latched then."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    boot: int
    """Low half of boot_id: a reset is never silent."""
    echo: int
    """Seq of the newest host frame accepted."""
    u_seq: int
    """Seq of the frame that supplied u_k."""
    k: int
    """Sample index: of the EXCHANGE, or since START in scheduled mode."""
    t_us: int
    """Device clock at theta_1's trigger; wraps after 71.6 min, in µs."""
    y0: int
    """Theta_1, left-justified to 16 bit, in counts."""
    y1: int
    """Alpha, left-justified to 16 bit, in counts."""
    u_k: int
    """Code latched at sample k: what the motor really gets, in code."""
    u_km1: int
    """Code before it: repairs u across one lost frame, in code."""
    flags: int
    """What there is to say (`Flag`)."""
    queued: int
    """Setpoints left after latching."""


class Pong(NamedTuple):
    """The device's clock."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    host_ns: int
    """From PING, in ns."""
    rx_us: int
    """Device clock when PING had come, in µs."""
    tx_us: int
    """Device clock when this began to leave, in µs."""


class CalReply(NamedTuple):
    """Statistics of raw readings."""

    state: int
    """Of the sender (`State`)."""
    seq: int
    """+1 each frame of this sender."""
    channel: int
    """From CAL."""
    zero: int
    """0."""
    n: int
    """Readings taken."""
    mean_256: int
    """Mean, in counts/256."""
    variance_256: int
    """Variance, over n - 1; at most 2^32 - 1, and 0 for n = 1, in counts²/256."""
    least: int
    """Smallest, in counts."""
    greatest: int
    """Largest, in counts."""


Message = (
    Hello
    | Config
    | Arm
    | Start
    | Stop
    | ClearFault
    | Estop
    | Exchange
    | Setpoints
    | Ping
    | Keepalive
    | Cal
    | HelloReply
    | ConfigReply
    | Ack
    | Event
    | Status
    | Sample
    | Pong
    | CalReply
)
"""Any message."""

MESSAGES: dict[int, type[Message]] = {
    0x01: Hello,
    0x02: Config,
    0x03: Arm,
    0x04: Start,
    0x05: Stop,
    0x06: ClearFault,
    0x07: Estop,
    0x10: Exchange,
    0x11: Setpoints,
    0x12: Ping,
    0x13: Keepalive,
    0x14: Cal,
    0x81: HelloReply,
    0x82: ConfigReply,
    0x83: Ack,
    0x84: Event,
    0x85: Status,
    0x90: Sample,
    0x92: Pong,
    0x94: CalReply,
}
"""Class of each type."""
TYPES: dict[type[Message], int] = {m: number for number, m in MESSAGES.items()}
"""Type of each class."""
LAYOUTS: dict[int, str] = {
    0x01: "BHHI",
    0x02: "BHIHHHHHBBBBHH",
    0x03: "BHIII",
    0x04: "BHII",
    0x05: "BH",
    0x06: "BHI",
    0x07: "BH",
    0x10: "BHIH",
    0x11: "BHIBB24H",
    0x12: "BHQ",
    0x13: "BH",
    0x14: "BHBBH",
    0x81: "BHHIQIIIIHHHHHBBBB",
    0x82: "BHBBIIHHHHHBBBBHHI",
    0x83: "BHBBH",
    0x84: "BHHBBIII",
    0x85: "BHHHIIIIHHHHHH",
    0x90: "BHHHHIIHHHHHH",
    0x92: "BHQII",
    0x94: "BHBBHIIHH",
}
"""Layout of each type behind its type byte, in the letters of the struct module."""
ARRAYS: dict[int, int] = {
    0x11: 24,
}
"""Length of the array that a type ends with, where it has one."""
