"""The loop: at each tick it exchanges frames with the device, as the core decides.

The loop waits only for its next deadline, for events and for the device's answer. It accesses the
device, the clock and the pipes through its `Ports`.
"""

from __future__ import annotations

from typing import NamedTuple

from armrig_core.telemetry.telemetry import Sample
from armrig_protocol.messages import Flag

from armrig_daemon.decisions import step
from armrig_daemon.decisions.state import (
    Action,
    DecisionState,
    Emit,
    Event,
    Exit,
    Ordered,
    Publish,
    RoundTrip,
    Rules,
    Send,
    SetPeriod,
    Tick,
    Wakeup,
)
from armrig_daemon.decisions.trace import VERSION, Chunk, TraceBuffer
from armrig_daemon.loop.meter import Meter, clock_record
from armrig_daemon.loop.outbox import Outbox
from armrig_daemon.loop.ports import Ports
from armrig_daemon.pipe import RunEnded, RunStarted
from armrig_daemon.pipe import Trace as TraceRecord

_RUN = int(Flag.RUN)  # int: `&` of two Flags takes 0.5 µs


class Loop:
    """Loop of one rig; `run` returns when the core exits."""

    def __init__(self, rules: Rules, ports: Ports) -> None:
        """Set the first tick to one period from now."""
        self.ports = ports
        self.state: DecisionState = step.start(rules)
        self.ended = False
        now = ports.now_ns()
        self._pace = TickSchedule(rules.ts_us * 1000, now + rules.ts_us * 1000, 0)
        self._k = 0  # next tick
        self._outbox = Outbox(ports)
        self._meter = Meter(now)
        self._trace: TraceBuffer | None = None
        self._late: list[Event] = []  # orders that came together with a missed deadline

    def run(self) -> None:
        """Perform ticks until the core exits."""
        while not self.ended:
            self.turn()

    def turn(self) -> None:
        """Handle events until the next tick is due, then perform the tick."""
        due = self._pace.due_ns(self._k)
        until = due - self.ports.margin_ns
        now = self._serve_until(until, due)
        # If this is false, the pace has changed meanwhile, or the loop has ended.
        if not self.ended and now >= until:
            self._tick(due)
        if self._late and not self.ended:
            late, self._late = self._late, []
            self._step(self.ports.now_ns(), late)

    def _serve_until(self, until_ns: int, due_ns: int) -> int:
        """Handle events, and wake-ups that the core requested, until shortly before the tick."""
        pace, ports = self._pace, self.ports
        now = ports.now_ns()
        while now < until_ns and not self.ended and self._pace is pace:
            wake = step.wake_ns(self.state)
            events = ports.wait(until_ns if wake > until_ns else max(wake, now))
            now = ports.now_ns()
            if now >= due_ns:
                # The tick is handled before these orders: if it trips, because the loop was
                # stalled, the core then refuses the orders.
                self._late = [e for e in events if isinstance(e, Ordered)]
                events = [e for e in events if not isinstance(e, Ordered)]
            if events:
                self._step(now, events)
            elif now >= wake:
                self._step(now, [Wakeup()])
        return now

    def _tick(self, due_ns: int) -> None:
        now = self.ports.sleep_until(due_ns)
        k = self._pace.current(self._k, now)
        sched_ns = self._pace.due_ns(k)
        self._meter.note_wake(now - due_ns, k - self._k, self._pace.period_ns)
        self._k = k + 1
        self._step(now, [Tick(k, sched_ns)])
        self._outbox.flush()
        if self._meter.is_second_over(now):
            # Only now: the number of garbage collections takes 3 µs.
            self._outbox.put(self._meter.take_second(now, self.ports.collections))
            clock = self.state.clock
            record = None if clock is None else clock_record(clock.map, now)
            if record is not None:
                self._outbox.put(record)

    def _step(self, now_ns: int, events: list[Event]) -> None:
        self.state, actions = step.step(self.state, now_ns, events)
        trace = self._trace
        if trace is not None:
            trace.note(now_ns, events, actions)
        failures: list[Event] = []
        for action in actions:
            if type(action) is Send:
                failure = self.ports.write(action.data)
                if failure is not None:
                    failures.append(failure)
            elif type(action) is RoundTrip:
                self._meter.note_round_trip(action.ns)
            elif type(action) is Publish:
                self._publish(action.sample, action.queued)
            else:
                self._do(action, now_ns)
        if trace is not None and trace is self._trace:
            self._put_trace(trace.full(), now_ns)
        if failures:  # after all earlier decisions, so that the last report is the current state
            self._step(now_ns, failures)

    def _put_trace(self, chunks: list[Chunk], now_ns: int) -> None:
        for number, state, steps in chunks:
            record = TraceRecord(
                t_host_ns=now_ns, number=number, state=state, steps=steps, version=VERSION
            )
            self._outbox.put(record)

    def _publish(self, sample: Sample, queued: int) -> None:
        self._outbox.put_sample(sample)
        # Outside a run the host requests the samples, even if the device will pace the run.
        ts_ns = self.state.ts_us * 1000 if sample.flags & _RUN else self._pace.period_ns
        self._meter.note_sample(sample, ts_ns)
        if queued >= 0:
            self._meter.note_queue(queued)

    def _do(self, action: Action, now_ns: int) -> None:
        """Carry out an action of the core that not every tick has."""
        match action:
            case Emit():
                if self._trace is not None and isinstance(action.record, RunEnded):
                    self._put_trace(self._trace.rest(), now_ns)
                    self._trace = None
                self._outbox.put(action.record)
                if isinstance(action.record, RunStarted):
                    self._meter.forget_device()
                    self._trace = TraceBuffer(self.state)
                elif isinstance(action.record, RunEnded):
                    self.ports.tidy()
            case SetPeriod():
                self._k = action.k
                self._pace = change_pace(self._pace, self._k, action.period_us * 1000, now_ns)
                self._meter.forget_device()
            case Exit():
                self.ended = True


class TickSchedule(NamedTuple):
    """Tick `k` is due at `origin_ns + (k - k_origin) · period_ns`."""

    period_ns: int
    origin_ns: int
    k_origin: int

    def due_ns(self, k: int) -> int:
        """Return the time at which tick `k` is due."""
        return self.origin_ns + (k - self.k_origin) * self.period_ns

    def current(self, k: int, now_ns: int) -> int:
        """Return the tick to perform now: the newest due tick, or `k` if no tick is due.

        Missed ticks are skipped. Catching up in a burst would sample at the wrong times.
        """
        late = now_ns - self.due_ns(k)
        return k + max(0, late // self.period_ns)


def change_pace(pace: TickSchedule, k: int, period_ns: int, now_ns: int) -> TickSchedule:
    """Return a pace whose next tick is `k`; with an unchanged period the phase stays the same.

    With another period, tick `k` is one period from now.
    """
    if period_ns == pace.period_ns:
        return TickSchedule(period_ns, now_ns + (pace.origin_ns - now_ns) % period_ns, k)
    return TickSchedule(period_ns, now_ns + period_ns, k)
