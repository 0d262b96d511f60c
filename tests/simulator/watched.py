"""The emulated device with somebody who looks at each frame, latch and transition."""

from __future__ import annotations

from armrig_daemon.emulator.board import Change
from armrig_daemon.emulator.clock import Clock
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.firmware import MOTOR_MAY_TURN
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol.messages import Cause, State

from simulator.checks import Checks

_BOOT, _RUN = State.BOOT, State.RUN


class Watched(Device):
    """A device whose every act is judged by `Checks`."""

    def __init__(self, settings: EmulatorSettings, checks: Checks, clock_start_us: int) -> None:
        """Switch it on at time 0, its clock showing `clock_start_us`."""
        self.checks = checks
        self._clock_start_ns = clock_start_us * 1000
        super().__init__(settings, 0, self._changed)
        self._really_latch = self._board.latch
        # The board is the device's own; its latch is where a code becomes a voltage.
        self._board.latch = self._latch  # type: ignore[method-assign]

    def _changed(self, change: Change) -> None:
        self.checks.gets(change.t_ns, change.volts, change.state, change.cause)

    def _begin(self, now_ns: int, mcusr: int) -> None:
        super()._begin(now_ns, mcusr)
        if self._clock_start_ns:
            fw = self._fw
            second_ns = fw.clock.second_ns
            fw.clock = Clock(now_ns - self._clock_start_ns * second_ns // 10**9, second_ns)
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
        if code:
            checks.latch_done(now_ns, code, k, self._board.code, scheduled=scheduled)
