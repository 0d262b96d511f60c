"""The service starts the loop, publishes and records the loop's reports, and passes on commands.

The main thread makes no call that may wait, so that it serves each stop at once. Threads write the
log and the recording, maintain the folder, and make the other calls of the file system; a process
plans the runs. zenoh's threads put commands into queues, or refuse them by `admission`.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import time
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import NamedTuple

import zenoh
from armrig_core.access.daemon_lock import DaemonFacts, absolute
from armrig_core.commands import commands
from armrig_core.commands.codes import Ending, OutcomeCode
from armrig_core.errors import InputError
from armrig_core.process import open_files, realtime
from armrig_core.process.line_writer import LineWriter
from armrig_core.process.signal_pipe import SignalPipe
from armrig_core.process.standstill import Standstill
from armrig_core.rig.description import Description, builtin
from armrig_core.rig.emulated import stall_sentence
from armrig_core.telemetry.telemetry import Outgoing, decode_sample
from msgspec.structs import replace

from armrig_daemon.config import EX_CONFIG, Config
from armrig_daemon.loop.process import NO_PORT, LoopSettings
from armrig_daemon.pipe import (
    Alive,
    Answer,
    Clock,
    Control,
    Gap,
    Host,
    Log,
    Quit,
    Record,
    RunEnded,
    RunStarted,
    State,
    Stop,
    Timing,
    Trace,
)
from armrig_daemon.service.access import Network, networks_of
from armrig_daemon.service.commands import Commands
from armrig_daemon.service.host import child, pressure
from armrig_daemon.service.host.planner import Planner
from armrig_daemon.service.host.startup_recovery import StartupRecovery
from armrig_daemon.service.host.systemd import Notifier
from armrig_daemon.service.host.worker import Worker
from armrig_daemon.service.preparation import Preparation
from armrig_daemon.service.protobuf_out import Published, outgoing
from armrig_daemon.service.publish import NetworkError, Session
from armrig_daemon.service.rig_view import RigView
from armrig_daemon.service.runs import Runs
from armrig_daemon.service.sentences import (
    endpoint_error,
    log_line,
    network_notice,
    print_line,
    startup_sentence,
    state_sentence,
    unreachable,
)
from armrig_daemon.service.socket_file import SocketFile
from armrig_daemon.service.thinning import Thinning

EX_TEMPFAIL = 75
"""Exit code of a service that must be started again with the same arguments (sysexits.h)."""
SILENCE_NS = 3_000_000_000
"""Silence of the service after which the loop stops the motor, in ns."""
_FINISH_S = 60.0  # the full chunks of a long recording take time to write
_DROP_S = 0.5  # an empty file that a silent disk leaves is named by `armrig recover`
_QUIT_S = 2.0  # longest time for a frozen loop to end
_LOAD_S = 30.0  # a loop that still loads has not reached the device yet
_AT_FIFO = "not granted: the ordinary policy for the service, whose threads may delay the loop"
_READ = 1 << 16
_BREATH_S = 0.005  # pause between two checks while too many orders are unanswered
_SWITCH_S = 0.0005  # longest time for which a thread of zenoh holds the interpreter


class _Look(NamedTuple):
    """Results of a look at the file system."""

    lines: list[tuple[str, str]]
    """Levels and texts of lines for the log."""
    cpu_pressure: float
    run_queue: int
    load: str


class Service:
    """Service of one rig; `run` returns the exit code."""

    def __init__(
        self,
        config: Config,
        endpoint: str,
        directory: Path,
        stalls_fd: int | None = None,
        notifier: Notifier | None = None,
        check_configuration: Callable[[], Config] | None = None,
        *,
        description: Description | None = None,
        log: LineWriter | None = None,
    ) -> None:
        """Catch the signals; start nothing yet.

        `stalls_fd` is a pipe with the reports of an emulator: times, in ns, for which the
        emulator's clock stood still. `notifier` is the connection to systemd; default: no
        connection. `check_configuration` is called at SIGHUP: it reads the configuration again, and
        raises ValueError if the configuration is refused. Without this function, SIGHUP ends the
        service. `description` describes the rig; default: the arm. `log` writes the lines of the
        service and of its loop, for which neither waits; default: to standard error.
        """
        self._description = description or builtin("arm")
        self._notifier = Notifier({}) if notifier is None else notifier
        self._check_configuration = check_configuration
        self._restarts = False
        self._config = config
        self._stalls_fd = stalls_fd
        self._log = log or LineWriter()
        self._endpoint = endpoint
        self._rig = RigView(config, endpoint, directory, self._description)
        self._signals = SignalPipe()
        wake = self._signals.wake
        self._runs = Runs(config, directory, wake, description=self._description)
        self._left_over = StartupRecovery(directory, config.rig.id, wake, config.recording)
        self._thinning = Thinning()
        self._files = open_files.FullTable()
        self._quitting = False
        self._kill_at = float("inf")
        self._anchor_clock()

    def run(self) -> int:
        """Run until SIGTERM, SIGINT or the loop's end."""
        config = self._config
        try:
            network, router = networks_of(config)
        except InputError as err:
            self._print("error", str(err))
            return EX_CONFIG
        loop = child.start(
            LoopSettings(
                rules=replace(config.rules(self._description), service_ns=SILENCE_NS),
                port=config.device.port,
                baud=config.device.baud,
                priority=config.timing.priority,
                cpu=config.timing.cpu,
                spin_ns=round(config.timing.spin_us * 1000),
            ),
            self._log.relay(),
        )
        try:
            # The loop has its real-time priority; later threads must not inherit this priority.
            has_left = realtime.leave_fifo(but=loop.starter.number)
            realtime.be_prompt(loop.starter.number)
            sys.setswitchinterval(_SWITCH_S)
            open_files.raise_limit()
            with Session(
                self._endpoint,
                config.rig.id,
                self._signals.wake,
                network,
                router,
                self._description.channels,
            ) as session:
                self._connect(loop, session)
                self._announce(filter(None, (network, router)), has_left_fifo=has_left)
                self._left_over.start()
                self._serve()
                self._notifier.stopping()  # the writer may need time, and the watchdog is not fed
                self._runs.end(Ending(OutcomeCode.DAEMON_ENDED, "the loop ended"))
                self._say_finished(_FINISH_S)
                self._runs.wait_for_dropped(_DROP_S)
        except zenoh.ZError as err:
            self._print("error", endpoint_error(self._endpoint, config.rig.id, err))
            return EX_CONFIG
        except NetworkError as err:
            self._print("error", str(err))
            return EX_CONFIG
        finally:
            code = loop.end()
            realtime.ignore_signals()
        if not self._quitting and code == NO_PORT:
            return EX_CONFIG
        if not self._quitting:
            self._print(
                "error",
                f"the loop died with code {code}: the device stops the motor by itself; "
                "restart armrigd",
            )
        if code == 0 and self._restarts:
            return EX_TEMPFAIL
        return 0 if self._quitting and code == 0 and not self._runs.has_lost else 1

    def _connect(self, loop: child.LoopChild, session: Session) -> None:
        self._loop, self._session = loop, session
        self._guard: open_files.NetworkGuard | None = None
        if self._config.access.listen:
            self._guard = open_files.NetworkGuard(
                open_files.count, session.shut_network, session.open_network
            )
        device = self._config.device
        facts = DaemonFacts(pid=os.getpid(), port=absolute(device.port), baud=device.baud)
        path = Path(self._endpoint.partition("/")[2])
        self._socket_file = SocketFile(path, facts, session.open_socket)
        self._sleep, self._slept = Standstill(), ""
        self._pressure = pressure.Pressure()
        wake = self._signals.wake
        self._planner = Planner(self._description, wake, self._log.relay())
        self._disk, self._housekeeping = Worker("disk", wake), Worker("housekeeping", wake)
        self._commands = Commands(
            self._config,
            self._rig,
            self._runs,
            session,
            loop,
            Preparation(self._runs, self._planner),
            self._disk,
            self._say,
            self._note,
        )

    def _announce(self, ways: Iterable[Network], *, has_left_fifo: bool) -> None:
        """Log the endpoints, the permitted clients and the limits, and the problems found."""
        if not has_left_fifo:
            self._say("warning", _AT_FIFO)
        self._say("info", f"rig {self._config.rig.id} at {self._endpoint}")
        for way in ways:
            self._say(*network_notice(way, datetime.now(UTC)))
            if problem := unreachable(way.endpoint, Path("/proc/net/dev").read_text()):
                self._say("warning", problem)
        by = "`systemctl stop`" if self._notifier.is_asked else "Ctrl-C"
        self._say("info", startup_sentence(self._config, by))
        if objection := self._runs.no_room():  # report it now, not only at the first run
            self._say("warning", f"nothing can be recorded: {objection.error}")

    def _serve(self) -> None:
        """Publish records and pass on commands until the loop's pipe ends."""
        self._planner.start()
        state_due = time.monotonic() + 1
        while True:
            due = min(state_due, self._kill_at, self._runs.client_gone_s)
            timeout = max(0.0, due - time.monotonic())
            if self._session.is_asked:
                timeout = min(timeout, _BREATH_S if self._commands.room == 0 else 0.0)
            sources = [self._loop.records_fd, self._signals.fd]
            sources += [] if self._stalls_fd is None else [self._stalls_fd]
            sinks = [self._loop.orders_fd] if self._loop.is_behind else []
            ready, writable, _ = select.select(sources, sinks, [], timeout)
            if self._loop.records_fd in ready:  # first: subscribers wait for the sample
                records = self._loop.records()
                if records is None:
                    self._handle_wake()  # a signal may have ended the loop before `select` returned
                    self._planner.close()
                    return
                self._handle(records)
            if writable:
                self._loop.flush()
            if self._stalls_fd in ready:
                self._hear_of_stalls(self._stalls_fd)
            if self._signals.fd in ready:
                self._handle_wake()
            if time.monotonic() >= state_due:  # before what is looked at only after a wake-up
                state_due = time.monotonic() + 1
                self._each_second()
            # First handle the signs of life, so that a sign that had to wait is not too late.
            self._commands.serve_signs()
            if time.monotonic() >= self._runs.client_gone_s:
                gone = self._runs.client_gone()
                self._loop.order(Stop(reason=gone.text, outcome_code=gone.code))
            self._commands.serve()
            self._housekeeping.hand_back()
            if time.monotonic() >= self._kill_at:
                self._say("error", "the loop does not end: killed; the device stops the motor")
                self._kill_at = float("inf")
                self._loop.kill()

    # -- from the loop ---------------------------------------------------------------------

    def _handle(self, records: list[bytes | Record]) -> None:
        batch: list[Outgoing] = []
        for record in records:
            match record:
                case bytes():
                    self._session.put("sample", record)  # first: subscribers wait for it
                    sample = decode_sample(record)
                    if sample is None:
                        raise RuntimeError("the loop sent a sample of another layout")
                    self._rig.note_sample(sample)
                    if self._runs.includes_sample(sample.k):
                        times = sample.t_host_ns, sample.t_sched_ns
                        batch.append(Outgoing("sample", *times, sample.k, record))
                case RunStarted():
                    self._begin_run(record)
                case RunEnded():
                    batch += self._publish_all(self._thinning.due(realtime.now_ns(), end=True))
                    self._runs.add(batch)
                    batch = []
                    ended = Ending(record.outcome_code, record.outcome)
                    load = self._note_sleep() or self._rig.load
                    self._runs.end(pressure.with_load(ended, self._rig.state, load))
                case Answer():
                    self._commands.answer(record)
                case Host():
                    self._notifier.ready()
                    self._rig.host = record.granted
                    for grant in record.granted["refused"]:
                        self._say("warning", f"not granted: {grant}; timing is less exact")
                case Trace():
                    batch.append(outgoing(record, self._offset_ns))
                case Log():
                    if self._thinning.lets_through(record):
                        batch += self._publish_all([record])
                case Timing():
                    self._notifier.progress()
                    batch += self._publish_all([self._rig.note_timing(record)])
                case State():
                    if not record.owner:
                        self._commands.note_lease("")
                    batch += self._publish_all([record])
                case Gap() | Clock() | Control():
                    batch += self._publish_all([record])
        self._runs.add(batch)

    def _publish_all(self, records: Iterable[Published]) -> list[Outgoing]:
        """Publish records; return the messages for the recording."""
        published = [(record, self._publish(record)) for record in records]
        return [message for record, message in published if self._runs.includes(record)]

    def _publish(self, record: Published) -> Outgoing:
        if isinstance(record, State):
            self._rig.state = record
            self._notifier.status(state_sentence(record, self._rig.line))
        if isinstance(record, Log) and record.level != "debug":
            self._print(record.level, log_line(record), self._about(record))
        message = outgoing(record, self._offset_ns)
        self._session.put(message.stream, message.data)
        return message

    def _print(self, level: str, message: str, fields: dict[str, str] | None = None) -> None:
        self._log.call(partial(print_line, level, message, fields))

    def _about(self, log: Log) -> dict[str, str]:
        """Return the fields of a log line: rig, holder, current run, and the fields of `log`."""
        about = {
            "rig": self._config.rig.id,
            "run": self._runs.run_id,
            "owner": self._rig.state.owner,
            "owner_checked": self._rig.state.owner_checked,
        }
        return about | log.fields

    def _say(self, level: str, message: str, **fields: str) -> None:
        now_ns = realtime.now_ns()
        self._handle([Log(t_host_ns=now_ns, level=level, message=message, fields=fields)])

    def _note(self, t_host_ns: int, text: str, owner: str) -> None:
        """Publish and record a note; the filter of the log never holds back a note."""
        fields = {"owner": owner, "command": commands.NoteRequest.name}
        log = Log(t_host_ns=t_host_ns, level="info", message=text, fields=fields, is_note=True)
        self._runs.add_note(self._publish(log))

    def _hear_of_stalls(self, fd: int) -> None:
        """Report the stalls of an emulator, which writes them at most once a second."""
        stalls = os.read(fd, _READ)
        if not stalls:
            self._stalls_fd = None  # the emulator has ended; the loop reports this end
            return
        now_ns = realtime.now_ns()
        logs = [
            Log(t_host_ns=now_ns, level="warning", message=stall_sentence(ns), emulator_stall_ns=ns)
            for ns in map(int, stalls.split())
        ]
        self._runs.add(self._publish_all(logs))

    def _note_sleep(self) -> str:
        """Report a sleep of this computer; return the sentence on a sleep in the current run."""
        if slept := self._sleep.look():
            self._slept = slept
            self._say("warning", slept)
        return self._slept

    def _begin_run(self, started: RunStarted) -> None:
        self._anchor_clock()
        self._slept = ""
        self._left_over.rest()
        try:
            path = self._runs.begin(started, self._rig.state, self._rig.host, self._offset_ns)
        except LookupError as err:
            self._say("error", str(err))
            self._loop.order(Stop())
            return
        self._say("info", f"recording {path}")

    def _say_finished(self, timeout: float = 0.0) -> None:
        level, text = self._runs.completion_line(timeout)
        if text and (last := self._runs.last):
            self._say(level, text, run=last.run_id, cause=last.outcome)

    # -- the service itself ----------------------------------------------------------------

    def _handle_wake(self) -> None:
        """Handle signals, and changes that the other threads report."""
        signals = self._signals.read()  # read first: a later signal wakes the service again
        if signal.SIGHUP in signals and self._check_configuration is not None:
            signals -= {signal.SIGHUP}
            self._restart(self._check_configuration)
        if signals:
            self._quit("the service received a signal to end")
        if ended := self._runs.recording_failure():
            self._loop.order(Stop(reason=ended.text, outcome_code=ended.code))
        self._say_finished()
        for level, text in self._left_over.lines():
            self._say(level, text)

    def _restart(self, check_configuration: Callable[[], Config]) -> None:
        """End the unused service, as only a new process can give its loop a real-time priority."""

        def then(outcome: object) -> None:
            if isinstance(outcome, Exception):
                text = "configuration not reloaded, the old configuration stays"
                self._say("error", f"{text}: {outcome}")
            elif not self._is_in_use():
                self._restarts = True
                self._quit("the configuration is reloaded")

        if not self._is_in_use():
            self._disk.call(lambda: networks_of(check_configuration()), then)

    def _is_in_use(self) -> bool:
        """Return whether the rig is in use; if so, say that nothing is reloaded."""
        owner = self._rig.state.owner
        if self._is_busy:
            who = f"{owner} has the rig" if owner else "a run or a command is in progress"
            self._say("warning", f"configuration not reloaded: {who}; reload when the rig is free")
        return self._is_busy

    def _quit(self, reason: str) -> None:
        self._quitting = True
        self._notifier.stopping()
        within_s = _QUIT_S if self._rig.host else _LOAD_S
        self._kill_at = min(self._kill_at, time.monotonic() + within_s)
        self._loop.order(Quit(reason=reason))
        self._commands.cancel("the daemon is ending")

    def _each_second(self) -> None:
        self._loop.order(Alive())
        self._note_sleep()
        self._handle_wake()  # a disk that does not answer wakes nobody
        self._commands.refuse_overdue(time.monotonic())
        self._planner.look()
        if not self._housekeeping.waiting:
            self._housekeeping.call(self._look, self._note_look)
        if self._runs.is_idle:
            self._left_over.go_on()
        self._runs.add(self._publish_all(self._thinning.due(realtime.now_ns())))
        if self._rig.is_known:
            self._publish(replace(self._rig.state, t_host_ns=realtime.now_ns()))

    def _look(self) -> _Look:
        """Look at what needs the file system; this is done in a thread."""
        lines = [self._files.look()]
        if self._guard is not None:
            lines.append(self._guard.look(time.monotonic(), is_busy=self._is_busy))
        changed = self._socket_file.look()
        lines.append(("error", changed) if changed else None)
        if self._session.uplink is not None:
            lines.append(self._session.uplink.look())
        return _Look([line for line in lines if line], *self._pressure.read(), pressure.load())

    def _note_look(self, look: _Look | Exception) -> None:
        if isinstance(look, Exception):
            self._say("error", f"the daemon could not look after its files: {look!r}")
            return
        for line in look.lines:
            self._say(*line)
        self._rig.note_load(*look[1:])

    @property
    def _is_busy(self) -> bool:
        """True if a client holds the rig, or a run or a command is pending."""
        idle = self._runs.is_idle and not self._commands.is_waiting
        return bool(self._rig.state.owner) or not idle

    def _anchor_clock(self) -> None:
        self._offset_ns = time.time_ns() - time.monotonic_ns()
