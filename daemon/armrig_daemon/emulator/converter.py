"""The converter: consecutive conversions for a sample or for a CAL, and the sample's frame.

All times are computed from the first trigger, in device time; `due_ns` and `end_ns` are in the time
of the caller.
"""

from __future__ import annotations

from armrig_protocol.messages import Cause, Flag, Message, Sample, State

from armrig_daemon.emulator.clock import U32, microseconds
from armrig_daemon.emulator.firmware import NEVER, U16, UNNUMBERED, Firmware
from armrig_daemon.emulator.guards import watch
from armrig_daemon.emulator.queue import Setpoint
from armrig_daemon.emulator.requests import cal_answer
from armrig_daemon.emulator.sensors import at_rail, mean

# Names at module level: the lookup of a member in its enum takes 0.08 µs each time.
_RUN, _FAULT, _REQUEST, _NONE = State.RUN, State.FAULT, Cause.REQUEST, Cause.NONE
_STATE_FLAGS = {
    State.RUN: int(Flag.RUN | Flag.ARMED),
    State.ARMED: int(Flag.ARMED),
    State.ESTOP: int(Flag.ESTOP),
}
_FAULT_FLAGS = {
    Cause.WATCHDOG: int(Flag.WATCHDOG),
    Cause.RANGE: int(Flag.RANGE),
    Cause.SLEW: int(Flag.SLEW),
    Cause.REV_LIMIT: int(Flag.REV_LIMIT),
}
_RAIL_0_FLAG, _RAIL_1_FLAG = int(Flag.ADC0_RAIL), int(Flag.ADC1_RAIL)
_LATE_FLAG, _UNDERRUN_FLAG = int(Flag.TICK_LATE), int(Flag.UNDERRUN)
_VCC_LOW_FLAG = int(Flag.VCC_LOW)


class Converter:
    """Converter that takes the samples in `fw.pending` and the readings of `fw.cal`."""

    def __init__(self, fw: Firmware) -> None:
        """Begin idle."""
        self._fw = fw
        self._conversion_ns = fw.hardware.conversion_ns
        self._hold_ns = fw.hardware.hold_ns
        self._codes: tuple[list[int], list[int]] = ([], [])
        """Readings of channels 0 and 1 since the first trigger."""
        self._trigger_ns = 0
        self._held = self._conversions = 0
        self.due_ns = NEVER
        """Time of the next step."""
        self.end_ns = NEVER
        """Time at which the present sample or CAL ends."""

    def wake(self) -> None:
        """Begin the first waiting sample or CAL, unless a sample or a CAL is in progress."""
        fw = self._fw
        if self._conversions:
            return
        if fw.pending:
            self._trigger(fw.pending[0].due_ns, fw.conversions)
        elif fw.cal is not None:
            self._trigger(fw.cal.due_ns, fw.cal.n)

    def step(self, t_ns: int) -> list[Message]:
        """Hold the next input. After the last hold, latch u; after the last conversion, answer."""
        fw, codes = self._fw, self._codes
        if self._held == self._conversions:
            return self._end(t_ns)
        # Channel 1 first, then in turn.
        channel = fw.cal.channel if fw.cal is not None else int(not self._held & 1)
        codes[channel].append(fw.board.reading(channel, t_ns))
        self._held += 1
        if self._held < self._conversions:
            after_ns = self._held * self._conversion_ns + self._hold_ns
            self.due_ns = fw.clock.instant(self._trigger_ns + after_ns)
        else:
            if fw.cal is None:
                # Channel 0 is held just before the latch: its reading does not depend on this u.
                latch(fw, t_ns)
            self.due_ns = self.end_ns
        return []

    def _end(self, t_ns: int) -> list[Message]:
        fw, conversion_ns = self._fw, self._conversion_ns
        first, second = self._codes
        end_ns = self._trigger_ns + self._conversions * conversion_ns
        self._conversions, self.due_ns, self.end_ns = 0, NEVER, NEVER
        if fw.cal is not None:
            return [cal_answer(fw, second or first)]
        t_us = microseconds(end_ns - conversion_ns)
        late = self._trigger_ns > fw.pending[0].due_ns
        messages = sample(fw, t_ns, t_us, mean(first), mean(second), late=late)
        if fw.pending:
            self._trigger(max(end_ns, fw.pending[0].due_ns), fw.conversions)
        return messages

    def _trigger(self, device_ns: int, conversions: int) -> None:
        clock = self._fw.clock
        self._codes = ([], [])
        self._trigger_ns, self._held, self._conversions = device_ns, 0, conversions
        self.end_ns = clock.instant(device_ns + conversions * self._conversion_ns)
        self.due_ns = clock.instant(device_ns + self._hold_ns)


def latch(fw: Firmware, now_ns: int) -> None:
    """Latch the input u of the first pending sample, unless the run of this sample has ended."""
    wanted = fw.pending[0]
    fw.u_km1 = fw.board.code
    if not wanted.drives:
        return
    u, fw.u_seq = (wanted.u, wanted.seq) if wanted.u is not None else _next_setpoint(fw)
    fw.board.latch(now_ns, u, _REQUEST)


def _next_setpoint(fw: Firmware) -> Setpoint:
    """Return the setpoint to latch: the next in the queue, or that of the underrun policy."""
    if fw.queue is None:
        raise RuntimeError("a sample of scheduled mode needs a queue")
    if not fw.queue.advance():
        fw.new_flags |= _UNDERRUN_FLAG
        fw.counters.underruns += 1
    return fw.queue.in_force


def sample(fw: Firmware, now_ns: int, t_us: int, y0: int, y1: int, *, late: bool) -> list[Message]:
    """Return SAMPLE of the first pending sample, and the EVENT of a guard that trips.

    The guards are checked after the conversion of channel 0. SAMPLE is created afterwards and
    reports the fault.

    `t_us` is the device time at which the conversion of channel 0 was triggered, in µs; `y0` and
    `y1` are the readings of the channels. `late` is True if the conversions had to wait for the
    conversions of another sample.
    """
    wanted, config = fw.pending.popleft(), fw.config
    events: list[Message] = []
    if fw.state is _RUN and config is not None:
        fw.guards, cause = watch(
            fw.guards, y0, y1, rail_ticks=config.rail_ticks, turns=config.turns
        )
        if cause is not _NONE:
            events = [fw.enter(now_ns, State.FAULT, cause)]
    flags = fw.new_flags | _STATE_FLAGS.get(fw.state, 0)
    if fw.state is _FAULT:
        flags |= _FAULT_FLAGS.get(fw.cause, 0)
    if at_rail(y0):
        flags |= _RAIL_0_FLAG
    if at_rail(y1):
        flags |= _RAIL_1_FLAG
    if fw.supply_is_low:
        flags |= _VCC_LOW_FLAG
    if late:
        flags |= _LATE_FLAG
        fw.counters.late += 1
    fw.new_flags = 0
    taken = Sample(  # positional: keywords would take twice as long at each sample
        fw.state,
        UNNUMBERED,
        fw.boot_id & U16,
        fw.newest or 0,
        fw.u_seq,
        wanted.k & U32,
        t_us,
        y0,
        y1,
        fw.board.code,
        fw.u_km1,
        flags,
        0 if fw.queue is None else len(fw.queue),
    )
    # SAMPLE is the answer to a request, so it leaves before the EVENT of the transition.
    return [taken, *events]
