"""State of the firmware, and its transitions (PROTOCOL.md, section 3).

The module `requests` implements the effect of each frame, `sampling` the steps of each sample, and
`device` the times. Frames are created with seq 0; `device` numbers the frames in the order in which
they are sent.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Final

import msgspec
import numpy as np
from armrig_protocol.frame import config_crc
from armrig_protocol.messages import Ack, Cause, Code, Config, Event, Flag, Message, State, Status
from msgspec.structs import replace

from armrig_daemon.emulator.board import Board
from armrig_daemon.emulator.clock import U32, EmulatedClock, Timer, microseconds
from armrig_daemon.emulator.guards import NOTHING_SEEN, Guards
from armrig_daemon.emulator.queue import SetpointQueue

NEVER: Final = 1 << 62
"""Time of an event that never occurs, in ns."""
U16: Final = 0xFFFF
UNNUMBERED: Final = 0
"""Sequence number in a frame to which `device` has not yet given a number."""
SUPPLY_LOW_MV = 4000
MOTOR_MAY_TURN: Final = (State.ARMED, State.RUN)
NO_STACK_LIMIT = 0xFFFF  # an emulator cannot run out of stack


@dataclass(frozen=True, slots=True, kw_only=True)
class Hardware:
    """Properties of the hardware."""

    conversion_ns: int
    """Time of one conversion, in ns; in a sample, channel 1 is converted first, then channel 0."""
    hold_ns: int
    """Time from the trigger of a conversion to the hold of its input, in ns."""
    adc_bits: int
    pwm_bits: int
    queue: int
    """Capacity of the queue, in setpoints."""

    @property
    def ts_min_us(self) -> int:
        """Shortest sampling time, in µs: two conversions, rounded up."""
        return -(-2 * self.conversion_ns // 1000)

    @property
    def skew_us(self) -> int:
        """Time from one conversion to the next, in µs, rounded up."""
        return -(-self.conversion_ns // 1000)


class PendingSample(msgspec.Struct, frozen=True, gc=False):
    """A sample that an EXCHANGE or the timer requested, and that is not converted yet."""

    due_ns: int
    """Device time of the first conversion."""
    k: int
    seq: int = 0
    """Sequence number of the EXCHANGE."""
    u: int | None = None
    """Code to latch; None to latch the setpoint of sample k in the queue."""
    drives: bool = True
    """True if u must be latched, because the request arrived in the current RUN."""


class PendingCal(msgspec.Struct, frozen=True, gc=False):
    """A CAL in progress."""

    due_ns: int
    """Device time of the first conversion."""
    channel: int
    """Channel, 0 or 1, in the order of the rig's outputs."""
    n: int


@dataclass(slots=True, kw_only=True)
class Counters:
    """Counters of STATUS since boot."""

    frames: int = 0
    spoilt: int = 0
    refused: int = 0
    rx_lost: int = 0
    tx_dropped: int = 0
    late: int = 0
    underruns: int = 0


@dataclass(slots=True, kw_only=True)
class Firmware:
    """State of the firmware during one boot."""

    board: Board
    hardware: Hardware
    rng: np.random.Generator
    """Generator of tokens and boot ids."""
    clock: EmulatedClock
    boot_id: int
    mcusr: int
    """Reset flags of the processor."""
    state: State = State.BOOT
    cause: Cause = Cause.POWER_ON
    """Cause of the last transition."""
    token: int = 0
    config: Config | None = None
    """Current configuration; None if there is none."""
    config_crc: int = 0
    nonce: int = 0
    """Nonce of the current configuration; 0 if there is none."""
    accepted: int = 0
    """Number of configurations accepted in this boot; each has its own nonce."""
    newest: int | None = None
    """Sequence number of the newest accepted frame; None if this boot has accepted no frame."""
    fed_ns: int = 0
    """Time of the last frame that fed the watchdog."""
    watchdog_ns: int = NEVER
    """Time at which the watchdog trips; stored, because it is read far more often than set."""
    k: int | None = None
    """Index of the last EXCHANGE; None if the next EXCHANGE may have any index."""
    u: int = 0
    """Last code accepted in RUN, as the host sent it (not rounded to the duty)."""
    u_seq: int = 0
    """Sequence number of the frame that contained the applied code; 0 outside RUN."""
    u_km1: int = 0
    """Code applied before the last latch."""
    guards: Guards = NOTHING_SEEN
    new_flags: int = 0
    """Flags to report once, in the next SAMPLE."""
    pending: deque[PendingSample] = field(default_factory=deque)
    cal: PendingCal | None = None
    """CAL that occupies the converter."""
    supply_mv: int = 0
    """Last measured supply voltage, in mV."""
    queue: SetpointQueue | None = None
    """Queue in ARMED and RUN of scheduled mode; None otherwise."""
    timer: Timer | None = None
    """Timer in RUN of scheduled mode; None otherwise."""
    timer_ns: int = NEVER
    """Time at which the timer is due; stored, because it is read far more often than set."""
    counters: Counters = field(default_factory=Counters)

    def accept(self, config: Config) -> None:
        """Apply a configuration, and give it a nonce that is new in this boot."""
        self.config, self.config_crc = config, config_crc(config)
        # Nonces begin after boot_id, so that other boots have other nonces; 1 follows 2^32 - 1.
        self.nonce = (self.boot_id + self.accepted) % U32 + 1
        self.accepted += 1

    @property
    def conversions(self) -> int:
        """Total number of conversions, of both channels, in a sample that begins now."""
        return 2 * self.config.oversampling if self.config is not None else 2

    @property
    def supply_is_low(self) -> bool:
        """True if the last measured supply voltage was too low."""
        return self.supply_mv < SUPPLY_LOW_MV

    def measure_supply(self, now_ns: int) -> list[Message]:
        """Measure the supply; if it is too low in ARMED or RUN, enter FAULT."""
        self.supply_mv = self.board.supply_mv(now_ns)
        if not self.supply_is_low or self.state not in MOTOR_MAY_TURN:
            return []
        return [self.enter(now_ns, State.FAULT, Cause.VCC_LOW, detail=self.supply_mv)]

    def device_us(self, now_ns: int) -> int:
        """Return the device's clock in µs, which starts at reset and wraps at 2^32."""
        return microseconds(self.clock.device_ns(now_ns))

    def feed(self, now_ns: int) -> None:
        """Restart the watchdog, because a frame was accepted."""
        self.fed_ns = now_ns
        self._set_watchdog()

    def _set_watchdog(self) -> None:
        """Set the watchdog, which is active only in ARMED and RUN."""
        self.watchdog_ns = NEVER
        if self.config is not None and self.state in MOTOR_MAY_TURN:
            self.watchdog_ns = self.clock.after(self.fed_ns, self.config.watchdog_ms * 1_000_000)

    def set_timer(self, timer: Timer | None) -> None:
        """Set the timer and the time of its next event."""
        self.timer = timer
        self.timer_ns = self.clock.instant(timer.due_ns) if timer else NEVER

    def tick(self, now_ns: int) -> list[Message]:
        """Request the sample that is due; after the last sample, end the run."""
        if self.timer is None or self.timer.ends:
            return [self.enter(now_ns, State.IDLE, Cause.END)]
        self.pending.append(PendingSample(self.timer.due_ns, self.timer.k))
        self.timer.k += 1
        self.set_timer(self.timer)
        return []

    def enter(self, now_ns: int, state: State, cause: Cause, *, detail: int = 0) -> Message:
        """Perform a transition and return its EVENT."""
        was, self.state, self.cause = self.state, state, cause
        if state is not State.RUN:
            self.board.release(now_ns, state, cause)
            self.u_seq = 0
            self.set_timer(None)
            if state is not State.ARMED:
                self.queue = None
        if was is State.RUN:
            # Samples that still wait for conversions belong to the run that is over.
            self.pending = deque(replace(sample, drives=False) for sample in self.pending)
        self.token = 0
        if state in (State.FAULT, State.ESTOP):
            self.token = int(self.rng.integers(1, U32, endpoint=True))
        if state is State.IDLE:
            self.config, self.config_crc, self.nonce = None, 0, 0
        self._set_watchdog()
        return Event(
            state,
            UNNUMBERED,
            boot=self.boot_id & U16,
            was=was,
            cause=cause,
            t_us=self.device_us(now_ns),
            token=self.token,
            detail=detail,
        )

    def answer(self, number: int, of_seq: int, code: Code) -> Message:
        """Return the ACK of a frame; if the frame was refused, count the frame."""
        if code is not Code.OK:
            self.counters.refused += 1
        return Ack(self.state, UNNUMBERED, of_type=number, code=code, of_seq=of_seq)

    def count_lost(self, n_bytes: int) -> None:
        """Count received bytes that were lost because the receiver had no room."""
        self.counters.rx_lost += n_bytes
        self.new_flags |= int(Flag.RX_OVERFLOW)

    def count_dropped(self) -> None:
        """Count a frame to the host that was dropped because the transmitter had no room."""
        self.counters.tx_dropped += 1
        self.new_flags |= int(Flag.TX_DROP)

    def status(self, now_ns: int) -> Message:
        """Return STATUS with the counters."""
        counters = self.counters
        return Status(
            self.state,
            UNNUMBERED,
            boot=self.boot_id & U16,
            vcc_mv=self.supply_mv,
            uptime_ms=self.clock.device_ns(now_ns) // 1_000_000 & U32,
            frames=counters.frames & U32,
            spoilt=counters.spoilt & U32,
            refused=counters.refused & U32,
            rx_lost=min(counters.rx_lost, U16),
            tx_dropped=min(counters.tx_dropped, U16),
            late=min(counters.late, U16),
            underruns=min(counters.underruns, U16),
            isr_max_us=0,
            stack_free=NO_STACK_LIMIT,
        )
