"""The device on its wire: when bytes arrive, conversions end and frames leave.

Time is given, in integer nanoseconds, and never goes back. What falls due is done at its own
instant, in order, when `advance` is called: a late caller gets the same bytes with the same times.
"""

from __future__ import annotations

import numpy as np
from armrig_protocol import frame
from armrig_protocol.messages import Ack, Cause, Exchange, Sample, State

from armrig_daemon.emulator import clock
from armrig_daemon.emulator.board import Board, Witness
from armrig_daemon.emulator.clock import U32
from armrig_daemon.emulator.converter import Converter
from armrig_daemon.emulator.firmware import NEVER, U16, Firmware, Hardware
from armrig_daemon.emulator.reception import Reception
from armrig_daemon.emulator.requests import handle, makes_sample
from armrig_daemon.emulator.sensors import CODE_BITS
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.emulator.transmission import Transmission
from armrig_daemon.emulator.uart import wire_ns

HOLD_NS = 12_000  # ATmega328P data sheet, table 24-1: sample and hold after 1.5 clocks of 125 kHz
LEAD_NS = 80_000  # twice what an answer takes to be made, so that it is there when it is due
STATUS_NS = 1_000_000_000
SUPPLY_NS = 100_000_000
MOST_PENDING = 2
_BOOT = State.BOOT
POWER_ON_FLAGS, EXTERNAL_RESET_FLAGS = 0x01, 0x02  # PORF, EXTRF in MCUSR


class Device:
    """An emulated rig: bytes in, bytes out, and an arm that moves."""

    violations: tuple[()] = ()
    """None: the pins of this board do what its firmware says."""

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
        self._sample_ns = wire_ns(frame.wire_length(Sample), self._baud)
        self._settings = settings
        self._boot_ns = round(settings.boot_ms * 1e6)
        self._hardware = Hardware(
            conversion_ns=round(settings.conversion_us * 1e3),
            hold_ns=HOLD_NS,
            adc_bits=settings.adc_bits or CODE_BITS,
            pwm_bits=settings.pwm_bits or CODE_BITS,
            queue=settings.queue,
        )
        self._boot_id = 0
        self._next_ns = now_ns
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
        self._next_ns = min(self._next_ns, self._rx.first_ns)

    def rx_backlog_ns(self, now_ns: int) -> int:
        """Return how long the bytes given so far still occupy the wire to the device."""
        return self._rx.backlog_ns(now_ns)

    def next_ns(self) -> int:
        """Return when something can happen next: call `advance` then."""
        return self._next_ns

    def visible_ns(self) -> int:
        """Return a time before which no byte can leave and the watchdog cannot trip.

        Later than `next_ns` where only inner work is due: who has nothing to do but write bytes
        can sleep until then, have the same bytes, and have answers `LEAD_NS` before they are due.
        No host waits for a sample of the timer: it is there when it is due, for one sleep less.
        """
        fw, sample_ns = self._fw, self._sample_ns
        timer_ns, answer_ns = fw.timer_ns, max(0, sample_ns - LEAD_NS)
        rx_ns = self._rx.first_ns + self._shortest_ns
        conversions_ns = fw.conversions * self._hardware.conversion_ns
        if self._rx.first_ns < NEVER and self._next_makes_sample():
            end_ns = fw.clock.after(self._rx.first_ns, conversions_ns)
            rx_ns = min(end_ns + answer_ns, self._rx.second_ns() + self._shortest_ns)
        if fw.timer is not None:
            answer_ns = sample_ns
            if not fw.timer.ends:
                timer_ns = fw.clock.after(timer_ns, conversions_ns) + sample_ns
        elif fw.cal is not None:
            answer_ns = self._shortest_ns
        return min(
            rx_ns,
            timer_ns,
            self._converter.end_ns + answer_ns,
            self._booted_ns,
            fw.watchdog_ns,
            self._status_ns,
            self._supply_ns,
        )

    def advance(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Do what is due until `now_ns`; return frames, each with its last byte's departure."""
        while self._next_ns <= now_ns:
            self._step(self._next_ns)
        return self._tx.pop_sent()

    def advance_until(self, limit_ns: int) -> tuple[int, list[tuple[int, bytes]]]:
        """Let time pass up to a limit or to what is due next; return the time, and as `advance`."""
        now_ns = min(limit_ns, self._next_ns)
        return now_ns, self.advance(now_ns)

    def advance_to_frame(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Do what is due until `now_ns` or the next frame, whatever is first; return as `advance`.

        Who has it called again, with all that happens to the device in between, gets the frames
        that `advance` gives, and none of the calls between them.
        """
        if self._next_ns > now_ns:  # as it is most times that it is asked
            return []
        tx = self._tx
        while self._next_ns <= now_ns:
            self._step(self._next_ns)
            if tx.sent:
                return tx.pop_sent()
        return []

    def _begin(self, now_ns: int, mcusr: int) -> None:
        last = self._boot_id
        while self._boot_id == 0 or not (self._boot_id ^ last) & U16:
            self._boot_id = int(self._rng.integers(1, U32, endpoint=True))
        self._fw = Firmware(
            board=self._board,
            hardware=self._hardware,
            rng=self._rng,
            clock=clock.started(self._settings, now_ns),
            boot_id=self._boot_id,
            mcusr=mcusr,
        )
        self._board.release(now_ns, State.BOOT, self._fw.cause)
        self._rx = Reception(now_ns, self._baud)
        self._tx = Transmission(now_ns, self._baud)
        self._converter = Converter(self._fw)
        self._booted_ns = self._fw.clock.after(now_ns, self._boot_ns)
        self._status_ns = self._fw.clock.after(now_ns, max(STATUS_NS, self._boot_ns + 1))
        self._supply_ns = NEVER
        self._next_ns = self._booted_ns  # nothing else is due before

    def _step(self, t_ns: int) -> None:
        """Do one thing that is due at `t_ns`, and look ahead to the next.

        Bytes come first, so that a STOP beats a latch.
        """
        fw, rx, converter = self._fw, self._rx, self._converter
        if rx.first_ns == t_ns:
            self._arrive(t_ns)
        elif self._booted_ns == t_ns:
            self._booted_ns = NEVER
            rx.forget(t_ns)
            self._supply_ns = fw.clock.after(t_ns, SUPPLY_NS)
            fw.measure_supply(t_ns)
            self._tx.begin(t_ns)
            self._tx.send(fw, t_ns, [fw.enter(t_ns, State.IDLE, fw.cause)])
        elif fw.watchdog_ns == t_ns:
            self._tx.send(fw, t_ns, fw.trip_on_silence(t_ns))
        elif converter.due_ns == t_ns:
            made = converter.step(t_ns)
            if made:  # two of three acts make nothing
                self._tx.send(fw, t_ns, made)
        elif fw.timer_ns == t_ns:
            self._tx.send(fw, t_ns, fw.tick(t_ns))
            converter.wake()
        elif self._supply_ns == t_ns:
            self._supply_ns = converter.end_ns  # where it is taken: as soon as it is free
            if self._supply_ns == NEVER:
                self._supply_ns = fw.clock.after(t_ns, SUPPLY_NS)
                self._tx.send(fw, t_ns, fw.measure_supply(t_ns))
        else:
            self._status_ns = fw.clock.after(t_ns, STATUS_NS)
            self._tx.send(fw, t_ns, [fw.status(t_ns)])
        self._next_ns = min(  # kept, because it is asked far more often
            rx.first_ns,
            converter.due_ns,
            fw.watchdog_ns,
            fw.timer_ns,
            self._status_ns,
            self._booted_ns,
            self._supply_ns,
        )

    def _next_makes_sample(self) -> bool:
        """Return whether the next piece to arrive is an EXCHANGE that a sample will answer."""
        match self._rx.peek():
            case [Exchange() as exchange]:
                return makes_sample(self._fw, exchange)
        return False

    def _arrive(self, t_ns: int) -> None:
        """Take in the piece that is complete at `t_ns`."""
        fw = self._fw
        received = self._rx.pop()
        if fw.state is _BOOT:
            return
        for item in received:
            # Where the timer samples, an EXCHANGE never waits: it is refused.
            waits = isinstance(item, Exchange) and fw.timer is None
            if waits and sum(one.u is not None for one in fw.pending) >= MOST_PENDING:
                fw.count_lost(frame.wire_length(Exchange))
                continue
            answers = handle(fw, t_ns, item)
            if answers:  # an EXCHANGE is answered by its sample
                self._tx.send(fw, t_ns, answers)
            self._converter.wake()
