"""The invariants of docs/safety.md, judged from outside.

The checks judge the voltage of the emulated motor, at each latch, each frame and each change of the
device. The reference is kept here, independent of core and firmware. It consists of the frames of
the host with their times, the frames that the device may accept, and the commands of the lease's
holder.

Times are the device's given times: the host's time without the stalls that an emulator tolerates.
Only the age of the round trip (S4) is by the host's clock.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from armrig_core.commands.codes import OutcomeCode
from armrig_core.telemetry.telemetry import Sample
from armrig_daemon import pipe
from armrig_daemon.decisions.gaps import MAX_MISSING_PIECES
from armrig_daemon.decisions.requests import MAX_REMEMBERED_FRAMES
from armrig_daemon.decisions.state import DecisionState as CoreState
from armrig_daemon.decisions.state import LinkState
from armrig_daemon.loop.outbox import MAX_WAITING_RECORDS
from armrig_daemon.pipe import (
    Answer,
    Calibrate,
    Gap,
    Leased,
    Order,
    Quit,
    Record,
    Reset,
    RunEnded,
    RunStarted,
)
from armrig_daemon.pipe import State as StateRecord
from armrig_protocol.decoder import MAX_STUFFED
from armrig_protocol.messages import (
    CODE_FULL_SCALE,
    MAX_UNECHOED,
    TYPES,
    Arm,
    Cause,
    ClearFault,
    Config,
    Exchange,
    Hello,
    Start,
    Stop,
)
from armrig_protocol.messages import State as DeviceState

from tests.simulator.frames import Frame, ask_the_same, exchange, may_exchange, may_fill
from tests.simulator.law_judge import LawJudge
from tests.simulator.monitor_judge import GATES
from tests.simulator.options import MS, Options
from tests.simulator.outputs import OutputJudge
from tests.simulator.violation import Violation

HELLO, STOP, CLEAR = TYPES[Hello], TYPES[Stop], TYPES[ClearFault]
CONFIG, EXCHANGE = TYPES[Config], TYPES[Exchange]
_LEADS = {DeviceState.ARMED: TYPES[Arm], DeviceState.RUN: TYPES[Start]}
"""The only frame that leads to each state in which the motor may turn."""
FULL_SCALE_V = 5.0
LINK_GONE, COMMANDER_GONE = "link gone", "commander gone"
_MOST_MORE = 100
"""Records that wait in the outbox however full it is: gaps, answers, ends of runs."""
HELD = "S2: driven on by old frames alone, the host not heard"
PLAYED = "played again from an earlier session: "


class Checks:
    """The invariants, and the counts on the way."""

    def __init__(self, options: Options) -> None:
        """Begin with a host and a device that have not met."""
        self.options = options
        self.seen: Counter[str] = Counter()
        """Trips by their cause, and how often each check had something to judge."""
        self.seen["law: schedules"] = int("control" in options.modes)
        self.worst_ns: dict[str, int] = {}
        """Longest time to 0 V, by its cause."""
        bits = options.pwm_bits
        self._half_step = FULL_SCALE_V / (1 << bits + 1) if bits else 0.0
        self._rest_v = FULL_SCALE_V * options.rest / CODE_FULL_SCALE
        self.volts = 0.0
        self.is_driven = False
        """The driver is on, and its input is not at rest."""
        self.in_run = False
        self.latches = self.driving_latches = 0
        self.phase, self.reason = "init", ""
        self.said: StateRecord | None = None
        """Last report of the core."""
        self.latched = False
        self.grant = 0
        self.taken: Violation | None = None
        self.lease: str | None = None
        self.run: pipe.Run | None = None
        self.offered: pipe.Run | None = None
        """An experiment that has not been answered; the device may have begun with it."""
        self.cut_off: pipe.Run | None = None
        """Run that was refused after its START, which may reach the device: until it is stopped."""
        self.law: LawJudge | None = None
        """Judge of the newest run, if it is in control."""
        self.k_first = -1
        self.command_ns = 0
        self.last_sample_ns = 0
        self._limit = options.watchdog_ms * MS
        ts_ns = options.ts_us * 1000
        self._s2_ns = max(100 * MS, 5 * ts_ns) + self._limit + 2 * ts_ns
        """Lease, the device's watchdog and 2 Ts: the longest time from a command to 0 V (S2)."""
        self._s3_ns = self._limit * 1.0002 + MS
        """The watchdog by an oscillator that is 200 ppm slow, and 1 ms (S3)."""
        self._age_ns = max(50 * MS, 3 * ts_ns)
        self.outputs = OutputJudge(
            options.outputs, options.ts_us, options.rail_ticks, options.turns
        )
        self._frames: dict[bytes, Frame] = {}
        self._led: set[bytes] = set()
        """Frames that have armed or started the device."""
        self._session = 0
        self._boot()
        self.begin_host(0)

    # -- the host --------------------------------------------------------------------------------

    def begin_host(self, now_ns: int) -> None:
        """Forget what the ended process knew."""
        self.link_up()
        self.outputs.begin_host()
        self.phase = "init"  # not that of the ended process
        self.fresh_ns = self.newest_ns = self.step_ns = now_ns
        """Time of the newest frame that came back, or reached the device, by the core's step."""
        self.must_stop = self.stop_sent = False
        self.latched = False
        self._next_k: int | None = None
        self._latched_codes: dict[int, int] = {}
        self._given: dict[int, tuple[int, Order]] = {}
        self.law = None
        self._end_grant()

    def _end_grant(self) -> None:
        self.lease, self.code, self._n = None, self.options.rest, -1
        self.ended_ns: int | None = None

    def link_up(self) -> None:
        """Note that seq begins again: earlier frames belong to an earlier session."""
        self._seq = 0
        self._session += 1
        self._own: dict[int, Frame] = {}
        """Each frame of this session, by seq."""

    def ordered(self, now_ns: int, given_ns: int, order: Order) -> None:
        """Note an order that the core is about to take; it was put into the pipe at `given_ns`."""
        self._given[order.order] = (given_ns, order)
        if isinstance(order, pipe.Stop | pipe.Disarm | Quit) and (
            not isinstance(order, pipe.Disarm) or order.lease == self.lease
        ):
            self._close(now_ns)
        elif isinstance(order, Reset):
            self.latched = False
        elif isinstance(order, pipe.Run) and self._is_valid(order):
            self.offered = order

    def _close(self, now_ns: int) -> None:
        """No command is in force from now on."""
        if self.lease is not None:
            self._end_grant()
            self.ended_ns = now_ns

    def _is_valid(self, order: Leased) -> bool:
        return self.lease is not None and order.lease == self.lease and order.n > self._n

    @property
    def is_by_hand(self) -> bool:
        """Return whether each code is that of the newest `Set`: by hand, or in a run."""
        return self.run is None or bool(self.run.reference and not self.run.law)

    def is_arming(self) -> bool:
        """Return whether an arming waits for its answer."""
        return any(isinstance(order, pipe.Arm) for _, order in self._given.values())

    def told(self, now_ns: int, record: Record) -> None:
        """Judge a record of the core."""
        if isinstance(record, Answer):
            self._answered(now_ns, record)
        elif isinstance(record, StateRecord):
            self._state(now_ns, record)
        elif isinstance(record, RunStarted):
            self.k_first = record.k_first
            if self.law is not None:
                self.law.k_first = record.k_first
        elif self.law is not None and isinstance(record, pipe.Control):
            self.law.recorded(now_ns, record)
        elif self.law is not None and isinstance(record, RunEnded):
            self.law.ended(now_ns, record.outcome_code)

    def _answered(self, now_ns: int, answer: Answer) -> None:
        given = self._given.pop(answer.order, None)
        if given is not None and given[1] is self.offered:
            if not answer.error:
                self.run, self.k_first = self.offered, -1
                self.law = LawJudge(self.run, self.options, self.seen) if self.run.law else None
            elif answer.error.startswith(("link lost", "overtaken by STOP")):
                self.cut_off = self.offered
            self.offered = None
        if given is None:
            return
        given_ns, order = given
        steps = answer.error.startswith("u steps by") and isinstance(order, pipe.Set)
        # In a run, of several codes before a tick the last one acts: the slew is that of the tick.
        if steps and self.run is None and abs(order.code - self.code) <= self.options.slew:
            self._wrongly(now_ns, f"refused {order}, {answer.error}, at {self.code}")
        if answer.error:
            return
        if isinstance(order, pipe.Arm):
            if self.lease is not None:
                self._wrongly(now_ns, f"gave the rig to {order.owner}, while another held it")
            if self.latched:
                raise Violation("S6", now_ns, "armed before a reset")
            self._end_grant()
            self.grant += 1
            self.lease, self.run, self.offered, self.cut_off = order.lease, None, None, None
            self.law = None
            self.command_ns = given_ns
        elif isinstance(order, Calibrate):
            self.seen["calibrated"] += 1
            if self.phase != "safe" or self.lease is not None:
                self._wrongly(now_ns, f"took a calibration while {self.phase}")
        elif isinstance(order, pipe.Set):
            low, high = self.options.u_min, self.options.u_max
            if not self._is_valid(order) or not low <= order.code <= high:
                self._wrongly(now_ns, f"took {order}")
                return
            self._n, self.code, self.command_ns = order.n, order.code, given_ns
            self.seen["own controller: codes"] += self.run is not None
        elif isinstance(order, pipe.SetReference):
            low, high = self.run.r_range if self.run else (1.0, 0.0)
            if not self._is_valid(order) or self.law is None or not low <= order.r <= high:
                self._wrongly(now_ns, f"took {order}")
                return
            self._n, self.command_ns = order.n, given_ns
            self.law.set_reference(order.r, order.n)
        elif isinstance(order, pipe.Run):
            if not self._is_valid(order):
                self._wrongly(now_ns, "took an experiment of nobody who holds the rig")
                return
            self._n, self.command_ns = order.n, given_ns

    def _wrongly(self, now_ns: int, text: str) -> None:
        """Note an order that should have been refused; its effect on the motor comes first."""
        if self.taken is None:
            self.taken = Violation("A1", now_ns, text)

    def _state(self, now_ns: int, record: StateRecord) -> None:
        before, self.phase, self.reason = self.phase, str(record.phase), record.reason
        self.said = record
        if self.phase == "fault":
            if before != "fault":
                self.seen[f"trip: {_cause(record.reason)}"] += 1
                if record.fault not in GATES:
                    self.outputs.tripped(self.step_ns, record.reason)
                elif self.law is not None:
                    self.law.tripped(now_ns, record.fault, record.reason.split()[0])
                if self.law is not None and record.reason.startswith("the law"):
                    self.law.ends_by(now_ns, OutcomeCode.FAULT)
                if record.reason.endswith("not within the limits"):  # each experiment is inside
                    self._wrongly(now_ns, f"tripped: {record.reason}")
            self.latched = True
            self._close(now_ns)
        elif self.latched:
            raise Violation("S6", now_ns, f"left the fault for {self.phase} without a reset")
        elif self.phase in ("init", "safe"):
            self._close(now_ns)

    def begin_tick(self, now_ns: int, k: int, *, driving: bool, scheduled: bool) -> None:
        """Judge the round trip before the core does (S4), and compute the code of a law (S5)."""
        self.step_ns = now_ns
        if self.law is not None:
            self.law.begin_tick(k)
        age_ns = self._limit if scheduled else self._age_ns
        self.must_stop = driving and now_ns - self.fresh_ns > age_ns
        self.stop_sent = False

    def end_tick(self, now_ns: int) -> None:
        """Judge the core's actions at a stale tick (S4)."""
        if self.must_stop:
            self.seen["S4"] += 1
            if not self.stop_sent:
                age_ms = (now_ns - self.fresh_ns) / MS
                raise Violation("S4", now_ns, f"the round trip is {age_ms:.1f} ms old, and no STOP")

    def sent(self, now_ns: int, data: bytes, host_ns: int) -> None:
        """Note a frame of the host, sent at `host_ns` of its own clock."""
        text = data[1:] if data[0] == 0 else data
        kind = text[1] if text[0] > 1 else 0
        if kind == STOP:
            self.stop_sent = self.outputs.stop_sent = True
            if self.law is not None:
                self.law.stopped()
        elif self.law is not None and kind == EXCHANGE and (asked := exchange(text)):
            self.law.sent(now_ns, asked.k, asked.u)
        self._frames[text] = Frame(
            kind,
            self._seq,
            now_ns,
            self._session,
            self.grant if self.lease is not None else 0,
            self.code if self.is_by_hand else -1,
            self.command_ns,
            self.step_ns - self.fresh_ns > self._age_ns,
            not self.latched,
            text,
            host_ns,
        )
        self._own[self._seq] = self._frames[text]
        if self._seq in self._old_echoes:
            self._old_looks_ours(self._old_echoes[self._seq], self._own[self._seq])
        self._seq = (self._seq + 1) & 0xFFFF

    def _old_looks_ours(self, old: Frame, own: Frame) -> None:
        """Let an old frame's echo count: the host has sent one with its seq, and cannot know.

        An EXCHANGE is known by its k, too.
        """
        scheduled = self.run is not None and self.run.scheduled
        if not scheduled and not ask_the_same(old, own):
            return
        self.seen[f"{PLAYED}echo not to be told from the host's own"] += 1
        self.newest_ns = max(self.newest_ns, own.host_ns)

    def came_back(self, heard_ns: int) -> None:
        """Note a whole answer, made after the device had received the frames of that time."""
        if heard_ns > self.fresh_ns:
            self.fresh_ns = heard_ns

    def sampled(self, now_ns: int, sample: Sample) -> None:
        """Note that the core has published a sample."""
        self.last_sample_ns = now_ns
        self.outputs.sampled(now_ns, sample)
        if self.law is not None:
            self.law.sampled(sample.k, (sample.value_0, sample.value_1))

    def end_step(self, now_ns: int, *, is_tick: bool = False) -> None:
        """Judge the measured outputs and the law after a step of the core."""
        self.outputs.end_step(now_ns, self.phase, is_tick=is_tick)
        if self.law is not None:
            self.law.end_step(now_ns)

    def bounded(self, now_ns: int, state: CoreState, waiting: int) -> None:
        """Judge the size of the loop's memory (R1)."""
        link = state.link or LinkState()
        kept = len(link.pending) <= MAX_STUFFED + 1 and len(link.sent) <= MAX_UNECHOED
        told = (
            len(state.absent) <= MAX_MISSING_PIECES and waiting <= MAX_WAITING_RECORDS + _MOST_MORE
        )
        if not (kept and told and len(link.beats) <= MAX_REMEMBERED_FRAMES):
            raise Violation("R1", now_ns, f"more is kept than may be: {state}"[:600])

    def published(self, now_ns: int, sample: Sample) -> None:
        """Judge a sample for the service (L2, S5)."""
        self._expect(now_ns, sample.k, 1, "a sample")
        code = self._latched_codes.get(sample.k)
        if code is None:
            return
        applied = round(sample.u_applied_v * CODE_FULL_SCALE / FULL_SCALE_V)
        if applied not in (self.options.rest, code):
            text = f"sample {sample.k} says code {applied} where the motor got {code}"
            raise Violation("S5", now_ns, text)

    def gap(self, now_ns: int, gap: Gap) -> None:
        """Judge a gap (L2)."""
        self.seen["gaps"] += 1
        self._expect(now_ns, gap.k_first, gap.count, f"a gap ({gap.reason})")

    def _expect(self, now_ns: int, k: int, count: int, what: str) -> None:
        if count < 1 or (self._next_k is not None and k != self._next_k):
            text = f"{what} of {count} from k={k}, where k={self._next_k} was to be told next"
            raise Violation("L2", now_ns, text)
        self._next_k = k + count

    # -- the device ------------------------------------------------------------------------------

    def _boot(self) -> None:
        self._taken: dict[int, Frame] = {}
        """Accepted frames, by seq."""
        self._newest = self._k = -1
        self._old_echoes: dict[int, Frame] = {}
        """Old frames that the device has taken in since the last frame of the host, by seq."""
        self._came: set[bytes] = set()
        self._u = self.options.rest
        self._part = b""
        self.fed_ns = 0
        """Time at which a frame that feeds the watchdog was accepted, from any sender."""
        self._old_ns = -self._limit
        """Time at which a frame of an earlier session was accepted."""
        self._heard_ns = 0
        """Time at which a frame of this session came first, accepted or not."""
        self._held_ns = 0
        """Time at which old frames alone last kept the motor driven."""
        self._configured_ns = 0

    def booted(self) -> None:
        """Note a reset of the device."""
        self._boot()

    def arrives(self, t_ns: int, piece: bytes, *, bound: bool) -> Frame | None:
        """Note bytes that the device takes off the line; `bound`: it is in ARMED or RUN."""
        self.zero_in_time(t_ns)
        if self._part:
            piece, self._part = self._part + piece, b""
        if piece[-1]:
            self._part = piece[-80:]  # no frame is longer
            return None
        frame = self._frames.get(piece)
        if frame is None:
            return None
        ours = frame.session == self._session
        if ours:
            # Every session has the same HELLO, and a frame that came before may be played again.
            if frame.type != HELLO and piece not in self._came:
                self._heard_ns = t_ns
            self._came.add(piece)
            if frame.type == STOP:  # it is carried out however old its seq looks
                self.newest_ns = max(self.newest_ns, frame.host_ns)
        fresh = self._newest < 0 or 1 <= (frame.seq - self._newest) & 0xFFFF < 0x8000
        if fresh or (frame.type == HELLO and not bound):
            self._newest = frame.seq
            self._taken[frame.seq] = frame
            if frame.type != HELLO:
                self.fed_ns = t_ns
            if frame.type == CONFIG and not bound:
                self._configured_ns = t_ns
            elif frame.type == HELLO and not bound:
                self._k = -1  # the next may be any
            if ours:
                self._old_echoes.clear()
                self.newest_ns = max(self.newest_ns, frame.host_ns)
            else:
                self._old_ns, self._old_echoes[frame.seq] = t_ns, frame
                if frame.seq in self._own:
                    self._old_looks_ours(frame, self._own[frame.seq])
                self.seen[f"{PLAYED}taken in"] += 1
        return frame

    def taken_in(self, seq: int) -> Frame | None:
        """Return the newest frame with this seq that the device has taken in."""
        return self._taken.get(seq)

    def changed(self, t_ns: int, before: int, after: int, frame: Frame | None) -> None:
        """Judge a transition of the device that a frame made (S6).

        What is played again arms and starts nothing: that takes a frame that has done so never
        before, sent after the configuration in force had come (PROTOCOL.md, section 7). It may
        be of an earlier session, where the line has held it back: it leads to 0 V.
        """
        left = before in (6, 7) and after not in (6, 7)
        if left and (frame is None or frame.type != CLEAR or not frame.reset):
            raise Violation("S6", t_ns, "the device left its fault without a reset")
        leads = _LEADS.get(DeviceState(after))
        if leads is not None:
            if frame is None or frame.type != leads or frame.data in self._led:
                raise Violation("S6", t_ns, f"in state {after} by a frame that was played again")
            self._led.add(frame.data)
            if frame.t_ns < self._configured_ns:
                raise Violation("S6", t_ns, f"in state {after} by a frame from before its CONFIG")
        if after == DeviceState.RUN:
            self._u = self.options.rest
            if self.is_driven:
                raise Violation("S6", t_ns, f"RUN begins with {self.volts:.3f} V")

    def zero_in_time(self, t_ns: int) -> None:
        """Judge how long the motor has been driven without host and without command (S2, S3)."""
        if not self.is_driven:
            return
        silent_ns = t_ns - self.fed_ns
        if silent_ns > self._s3_ns:
            raise Violation("S3", t_ns, f"no valid frame for {silent_ns / MS:.1f} ms")
        if self.is_by_hand and self._is_over(t_ns, self.command_ns):
            since = t_ns - self.command_ns
            raise Violation("S2", t_ns, f"the last command was given {since / MS:.1f} ms ago")
        if self.ended_ns is not None and self._is_over(t_ns, self.ended_ns):
            raise Violation("S2", t_ns, "driven on long after a stop")

    def _is_over(self, t_ns: int, since_ns: int) -> bool:
        """Return whether a command of `since_ns` may no longer drive: the time of S2 and S5.

        There is no allowance for a delay of the line, though a device cannot know a frame's age. If
        the line is delayed suddenly, the watchdog stops the motor in time. If it is delayed slowly,
        the host sees the age and sends STOP in time. One case is excepted, and counted: if no frame
        of the host arrives for a whole watchdog, replayed frames hold RUN (PROTOCOL.md, section 7).
        The time begins again when the host's frames arrive again, first those before STOP.
        """
        if t_ns - max(since_ns, self._held_ns) <= self._s2_ns:
            return False
        if t_ns - self._old_ns <= self._s3_ns and t_ns - self._heard_ns > self._limit:
            self.seen[HELD] += 1
            self._held_ns = t_ns
            return False
        return True

    def latch(self, t_ns: int, code: int, k: int, seq: int, *, scheduled: bool) -> None:
        """Judge a code that is about to drive the motor (S5)."""
        self.latches += 1
        self.zero_in_time(t_ns)
        if code != self.options.rest:
            self.driving_latches += 1
            if scheduled:
                self._scheduled(t_ns, code, k, seq)
            else:
                self._exchanged(t_ns, code, k, seq)
        if k >= 0 and not scheduled:
            self._k, self._u = k, code

    def _scheduled(self, t_ns: int, code: int, k: int, seq: int) -> None:
        wanted = _of(self.offered or self.run, k)
        if code == wanted:
            self.command_ns = t_ns
            return
        if code == _of(self.cut_off, k):
            self.seen["driven by a run that was refused behind its START"] += 1
            return
        frame = self._taken.get(seq)
        if frame is None or frame.session == self._session:
            raise Violation("S5", t_ns, f"code {code} at sample {k}, where u[k] is {wanted}")
        error = may_fill(frame, code, k)
        if error:
            raise Violation("S5", t_ns, f"code {code} at sample {k}, played again: {error}")
        self.seen[f"{PLAYED}SETPOINTS latched"] += 1

    def _exchanged(self, t_ns: int, code: int, k: int, seq: int) -> None:
        frame = self._taken.get(seq)
        if frame is None:
            raise Violation("S5", t_ns, f"code {code} from a frame that nobody sent (seq {seq})")
        if frame.session != self._session:
            slew = self.options.slew
            last_k, last_code = self._k, self._u
            error = may_exchange(frame, code, k, last_k=last_k, last_code=last_code, slew=slew)
            if error:
                raise Violation("S5", t_ns, f"code {code} at k={k}, played again: {error}")
            self.seen[f"{PLAYED}EXCHANGE latched"] += 1
            return
        if frame.grant != self.grant or not frame.grant:
            raise Violation("S6", t_ns, f"code {code}, sent when nobody held the rig")
        if frame.stale:
            raise Violation("S4", t_ns, f"code {code}, sent on a stale round trip")
        wanted = frame.code
        if wanted < 0:
            i, codes = k - self.k_first, self._codes()
            if self.k_first < 0 or not 0 <= i < len(codes):
                raise Violation("S5", t_ns, f"code {code} at k={k}, which no experiment has")
            wanted = codes[i]
            self.command_ns = frame.t_ns
        if code != wanted:
            raise Violation("S5", t_ns, f"code {code} at k={k}, where {wanted} was commanded")
        if frame.code >= 0 and self._is_over(t_ns, frame.command_ns):
            age_ms = (t_ns - frame.command_ns) / MS
            raise Violation("S5", t_ns, f"code {code} of a command {age_ms:.0f} ms ago")

    def _codes(self) -> Sequence[int]:
        """Return the codes of the newest run: those of its order, or those that its law gave."""
        if self.law is not None:
            return self.law.codes
        return () if self.run is None else memoryview(self.run.codes).cast("H")

    def latch_done(self, t_ns: int, asked: int, k: int, got: int, *, scheduled: bool) -> None:
        """Judge the motor's voltage for a code, and remember it (S5)."""
        wanted = FULL_SCALE_V * asked / CODE_FULL_SCALE
        if abs(self.volts - wanted) > self._half_step + 1e-9:
            raise Violation("S5", t_ns, f"{self.volts} V for code {asked}, which is {wanted} V")
        self.remember(k, got, scheduled=scheduled)

    def remember(self, k: int, got: int, *, scheduled: bool) -> None:
        """Remember the code of the motor's voltage for a sample."""
        if k < 0:  # the rest that START latches, before the first sample of the run
            return
        codes = self._latched_codes
        codes[self.k_first + k if scheduled else k] = got
        if len(codes) > 2_000:
            for old in list(codes)[:1_000]:
                del codes[old]

    def gets(self, t_ns: int, volts: float, state: int, cause: int) -> None:
        """Judge the motor's new voltage (S1), and the time to 0 V."""
        top = FULL_SCALE_V * self.options.u_max / CODE_FULL_SCALE
        if not 0.0 <= volts <= min(FULL_SCALE_V, top + self._half_step + 1e-9):
            raise Violation("S1", t_ns, f"{volts} V at the motor")
        if volts and state != 5:
            raise Violation("S1", t_ns, f"{volts} V in state {state}")
        is_driven = state == 5 and abs(volts - self._rest_v) > self._half_step + 1e-9
        if self.is_driven and not is_driven:
            self.zero_in_time(t_ns)
            if state != 5:
                self.stopped(t_ns, cause)
        self.volts, self.is_driven = volts, is_driven

    def stopped(self, t_ns: int, cause: int) -> None:
        """Note how long it took until the motor had 0 V."""
        if cause == Cause.WATCHDOG:
            self._worst(LINK_GONE, t_ns - self.fed_ns)
        if self.reason.startswith("the lease") and self.is_by_hand:
            self._worst(COMMANDER_GONE, t_ns - self.command_ns)
        elif self.ended_ns is not None:
            self._worst("stop or trip", t_ns - self.ended_ns)

    def _worst(self, kind: str, ns: int) -> None:
        options = self.options
        kind = f"watchdog {options.watchdog_ms} ms, Ts {options.ts_us // 1000} ms: {kind}"
        self.seen[f"to 0 V, {kind}"] += 1
        self.worst_ns[kind] = max(self.worst_ns.get(kind, 0), ns)


def _of(run: pipe.Run | None, k: int) -> int:
    """Return the code of a scheduled run at sample `k`; -1 without one."""
    if run is None or not run.scheduled or 2 * k >= len(run.codes):
        return -1
    return run.codes[2 * k] | run.codes[2 * k + 1] << 8


def _cause(reason: str) -> str:
    """Return a reason without the numbers in it."""
    return " ".join("#" if any(c.isdigit() for c in word) else word for word in reason.split())
