"""The loop: at each tick one exchange with the device, as the core decides.

It waits for its next deadline and for the device's answer, and for nothing else. It knows no
device, no clock and no pipe: those are its `Ports`.
"""

from __future__ import annotations

from collections import deque

from armrig_core.telemetry import Sample, encode_sample

from armrig_daemon import core
from armrig_daemon.pacing import Pace, change
from armrig_daemon.ports import Ports
from armrig_daemon.records import Gap, Record, Timing, record_bytes, sample_bytes
from armrig_daemon.state import (
    Action,
    Beat,
    Emit,
    Event,
    Exit,
    Publish,
    Repace,
    Rules,
    Send,
    State,
    Tick,
)
from armrig_daemon.timing import Histogram

MARGIN_NS = 150_000
"""How long before a deadline waiting for bytes ends and waiting for the time begins, in ns."""
MOST_WAITING = 1000
"""Records that may wait for room in the pipe; the oldest go first."""
_SECOND_NS = 1_000_000_000


class Loop:
    """One rig's loop; `run` returns when the core wants to exit."""

    def __init__(self, rules: Rules, ports: Ports) -> None:
        """Start with the first tick one period from now."""
        self.ports = ports
        self.state: State = core.start(rules)
        self.ended = False
        now = ports.now_ns()
        self._pace = Pace(rules.ts_us * 1000, now + rules.ts_us * 1000, 0)
        self._k = 0  # next tick
        self._outbox = Outbox(ports)
        self._meter = Meter(now)

    def run(self) -> None:
        """Tick until the core wants to exit."""
        while not self.ended:
            self.turn()

    def turn(self) -> None:
        """Serve what comes until the next tick is due, and tick."""
        due = self._pace.due_ns(self._k)
        now = self._serve_until(due - MARGIN_NS)
        # Else the pace has changed meanwhile, or it is over.
        if not self.ended and now >= due - MARGIN_NS:
            self._tick(due)

    def _serve_until(self, until_ns: int) -> int:
        """Take what comes, and wake for the core's own times, until shortly before the tick."""
        pace = self._pace
        now = self.ports.now_ns()
        while now < until_ns and not self.ended and self._pace is pace:
            wake = core.wake_ns(self.state)
            events = self.ports.wait(max(min(until_ns, wake), now))
            now = self.ports.now_ns()
            if events:
                self._step(now, events)
            elif now >= wake:
                self._step(now, [Beat()])
        return now

    def _tick(self, due_ns: int) -> None:
        now = self.ports.sleep_until(due_ns)
        k = self._pace.current(self._k, now)
        sched_ns = self._pace.due_ns(k)
        self._meter.woke(now - due_ns, k - self._k, self._pace.period_ns)
        self._k = k + 1
        # The tick first: after a pause it trips before orders from before the pause are looked at.
        self._step(now, [Tick(k, sched_ns)])
        self._outbox.flush()
        timing = self._meter.each_second(now)
        if timing is not None:
            self._outbox.put(timing)

    def _step(self, now_ns: int, events: list[Event]) -> None:
        self.state, actions = core.step(self.state, now_ns, events)
        for action in actions:
            self._do(action, now_ns)

    def _do(self, action: Action, now_ns: int) -> None:
        match action:
            case Send():
                failure = self.ports.write(action.data)
                if failure is not None:
                    self._step(now_ns, [failure])
            case Publish():
                self._meter.sampled(action.sample, now_ns, self._pace.period_ns)
                self._outbox.put_sample(action.sample)
            case Emit():
                self._outbox.put(action.record)
            case Repace():
                self._pace = change(self._pace, self._k, action.ts_us * 1000, now_ns)
                self._meter.forget_device()
            case Exit():
                self.ended = True


class Outbox:
    """The way to the service: never waits, keeps the order, and drops nothing but samples.

    Samples that find no room are counted and told as one gap. Records wait for room.
    """

    def __init__(self, ports: Ports) -> None:
        """Start with nothing waiting."""
        self._ports = ports
        self._waiting: deque[bytes] = deque(maxlen=MOST_WAITING)
        self._gap: Gap | None = None

    def put(self, record: Record) -> None:
        """Hand over a record, now or when there is room."""
        self._close_gap()
        self._waiting.append(record_bytes(record))
        self.flush()

    def put_sample(self, sample: Sample) -> None:
        """Hand over a sample, now or never."""
        if self._has_room_after_gap() and self._ports.put(sample_bytes(encode_sample(sample))):
            return
        first = self._gap
        self._gap = Gap(
            k_first=first.k_first if first else sample.k,
            count=sample.k - first.k_first + 1 if first else 1,
            t_from_ns=first.t_from_ns if first else sample.t_host_ns,
            t_to_ns=sample.t_host_ns,
            u_held_v=sample.u_applied_v,
            reason="the service did not keep up",
        )

    def _has_room_after_gap(self) -> bool:
        """Hand over what came before the next sample; return whether all of it went."""
        self.flush()
        if self._gap is not None and not self._waiting and self._ports.put(record_bytes(self._gap)):
            self._gap = None
        return not self._waiting and self._gap is None

    def flush(self) -> None:
        """Hand over what waits, as far as there is room."""
        while self._waiting and self._ports.put(self._waiting[0]):
            self._waiting.popleft()

    def _close_gap(self) -> None:
        """Put the gap in its place: before what comes now."""
        if self._gap is not None:
            self._waiting.append(record_bytes(self._gap))
            self._gap = None


class Meter:
    """What the timing was, second by second."""

    def __init__(self, now_ns: int) -> None:
        """Begin the first second now."""
        self._begin(now_ns)
        self._device: tuple[int, int] | None = None

    def _begin(self, now_ns: int) -> None:
        self._since_ns = now_ns
        self._wake, self._error, self._trip = Histogram(), Histogram(), Histogram()

    def woke(self, late_ns: int, missed: int, period_ns: int) -> None:
        """Count one wake-up, and the ticks that were missed before it."""
        self._wake.add(late_ns, missed, period_ns)

    def sampled(self, sample: Sample, now_ns: int, period_ns: int) -> None:
        """Count one sample's round trip, and how far the device was from its period."""
        self._trip.add(now_ns - sample.t_host_ns)
        last, self._device = self._device, (sample.k, sample.t_device_us)
        if last is not None and sample.k > last[0]:
            apart_ns = (sample.t_device_us - last[1]) * 1000
            self._error.add(abs(apart_ns - (sample.k - last[0]) * period_ns))

    def forget_device(self) -> None:
        """Do not compare across a change of the period."""
        self._device = None

    def each_second(self, now_ns: int) -> Timing | None:
        """Return the statistics once a second."""
        if now_ns - self._since_ns < _SECOND_NS:
            return None
        timing = Timing(
            t_host_ns=now_ns,
            wake_lateness_us=self._wake.distribution_us(),
            device_tick_error_us=self._error.distribution_us(),
            link_round_trip_us=self._trip.distribution_us(),
        )
        self._begin(now_ns)
        return timing
