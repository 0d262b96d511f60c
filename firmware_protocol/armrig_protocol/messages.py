"""Messages of the wire; generated from schema.toml, not to be edited.

`python -m armrig_protocol.generate` makes this file. Fields are raw integers.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import NamedTuple

VERSION = 2
"""Version of the protocol."""
SCHEMA_HASH = 0xF7128A84
"""CRC-32 of the schema; host and device must have the same."""
MAX_DECODED = 64
"""Longest decoded frame, header and CRC included, in bytes."""
QUEUE_CAPACITY = 512
"""Largest capacity of a device's queue of setpoints; `queue` in HELLO_R is the capacity of the device."""
SETPOINTS_PER_FRAME = 24
"""Largest number of codes in one SETPOINTS frame."""
CODE_FULL_SCALE = 65535
"""Code of the full-scale voltage. Code 0 is 0 V, and the codes are linear in the voltage."""
FULL_SCALE_MV = 5000
"""Full-scale motor voltage, in mV. A higher voltage destroys the rig."""
WATCHDOG_MIN_MS = 20
"""Shortest watchdog time that a device accepts, in ms."""
WATCHDOG_MAX_MS = 250
"""Longest watchdog time that a device accepts, in ms. The watchdog cannot be switched off."""
WATCHDOG_DEFAULT_MS = 100
"""Watchdog time that a host requests by default, in ms."""
MAX_UNECHOED = 2
"""Largest number of EXCHANGE frames that a host has sent and that are not yet echoed."""


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
    """Latched; 0 V; only CLEAR_FAULT with the token of this fault ends it."""
    ESTOP = 7
    """Latched on request; 0 V; only CLEAR_FAULT with the token of this stop ends it."""


class Cause(IntEnum):
    """Reason for a change of the device's state."""

    NONE = 0
    """No cause to report."""
    POWER_ON = 1
    """Reset, for example at power-on or when the port is opened."""
    REQUEST = 2
    """Requested by a host."""
    END = 3
    """The last requested sample was taken, and its input was held for a whole Ts."""
    WATCHDOG = 4
    """No valid host frame for watchdog_ms."""
    RANGE = 5
    """A code outside [u_min, u_max]."""
    SLEW = 6
    """A change of the code of more than `slew`."""
    ADC_RAIL = 7
    """A potentiometer at a rail for `rail_ticks` samples."""
    REV_LIMIT = 8
    """`turns`/100 net turns of channel 0 or more since START."""
    UNDERRUN = 9
    """Reserved: an empty queue of setpoints is no fault."""
    VCC_LOW = 10
    """Supply too low."""
    INTERNAL = 11
    """An internal check of the firmware failed."""


class Code(IntEnum):
    """Answer to a request."""

    OK = 0
    """Done."""
    UNKNOWN_TYPE = 1
    """No request has this type."""
    WRONG_STATE = 2
    """The request is not allowed in this state; nothing changed."""
    UNSUPPORTED = 3
    """The device does not have this function; see `capabilities`."""
    BAD_VALUE = 4
    """A field has a value that is not allowed; nothing changed."""
    WRONG_BOOT = 5
    """Wrong boot_id: not the boot_id of this boot."""
    WRONG_CONFIG = 6
    """Wrong config_crc: not the config_crc of the configuration in force."""
    WRONG_TOKEN = 7
    """Wrong token: not the token of this fault."""
    STALE = 8
    """Seq or k is not newer than the last accepted seq or k; nothing changed."""
    WRONG_NONCE = 9
    """Wrong nonce: not the nonce of the newest accepted CONFIG; for example, an old frame was sent again."""


class Mode(IntEnum):
    """Clock that determines the times of the samples."""

    EXCHANGE = 0
    """The host's clock; the device sends one SAMPLE for each EXCHANGE."""
    SCHEDULED = 1
    """The device's timer; the inputs are in a queue of setpoints."""


class Underrun(IntEnum):
    """Code that a device latches if its queue is empty."""

    ZERO = 0
    """U_rest at once."""
    HOLD = 1
    """The last code for `hold` ticks, then u_rest."""


class Flag(IntFlag):
    """Conditions that a device reports with a sample."""

    RUN = 0x0001
    """U_k drives the motor."""
    ARMED = 0x0002
    """ARMED or RUN."""
    UNDERRUN = 0x0004
    """No setpoint for this k."""
    WATCHDOG = 0x0008
    """In FAULT, caused by the watchdog."""
    RANGE = 0x0010
    """In FAULT, caused by a code out of range."""
    SLEW = 0x0020
    """In FAULT, caused by a change of the input that is too large."""
    ADC0_RAIL = 0x0040
    """Channel 0 at a rail: dead band or broken wire."""
    ADC1_RAIL = 0x0080
    """Channel 1 at a rail."""
    TICK_LATE = 0x0100
    """This sample was taken late."""
    ESTOP = 0x0200
    """In ESTOP."""
    CRC_ERR = 0x0400
    """A spoilt frame was received since the last sample."""
    RX_OVERFLOW = 0x0800
    """Received bytes were lost since the last sample."""
    TX_DROP = 0x1000
    """Frames to the host were dropped since the last sample."""
    REV_LIMIT = 0x2000
    """In FAULT, caused by too many turns."""
    VCC_LOW = 0x4000
    """Supply below 4000 mV when last measured."""


class Capability(IntFlag):
    """Functions of a device."""

    EXCHANGE = 0x0001
    """Exchange mode."""
    SCHEDULED = 0x0002
    """Scheduled mode."""
    CAL = 0x0004
    """CAL."""
    ENABLE_LINE = 0x0008
    """Enable line of the motor driver, driven by the device."""


class Hello(NamedTuple):
    """Ask for the identity of the device. Outside ARMED and RUN, also begin a new sequence."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    version: int
    """Protocol version of the host."""
    schema: int
    """Schema hash of the host."""


class Config(NamedTuple):
    """Set the run's parameters, in IDLE or READY."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    ts_us: int
    """Sampling time, in µs."""
    u_min: int
    """Lowest code accepted, in code."""
    u_max: int
    """Highest code accepted, in code."""
    u_rest: int
    """Code at which the motor stands still, latched when RUN begins and after an underrun, in code; 0 if there is no enable line."""
    slew: int
    """Largest change from one sample to the next, in code; 0 sets no limit."""
    watchdog_ms: int
    """Time without a host frame after which the device enters FAULT(WATCHDOG), in ms."""
    mode: int
    """Clock that determines the times of the samples (`Mode`)."""
    underrun: int
    """Policy for an empty queue (`Underrun`)."""
    hold: int
    """Longest time for which the policy HOLD keeps the last code, in ticks."""
    oversampling: int
    """Conversions averaged in one reading of each channel, at least 1."""
    rail_ticks: int
    """Samples in a row at a rail that cause FAULT(ADC_RAIL) in RUN, in samples; 0 sets no limit."""
    turns: int
    """Net turns of channel 0 since START that cause FAULT(REV_LIMIT), in turns/100; 0 sets no limit."""


class Arm(NamedTuple):
    """Change from READY to ARMED. ARM is valid only in this boot and for this configuration and its nonce."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    boot_id: int
    """As in HELLO_R."""
    config_crc: int
    """As in CONFIG_R."""
    nonce: int
    """As in CONFIG_R."""


class Start(NamedTuple):
    """Change from ARMED to RUN."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    k_stop: int
    """Scheduled mode: number of samples, or 0 for samples until STOP; exchange mode: 0."""
    nonce: int
    """As in ARM."""


class Stop(NamedTuple):
    """Change from READY, ARMED or RUN to IDLE. STOP takes effect even if its seq is not newer than the last seq."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""


class ClearFault(NamedTuple):
    """Change from FAULT or ESTOP to IDLE. No program sends CLEAR_FAULT without an order of the user."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    token: int
    """As in the EVENT or HELLO_R that reported the fault."""


class Estop(NamedTuple):
    """Change from any state to ESTOP. ESTOP takes effect even if its seq is not newer than the last seq. A host sends ESTOP three times."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""


class Exchange(NamedTuple):
    """Take a sample. In RUN of exchange mode, also latch u."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    k: int
    """The host's tick index."""
    u: int
    """Input from this sample on, in code."""


class Setpoints(NamedTuple):
    """Scheduled mode: the inputs of samples k0 … k0 + n - 1. If the queue already has a code for a sample, the frame must repeat this code."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    k0: int
    """Sample index of the first code."""
    n: int
    """Number of codes, 1 to 24."""
    zero: int
    """0."""
    u: tuple[int, ...]
    """Codes, in code; padded with 0."""


class Ping(NamedTuple):
    """Ask for the device's clock."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    host_ns: int
    """Host's clock when the host sent PING, in ns; returned in PONG."""


class Keepalive(NamedTuple):
    """Feed the watchdog. KEEPALIVE has no other effect."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""


class Cal(NamedTuple):
    """Ask for raw readings of one channel, at 0 V only."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    channel: int
    """Number of the channel, 0 or 1."""
    zero: int
    """0."""
    n: int
    """Readings, 1 to 1024."""


class HelloReply(NamedTuple):
    """Identity and properties of the device."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    version: int
    """Protocol version of the device."""
    schema: int
    """Schema hash of the device."""
    uid: int
    """Identifies this piece of hardware."""
    boot_id: int
    """Drawn at each boot, never 0."""
    firmware: int
    """CRC-32 of the firmware's image."""
    token: int
    """Token that CLEAR_FAULT must contain; 0 outside FAULT and ESTOP."""
    ts_min_us: int
    """Shortest sampling time of the device itself, with oversampling 1, in µs."""
    full_scale_mv: int
    """Voltage of code 65535, in mV."""
    queue: int
    """Capacity of the queue, in setpoints."""
    capabilities: int
    """Functions of the device (`Capability`)."""
    skew_us: int
    """Time from one conversion to the next, and therefore from the conversion of channel 1 to the conversion of channel 0, in µs; rounded up."""
    hold_us: int
    """Time from the trigger (t_us) to the hold of channel 0 and the latch of u, in µs."""
    adc_bits: int
    """Resolution of the converter; readings are left-justified to 16 bits."""
    pwm_bits: int
    """Resolution of the duty; 16 if the duty is not quantised."""
    cause: int
    """Cause of the last change of state (`Cause`)."""
    reset: int
    """Reset flags of the processor, unchanged (MCUSR)."""


class ConfigReply(NamedTuple):
    """Answer to CONFIG. It contains the configuration in force, also if CONFIG was refused."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    code: int
    """OK, or the reason for the refusal (`Code`)."""
    zero: int
    """0."""
    config_crc: int
    """CRC-32 of the CONFIG body in force; 0 if no configuration is in force."""
    ts_us: int
    """As in CONFIG, in µs."""
    u_min: int
    """As in CONFIG, in code."""
    u_max: int
    """As in CONFIG, in code."""
    u_rest: int
    """As in CONFIG, in code."""
    slew: int
    """As in CONFIG, in code."""
    watchdog_ms: int
    """As in CONFIG, in ms."""
    mode: int
    """As in CONFIG (`Mode`)."""
    underrun: int
    """As in CONFIG (`Underrun`)."""
    hold: int
    """As in CONFIG, in ticks."""
    oversampling: int
    """As in CONFIG."""
    rail_ticks: int
    """As in CONFIG, in samples."""
    turns: int
    """As in CONFIG, in turns/100."""
    nonce: int
    """Nonce that ARM and START must contain; 0 if no configuration is in force."""


class Ack(NamedTuple):
    """Answer to ARM, START, STOP, CLEAR_FAULT, ESTOP, and to any frame that had no effect."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    of_type: int
    """Type of the frame answered."""
    code: int
    """OK, or the reason for the refusal (`Code`)."""
    of_seq: int
    """Seq of the frame answered."""


class Event(NamedTuple):
    """The state changed."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    boot: int
    """Low half of boot_id."""
    was: int
    """State before (`State`)."""
    cause: int
    """Reason for the change (`Cause`)."""
    t_us: int
    """Device clock, in µs."""
    token: int
    """Token that CLEAR_FAULT must contain; 0 outside FAULT and ESTOP."""
    detail: int
    """RANGE and SLEW: the code refused; VCC_LOW: the supply in mV; else 0."""


class Status(NamedTuple):
    """Counters since boot, once a second."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    boot: int
    """Low half of boot_id."""
    vcc_mv: int
    """Last measured supply, in mV; 0 if the device has not measured it."""
    uptime_ms: int
    """Time since the reset, in ms."""
    frames: int
    """Valid frames received."""
    spoilt: int
    """Frames dropped because of COBS, length or CRC."""
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
    """Smallest free stack since boot, in B."""


class Sample(NamedTuple):
    """Readings of both potentiometers, and the input latched at the last conversion."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    boot: int
    """Low half of boot_id, by which the host notices every reset."""
    echo: int
    """Seq of the newest host frame taken in."""
    u_seq: int
    """Seq of the frame that contained u_k; 0 if no frame contained u_k."""
    k: int
    """Sample index: k of the EXCHANGE, or in scheduled mode counted from 0 at START."""
    t_us: int
    """Device clock when the conversion of channel 0 is triggered, in µs; wraps after 71.6 min."""
    y0: int
    """Channel 0, left-justified to 16 bits, in counts."""
    y1: int
    """Channel 1, left-justified to 16 bits, in counts."""
    u_k: int
    """Code of the duty that the motor has from sample k on, in code."""
    u_km1: int
    """Code in force just before the latch, in code; if the previous SAMPLE is lost, it shows the u_k of the lost SAMPLE."""
    flags: int
    """Conditions of the sample (`Flag`)."""
    queued: int
    """Setpoints in the queue after the latch."""


class Pong(NamedTuple):
    """The device's clock."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    host_ns: int
    """Value of host_ns in PING, in ns."""
    rx_us: int
    """Device clock after PING was received, in µs."""
    tx_us: int
    """Device clock at which the first byte of PONG leaves, in µs."""


class CalReply(NamedTuple):
    """Statistics of raw readings."""

    state: int
    """State of the device; 0 from a host (`State`)."""
    seq: int
    """Number of the frame, counted by its sender."""
    channel: int
    """Channel of the CAL."""
    zero: int
    """0."""
    n: int
    """Readings taken."""
    mean_256: int
    """Mean of the readings, in counts/256."""
    variance_256: int
    """Variance of the readings, with the divisor n - 1, in counts²/256; at most 2^32 - 1, and 0 for n = 1."""
    least: int
    """Smallest reading, in counts."""
    greatest: int
    """Largest reading, in counts."""


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
"""Layout of each type after its type byte, in the letters of the struct module."""
ARRAYS: dict[int, int] = {
    0x11: 24,
}
"""Length of the array at the end of a type; types without an array are left out."""
