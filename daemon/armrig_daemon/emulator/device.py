"""The device on its wire: when bytes arrive, conversions end and frames leave.

Time is given, in integer nanoseconds, and never goes back. What falls due is done at its own
instant, in order, when `advance` is called: a late caller gets the same bytes with the same times.
"""

from __future__ import annotations

import numpy as np
from armrig_protocol import frame
from armrig_protocol.messages import Ack, Cause, Exchange, Message, Pong, Sample, State

from armrig_daemon.emulator.board import Board, Witness
from armrig_daemon.emulator.firmware import NEVER, U16, U32, Firmware, Traits
from armrig_daemon.emulator.reception import Reception
from armrig_daemon.emulator.requests import makes_sample, take
from armrig_daemon.emulator.sampling import latch, sample
from armrig_daemon.emulator.sensors import CODE_BITS
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.emulator.uart import departure_ns, wire_ns

HOLD_NS = 12_000  # ATmega328P data sheet, table 24-1: sample and hold after 1.5 clocks of 125 kHz
LEAD_NS = 80_000  # twice what an answer takes to be made, so that it is there when it is due
STATUS_NS = 1_000_000_000
TX_RING_BYTES = 256
MOST_ORDERS = 2
POWER_ON_FLAGS, EXTERNAL_RESET_FLAGS = 0x01, 0x02  # PORF, EXTRF in MCUSR


class Device:
    """An emulated rig: bytes in, bytes out, and an arm that moves."""

    def __init__(
        self, settings: EmulatorSettings, now_ns: int, witness: Witness | None = None
    ) -> None:
        """Switch it on.

        Parameters
        ----------
        witness : callable, optional
            Is told of each change of the terminal voltage.
        """
        noise, self._rng = (
            np.random.default_rng(s) for s in np.random.SeedSequence(settings.seed).spawn(2)
        )
        self._board = Board(settings, now_ns, noise, witness)
        self._baud = settings.baud if settings.model_baud else 0
        self._shortest_ns = max(0, wire_ns(frame.wire_length(Ack), self._baud) - LEAD_NS)
        self._sample_ns = max(0, wire_ns(frame.wire_length(Sample), self._baud) - LEAD_NS)
        self._boot_ns = round(settings.boot_ms * 1e6)
        self._conversion_ns = round(settings.conversion_us * 1e3)
        self._traits = Traits(
            ts_min_us=-(-2 * self._conversion_ns // 1000),
            skew_us=round(settings.conversion_us),
            hold_us=HOLD_NS // 1000,
            adc_bits=settings.adc_bits or CODE_BITS,
            pwm_bits=settings.pwm_bits or CODE_BITS,
        )
        self._boot_id = 0
        self._replies: list[tuple[int, bytes]] = []
        self._begin(now_ns, POWER_ON_FLAGS)

    @property
    def state(self) -> State:
        """State of the firmware at the last call."""
        return self._fw.state

    @property
    def cause(self) -> Cause:
        """Cause of the last transition."""
        return self._fw.cause

    @property
    def board(self) -> Board:
        """The pins and the arm, for who wants to look at them."""
        return self._board

    def reset(self, now_ns: int) -> None:
        """Reset the processor, as opening the port of an Uno does; what is on the wires is lost."""
        self.advance(now_ns)
        self._begin(now_ns, EXTERNAL_RESET_FLAGS)

    def receive(self, now_ns: int, data: bytes) -> None:
        """Put bytes on the wire to the device; they arrive one after the other from `now_ns` on."""
        self._rx.put(now_ns, data)

    def rx_backlog_ns(self, now_ns: int) -> int:
        """Return how long the bytes given so far still occupy the wire to the device."""
        return self._rx.backlog_ns(now_ns)

    def next_ns(self) -> int:
        """Return when something can happen next: call `advance` then."""
        return min(
            self._rx.first_ns,
            self._booted_ns,
            self._phase_ns,
            self._fw.watchdog_ns,
            self._status_ns,
        )

    def visible_ns(self) -> int:
        """Return a time before which no byte can leave and the watchdog cannot bite.

        Later than `next_ns` where only inner work is due: who has nothing to do but write bytes
        can sleep until then, have the same bytes, and have them `LEAD_NS` before they are due.
        """
        rx_ns = self._rx.first_ns
        if rx_ns < NEVER and self._next_makes_sample():
            rx_ns += 2 * self._conversion_ns + self._sample_ns
            rx_ns = min(rx_ns, self._rx.second_ns() + self._shortest_ns)
        else:
            rx_ns += self._shortest_ns
        return min(
            rx_ns,
            self._end_ns + self._sample_ns,
            self._booted_ns,
            self._fw.watchdog_ns,
            self._status_ns,
        )

    def advance(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Do what is due until `now_ns`; return frames, each with its last byte's departure."""
        while (t_ns := self.next_ns()) <= now_ns:
            self._step(t_ns)
        replies, self._replies = self._replies, []
        return replies

    def _begin(self, now_ns: int, mcusr: int) -> None:
        last = self._boot_id
        while self._boot_id in (0, last):
            self._boot_id = int(self._rng.integers(1, U32, endpoint=True))
        self._fw = Firmware(
            board=self._board,
            traits=self._traits,
            rng=self._rng,
            boot_id=self._boot_id,
            reset_ns=now_ns,
            mcusr=mcusr,
        )
        self._board.release(now_ns, State.BOOT, self._fw.cause)
        self._rx = Reception(now_ns, self._baud)
        self._tx_free_ns = now_ns
        self._replies.clear()
        self._seq = 0
        self._booted_ns = now_ns + self._boot_ns
        self._status_ns = now_ns + max(STATUS_NS, self._boot_ns + 1)
        self._idle_converter()

    def _idle_converter(self) -> None:
        self._phase = 0
        self._phase_ns = self._end_ns = NEVER

    def _step(self, t_ns: int) -> None:
        """Do one thing that is due at `t_ns`; bytes come first, so that a STOP beats a latch."""
        if self._rx.first_ns == t_ns:
            self._arrive(t_ns)
        elif self._booted_ns == t_ns:
            self._booted_ns = NEVER
            self._rx.forget(t_ns)
            self._replies.append((self._depart(t_ns, 1), b"\0"))
            self._send(t_ns, [self._fw.go(t_ns, State.IDLE, self._fw.cause)])
        elif self._fw.watchdog_ns == t_ns:
            self._send(t_ns, self._fw.bite(t_ns))
        elif self._phase_ns == t_ns:
            self._convert(t_ns)
        else:
            self._status_ns += STATUS_NS
            self._send(t_ns, [self._fw.status(t_ns)])

    def _next_makes_sample(self) -> bool:
        """Return whether the next piece to arrive is an EXCHANGE that a sample will answer."""
        match self._rx.peek():
            case [Exchange() as exchange]:
                return makes_sample(self._fw, exchange)
        return False

    def _arrive(self, t_ns: int) -> None:
        """Take in the piece that is complete at `t_ns`."""
        fw = self._fw
        received = self._rx.take()
        if fw.state is State.BOOT:
            return
        for item in received:
            if isinstance(item, Exchange) and len(fw.orders) >= MOST_ORDERS:
                fw.lose(frame.wire_length(Exchange))
                continue
            self._send(t_ns, take(fw, t_ns, item))
            if fw.orders and not self._phase:
                self._trigger(t_ns)

    def _trigger(self, t_ns: int) -> None:
        """Start alpha's conversion, and plan all that follows from it."""
        self._trigger_ns = t_ns
        self._end_ns = t_ns + 2 * self._conversion_ns
        self._phase, self._phase_ns = 1, t_ns + HOLD_NS

    def _convert(self, t_ns: int) -> None:
        """Do the next of an exchange's three acts: hold alpha; hold theta_1 and latch; answer."""
        fw = self._fw
        if self._phase == 1:
            self._y1 = self._board.alpha(t_ns)
            self._phase, self._phase_ns = 2, t_ns + self._conversion_ns
        elif self._phase == 2:
            # theta_1 is held just before the latch, so that it cannot know of this u.
            self._y0 = self._board.theta_1(t_ns)
            latch(fw, t_ns)
            self._phase, self._phase_ns = 3, self._end_ns
        else:
            t_us = fw.device_us(self._trigger_ns + self._conversion_ns)
            late = self._trigger_ns > fw.orders[0].t_ns
            self._send(t_ns, sample(fw, t_ns, t_us, self._y0, self._y1, late=late))
            self._idle_converter()
            if fw.orders:
                self._trigger(t_ns)

    def _send(self, t_ns: int, messages: list[Message]) -> None:
        """Put frames on the wire, numbered; drop what finds no room in the ring."""
        for message in messages:
            if isinstance(message, Pong):
                tx_us = self._fw.device_us(max(t_ns, self._tx_free_ns))
                message = message._replace(tx_us=tx_us)
            wire = frame.encode(message._replace(seq=self._seq))
            self._seq = (self._seq + 1) & U16  # a frame that is dropped leaves a break in seq
            backlog_ns = self._tx_free_ns - t_ns
            if backlog_ns + wire_ns(len(wire), self._baud) > wire_ns(TX_RING_BYTES, self._baud):
                self._fw.drop()
            else:
                self._replies.append((self._depart(t_ns, len(wire)), wire))

    def _depart(self, t_ns: int, n_bytes: int) -> int:
        self._tx_free_ns = departure_ns(self._tx_free_ns, t_ns, n_bytes, self._baud)
        return self._tx_free_ns
