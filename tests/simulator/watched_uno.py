"""The Uno's binary in simavr as the device of a schedule, judged at its pin.

The inside of the program is not visible. The voltage is the pin's, in each period of its PWM. The
line gives the arrival of bytes, the converter the hold of theta_1. The program reports the rest:
SAMPLE the latched code and its frame, EVENT the state that it left.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path

from armrig_core.rig.firmware_image import image_path
from armrig_core.rig.volts import device_code
from armrig_core.rig.volts import duty as duty_of
from armrig_daemon.emulator.board import FULL_SCALE_V
from armrig_daemon.emulator.firmware import MOTOR_MAY_TURN
from armrig_daemon.emulator.harness import CYCLES_PER_US, Duty
from armrig_daemon.emulator.harness import Violation as Violated
from armrig_daemon.emulator.layout import LAYOUTS
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.emulator.uart import arrivals, wire_ns
from armrig_daemon.emulator.uno import Uno
from armrig_protocol import messages as wire
from armrig_protocol.decoder import feed
from armrig_protocol.frame import decode
from armrig_protocol.messages import TYPES, Cause, Code, State

from tests.firmware.uno_host import harness
from tests.simulator.checks import Checks
from tests.simulator.frames import Frame
from tests.simulator.violation import Violation

_LATCH_NS = 16_000
"""An interrupt may wait for another."""
_SAME_NS = 3_000
_START = TYPES[wire.Start]


class WatchedUno(Uno):
    """A simulated Uno whose pin and frames are judged by `Checks`."""

    is_stalled = False

    def __init__(
        self, settings: EmulatorSettings, checks: Checks, trace: Path | None, name: str
    ) -> None:
        """Switch it on at time 0 with the image `name`; `trace` is the VCD file for its pins."""
        self.checks = checks
        self._baud = settings.baud
        self._begin(0)
        layout = LAYOUTS[name]
        self._pwm_bits = layout.pwm_bits
        self._acts_ns = layout.period * 1000 // CYCLES_PER_US + _LATCH_NS
        """Time from a latch until the code acts: in the next period of the PWM."""
        super().__init__(harness(), image_path(name), settings, layout=layout, trace=trace)

    def _begin(self, now_ns: int) -> None:
        self._reset_ns = now_ns
        self._coming: deque[tuple[int, bytes]] = deque()
        """Pieces on the line to the device, with when the last byte of each has arrived."""
        self._holds: deque[int] = deque(maxlen=32)
        """Times at which theta_1 was held."""
        self._behind_ns: int | None = None
        """Time from the device's clock at a trigger to the hold."""
        self._acked: Frame | None = None
        self._may_run = False
        self._low_ns = 0
        self.checks.booted()

    def emulation_ns(self, host_ns: int) -> int:
        """Return the device's share of the host's time: all of it."""
        return host_ns

    def acted_ns(self, host_ns: int) -> int:
        """Return up to which time it has acted."""
        return host_ns

    def reset(self, now_ns: int) -> None:
        """Reset it by its pin."""
        super().reset(now_ns)
        self.checks.gets(
            now_ns, 0.0, State.RUN, Cause.NONE
        )  # unless the next period shows another duty
        self._begin(now_ns)

    def receive(self, now_ns: int, data: bytes) -> None:
        """Put bytes on the wire to it."""
        self._coming.extend(arrivals(self._line_free_ns, now_ns, data, self._baud))
        super().receive(now_ns, data)

    def advance_to_frame(self, now_ns: int) -> list[tuple[int, bytes]]:
        """Do everything due until `now_ns` or the next frame, whichever is first."""
        while True:
            limit_ns = min(now_ns, self._coming[0][0]) if self._coming else now_ns
            _, frames = self.advance_until(limit_ns)
            if frames:
                return frames
            while self._coming and self._coming[0][0] <= limit_ns:
                self._arrives(*self._coming.popleft())
            if limit_ns == now_ns:
                return []

    def _arrives(self, t_ns: int, piece: bytes) -> None:
        if self.state is State.BOOT:
            return
        frame = self.checks.arrives(t_ns, piece, bound=self.state in MOTOR_MAY_TURN)
        self._may_run |= frame is not None and frame.type == _START

    # -- the pin ---------------------------------------------------------------------------------

    def _apply(self, duty: Duty) -> None:
        super()._apply(duty)
        t_ns, checks = self.ns(duty.cycle), self.checks
        volts = FULL_SCALE_V * duty.high / self._layout.period
        if checks.volts and not volts:
            self._low_ns = t_ns
        if t_ns < self._reset_ns:
            return  # the period that a reset cut off: it was high before
        checks.gets(
            t_ns, volts, State.RUN if self._may_run or not volts else State.IDLE, Cause.NONE
        )
        for violated in self.violations:
            if violated.what is not Violated.RX_OVERRUN:
                raise Violation("S1", t_ns, violated.what.name)
        self.violations.clear()

    def _hold(self, cycle: int) -> None:
        self._holds.append(self.ns(cycle))
        super()._hold(cycle)

    def _duty_at(self, t_ns: int) -> int:
        return next((d.high for d in reversed(self.duties) if self.ns(d.cycle) <= t_ns), 0)

    # -- its reports -----------------------------------------------------------------------------

    def _note_sent_frame(self, t_ns: int) -> None:
        super()._note_sent_frame(t_ns)
        for message in feed(b"", self._frames[-1][1])[1]:
            self._judge(t_ns, message)

    def _judge(self, t_ns: int, m: object) -> None:
        if isinstance(m, wire.Ack) and m.code == Code.OK:
            self._acked = self.checks.taken_in(m.of_seq)
        elif isinstance(m, wire.Event):
            self._left(t_ns, m)
        elif isinstance(m, wire.Sample) and m.state == State.RUN:
            self._latched(t_ns, m)

    def _left(self, t_ns: int, m: wire.Event) -> None:
        """Judge a reported transition."""
        if m.was != State.BOOT:
            self.checks.changed(t_ns, m.was, m.state, self._acked)
        if m.state == State.RUN:
            return
        self._may_run = False
        if self.checks.volts:
            raise Violation("S1", t_ns, f"{self.checks.volts} V, and it tells {m}")
        if m.was == State.RUN:
            self.checks.stopped(self._low_ns, m.cause)

    def _latched(self, t_ns: int, m: wire.Sample) -> None:
        """Judge a reported latch, and the pin at that time (S5)."""
        hold_ns = self._hold_of(t_ns, m)
        frame = self.checks.taken_in(m.u_seq) if m.u_seq else None
        said = decode(frame.data[:-1]) if frame is not None else None
        scheduled = isinstance(said, wire.Setpoints)
        code = _code_of(said, m)
        if device_code(code, self._pwm_bits) != m.u_k:
            raise Violation("S5", t_ns, f"{m} where {said} was taken in")
        self.checks.latch(hold_ns, code, m.k, m.u_seq, scheduled=scheduled)
        self.checks.remember(m.k, m.u_k, scheduled=scheduled)
        high = self._duty_at(hold_ns + self._acts_ns)
        period = self._layout.period
        if high not in (0, duty_of(code, self._pwm_bits) * period >> self._pwm_bits):
            raise Violation("S5", t_ns, f"the pin is high for {high} of {period} cycles, where {m}")
        self.checks.seen["S5: the pin had the code that was told"] += bool(high)

    def _hold_of(self, t_ns: int, m: wire.Sample) -> int:
        """Return when theta_1 was held for a sample; the first of a boot was held just now."""
        t_device_ns = m.t_us * 1000
        if self._behind_ns is None:
            begun_ns = t_ns - wire_ns(len(self._frames[-1][1]), self._baud)
            newest_ns = max(t for t in self._holds if t < begun_ns)
            self._behind_ns = newest_ns - t_device_ns
        for hold_ns in self._holds:
            if abs(hold_ns - t_device_ns - self._behind_ns) < _SAME_NS:
                return hold_ns
        raise Violation("S5", t_ns, f"{m}: nothing was held at its time")


def _code_of(said: object, m: wire.Sample) -> int:
    """Return the code of a frame for a sample; START means u_rest."""
    if isinstance(said, wire.Exchange):
        return said.u
    if isinstance(said, wire.Setpoints) and 0 <= m.k - said.k0 < said.n:
        return said.u[m.k - said.k0]
    return 0
