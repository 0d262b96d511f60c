"""The device and its wire: the times at which bytes arrive, conversions end and frames leave.

Time is an argument, in integer nanoseconds, and never decreases. `advance` performs each due step
at its own time and in order. A late caller therefore gets the same bytes with the same times.
"""

from __future__ import annotations

import numpy as np
from armrig_core.rig.description import Description
from armrig_protocol import frame
from armrig_protocol.messages import Ack, Cause, Exchange, Sample, State

from armrig_daemon.emulator import clock
from armrig_daemon.emulator.board import Board, Witness
from armrig_daemon.emulator.clock import U32
from armrig_daemon.emulator.converter import Converter
from armrig_daemon.emulator.firmware import NEVER, U16, Firmware, Hardware
from armrig_daemon.emulator.requests import handle, makes_sample
from armrig_daemon.emulator.sensors import CODE_BITS
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.emulator.uart import Reception, Transmission, wire_ns

HOLD_NS = 12_000  # ATmega328P data sheet, table 24-1: sample and hold after 1.5 clocks of 125 kHz
LEAD_NS = 80_000  # twice the time to compute an answer, so that the answer is ready when it is due
STATUS_NS = 1_000_000_000
SUPPLY_NS = 100_000_000
MOST_PENDING = 2
_BOOT = State.BOOT
POWER_ON_FLAGS, EXTERNAL_RESET_FLAGS = 0x01, 0x02  # PORF, EXTRF in MCUSR


class Device:
    """An emulated rig: bytes in, bytes out, and a moving arm or another rig."""

    violations: tuple[()] = ()
    """Empty, because the pins of an emulated device always agree with its firmware."""

    def __init__(
        self,
        settings: EmulatorSettings,
        now_ns: int,
        witness: Witness | None = None,
        *,
        description: Description | None = None,
    ) -> None:
        """Switch the device on; `witness` is called at each change of the terminal voltage."""
        noise, self._rng = (
            np.random.default_rng(s) for s in np.random.SeedSequence(settings.seed).spawn(2)
        )
        self.board = Board(settings, now_ns, noise, witness, description)
        """The pins and the rig."""
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
        """State of the firmware."""
        return self._fw.state

    @property
    def cause(self) -> Cause:
        """Cause of the last transition."""
        return self._fw.cause

    def reset(self, now_ns: int) -> None:
        """Reset the processor, as opening an Uno's port does; bytes on the wires are lost."""
        self.advance(now_ns)
        self._begin(now_ns, EXTERNAL_RESET_FLAGS)

    def receive(self, now_ns: int, data: bytes) -> None:
        """Put bytes on the wire to the device; they arrive one by one from `now_ns` on."""
        self._rx.put(now_ns, data)
        self._next_ns = min(self._next_ns, self._rx.first_ns)

    def rx_backlog_ns(self, now_ns: int) -> int:
        """Return the time for which the sent bytes still occupy the wire to the device, in ns."""
        return self._rx.backlog_ns(now_ns)

    def next_ns(self) -> int:
        """Return the time of the next step, at which `advance` must be called."""
        return self._next_ns

    def visible_ns(self) -> int:
        """Return a time before which no byte can leave and the watchdog cannot trip.

        If only internal work is due, the returned time is later than `next_ns`. A caller that only
        needs the bytes can sleep until this time. The sleep does not change the bytes.

        An answer is ready `LEAD_NS` before it is due. A sample of the timer is ready only when it
        is due, because no host waits for it. The caller then wakes only once for each sample.
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
        """Advance to `now_ns`; return the sent frames, each with the time of its last byte."""
        while self._next_ns <= now_ns:
            self._step(self._next_ns)
        return self._tx.pop_sent()

    def advance_until(self, limit_ns: int) -> tuple[int, list[tuple[int, bytes]]]:
        """Advance to the limit or the next step, whichever is earlier; return time and frames."""
        now_ns = min(limit_ns, self._next_ns)
        return now_ns, self.advance(now_ns)

    def _begin(self, now_ns: int, mcusr: int) -> None:
        last = self._boot_id
        while self._boot_id == 0 or not (self._boot_id ^ last) & U16:
            self._boot_id = int(self._rng.integers(1, U32, endpoint=True))
        self._fw = Firmware(
            board=self.board,
            hardware=self._hardware,
            rng=self._rng,
            clock=clock.clock_at_reset(self._settings, now_ns),
            boot_id=self._boot_id,
            mcusr=mcusr,
        )
        self.board.release(now_ns, State.BOOT, self._fw.cause)
        self._rx = Reception(now_ns, self._baud)
        self._tx = Transmission(now_ns, self._baud)
        self._converter = Converter(self._fw)
        self._booted_ns = self._fw.clock.after(now_ns, self._boot_ns)
        self._status_ns = self._fw.clock.after(now_ns, max(STATUS_NS, self._boot_ns + 1))
        self._supply_ns = NEVER
        self._next_ns = self._booted_ns  # no other event is due earlier

    def _step(self, t_ns: int) -> None:
        """Perform one step that is due at `t_ns`, and compute the time of the next step."""
        fw, rx, converter = self._fw, self._rx, self._converter
        if rx.first_ns == t_ns:  # first: a STOP takes effect before a latch at the same time
            self._arrive(t_ns)
        elif self._booted_ns == t_ns:
            self._booted_ns = NEVER
            rx.forget(t_ns)
            self._supply_ns = fw.clock.after(t_ns, SUPPLY_NS)
            fw.measure_supply(t_ns)
            self._tx.begin(t_ns)
            self._tx.send(fw, t_ns, [fw.enter(t_ns, State.IDLE, fw.cause)])
        elif fw.watchdog_ns == t_ns:
            self._tx.send(fw, t_ns, [fw.enter(t_ns, State.FAULT, Cause.WATCHDOG)])
        elif converter.due_ns == t_ns:
            made = converter.step(t_ns)
            if made:  # two of three steps create no message
                self._tx.send(fw, t_ns, made)
        elif fw.timer_ns == t_ns:
            self._tx.send(fw, t_ns, fw.tick(t_ns))
            converter.wake()
        elif self._supply_ns == t_ns:
            self._supply_ns = converter.end_ns  # if the converter is busy: as soon as it is free
            if self._supply_ns == NEVER:
                self._supply_ns = fw.clock.after(t_ns, SUPPLY_NS)
                self._tx.send(fw, t_ns, fw.measure_supply(t_ns))
        else:
            self._status_ns = fw.clock.after(t_ns, STATUS_NS)
            self._tx.send(fw, t_ns, [fw.status(t_ns)])
        self._next_ns = min(  # stored, because it is read far more often
            rx.first_ns,
            converter.due_ns,
            fw.watchdog_ns,
            fw.timer_ns,
            self._status_ns,
            self._booted_ns,
            self._supply_ns,
        )

    def _next_makes_sample(self) -> bool:
        """Return whether the next piece is an EXCHANGE whose answer is a sample."""
        match self._rx.peek():
            case [Exchange() as exchange]:
                return makes_sample(self._fw, exchange)
        return False

    def _arrive(self, t_ns: int) -> None:
        """Receive the piece that is complete at `t_ns`."""
        fw = self._fw
        received = self._rx.pop()
        if fw.state is _BOOT:
            return
        for item in received:
            # While the timer samples, an EXCHANGE never waits: it is refused.
            waits = isinstance(item, Exchange) and fw.timer is None
            if waits and sum(sample.u is not None for sample in fw.pending) >= MOST_PENDING:
                fw.count_lost(frame.wire_length(Exchange))
                continue
            answers = handle(fw, t_ns, item)
            if answers:  # the answer to an EXCHANGE is its sample
                self._tx.send(fw, t_ns, answers)
            self._converter.wake()
