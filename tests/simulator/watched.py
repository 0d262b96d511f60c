"""The emulated device under observation of each frame, latch and transition.

Its process may be stalled: the device is called with the host's time, and is given its own.
`Checks` receive its acts in given time.
"""

from __future__ import annotations

from ctypes import string_at
from itertools import product
from typing import Any

from armrig_daemon.emulator.board import Change
from armrig_daemon.emulator.clock import EmulatedClock
from armrig_daemon.emulator.device import HOLD_NS, Device
from armrig_daemon.emulator.firmware import MOTOR_MAY_TURN, Hardware
from armrig_daemon.emulator.host_time import STALL_NS, HostTime
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol.messages import Cause, State

from tests.firmware.core_device import CoreDevice
from tests.firmware.library import library
from tests.simulator.checks import Checks
from tests.simulator.frames import Frame

_BOOT, _RUN = State.BOOT, State.RUN


class Watching:
    """Device whose every act `Checks` judges."""

    def __init__(self, settings: EmulatorSettings, checks: Checks, clock_start_us: int) -> None:
        """Switch it on at time 0, its clock showing `clock_start_us`."""
        self.checks = checks
        self._clock_start_ns = clock_start_us * 1000
        self._time = HostTime(0, tolerates_stalls=settings.tolerates_stalls)
        self._tolerates = settings.tolerates_stalls
        self._standstills: list[tuple[int, int]] = []
        """Host times without the device's clock; the last end may be in the future."""
        self.is_stalled = False
        self._due_ns = self._acted_ns = 0
        self._waiting: list[bytes] = []
        self._is_opened = False
        super().__init__(settings, 0, self._changed)
        self._really_latch, self._really_release = self.board.latch, self.board.release
        # The board is the device's own; its latch is where a code becomes a voltage.
        self.board.latch, self.board.release = self._latch, self._release

    # -- the process that emulates it ------------------------------------------------------------

    def emulation_ns(self, host_ns: int) -> int:
        """Return the device's share of the host's time, at any time that has been."""
        if not self._standstills:
            return host_ns
        return host_ns - sum(min(max(host_ns - a, 0), b - a) for a, b in self._standstills)

    def acted_ns(self, host_ns: int) -> int:
        """Return up to which given time it has acted, at a host time that is now."""
        return self._acted_ns if self.is_stalled else self.emulation_ns(host_ns)

    def stall(self, now_ns: int, end_ns: int) -> None:
        """Let the process stand still from now on, while it waits."""
        self._acted_ns = self.emulation_ns(now_ns)
        self._time.emulation_ns(now_ns, self._acted_ns)  # it has been on time until now
        self._due_ns = self._time.look_ns(self.visible_ns())
        self.is_stalled = True
        if self._tolerates:
            stops_ns = max(now_ns, self._time.monotonic_ns(self._due_ns)) + STALL_NS
            if stops_ns < end_ns:
                self._standstills.append((stops_ns, end_ns))

    def go_on(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Let the process go on as `emulator.real_time` does; return what it sends at once."""
        given_ns = self._time.emulation_ns(now_ns, self._due_ns)
        assert given_ns == self.emulation_ns(now_ns)
        self.is_stalled = False
        sent = [(now_ns, data) for _, data in super().advance(given_ns)]
        waiting, self._waiting = self._waiting, []
        if self._is_opened:  # what waits is thrown away, either way
            self._is_opened = False
            super().reset(given_ns)
            return []
        for piece in waiting:
            super().receive(given_ns, piece)
        return sent

    def advance_to_frame(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Do as `Device` does, in the host's time."""
        if self.is_stalled:
            return []
        if not self._standstills:
            return super().advance_to_frame(now_ns)
        held_ns = self._time.held_up_ns
        frames = super().advance_to_frame(now_ns - held_ns)
        return [(t_ns + held_ns, data) for t_ns, data in frames]

    def receive(self, now_ns: int, data: bytes) -> None:
        """Take bytes; those that come in a stall wait in the terminal."""
        if self.is_stalled:
            self._waiting.append(data)
        else:
            super().receive(now_ns - self._time.held_up_ns, data)

    def reset(self, now_ns: int) -> None:
        """Reset the device, at once or when the process goes on."""
        if self.is_stalled:
            self._is_opened = True
        else:
            super().reset(now_ns - self._time.held_up_ns)

    def close(self) -> None:
        """Do nothing: it is no process."""

    # -- what it does ----------------------------------------------------------------------------

    def _changed(self, change: Change) -> None:
        self.checks.gets(change.t_ns, change.volts, change.state, change.cause)

    def _begin(self, now_ns: int, mcusr: int) -> None:
        super()._begin(now_ns, mcusr)
        if self._clock_start_ns:
            fw = self._fw
            second_ns = fw.clock.second_ns
            fw.clock = EmulatedClock(now_ns - self._clock_start_ns * second_ns // 10**9, second_ns)
        self.checks.booted()

    def _arrive(self, t_ns: int) -> None:
        fw, checks = self._fw, self.checks
        before = fw.state
        if before is _BOOT:
            super()._arrive(t_ns)
            return
        bound = before in MOTOR_MAY_TURN
        frame = checks.arrives(t_ns, self._rx.first(), bound=bound)
        super()._arrive(t_ns)
        if fw.state is not before:
            checks.changed(t_ns, before, fw.state, frame)

    def _release(self, now_ns: int, state: State, cause: Cause) -> None:
        self._really_release(now_ns, state, cause)
        self.checks.gets(now_ns, 0.0, state, cause)  # 0 V may have been driven

    def _latch(self, now_ns: int, code: int, cause: Cause) -> None:
        fw, checks = self._fw, self.checks
        pending = fw.pending
        if fw.state is not _RUN:
            self._really_latch(now_ns, code, cause)
            return
        scheduled = fw.timer is not None
        k, seq = (pending[0].k, pending[0].seq) if pending else (-1, -1)
        if scheduled:
            seq = fw.u_seq  # of the SETPOINTS that brought what is latched now
        checks.latch(now_ns, code, k, seq, scheduled=scheduled)
        self._really_latch(now_ns, code, cause)
        checks.gets(now_ns, self.board.volts, _RUN, cause)
        if code:
            checks.latch_done(now_ns, code, k, self.board.code, scheduled=scheduled)


def build() -> None:
    """Build the C core for all boards that are drawn."""
    for pwm_bits, queue in product((8, 10, 16), (256, 512)):
        library(
            Hardware(
                conversion_ns=104_000, hold_ns=HOLD_NS, adc_bits=10, pwm_bits=pwm_bits, queue=queue
            ),
            WatchedCore.build,
        )


class FrameByFrame(Device):
    """A device that also advances frame by frame."""

    def advance_to_frame(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Advance to `now_ns` or to the next frame, whichever is earlier; return the sent frames.

        Repeated calls perform the same events as `advance` and return the same frames, one frame
        per call.
        """
        if self._next_ns > now_ns:  # the usual case
            return []
        tx = self._tx
        while self._next_ns <= now_ns:
            self._step(self._next_ns)
            if tx.sent:
                return tx.pop_sent()
        return []


class Watched(Watching, FrameByFrame):
    """A device with the Python firmware."""


class WatchedCore(Watching, CoreDevice):
    """A device with the C core, whose calls of the board layer are judged."""

    is_watched = True
    build = "librig-fast.so"
    _frame: Frame | None = None

    def arrives(self, t_ns: int, data: Any, n: int) -> None:
        """Judge bytes that C is about to take in."""
        bound = self._fw.state in MOTOR_MAY_TURN
        self._frame = self.checks.arrives(t_ns, string_at(data, n), bound=bound)

    def changed(self, t_ns: int, before: int) -> None:
        """Judge the effects."""
        self.checks.changed(t_ns, before, self._fw.state, self._frame)
