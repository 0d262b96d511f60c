"""The C core in the place of the Python firmware, in the emulated device, on the emulated board.

Wire, clock, converter, timer and arm are the emulator's own; what decides is the C core. So both
devices must send the same bytes at the same times.
"""

from __future__ import annotations

import ctypes
from collections import deque
from typing import Any

import numpy as np
from armrig_daemon.emulator import clock
from armrig_daemon.emulator.board import Board, VoltageError, duty
from armrig_daemon.emulator.clock import U32, Clock, microseconds
from armrig_daemon.emulator.converter import Converter
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.firmware import (
    MOTOR_MAY_TURN,
    NEVER,
    Hardware,
    PendingCal,
    PendingSample,
)
from armrig_daemon.emulator.reception import Reception
from armrig_daemon.emulator.timer import Timer
from armrig_daemon.emulator.transmission import Transmission
from armrig_daemon.emulator.uart import departure_ns
from armrig_protocol.messages import Cause, Message, State

from firmware.library import library

ASKED, TIMED, LATE = 0, 1, 2
_CAUSES, _STATES = tuple(Cause), tuple(State)


class CoreReception(Reception):
    """The wire to the device, without a decoder: the core has its own."""

    def pop(self) -> Any:
        """Return the next piece, which has arrived."""
        _, piece = self._pieces.popleft()
        self.first_ns = self._pieces[0][0] if self._pieces else NEVER
        return piece


class CoreTransmission(Transmission):
    """The ring and the wire to the host; the core makes the frames."""

    def begin(self, t_ns: int) -> None:
        """Do nothing: the core sends its 00 by itself."""

    def send(self, fw: Any, t_ns: int, messages: list[Message]) -> None:
        """Do nothing: the core has called `put`."""

    def put(self, t_ns: int, wire: bytes) -> bool:
        """Put bytes on the wire; return whether the ring had room."""
        end_ns = departure_ns(self._free_ns, t_ns, len(wire), self._baud)
        if end_ns - t_ns > self._ring_ns:
            return False
        self._free_ns = end_ns
        self.sent.append((end_ns, wire))
        return True

    def begins_ns(self, t_ns: int) -> int:
        """Return when the next byte would begin to leave."""
        return max(t_ns, self._free_ns)


class CoreFirmware:
    """The C core as `Firmware` is, for the device; and the hardware, for the core."""

    def __init__(
        self,
        *,
        board: Board,
        hardware: Hardware,
        rng: np.random.Generator,
        device_clock: Clock,
        tx: CoreTransmission,
    ) -> None:
        """Begin in BOOT."""
        self.board, self.hardware, self.rng, self.clock = board, hardware, rng, device_clock
        self.state, self.cause = State.BOOT, Cause.POWER_ON
        self.pending: deque[PendingSample] = deque()
        self.cal: PendingCal | None = None
        self.timer: Timer | None = None
        self.timer_ns = self.watchdog_ns = NEVER
        self.u_seq = 0
        self.image: Any = None
        self._tx = tx
        self._library = library(hardware)
        self._now_ns = self._fed_ns = 0
        self._is_off = False
        self._latched = "pc_u_rest"
        self._boot = (0, 0)

    # -- what tests set ---------------------------------------------------------------------------

    @property
    def boot_id(self) -> int:
        """Of this boot."""
        return self._boot[0]

    @boot_id.setter
    def boot_id(self, boot_id: int) -> None:
        self._library.use(self).pc_set_boot_id(boot_id)

    @property
    def queue(self) -> CoreFirmware:
        """The queue, of which nothing but `next` can be reached."""
        return self

    @property
    def next(self) -> int:
        """Index of the next sample to be latched."""
        return int(self._library.use(self).pc_next())

    @next.setter
    def next(self, k: int) -> None:
        self._library.use(self).pc_set_next(k % (1 << 32))

    # -- what the device asks for ----------------------------------------------------------------

    @property
    def conversions(self) -> int:
        """How many a sample that begins now takes."""
        return 2 * self._library.use(self).rig_oversampling()

    def boot(self, boot_id: int, mcusr: int) -> None:
        """Reset the processor."""
        self._boot = (boot_id, mcusr)

    def enter(self, now_ns: int, state: State, cause: Cause) -> None:
        """End BOOT, as the device knows it; all other transitions are the core's."""
        self._library.use(self).pc_reset(*self._boot)
        self._call(now_ns, "rig_begin")

    def receive(self, now_ns: int, piece: bytes) -> None:
        """Take bytes."""
        self._call(now_ns, "pc_receive", piece, len(piece))

    def trip_on_silence(self, now_ns: int) -> list[Message]:
        """Look at the watchdog."""
        self._call(now_ns, "rig_watch_run")
        assert self.state is State.FAULT
        return []

    def tick(self, now_ns: int) -> list[Message]:
        """Let the timer's sample fall due, or end the run."""
        timer = self.timer
        assert timer is not None
        if timer.ends:
            self.timer_stop()
            self._call(now_ns, "pc_end")
        else:
            self.pending.append(PendingSample(timer.due_ns, timer.k))
            timer.k += 1
            self._set_timer(timer)
        return []

    def measure_supply(self, now_ns: int) -> list[Message]:
        """Let the core ask for a measurement; in BOOT it does so by itself."""
        if self.state is not State.BOOT:
            self._call(now_ns, "rig_watch_supply")
        return []

    def status(self, now_ns: int) -> list[Message]:
        """Let the core tell its counters."""
        self._call(now_ns, "rig_tell_status")
        return []

    # -- what the converter has ------------------------------------------------------------------

    def reading(self, now_ns: int, channel: int, code: int) -> None:
        """Give a conversion's code to the core."""
        self._call(now_ns, "rig_reading", channel, code)

    def latch(self, now_ns: int) -> None:
        """Let u of the sample under way act."""
        timed = self.pending[0].u is None
        self._latched = "pc_u_in_force" if timed else "pc_asked_u"
        self._call(now_ns, "rig_latch", TIMED if timed else ASKED)
        self._latched = "pc_u_rest"

    def converted(self, now_ns: int, t_us: int, *, late: bool) -> None:
        """End the sample under way."""
        what = TIMED if self.pending.popleft().u is None else ASKED
        self._call(now_ns, "pc_converted", what | (LATE if late else 0), t_us)

    def end_cal(self, now_ns: int) -> None:
        """End the CAL under way."""
        self.cal = None
        self._call(now_ns, "rig_tell_cal")

    # -- what the core asks of its board ---------------------------------------------------------

    def motor_off(self) -> None:
        self._is_off = True

    def motor_set(self, code_duty: int) -> None:
        code = getattr(self._library.c, self._latched)()
        wanted = duty(code, self.hardware.pwm_bits) if self.hardware.pwm_bits < 16 else code
        if code_duty != wanted or self._library.c.pc_state() != State.RUN:
            msg = f"duty {code_duty} for code {code} in state {self._library.c.pc_state()}"
            raise VoltageError(msg)
        self._refresh()
        self.board.latch(self._now_ns, code, Cause.REQUEST)

    def convert_now(self) -> None:
        c, due_ns = self._library.c, self.clock.device_ns(self._now_ns)
        self.pending.append(PendingSample(due_ns, c.pc_asked_k(), c.pc_asked_seq(), 0))

    def timer_start(self, t0_us: int, ts_us: int, k_stop: int) -> None:
        period_ns = ts_us * 1000
        first_ns = self.clock.device_ns(self._now_ns) + period_ns
        assert microseconds(first_ns) == t0_us
        lead_ns = (self.conversions - 1) * self.hardware.conversion_ns
        self._set_timer(
            Timer(
                first_ns=first_ns,
                period_ns=period_ns,
                lead_ns=lead_ns,
                hold_ns=self.hardware.hold_ns,
                k_stop=k_stop,
            )
        )

    def timer_stop(self) -> None:
        self._set_timer(None)

    def converter_is_free(self) -> bool:
        return not self.pending

    def convert_channel(self, channel: int, n: int) -> None:
        self.cal = PendingCal(self.clock.device_ns(self._now_ns), channel, n)

    def measure_supply_now(self) -> None:
        self._library.c.rig_supply(self.board.supply_mv(self._now_ns))

    def send(self, data: Any, n: int) -> bool:
        return self._tx.put(self._now_ns, ctypes.string_at(data, n))

    def send_us(self) -> int:
        return microseconds(self.clock.device_ns(self._tx.begins_ns(self._now_ns)))

    def token(self) -> int:
        return int(self.rng.integers(1, U32, endpoint=True))

    # -- between both ----------------------------------------------------------------------------

    def _set_timer(self, timer: Timer | None) -> None:
        self.timer = timer
        self.timer_ns = self.clock.instant(timer.due_ns) if timer else NEVER

    def _call(self, now_ns: int, name: str, *given: Any) -> None:
        c = self._library.use(self)
        self._now_ns = now_ns
        c.pc_set_time(microseconds(self.clock.device_ns(now_ns)))
        getattr(c, name)(*given)
        self._refresh()
        if self._is_off:
            self._is_off = False
            self.board.release(now_ns, self.state, self.cause)
        self._library.raise_error()

    def _refresh(self) -> None:
        """Look at what the device, and who watches it, want to know of the core."""
        c = self._library.c
        self.state, self.cause = _STATES[c.pc_state()], _CAUSES[c.pc_cause()]
        self.u_seq = c.pc_u_seq()
        self.watchdog_ns = NEVER
        if self.state in MOTOR_MAY_TURN:
            # The core counts microseconds; the device knows the nanosecond at which it was fed.
            if c.pc_fed_us() == microseconds(self.clock.device_ns(self._now_ns)):
                self._fed_ns = self._now_ns
            self.watchdog_ns = self.clock.after(self._fed_ns, c.pc_watchdog_ms() * 1_000_000)


class CoreConverter(Converter):
    """The converter, whose codes go to the core."""

    _fw: Any

    def step(self, t_ns: int) -> list[Message]:
        """Hold the next input, latching behind theta_1's last; behind the last end the sample."""
        fw = self._fw
        if self._held == self._conversions:
            self._end_core(t_ns)
            return []
        channel = fw.cal.channel if fw.cal is not None else 1 - (self._held & 1)
        fw.reading(t_ns, channel, fw.board.alpha(t_ns) if channel else fw.board.theta_1(t_ns))
        self._held += 1
        if self._held < self._conversions:
            after_ns = self._held * self._conversion_ns + self._hold_ns
            self.due_ns = fw.clock.instant(self._trigger_ns + after_ns)
        else:
            if fw.cal is None:
                fw.latch(t_ns)
            self.due_ns = self.end_ns
        return []

    def _end_core(self, t_ns: int) -> None:
        fw = self._fw
        end_ns = self._trigger_ns + self._conversions * self._conversion_ns
        self._conversions, self.due_ns, self.end_ns = 0, NEVER, NEVER
        if fw.cal is not None:
            fw.end_cal(t_ns)
            return
        late = self._trigger_ns > fw.pending[0].due_ns
        fw.converted(t_ns, microseconds(end_ns - self._conversion_ns), late=late)
        if fw.pending:
            self._trigger(max(end_ns, fw.pending[0].due_ns), fw.conversions)


class CoreDevice(Device):
    """An emulated rig whose firmware is the C core."""

    _fw: Any
    _rx: Any

    def _begin(self, now_ns: int, mcusr: int) -> None:
        last = self._boot_id
        while self._boot_id in (0, last):
            self._boot_id = int(self._rng.integers(1, U32, endpoint=True))
        self._rx = CoreReception(now_ns, self._baud)
        self._tx = CoreTransmission(now_ns, self._baud)
        self._fw = CoreFirmware(
            board=self._board,
            hardware=self._hardware,
            rng=self._rng,
            device_clock=clock.started(self._settings, now_ns),
            tx=self._tx,
        )
        self._fw.boot(self._boot_id, mcusr)
        self._board.release(now_ns, State.BOOT, self._fw.cause)
        self._converter = CoreConverter(self._fw)
        self._booted_ns = self._fw.clock.after(now_ns, self._boot_ns)
        self._status_ns = self._fw.clock.after(now_ns, max(1_000_000_000, self._boot_ns + 1))
        self._supply_ns = NEVER
        self._next_ns = self._booted_ns

    def _next_makes_sample(self) -> bool:
        return False

    def _arrive(self, t_ns: int) -> None:
        piece = self._rx.pop()
        if self._fw.state is State.BOOT:
            return
        self._fw.receive(t_ns, piece)
        self._converter.wake()
