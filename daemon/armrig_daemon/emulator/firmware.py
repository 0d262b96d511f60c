"""What the firmware remembers between frames, and its transitions (PROTOCOL.md, section 3).

`requests` says what each frame does with it, `sampling` what each sample does, `device` when.
Frames are made with seq 0; `device` numbers them in the order in which they leave.
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
from armrig_daemon.emulator.clock import U32, Clock, microseconds
from armrig_daemon.emulator.guards import NOTHING_SEEN, Guards
from armrig_daemon.emulator.queue import SetpointQueue
from armrig_daemon.emulator.timer import Timer

NEVER: Final = 1 << 62
"""Later than any clock: the deadline of what is not awaited."""
U16: Final = 0xFFFF
UNNUMBERED: Final = 0
"""seq of a frame before it leaves."""
SUPPLY_LOW_MV = 4000
MOTOR_MAY_TURN: Final = (State.ARMED, State.RUN)
NO_STACK_LIMIT = 0xFFFF  # an emulator has no stack to run out of


@dataclass(frozen=True, slots=True, kw_only=True)
class Hardware:
    """What the hardware is like."""

    conversion_ns: int
    """One conversion: alpha's, then theta_1's."""
    hold_ns: int
    """From a trigger to its sampling."""
    adc_bits: int
    pwm_bits: int
    queue: int
    """Setpoints that there is room for."""

    @property
    def ts_min_us(self) -> int:
        """Shortest sampling time: that of two conversions, rounded up."""
        return -(-2 * self.conversion_ns // 1000)

    @property
    def skew_us(self) -> int:
        """From one conversion to the next, rounded up."""
        return -(-self.conversion_ns // 1000)


class PendingSample(msgspec.Struct, frozen=True, gc=False):
    """A sample that an EXCHANGE or the timer asked for and that is not taken yet."""

    due_ns: int
    """Device time at which its conversions are to begin."""
    k: int
    seq: int = 0
    """Of the EXCHANGE."""
    u: int | None = None
    """None is what the queue has for k when it is latched."""
    drives: bool = True
    """u is to be latched: it was asked for in this RUN."""


class PendingCal(msgspec.Struct, frozen=True, gc=False):
    """The readings that a CAL asked for and that are not all taken yet."""

    due_ns: int
    """Device time at which the first conversion is to begin."""
    channel: int
    """0 theta_1, 1 alpha."""
    n: int


@dataclass(slots=True, kw_only=True)
class Counters:
    """What STATUS tells, since boot."""

    frames: int = 0
    spoilt: int = 0
    refused: int = 0
    rx_lost: int = 0
    tx_dropped: int = 0
    late: int = 0
    underruns: int = 0


@dataclass(slots=True, kw_only=True)
class Firmware:
    """One boot of the firmware."""

    board: Board
    hardware: Hardware
    rng: np.random.Generator
    """Tokens come from it."""
    clock: Clock
    boot_id: int
    mcusr: int
    """Reset flags of the processor."""
    state: State = State.BOOT
    cause: Cause = Cause.POWER_ON
    """Of the last transition."""
    token: int = 0
    config: Config | None = None
    """In force; None where none is."""
    config_crc: int = 0
    nonce: int = 0
    """Of the configuration in force; 0 where none is."""
    accepted: int = 0
    """Configurations accepted in this boot, of which each has a nonce of its own."""
    newest: int | None = None
    """seq of the newest frame taken in; None before the first of this boot."""
    fed_ns: int = 0
    """When it came."""
    watchdog_ns: int = NEVER
    """When the watchdog trips; kept by `feed` and `enter`, because it is read far more often."""
    k: int | None = None
    """Of the last EXCHANGE; None where the next may be any."""
    u: int = 0
    """Code last accepted in RUN, as the host sent it."""
    u_seq: int = 0
    """seq of the frame that supplied the code in force; 0 outside RUN."""
    u_km1: int = 0
    """Code in force before the last latch."""
    guards: Guards = NOTHING_SEEN
    new_flags: int = 0
    """Flags to be told once, in the next SAMPLE."""
    pending: deque[PendingSample] = field(default_factory=deque)
    cal: PendingCal | None = None
    """Holds the converter."""
    supply_mv: int = 0
    """As measured last."""
    queue: SetpointQueue | None = None
    """In ARMED and RUN of scheduled mode; elsewhere None, and so empty."""
    timer: Timer | None = None
    """In RUN of scheduled mode."""
    timer_ns: int = NEVER
    """When it is due; kept by `set_timer` and `enter`, because it is read far more often."""
    counters: Counters = field(default_factory=Counters)

    def accept(self, config: Config) -> None:
        """Put a configuration in force, under a nonce that this boot has not had."""
        self.config, self.config_crc = config, config_crc(config)
        # 1 ... 2^32 - 1 in turn; begun at boot_id, so that no other boot has the same ones.
        self.nonce = (self.boot_id + self.accepted) % U32 + 1
        self.accepted += 1

    @property
    def conversions(self) -> int:
        """How many a sample that begins now takes, of both channels together."""
        return 2 * self.config.oversampling if self.config is not None else 2

    @property
    def supply_is_low(self) -> bool:
        """Whether the supply was too low when it was measured last."""
        return self.supply_mv < SUPPLY_LOW_MV

    def measure_supply(self, now_ns: int) -> list[Message]:
        """Measure the supply; too low a one trips where the motor may turn."""
        self.supply_mv = self.board.supply_mv(now_ns)
        if not self.supply_is_low or self.state not in MOTOR_MAY_TURN:
            return []
        return [self.enter(now_ns, State.FAULT, Cause.VCC_LOW, detail=self.supply_mv)]

    def device_us(self, now_ns: int) -> int:
        """Return the device's clock, which starts at reset and wraps at 2^32."""
        return microseconds(self.clock.device_ns(now_ns))

    def feed(self, now_ns: int) -> None:
        """Note that a frame was taken in."""
        self.fed_ns = now_ns
        self._set_watchdog()

    def _set_watchdog(self) -> None:
        """Set the watchdog, which is on in ARMED and RUN only."""
        self.watchdog_ns = NEVER
        if self.config is not None and self.state in MOTOR_MAY_TURN:
            self.watchdog_ns = self.clock.after(self.fed_ns, self.config.watchdog_ms * 1_000_000)

    def set_timer(self, timer: Timer | None) -> None:
        """Let the timer's next act be due at its time."""
        self.timer = timer
        self.timer_ns = self.clock.instant(timer.due_ns) if timer else NEVER

    def tick(self, now_ns: int) -> list[Message]:
        """Ask for the sample that is due; behind the last one end the run."""
        if self.timer is None or self.timer.ends:
            return [self.enter(now_ns, State.IDLE, Cause.END)]
        self.pending.append(PendingSample(self.timer.due_ns, self.timer.k))
        self.timer.k += 1
        self.set_timer(self.timer)
        return []

    def enter(self, now_ns: int, state: State, cause: Cause, *, detail: int = 0) -> Message:
        """Make a transition and return its EVENT."""
        was, self.state, self.cause = self.state, state, cause
        if state is not State.RUN:
            self.board.release(now_ns, state, cause)
            self.u_seq = 0
            self.set_timer(None)
            if state is not State.ARMED:
                self.queue = None
        if was is State.RUN:
            # What still waits for its conversions was meant for the run that is over.
            self.pending = deque(replace(one, drives=False) for one in self.pending)
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

    def trip_on_silence(self, now_ns: int) -> list[Message]:
        """Trip on the host's silence."""
        return [self.enter(now_ns, State.FAULT, Cause.WATCHDOG)]

    def answer(self, number: int, of_seq: int, code: Code) -> Message:
        """Return the ACK of a frame; what is not OK had no effect, and is counted."""
        if code is not Code.OK:
            self.counters.refused += 1
        return Ack(self.state, UNNUMBERED, of_type=number, code=code, of_seq=of_seq)

    def count_lost(self, n_bytes: int) -> None:
        """Count received bytes that found no room."""
        self.counters.rx_lost += n_bytes
        self.new_flags |= int(Flag.RX_OVERFLOW)

    def count_dropped(self) -> None:
        """Count a frame that found no room on its way out."""
        self.counters.tx_dropped += 1
        self.new_flags |= int(Flag.TX_DROP)

    def status(self, now_ns: int) -> Message:
        """Return the counters."""
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
