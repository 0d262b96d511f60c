"""One schedule: the real loop and its core, the emulated device, commanders, and the faults."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from hashlib import blake2b
from heapq import heappop, heappush
from pathlib import Path
from random import Random
from struct import Struct
from traceback import extract_tb
from typing import Any, NamedTuple

from armrig_core.rig.calibration import Calibration
from armrig_daemon.config import output_limits
from armrig_daemon.decisions.outcomes import report_state
from armrig_daemon.decisions.state import (
    Emit,
    Event,
    LinkDown,
    LinkUp,
    Ordered,
    Phase,
    Received,
    Rules,
    ServiceGone,
    Tick,
)
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.loop.loop import Loop
from armrig_daemon.pipe import Alive, Gap, Log, Order, Quit, Record
from armrig_protocol.messages import State as DeviceState
from msgspec import UNSET
from msgspec.structs import replace

from tests.simulator.checks import Checks
from tests.simulator.commander import Commander
from tests.simulator.line import Line
from tests.simulator.options import CLEAR_NS, END_NS, MS, Episode, Options
from tests.simulator.outputs import described
from tests.simulator.telling import FullPipe, Silent, Teller, read
from tests.simulator.violation import Violation
from tests.simulator.watched import Watched, WatchedCore
from tests.simulator.watched_uno import WatchedUno

NEVER = 1 << 62
_DRIVING, _RUN = (Phase.ACTIVE, Phase.ARMED), DeviceState.RUN
_MARK = Struct("<qc")
_PIPE_NS = 50_000
Story = Callable[[int, str, Any], None]
"""Function of the time, the kind of the event, and the event."""


class Outcome(NamedTuple):
    """Outcome of one schedule."""

    seed: int
    violation: tuple[str, int, str] | None
    digest: str
    """Digest of all bytes on the line, both ways, with their times."""
    faults: dict[str, int]
    seen: dict[str, int]
    worst_ns: dict[str, int]
    latches: int
    driving: int
    ticks: int
    """Sampling times in the schedule."""


class Killed(Exception):  # noqa: N818 - it is no error
    """The process is gone, wherever it was."""


class WatchedLoop(Loop):
    """The loop, with an observer of each step of its core."""

    def __init__(self, rules: Rules, rig: Rig) -> None:
        super().__init__(rules, rig)
        self._meter = Silent()
        self._outbox = rig.outbox()
        self._rig = rig

    def _step(self, now_ns: int, events: list[Event]) -> None:
        if type(events[0]) is Tick:
            self._judged(now_ns, events)
            return
        self._rig.checks.step_ns = now_ns
        # One by one, as the core takes them: an order is judged by what was in force then.
        for event in events:
            if type(event) is Ordered:
                self._rig.delivered(now_ns, event.order)
            elif type(event) is LinkUp:
                self._rig.checks.link_up()
            self._rig.checks.outputs.begin_step()
            super()._step(now_ns, [event])
            self._rig.checks.end_step(now_ns)

    def _judged(self, now_ns: int, ticks: list[Tick]) -> None:
        """Do a tick, with checks of the round trip before it and of the memory after it."""
        state, checks = self.state, self._rig.checks
        checks.begin_tick(
            now_ns,
            ticks[0].k,
            driving=state.phase in _DRIVING and state.link is not None and state.device is not None,
            scheduled=state.scheduled and state.device_state == _RUN,
        )
        checks.outputs.begin_step()
        super()._step(now_ns, ticks)
        checks.end_step(now_ns, is_tick=True)
        checks.end_tick(now_ns)
        checks.bounded(now_ns, self.state, self._outbox.waiting)


class Rig:
    """The world of one loop: its clock is a number, and faults come when they were drawn."""

    margin_ns = 150_000
    collections = 0

    def __init__(
        self, options: Options, story: Story | None = None, trace: Path | None = None
    ) -> None:
        """Switch everything on at time 0; `trace` is the VCD file for an Uno's pins."""
        self.options, self.now = options, 0
        self.story = story
        rng = Random(options.seed ^ 0x5EED)
        self.faults: Counter[str] = Counter()
        self.checks = Checks(options)
        self._rng = rng
        self._to_device = Line("to_device", options.episodes, Random(rng.random()), self.faults)
        self._from_device = Line("from_device", options.episodes, Random(rng.random()), self.faults)
        self.device = _switch_on(options, self.checks, trace)
        self._readings()
        self._n = 0
        self._world: list[tuple[int, int, Callable[[Any], None], Any]] = []
        self._inbox: list[tuple[int, int, Event, int]] = []
        self._pauses: list[tuple[int, int]] = []
        self._write_pauses: list[tuple[int, int]] = []
        self._late: list[Episode] = []
        self._kill_ns = NEVER
        self._hung_until = self._slow_until = self.full_until = 0
        self._unplugged = self._write_fails = False
        self._log = bytearray()
        self._orders: dict[int, int] = {}
        self._rules = _rules(options)
        self.commander = Commander(options, Random(rng.random()))
        self._plan()
        self.loop: WatchedLoop | None = None
        self._start(None)

    @property
    def emulation_ns(self) -> int:
        """The device's share of the time that has passed."""
        return self.device.emulation_ns(self.now)

    # -- the ports of the loop -------------------------------------------------------------------

    def now_ns(self) -> int:
        """Return the virtual time."""
        return self.now

    def sleep_until(self, deadline_ns: int) -> int:
        """Let time pass to the deadline, or to the end of a pause, or later by some lateness."""
        wake_ns = max(self.now, deadline_ns)
        while self._late and self._late[0].end_ns <= wake_ns:
            self._late.pop(0)
        if self._late and self._late[0].t_ns <= wake_ns:
            self.faults["late"] += 1
            worst_ns = 4 * self.options.ts_us * 1000 * self._late[0].size
            wake_ns += round(worst_ns * self._rng.random())
        self._pass(wake_ns)
        while self._pauses and self._pauses[0][0] <= self.now:
            self._pause(self._pauses.pop(0))
        return self.now

    def wait(self, until_ns: int) -> list[Event]:
        """Let time pass until something has come, or `until_ns`."""
        inbox, world = self._inbox, self._world
        advance = self.device.advance_to_frame
        pauses = self._pauses
        while True:
            if pauses and pauses[0][0] <= self.now:
                self._pause(pauses.pop(0))
            if inbox and inbox[0][0] <= self.now:
                return self._due()
            if self.now >= until_ns:
                return []
            to_ns = until_ns
            if inbox and inbox[0][0] < to_ns:
                to_ns = inbox[0][0]
            if world[0][0] < to_ns:
                to_ns = world[0][0]
            if pauses and pauses[0][0] < to_ns:
                to_ns = pauses[0][0]
            frames = advance(to_ns)
            if frames:
                self._left(frames)
                continue
            self.now = to_ns
            while world[0][0] <= to_ns:
                _, _, act, what = heappop(world)
                act(what)

    def write(self, data: bytes) -> Event | None:
        """Put a frame on the line."""
        if self._write_pauses and self._write_pauses[0][0] <= self.now:
            self._pause(self._write_pauses.pop(0), "pause_in_write")
        now = self.now
        self.checks.sent(self.emulation_ns, data, now)
        self._log += _MARK.pack(now, b">") + data
        if self.story:
            self.story(now, "host sends", data)
        if self._write_fails:
            self._write_fails = False
            return LinkDown("unplugged")
        if self._unplugged:
            return None  # the kernel takes it, and nobody reads it
        for t_ns, piece in self._to_device.carry(now, data):
            if t_ns <= now:
                self.device.receive(now, piece)
            else:
                self.at(t_ns, self._arrive, piece)
        return None

    def put(self, text: bytes) -> bool:
        """Hand one record to the service, unless the pipe is full."""
        if self.now < self.full_until:
            self.faults["full_pipe"] += 1
            return False
        read(self, text)
        return True

    def tidy(self) -> None:
        """Do nothing."""

    # -- time ------------------------------------------------------------------------------------

    def at(self, t_ns: int, act: Callable[[Any], None], what: Any = None) -> None:
        """Let something happen to the world at a time."""
        self._n += 1
        heappush(self._world, (t_ns, self._n, act, what))

    def event(self, t_ns: int, event: Event, heard_ns: int = -1) -> None:
        """Let the loop find an event at a time; `heard_ns` is what an answer proves."""
        self._n += 1
        heappush(self._inbox, (t_ns, self._n, event, heard_ns))

    def _pass(self, to_ns: int) -> None:
        """Let the world go on."""
        world, advance = self._world, self.device.advance_to_frame
        while True:
            t_ns = world[0][0]
            if t_ns > to_ns:
                t_ns = to_ns
            while frames := advance(t_ns):
                self._left(frames)
            if t_ns > self.now:
                self.now = t_ns
            if world[0][0] > t_ns:
                return
            while world[0][0] <= t_ns:
                _, _, act, what = heappop(world)
                act(what)

    def _pause(self, pause: tuple[int, int], kind: str = "pause") -> None:
        self.faults[kind] += 1
        if self.story:
            self.story(self.now, kind, f"for {pause[1] / MS:.1f} ms")
        self._pass(self.now + pause[1])

    def _due(self) -> list[Event]:
        """Return what has come for the loop."""
        inbox, now = self._inbox, self.now
        events: list[Event] = []
        while inbox and inbox[0][0] <= now:
            _, _, event, heard_ns = heappop(inbox)
            if heard_ns >= 0:
                self.checks.came_back(heard_ns)
            if self.story:
                self.story(now, "host gets", event)
            events.append(event)
        return events

    # -- the line --------------------------------------------------------------------------------

    def _left(self, frames: Sequence[tuple[int, bytes]]) -> None:
        """Carry frames that the device has made just now."""
        heard_ns, usb_ns = self.checks.newest_ns, self.options.usb_ns
        for t_ns, data in frames:
            self._log += _MARK.pack(t_ns, b"<") + data
            if self.story:
                self.story(t_ns, "device sends", data)
            if self._unplugged:
                continue
            for out_ns, piece in self._from_device.carry(t_ns, data):
                # A frame proves something with its end, whether or not it was cut before.
                whole = heard_ns if data.endswith(piece) else -1
                self.event(out_ns + usb_ns, Received(piece), whole)

    def _arrive(self, piece: bytes) -> None:
        if not self._unplugged:
            self.device.receive(self.now, piece)

    def heard(self, record: Record) -> None:
        """Let the service's side have a record."""
        if isinstance(record, Gap):
            self.checks.gap(self.now, record)
        if isinstance(record, Log) and record.level == "error" and self.loop and self.loop.ended:
            raise Violation("end", self.now, f"after its end the core reports {record.message!r}")
        self.commander.hears(record)
        if self.story:
            self.story(self.now, "host tells", record)

    # -- orders ----------------------------------------------------------------------------------

    def delivered(self, now_ns: int, order: Order) -> None:
        """Report an order to the checks before the core takes it."""
        given = self.device.emulation_ns
        at_ns = self._orders.pop(id(order), now_ns)
        self.checks.ordered(given(now_ns), given(at_ns), order)

    def order(self, order: Order) -> None:
        """Put an order into the pipe, as soon as the service does it."""
        at_ns = max(self.now + _PIPE_NS, self._slow_until)
        if self._slow_until > self.now:
            self.faults["slow_service"] += 1
        self._orders[id(order)] = at_ns
        self.event(at_ns, Ordered(order))

    def _act(self, _: None) -> None:
        """Let the commander act, and again later."""
        if self.now >= CLEAR_NS and not self.options.goes_on:
            return
        self.at(self.now + self.options.client_ns, self._act)
        if self.loop is None or self.now < self._hung_until:
            return
        order = self.commander.act()
        if order is not None:
            self.order(order)

    def _alive(self, _: None) -> None:
        """Let the service show that it is alive, and again later."""
        self.at(self.now + 100 * MS, self._alive)
        if self.loop is not None:
            # In every second schedule as if a run were prepared: this renews no held voltage.
            lease = self.commander.lease if self.options.seed % 2 else ""
            self.order(Alive(order=0, lease=lease))

    # -- the process -----------------------------------------------------------------------------

    def outbox(self) -> Teller:
        """Return the way to the service."""
        return FullPipe(self) if self.options.real_outbox else Teller(self)

    def _start(self, _: None) -> None:
        """Start the process, which opens the port: that resets an Uno."""
        if self.now:
            self.device.reset(self.now)
        self._inbox.clear()
        self._orders.clear()
        self.checks.begin_host(self.now)
        self.commander.forget()
        self.loop = WatchedLoop(self._rules, self)
        self.event(self.now, LinkUp())

    def run(self) -> None:
        """Run the whole schedule, and judge its end."""
        while self.now < END_NS:
            loop = self.loop
            if loop is None:
                self._pass(min(END_NS, self._world[0][0]))
                continue
            try:
                loop.turn()
            except Killed:
                self.loop = None
                continue
            except Violation:
                raise
            except Exception as err:
                # The process is gone, and the watchdog has the motor; but it must not happen.
                where = extract_tb(err.__traceback__)[-1]
                text = f"{type(err).__name__}: {err} in {where.name}, line {where.lineno}"
                raise Violation("crash", self.now, text) from err
            if loop.ended:
                self.loop = None
                self.at(self.now + 300 * MS, self._start)
        self.checks.zero_in_time(self.emulation_ns)
        if self.checks.taken is not None:
            raise self.checks.taken

    # -- faults ----------------------------------------------------------------------------------

    def _plan(self) -> None:
        options = self.options
        self.at(NEVER, self._act)
        self.at(20 * MS, self._act)
        if options.service_ns:
            self.at(50 * MS, self._alive)
        self.at(END_NS, self._judge_recovery)
        for e in options.episodes:
            if e.kind == "pause":
                self._pauses.append((e.t_ns, e.for_ns))
            elif e.kind == "pause_in_write":
                self._write_pauses.append((e.t_ns, e.for_ns))
            elif e.kind == "late":
                self._late.append(e)
            elif " " not in e.kind:
                self.at(e.t_ns, getattr(self, f"_{e.kind}"), e)
        for e in options.stalls:
            self.at(e.t_ns, self._stall, e)
            if e.size >= 0.5:  # the whole machine, whose programs go on at times of their own
                self._pauses.append((e.t_ns, round(e.for_ns * (0.9 + 0.2 * (e.size - 0.5)))))
        self._pauses.sort()

    def _told(self, kind: str, e: Episode) -> None:
        self.faults[kind] += 1
        if self.story:
            self.story(self.now, kind, f"for {e.for_ns / MS:.1f} ms, size {e.size:.2f}")

    def _stall(self, e: Episode) -> None:
        """Let the emulator's process stand still."""
        if self.device.is_stalled:
            return
        self._told("stall", e)
        self.device.stall(self.now, e.end_ns)
        self.at(e.end_ns, self._go_on)

    def _go_on(self, _: None) -> None:
        self._left(self.device.go_on(self.now))

    def _kill(self, e: Episode) -> None:
        """End the process as kill -9 does."""
        if self.loop is None:
            return
        self._told("kill", e)
        self.at(self.now + e.for_ns, self._start)
        self.loop = None
        raise Killed

    def _played_again(self, e: Episode) -> None:
        """End the process, and replay frames that lead the device to its state, reset or not."""
        if self.loop is None:
            return
        self._told("played_again", e)
        frames = self._to_device.played_again()
        t_ns = self.now + 2 * MS
        if e.size < 0.5:
            self.device.reset(self.now)
            t_ns += round(self.options.boot_ms * MS)
        for frame in frames:
            t_ns += MS
            self.at(t_ns, self._arrive, frame)
        self.at(t_ns + e.for_ns, self._start)
        self.loop = None
        raise Killed

    def _old_frames(self, e: Episode) -> None:
        """End the process, and replay its frames into the next session."""
        if self.loop is None:
            return
        self._told("old_frames", e)
        self.at(self.now + 10 * MS, self._start)
        t_ns = self.now + round(MS * (150 + 250 * e.size))
        for frame in self._to_device.played_again():
            t_ns += 3 * MS
            self.at(t_ns, self._arrive, frame)
        self.loop = None
        raise Killed

    def _service_gone(self, e: Episode) -> None:
        if self.loop is None:
            return
        self._told("service_gone", e)
        if e.size < 0.5:
            self.event(self.now, ServiceGone())
        else:
            self.order(Quit(order=-9, reason="the end"))

    def _reset(self, e: Episode) -> None:
        """Reset the device; half of the times its report is lost."""
        self._told("reset", e)
        self.device.reset(self.now)
        if e.size < 0.5:
            quiet_ns = round(self.options.boot_ms * MS) + 2 * MS
            self._from_device.cut_until_ns = self.now + quiet_ns

    def _unplug(self, e: Episode) -> None:
        if self.loop is None or self._unplugged:
            return
        self._told("unplug", e)
        self._unplugged = True
        self._write_fails = e.size % 0.5 < 0.25  # or the reader finds out
        if not self._write_fails:
            self.event(self.now, LinkDown("unplugged"))
        self.at(self.now + e.for_ns, self._plug, e)

    def _plug(self, e: Episode) -> None:
        self._unplugged = False
        if self._write_fails:
            self._write_fails = False
            self.event(self.now, LinkDown("unplugged"))
        if e.size < 0.5:
            self.device.reset(self.now)
        if self.loop is not None:
            self.event(self.now, LinkUp())

    def _stuck(self, e: Episode) -> None:
        self._told("stuck", e)
        self._fix(e, self._read(int(e.size >= 0.5), self.device.acted_ns(self.now)))

    def _rail(self, e: Episode) -> None:
        self._told("rail", e)
        self._fix(e, 0 if e.size % 0.5 < 0.25 else 65_472)

    def _fix(self, e: Episode, value: int) -> None:
        """Let a sensor read the same for a while."""
        self._fixed[int(e.size >= 0.5)] = value
        self.at(self.now + e.for_ns, lambda _: self._readings())

    def _readings(self) -> None:
        board: Any = self.device.board
        vars(board).pop("reading", None)
        self._read = read = board.reading
        fixed: dict[int, int] = {}
        self._fixed = fixed
        board.reading = lambda channel, t: fixed[channel] if channel in fixed else read(channel, t)

    def _hang(self, e: Episode) -> None:
        self._told("hang", e)
        self._hung_until = self.now + e.for_ns

    def _slow_service(self, e: Episode) -> None:
        self._told("slow_service", e)
        self._slow_until = self.now + e.for_ns

    def _full_pipe(self, e: Episode) -> None:
        self._told("full_pipe", e)
        self.full_until = self.now + e.for_ns

    def _intruder(self, e: Episode) -> None:
        self._again(e, "intruder", self.commander.intruded)

    def _forgery(self, e: Episode) -> None:
        self._again(e, "forgery", self.commander.forged)

    def _out_of_range(self, e: Episode) -> None:
        self._again(e, "out_of_range", self.commander.out_of_range)

    def _again(self, e: Episode, kind: str, make: Callable[[], Order]) -> None:
        self._told(kind, e)
        if self.loop is not None:
            self.order(make())
        if self.now + 15 * MS < e.end_ns:
            self.at(self.now + 15 * MS, getattr(self, f"_{kind}"), e)

    # -- the end ---------------------------------------------------------------------------------

    def _judge_recovery(self, _: None) -> None:
        """Judge the state some time after the last fault (T1)."""
        checks, options = self.checks, self.options
        recent_ns = max(100 * MS, 10 * options.ts_us * 1000)
        age_ns = self.now - checks.last_sample_ns
        if age_ns > recent_ns:
            raise Violation("T1", self.now, f"the last sample is {age_ns / MS:.0f} ms old")
        if checks.phase == "init":
            raise Violation("T1", self.now, "the device is not known again")
        self._judge_what_is_said()
        if not options.goes_on and checks.run is None and checks.is_driven:
            raise Violation("T1", self.now, f"{checks.volts:.2f} V, and nobody commands")
        # Disarmed, but for who has armed since the last stop and trip.
        if checks.lease is not None or checks.is_arming():
            return
        if checks.ended_ns is not None and self.emulation_ns - checks.ended_ns < recent_ns:
            return  # who held it has just let go: the way to rest takes some frames
        checks.seen["T1: disarmed"] += 1
        if checks.phase not in ("safe", "fault"):
            raise Violation("T1", self.now, f"{checks.phase}, and nobody holds the rig")
        if self.device.state in (DeviceState.ARMED, DeviceState.RUN):
            text = f"the device is in {self.device.state.name}, and nobody holds the rig"
            raise Violation("T1", self.now, text)

    def _judge_what_is_said(self) -> None:
        """Judge whether the reported state is what the core knows (T1)."""
        state = self.loop.state if self.loop is not None else None
        if state is None or state.asked is not None:
            return
        now, said = report_state(state, self.now), self.checks.said
        assert isinstance(now, Emit)
        if said is None or replace(said, t_host_ns=self.now) != now.record:
            raise Violation("T1", self.now, f"said last was {said}, where {now.record} is")


def _rules(options: Options) -> Rules:
    description = described(options.outputs, options.turns) if options.outputs else None
    in_core = options.rail_ticks if any(o.valid_rail for o in options.outputs) else 0
    turns = options.turns / 100 if description is None else description.outputs["y"].turns
    return Rules(
        described=UNSET if description is None else description.conversions,
        limits=UNSET if description is None else output_limits(description.outputs, in_core),
        rest_code=options.rest,
        code_min=options.u_min,
        code_max=options.u_max,
        slew=options.slew,
        ts_us=options.ts_us,
        watchdog_ms=options.watchdog_ms,
        baud=500_000,
        turns=round(turns * 100),
        rail_ticks=options.rail_ticks - in_core,
        calibration=Calibration(),
        service_ns=options.service_ns,
        stop_after=options.stop_after,
    )


def _settings(options: Options) -> EmulatorSettings:
    return EmulatorSettings(
        seed=options.seed,
        boot_ms=options.boot_ms,
        pwm_bits=options.pwm_bits,
        adc_noise_v=options.adc_noise_v,
        queue=options.queue,
        clock_ppm=options.clock_ppm,
        tolerates_stalls=options.tolerates_stalls,
    )


def _switch_on(
    options: Options, checks: Checks, trace: Path | None
) -> Watched | WatchedCore | WatchedUno:
    if options.uno:
        return WatchedUno(_settings(options), checks, trace, options.uno)
    watched = WatchedCore if options.c_core else Watched
    return watched(_settings(options), checks, options.clock_start_us)


def simulate(options: Options, story: Story | None = None, trace: Path | None = None) -> Outcome:
    """Run one schedule; `trace` is the VCD file for an Uno's pins."""
    violation = None
    rig = Rig(options, story, trace)
    try:
        rig.run()
    except Violation as err:
        violation = (err.invariant, err.t_ns, err.text)
    finally:
        rig.device.close()
    checks = rig.checks
    return Outcome(
        options.seed,
        violation,
        blake2b(rig._log, digest_size=16).hexdigest(),
        dict(rig.faults),
        dict(checks.seen),
        checks.worst_ns,
        checks.latches,
        checks.driving_latches,
        END_NS // (options.ts_us * 1000),
    )
