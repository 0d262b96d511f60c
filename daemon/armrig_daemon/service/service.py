"""The service: starts the loop, publishes and records what it says, hands it what is asked.

One thread of ours beside the recording's writer; zenoh's threads put commands into queues, or turn
them away by `admission`. It may wait for disk and network, for the loop never waits for it.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import select
import signal
import sys
import time
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple, assert_never

import zenoh
from armrig_core import commands
from armrig_core.printable import printable
from armrig_core.telemetry import Sample, decode_sample
from armrig_core.volts import code_of
from msgspec.structs import replace

from armrig_daemon.config import Config
from armrig_daemon.core import orders
from armrig_daemon.core.budget import check
from armrig_daemon.core.state import Phase
from armrig_daemon.loop import realtime
from armrig_daemon.loop.process import NO_PORT, Settings
from armrig_daemon.pipe import (
    Alive,
    Answer,
    Clock,
    Gap,
    Halt,
    Hold,
    Host,
    Leased,
    Log,
    Orders,
    Play,
    Quit,
    Record,
    Release,
    Reset,
    RunEnded,
    RunStarted,
    State,
    Take,
    Timing,
    Trace,
)
from armrig_daemon.service import child, pressure, readings
from armrig_daemon.service.directory import left_over
from armrig_daemon.service.protobuf_out import Outgoing, outgoing
from armrig_daemon.service.publish import Command, Kind, Session
from armrig_daemon.service.recorder import RecordingError
from armrig_daemon.service.runs import Runs, checked
from armrig_daemon.service.thinning import Thinning

ANSWER_S = 3.0
"""How long the loop may take to answer a command, in s."""
SILENCE_NS = 3_000_000_000
"""How long the loop drives the motor on without hearing from us, in ns."""
_FINISH_S = 60.0  # a long recording takes its time to be written in full chunks
_QUIT_S = 2.0  # a loop that is frozen is not waited for any longer
_READ = 1 << 16
_MOST_AT_ONCE = 16  # commands of a kind, between two looks at the loop and at the run's client
_MOST_ASKED = 16  # orders without an answer yet, beyond which a stranger's are not passed on
_MOST_UNANSWERED = 64  # and nobody's: what the service has to say itself must not wait behind more
_BREATH_S = 0.005  # between two looks at a loop that has so many to answer
_SWITCH_S = 0.0005  # zenoh's threads hold the interpreter for at most so long at a time
_VERSION = version("armrig")  # read from a file: not at each status
_UNKNOWN = State(t_host_ns=0, phase="init", reason="", owner="", ts_us=0, device={})


class Waiting(NamedTuple):
    """A command that the loop has not answered yet."""

    command: Command
    until: float
    order: Orders
    body: Any
    """What to answer instead of the loop's own body."""


class Service:
    """One rig's service; `run` returns the exit code."""

    def __init__(self, config: Config, endpoint: str, directory: Path) -> None:
        """Take the signals; nothing is started yet."""
        self._config = config
        self._endpoint = endpoint
        self._directory = directory
        self._runs = Runs(config, directory, self._wake)
        self._state = _UNKNOWN
        self._host: dict[str, Any] = {}
        self._waiting: dict[int, Waiting] = {}
        self._numbers = 0
        self._quitting = False
        self._kill_at = float("inf")
        self._pressure = pressure.Pressure()
        self._readings = readings.Readings()
        self._turns_per_volt_s = config.arm.turns_per_volt_s
        self._timing: Timing | None = None
        self._Ts = config.ts_us / 1e6  # of the newest lease
        self._lease = ""
        self._n = -1  # number of its newest order
        self._is_woken = False
        self._thinning = Thinning()
        self._wake_fd, self._waker_fd = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        signal.set_wakeup_fd(self._waker_fd, warn_on_full_buffer=False)
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(number, lambda *_: None)
        self._anchor_clock()

    def run(self) -> int:
        """Run until SIGTERM, SIGINT or the loop's end."""
        config = self._config
        self._loop = child.start(
            Settings(
                rules=replace(config.rules(), service_ns=SILENCE_NS),
                port=config.device.port,
                baud=config.device.baud,
                priority=config.timing.priority,
                cpu=config.timing.cpu,
                spin_ns=round(config.timing.spin_us * 1000),
            )
        )
        try:
            # The loop has its priority; whatever starts from here on must not take it.
            realtime.leave_fifo()
            sys.setswitchinterval(_SWITCH_S)
            with Session(self._endpoint, config.rig.id, self._wake) as self._session:
                self._say("info", f"rig {config.rig.id} at {self._endpoint}")
                self._say("info", _in_words(config))
                for path, error in left_over(self._directory, config.rig.id):
                    left = "left by a daemon that died; `armrig info` says what it holds"
                    text = f"{error}; passed over" if error else left
                    self._say("warning", f"{_shown(path)}: {text}")
                self._serve()
                self._runs.end("the loop ended")
                self._say_finished(_FINISH_S)
        except zenoh.ZError as err:
            _print(f"armrigd: {_endpoint_error(self._endpoint, config.rig.id, err)}")
            return 1
        finally:
            code = self._loop.end()
            realtime.ignore_signals()
        if not self._quitting and code != NO_PORT:
            _print(f"armrigd: the loop died with code {code}")
        return 0 if self._quitting and code == 0 else 1

    def _serve(self) -> None:
        """Carry records out and commands in until the loop's pipe ends."""
        state_due = time.monotonic() + 1
        while True:
            due = min(state_due, self._kill_at, self._runs.client_gone_s)
            timeout = max(0.0, due - time.monotonic())
            if self._session.is_asked:
                timeout = min(timeout, _BREATH_S * (self._room == 0))
            sources = [self._loop.records_fd, self._wake_fd]
            sinks = [self._loop.orders_fd] if self._loop.is_behind else []
            ready, writable, _ = select.select(sources, sinks, [], timeout)
            if self._loop.records_fd in ready:  # first of all: who listens waits for the sample
                records = self._loop.records()
                if records is None:
                    self._woken()  # a signal may have ended the loop before we looked
                    return
                self._take(records)
            if writable:
                self._loop.flush()
            if self._wake_fd in ready:
                self._woken()
            # Behind the signs that have come: one that waited for us is a sign, of when it came.
            self._take_signs()
            if time.monotonic() >= self._runs.client_gone_s:
                self._loop.order(Halt(reason=self._runs.client_gone()))
            self._take_commands()
            if time.monotonic() >= self._kill_at:
                self._say("error", "the loop does not end: killed; the device stops the motor")
                self._kill_at = float("inf")
                self._loop.kill()
            if time.monotonic() >= state_due:
                state_due = time.monotonic() + 1
                self._each_second()

    # -- from the loop ---------------------------------------------------------------------

    def _take(self, records: list[bytes | Record]) -> None:
        batch: list[Outgoing] = []
        for record in records:
            match record:
                case bytes():
                    self._session.put("sample", record)  # first of all: who listens waits for it
                    sample = _decoded(record)
                    self._readings = readings.seen(self._readings, sample)
                    if self._runs.takes_sample(sample.k):
                        batch.append(_outgoing(sample, record))
                case RunStarted():
                    self._begin_run(record)
                case RunEnded():
                    batch += self._told(self._thinning.due(realtime.now_ns(), end=True))
                    self._runs.add(batch)
                    batch = []
                    self._runs.end(pressure.outcome(record.outcome, self._state, pressure.load()))
                case Answer():
                    self._answered(record)
                case Host():
                    self._host = record.granted
                    for what in record.granted["refused"]:
                        self._say("warning", f"not granted: {what}; timing is less exact")
                case Trace():
                    batch.append(outgoing(record, self._offset_ns))
                case Log():
                    batch += self._told([record] * self._thinning.said(record))
                case Gap() | Timing() | Clock() | State():
                    if isinstance(record, Timing):
                        share, runnable = self._pressure.read()
                        record = replace(record, cpu_pressure_percent=share, run_queue=runnable)
                        self._timing = record
                    if isinstance(record, State) and not record.owner:
                        self._hold("")
                    batch += self._told([record])
        self._runs.add(batch)

    def _told(self, records: Iterable[Gap | Log | Timing | Clock | State]) -> list[Outgoing]:
        """Publish records; return the messages that belong into the recording."""
        told = [(record, self._publish(record)) for record in records]
        return [message for record, message in told if self._runs.takes(record)]

    def _publish(self, record: Gap | Log | Timing | Clock | State) -> Outgoing:
        if isinstance(record, State):
            self._state = record
        if isinstance(record, Log) and record.level != "debug":
            _print(f"armrigd: {record.level}: {record.message}")
        message = outgoing(record, self._offset_ns)
        self._session.put(message.stream, message.data)
        return message

    def _say(self, level: str, message: str) -> None:
        self._take([Log(t_host_ns=realtime.now_ns(), level=level, message=message)])

    def _begin_run(self, started: RunStarted) -> None:
        self._anchor_clock()
        try:
            path = self._runs.begin(started, self._state, self._host, self._offset_ns)
        except (RecordingError, LookupError) as err:
            self._say("error", str(err))
            self._loop.order(Halt())
            return
        self._say("info", f"recording {path}")

    def _say_finished(self, timeout: float = 0.0) -> None:
        level, text = self._runs.finished(timeout)
        if text:
            self._say(level, text)

    def _answered(self, answer: Answer) -> None:
        waiting = self._waiting.pop(answer.order, None)
        if waiting is None:
            return  # it came too late: who asked has been told so
        if not answer.error:
            if isinstance(waiting.order, Take):
                self._Ts = answer.body["Ts"]
                self._hold(waiting.order.lease)
            elif isinstance(waiting.order, Leased) and waiting.order.lease == self._lease:
                self._n = max(self._n, waiting.order.n)
        if answer.error:
            self._give_up(waiting, answer.error)
        else:
            waiting.command.answer(waiting.body or answer.body)

    def _hold(self, lease: str) -> None:
        """Take note of the lease in force, or that there is none: others are strangers."""
        self._lease, self._n = lease, -1
        self._session.lease = lease.encode()

    def _give_up(self, waiting: Waiting, error: str) -> None:
        if isinstance(waiting.order, Play):
            self._runs.forget(waiting.order.run_id)
        waiting.command.refuse(error)

    # -- to the loop -----------------------------------------------------------------------

    def _woken(self) -> None:
        """Take what the writer's thread and the signals left."""
        signals = False
        with contextlib.suppress(BlockingIOError):
            signals = any(os.read(self._wake_fd, _READ))  # their numbers; a 0 is our own
        # Behind the read, which may have taken the sign of who has just come, and before the look.
        self._is_woken = False
        if signals:
            self._quitting = True
            self._kill_at = min(self._kill_at, time.monotonic() + _QUIT_S)
            self._loop.order(Quit(reason="the service was told to end"))
        reason = self._runs.disturbed()
        if reason:
            self._loop.order(Halt(reason=reason))
        self._say_finished()

    def _take_signs(self) -> None:
        """Take the signs of the run's client, each as of the time when it came."""
        for command in self._session.waiting(Kind.SIGN):
            self._try(command)

    def _take_commands(self) -> None:
        """Take some of the commands that wait, a stop before all others."""
        for command in self._session.waiting(Kind.STOP, self._room):
            self._try(command)
        for command in self._session.waiting(Kind.LEASED, min(_MOST_AT_ONCE, self._room)):
            self._try(command)
        for kind in (Kind.STATUS, Kind.OTHER):
            for command in self._session.waiting(kind, _MOST_AT_ONCE):
                self._try(command)

    @property
    def _room(self) -> int:
        """How many orders more may wait for the loop's answer."""
        return max(0, _MOST_UNANSWERED - len(self._waiting))

    def _try(self, command: Command) -> None:
        try:
            self._carry_out(command, commands.parse(command.name, command.payload))
        except ValueError as err:
            command.refuse(str(err))
        except Exception as err:
            command.refuse(f"{command.name}: {err!r}")
            self._say("error", f"{command.name}: {err!r}")

    def _carry_out(self, command: Command, request: commands.Requests) -> None:
        """Hand a request to the loop; raises ValueError where it is not allowed."""
        match request:
            case commands.Status():
                command.answer(self._status())
            case commands.Arm():
                owner = self._state.owner
                error = orders.held_by(owner) if owner else self._objection()
                if error:
                    raise ValueError(error)
                lease, ts_us = secrets.token_hex(16), self._ts_us(request.Ts)
                self._ask(command, Take(owner=request.owner, lease=lease, ts_us=ts_us))
            case commands.Disarm():
                self._ask(command, Release(lease=request.lease, n=request.n))
            case commands.Set():
                (volts,) = checked([request.u], replace(self._config.limits, slew_v=0.0))
                code = code_of(volts)
                self._ask(command, Hold(lease=request.lease, n=request.n, code=code))
            case commands.Run():
                self._check_holder(request)
                start = readings.theta_1_rad(self._readings)
                self._ask(command, *self._runs.plan(request, self._Ts, start))
            case commands.Renew():
                self._runs.renew(request, command.came_s)
                command.answer(commands.Done())
            case commands.Stop():
                self._ask(command, Halt())
            case commands.Reset():
                self._ask(command, Reset())
            case _:
                assert_never(request)

    def _check_holder(self, request: commands.Run) -> None:
        """Raise ValueError where the core is sure to refuse a run, before it is rehearsed."""
        if request.lease != self._lease:
            raise ValueError(orders.NOT_HELD)
        if request.n <= self._n:
            raise ValueError(orders.not_newer(request.n, self._n))
        if self._state.phase == Phase.ACTIVE and self._runs.is_idle:
            raise ValueError(orders.BY_HAND)

    def _objection(self) -> str:
        """Return why the rig is not to be armed, as far as the loop cannot know it, or nothing."""
        config = self._config
        return (
            self._line
            or self._runs.no_room()
            or readings.objection(
                self._readings,
                turns_per_volt_s=self._turns_per_volt_s,
                alpha_is_read=not (config.arm.removed or config.calibration.alpha.wraps),
            )
            or pressure.untimely(self._timing, config.device.watchdog_ms, pressure.load())
        )

    @property
    def _line(self) -> str:
        """What came of a device that does not answer, and at which port, or nothing."""
        line = self._state.line
        return f"{self._config.device.port}: {line}" if line else ""

    def _ts_us(self, Ts: float | None) -> int:
        """Return the sampling time asked for, in µs; 0 for the configured one."""
        if Ts is None:
            return 0
        if round(Ts * 1e6, 3) % 1:
            msg = f"Ts={Ts} must be a whole number of microseconds"
            raise ValueError(msg)
        check(round(Ts * 1e6), self._config.device.baud, scheduled=True)
        return round(Ts * 1e6)

    def _ask(self, command: Command, order: Orders, body: Any = None) -> None:
        if len(self._waiting) >= _MOST_ASKED and isinstance(order, Take | Reset):
            msg = "too many commands are waiting: try again"
            raise ValueError(msg)
        self._numbers += 1
        order = replace(order, order=self._numbers)
        self._waiting[self._numbers] = Waiting(command, time.monotonic() + ANSWER_S, order, body)
        self._loop.order(order)

    def _status(self) -> commands.StatusReport:
        config, state = self._config, self._state
        return commands.StatusReport(
            rig=config.rig.id,
            version=_VERSION,
            phase=state.phase,
            reason=state.reason,
            fault=state.fault,
            motor=state.motor,
            remedy=state.remedy,
            owner=state.owner,
            Ts=(state.ts_us or config.ts_us) / 1e6,
            u_min=config.limits.u_min_v,
            u_max=config.limits.u_max_v,
            endpoint=self._endpoint,
            device=state.device,
            line=self._line,
            host=self._host,
            last_run=self._runs.last,
            recordings=str(self._directory),
            calibration=config.calibration_in_words,
            arm_removed=config.arm.removed,
        )

    # -- the service itself ----------------------------------------------------------------

    def _each_second(self) -> None:
        self._loop.order(Alive())
        now = time.monotonic()
        for number in [n for n, w in self._waiting.items() if now > w.until]:
            self._give_up(self._waiting.pop(number), "the loop does not answer: see the log")
        self._runs.add(self._told(self._thinning.due(realtime.now_ns())))
        if self._state is not _UNKNOWN:
            self._publish(replace(self._state, t_host_ns=realtime.now_ns()))

    def _wake(self) -> None:
        if self._is_woken:
            return  # a pipe that is full of our zeros would have no room for a signal
        self._is_woken = True
        with contextlib.suppress(BlockingIOError):
            os.write(self._waker_fd, b"\0")

    def _anchor_clock(self) -> None:
        self._offset_ns = time.time_ns() - time.monotonic_ns()


def _in_words(config: Config) -> str:
    """Return what is served, and how it is asked and ended, in a line for a person."""
    limits, rig = config.limits, f" --rig {config.rig.id}" * (config.rig.id != "1")
    return (
        f"port {config.device.port} at {config.device.baud} baud, {limits.u_min_v:g} to "
        f"{limits.u_max_v:g} V; ask it with `armrig status{rig}`, end it with Ctrl-C"
    )


def _shown(path: Path) -> str:
    """Return a path as text, whatever bytes it has: a message is UTF-8."""
    return os.fsencode(path).decode(errors="replace")


def _decoded(data: bytes) -> Sample:
    sample = decode_sample(data)
    if sample is None:
        msg = "the loop sent a sample of another layout"
        raise RuntimeError(msg)
    return sample


def _outgoing(sample: Sample, data: bytes) -> Outgoing:
    return Outgoing("sample", sample.t_host_ns, sample.t_sched_ns, sample.k, data)


def _print(line: str) -> None:
    """Say a line to whoever reads our log; that there is nobody must not end the service."""
    with contextlib.suppress(OSError):
        print(printable(line), file=sys.stderr, flush=True)


def _endpoint_error(endpoint: str, rig: str, err: Exception) -> str:
    if "lock" in str(err):
        return f"a daemon of rig {rig} already runs at {endpoint}; end it, or choose another --rig"
    return f"{endpoint}: {str(err).splitlines()[0][:200]}; see that the directory can be written"
