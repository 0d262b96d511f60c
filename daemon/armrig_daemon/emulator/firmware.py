"""What the firmware remembers between frames, and its transitions (PROTOCOL.md, section 3).

`requests` says what each frame does with it, `sampling` what each sample does, `device` when.
Frames are made with seq 0; `device` numbers them in the order in which they leave.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from armrig_protocol.messages import Ack, Cause, Code, Config, Event, Flag, Message, State, Status

from armrig_daemon.emulator.board import Board
from armrig_daemon.emulator.guards import NOTHING_SEEN, Guards

NEVER: Final = 1 << 62
"""Later than any clock: the deadline of what is not awaited."""
U16: Final = 0xFFFF
U32: Final = 0xFFFF_FFFF
UNNUMBERED: Final = 0
"""seq of a frame before it leaves."""
SUPPLY_MV = 5000
NO_STACK_LIMIT = 0xFFFF  # an emulator has no stack to run out of


@dataclass(frozen=True, slots=True, kw_only=True)
class Traits:
    """What HELLO_R tells of the hardware."""

    ts_min_us: int
    skew_us: int
    hold_us: int
    adc_bits: int
    pwm_bits: int


class Order(NamedTuple):
    """A sample that an EXCHANGE asked for and that is not taken yet."""

    t_ns: int
    seq: int
    k: int
    u: int
    drives: bool
    """u is to be latched: it came in this RUN."""


@dataclass(slots=True, kw_only=True)
class Counters:
    """What STATUS tells, since boot."""

    frames: int = 0
    spoilt: int = 0
    refused: int = 0
    rx_lost: int = 0
    tx_dropped: int = 0
    late: int = 0


@dataclass(slots=True, kw_only=True)
class Firmware:
    """One boot of the firmware."""

    board: Board
    traits: Traits
    rng: np.random.Generator
    """Tokens come from it."""
    boot_id: int
    reset_ns: int
    mcusr: int
    """Reset flags of the processor."""
    state: State = State.BOOT
    cause: Cause = Cause.POWER_ON
    """Of the last transition."""
    token: int = 0
    config: Config | None = None
    """In force; None where none is."""
    config_crc: int = 0
    newest: int | None = None
    """seq of the newest frame taken in; None before the first of this boot."""
    fed_ns: int = 0
    """When it came."""
    watchdog_ns: int = NEVER
    """When the watchdog bites; kept by `feed` and `go`, because it is read far more often."""
    k: int | None = None
    """Of the last EXCHANGE; None where the next may be any."""
    u: int = 0
    """Code last accepted in RUN, as the host sent it."""
    u_seq: int = 0
    """seq of the frame that supplied the code in force; 0 outside RUN."""
    u_km1: int = 0
    """Code in force before the last latch."""
    guards: Guards = NOTHING_SEEN
    news: int = 0
    """Flags to be told once, in the next SAMPLE."""
    orders: deque[Order] = field(default_factory=deque)
    counters: Counters = field(default_factory=Counters)

    def device_us(self, now_ns: int) -> int:
        """Return the device's clock, which starts at reset and wraps at 2^32."""
        return (now_ns - self.reset_ns) // 1000 & U32

    def feed(self, now_ns: int) -> None:
        """Note that a frame was taken in."""
        self.fed_ns = now_ns
        self._wind()

    def _wind(self) -> None:
        """Set the watchdog, which is on in ARMED and RUN only."""
        self.watchdog_ns = NEVER
        if self.config is not None and (self.state is State.RUN or self.state is State.ARMED):
            self.watchdog_ns = self.fed_ns + self.config.watchdog_ms * 1_000_000

    def go(self, now_ns: int, state: State, cause: Cause, *, detail: int = 0) -> Message:
        """Make a transition and return its EVENT."""
        was, self.state, self.cause = self.state, state, cause
        if state is not State.RUN:
            self.board.release(now_ns, state, cause)
            self.u_seq = 0
        if was is State.RUN:
            # What still waits for its conversions was meant for the run that is over.
            self.orders = deque(order._replace(drives=False) for order in self.orders)
        self.token = 0
        if state in (State.FAULT, State.ESTOP):
            self.token = int(self.rng.integers(1, U32, endpoint=True))
        if state is State.IDLE:
            self.config, self.config_crc = None, 0
        self._wind()
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

    def bite(self, now_ns: int) -> list[Message]:
        """Trip on the host's silence."""
        return [self.go(now_ns, State.FAULT, Cause.WATCHDOG)]

    def answer(self, number: int, of_seq: int, code: Code) -> Message:
        """Return the ACK of a frame; what is not OK had no effect, and is counted."""
        if code is not Code.OK:
            self.counters.refused += 1
        return Ack(self.state, UNNUMBERED, of_type=number, code=code, of_seq=of_seq)

    def lose(self, n_bytes: int) -> None:
        """Count received bytes that found no room."""
        self.counters.rx_lost += n_bytes
        self.news |= int(Flag.RX_OVERFLOW)

    def drop(self) -> None:
        """Count a frame that found no room on its way out."""
        self.counters.tx_dropped += 1
        self.news |= int(Flag.TX_DROP)

    def status(self, now_ns: int) -> Message:
        """Return the counters."""
        counters = self.counters
        return Status(
            self.state,
            UNNUMBERED,
            boot=self.boot_id & U16,
            vcc_mv=SUPPLY_MV,
            uptime_ms=(now_ns - self.reset_ns) // 1_000_000 & U32,
            frames=counters.frames & U32,
            spoilt=counters.spoilt & U32,
            refused=counters.refused & U32,
            rx_lost=min(counters.rx_lost, U16),
            tx_dropped=min(counters.tx_dropped, U16),
            late=min(counters.late, U16),
            underruns=0,
            isr_max_us=0,
            stack_free=NO_STACK_LIMIT,
        )
