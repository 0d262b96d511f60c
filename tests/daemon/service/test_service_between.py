"""The service between its clients and the loop: its own orders, and its refusals."""

from __future__ import annotations

import hashlib
import os
import select
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from datetime import UTC, datetime
from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from armrig.rig.session import open_session
from armrig_core.commands.codes import Ending, OutcomeCode, RefusalCode
from armrig_core.commands.commands import (
    ArmRequest,
    DisarmRequest,
    NoteRequest,
    Renew,
    RunRequest,
    SetRequest,
    StopRequest,
    build_refusal,
)
from armrig_core.commands.commands import CalibrateRequest as AskedCalibrate
from armrig_core.commands.commands import ResetRequest as AskedReset
from armrig_core.process.line_writer import LineWriter
from armrig_core.recording_file.manifest import CALIBRATION, CALIBRATION_RAW, Manifest
from armrig_core.recording_file.manifest import RUN as OF_RUN
from armrig_core.rig.calibration import Calibration, Made, Potentiometer
from armrig_core.rig.description import Description
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.history import decode_past
from armrig_core.telemetry.telemetry import Sample, encode_sample
from armrig_core.telemetry.topics import command_key
from armrig_daemon import pipe
from armrig_daemon.config import Config, DeviceTable
from armrig_daemon.decisions.orders import BY_HAND, not_newer
from armrig_daemon.pipe import (
    Alive,
    Answer,
    Calibrate,
    Host,
    Log,
    Reset,
    RunEnded,
    RunStarted,
    State,
)
from armrig_daemon.service import publish
from armrig_daemon.service.access import Network
from armrig_daemon.service.client_watchdog import begin_watch
from armrig_daemon.service.host.planner import Job
from armrig_daemon.service.plan import plan_of
from armrig_daemon.service.publish import CommandKind, Session
from armrig_daemon.service.sentences import line_and_limits
from armrig_daemon.service.service import Service
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from tests.daemon.loop_ends import LoopEnds
from tests.daemon.odd_bench import CONFIG
from tests.daemon.odd_service import odd_records
from tests.integration.processes import wait_for

LEASE = "a" * 32
FREE = State(t_host_ns=0, phase="safe", reason="", owner="", ts_us=0, device={})
RUN = RunRequest(lease=LEASE, n=3, u=[1.0] * 3)


class _AtOnce(LineWriter):
    """Log whose lines are printed at once."""

    def call(self, write: Callable[[], None]) -> None:
        write()


class _PlansAtOnce:
    """Planner without a process."""

    def __init__(self, description: Description) -> None:
        self._description, self._plans = description, dict[int, Any]()
        self.jobs: list[Job] = []

    def plan(self, job: Job) -> None:
        self.jobs.append(job)
        self._plans[job.number] = plan_of(
            lambda: job.payload, job.Ts, job.config, self._description, job.start_rad
        )

    def result(self, number: int) -> Any:
        return self._plans.pop(number, None)

    def cancel(self) -> None:
        self._plans.clear()

    def look(self) -> None:
        """Do nothing: there is no process."""


class Between:
    """A service with a client's session and the loop's ends."""

    def __init__(self, directory: Path, config: Config | None = None) -> None:
        self.loop = LoopEnds()
        self.has_come = threading.Event()
        endpoint = f"unixsock-stream/{directory}/s"
        self.service: Any = Service(config or Config(), endpoint, directory, log=_AtOnce())
        self.service._connect(self.loop.child, Session(endpoint, "1", self.has_come.set))
        self.commands = self.service._commands
        self.commands._preparation._planner = _PlansAtOnce(self.service._description)
        self.commands.note_lease(LEASE)
        self.client = open_session(endpoint, rig="1")

    def ask(self, request: Any) -> Any:
        """Send a command; return its replies, which may be waited for, once it has come."""
        self.has_come.clear()
        data = msgspec.json.encode(request)
        replies = self.client.get(command_key("1", request.name), payload=data)
        assert self.has_come.wait(30)
        return replies

    def serve(self, request: Any) -> Any:
        """Send a command and have it handled; return its replies."""
        replies = self.ask(request)
        self.handle()
        return replies

    def handle(self) -> None:
        """Have the waiting commands handled, and what they wait for."""
        self.commands.serve()
        prepares = self.commands._preparation
        wait_for(lambda: self.commands.serve() or not (self.commands._arming or prepares.is_busy))

    def pass_a_second(self) -> None:
        """Have done what is done each second."""
        self.service._each_second()
        worker = self.service._housekeeping
        wait_for(lambda: worker.hand_back() or not worker.waiting)

    def begin_run(self) -> str:
        """Have a run requested, accepted by the loop, and begun."""
        self.serve(RUN)
        (play,) = (order for order in self.loop.orders() if order != Alive())
        assert isinstance(play, pipe.Run)
        started = RunStarted(run_id=play.run_id, k_first=0, count=3, t_host_ns=0)
        self.service._handle([Answer(order=play.order), started])
        return play.run_id

    def answers(self, reads: Iterable[list[Any] | None]) -> None:
        """Have each read of the loop's pipe return the next of these records; None: its end."""
        self.loop.child.records = iter(reads).__next__  # type: ignore[method-assign]
        os.write(self.loop.records_fd, b"always something")

    def close(self) -> None:
        """End all."""
        self.client.close()
        self.service._planner.close()
        self.service._session.__exit__(None, None, None)
        self.loop.close()
        self.service._signals.close()


@pytest.fixture
def between(tmp_path: Path) -> Iterator[Between]:
    """Return a service without a loop, which acts on the test's calls."""
    between = Between(tmp_path)
    yield between
    between.close()


@pytest.fixture
def narrow(tmp_path: Path) -> Iterator[Between]:
    """Return such a service for a rig with narrow limits on a slow line."""
    between = Between(tmp_path, CONFIG)
    yield between
    between.close()


def _refusal(replies: Any) -> str:
    error = next(iter(replies)).err
    assert error is not None, "it was not refused"
    told = msgspec.json.decode(error.payload.to_bytes())
    assert told["passes"] == RefusalCode(told["code"]).passes
    assert told["passes"] == told["error"].endswith(": try again")
    return str(told["error"])


def _finished(between: Between) -> Path:
    """Have the run in hand ended; return its recording."""
    between.service._runs.end(Ending(OutcomeCode.STOPPED, "stopped"))
    assert between.service._runs.completion_line(30)[0] == "info"
    last = between.service._runs.last
    assert last is not None
    return Path(last.recording)


def _sample(k: int) -> bytes:
    return encode_sample(Sample(k, k + 1, k + 1, k, 0.1, 0.2, 1.0, 1.0, 1, 2, 3))


def test_a_run_that_cannot_be_recorded_is_stopped(between: Between) -> None:
    between.service._handle([RunStarted(run_id="another", k_first=0, count=1, t_host_ns=0)])

    assert between.loop.orders() == [pipe.Stop()]


def test_a_refused_run_does_not_block_the_next_run(between: Between) -> None:
    replies = between.serve(RUN)
    *_, play = between.loop.orders()

    between.service._handle([Answer(order=play.order, error="not now", code=RefusalCode.BY_HAND)])

    assert _refusal(replies) == "not now"
    assert between.service._runs.is_idle


def test_an_unanswered_run_does_not_block_the_next_run(between: Between) -> None:
    replies = between.serve(RUN)
    *_, play = between.loop.orders()

    between.commands.refuse_overdue(time.monotonic() + 3.1)

    assert _refusal(replies) == "the loop did not answer within 3 s: try again, or restart armrigd"
    assert between.service._runs.is_idle
    between.service._handle([Answer(order=play.order)])


def test_samples_that_come_with_the_end_of_their_run_are_recorded(between: Between) -> None:
    """L1: the samples precede the end in the pipe."""
    run_id = between.begin_run()

    ended = RunEnded(run_id=run_id, outcome="complete", outcome_code=OutcomeCode.COMPLETE)
    between.service._handle([*map(_sample, range(4)), ended, _sample(4)])

    level, text = between.service._runs.completion_line(30)
    assert (level, text.partition(": ")[2]) == ("info", "complete, 3 samples, 0 missing")


def test_a_lease_ended_by_the_loop_is_refused(between: Between) -> None:
    between.service._handle([msgspec.structs.replace(FREE, owner="a test")])
    assert between.service._session.lease == LEASE.encode()

    between.service._handle([FREE])
    assert between.service._session.lease == b""


def test_a_command_that_exceeds_the_queue_is_refused_at_once(between: Between) -> None:
    """R1."""
    for _ in range(publish.MAX_WAITING):
        between.ask(RUN)

    assert _refusal(between.ask(RUN)) == "too many commands are waiting: try again"
    waiting = list(between.service._session.waiting(CommandKind.LEASED))
    assert len(waiting) == publish.MAX_WAITING


def test_a_recording_that_cannot_be_written_stops_its_run(between: Between) -> None:
    between.begin_run()
    Path(between.service._runs.last.recording).unlink()
    orders: list[Any] = []

    wait_for(
        lambda: between.service._handle_wake() or orders.extend(between.loop.orders()) or orders
    )

    halt = orders[0]
    assert isinstance(halt, pipe.Stop)
    assert "the file was removed during the recording" in halt.reason
    between.service._runs.end(Ending(OutcomeCode.STOPPED, "stopped"))
    between.service._runs.completion_line(30)


def test_a_run_is_planned_with_the_sampling_time_of_the_newest_lease(between: Between) -> None:
    _ready(between)
    between.commands._n = 9
    between.serve(ArmRequest(owner="a test", Ts=0.02))
    (granted,) = between.loop.orders()
    assert isinstance(granted, pipe.Arm)
    between.service._handle([Answer(order=granted.order, body={"Ts": 0.02})])

    between.serve(RunRequest(lease=granted.lease, n=1, u=[1.0] * 100))

    (job,) = between.commands._preparation._planner.jobs
    assert job.Ts == 0.02


def test_a_command_number_already_accepted_by_the_loop_is_refused(between: Between) -> None:
    between.serve(SetRequest(lease=LEASE, n=5, u=0.5))
    (order,) = between.loop.orders()
    between.service._handle([Answer(order=order.order, body={"done": True})])

    replies = between.serve(msgspec.structs.replace(RUN, n=5))

    assert _refusal(replies) == not_newer(5, 5)


def test_a_repeated_signal_does_not_delay_the_kill_of_a_frozen_loop(between: Between) -> None:
    signal.raise_signal(signal.SIGTERM)
    between.service._handle_wake()
    kill_at_s = between.service._kill_at

    signal.raise_signal(signal.SIGTERM)
    between.service._handle_wake()

    assert between.service._kill_at == kill_at_s < inf


@pytest.mark.parametrize(
    ("records", "within_s"), [([], 30.0), ([Host(granted={"refused": []})], 2.0)]
)
def test_a_loop_that_is_still_starting_has_more_time_to_end(
    between: Between, records: list[Any], within_s: float
) -> None:
    """A loop that has loaded must end within 2 s."""
    between.service._handle(records)

    signal.raise_signal(signal.SIGTERM)
    began_s = time.monotonic()
    between.service._handle_wake()
    ended_s = time.monotonic()

    assert began_s + within_s <= between.service._kill_at <= ended_s + within_s


def test_a_queued_sign_of_life_is_read_before_its_client_counts_as_gone(between: Between) -> None:
    """Otherwise a busy service would stop the run of a client that is alive.

    The sign counts from its arrival, or a client that died meanwhile would count as alive.
    """
    between.begin_run()
    between.service._runs._presence = begin_watch(msgspec.structs.replace(RUN, dead_man=2.0), 0.0)
    sent_s = time.monotonic()
    between.ask(Renew(lease=LEASE, n=4))
    come_s = time.monotonic()
    between.answers([[], None])

    between.service._serve()

    assert sent_s + 2.0 <= between.service._runs.client_gone_s <= come_s + 2.0
    assert not [order for order in between.loop.orders() if isinstance(order, pipe.Stop)]
    between.service._runs.end(Ending(OutcomeCode.STOPPED, "stopped"))
    between.service._runs.completion_line(30)


def test_the_service_sends_alive_once_a_second(
    between: Between, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 0.0

    def reads() -> Iterator[list[Any] | None]:
        nonlocal now_s
        for _ in range(20):
            now_s += 0.25
            yield []
        yield None

    clock = SimpleNamespace(monotonic=lambda: now_s)
    monkeypatch.setattr("armrig_daemon.service.service.time", clock)
    between.answers(reads())

    between.service._serve()

    assert between.loop.orders() == [Alive()] * 5


def test_a_full_table_of_open_files_is_logged_as_an_error(
    between: Between, capsys: pytest.CaptureFixture[str]
) -> None:
    between.service._files.look = lambda: ("error", "64 of 64 files are open")

    between.pass_a_second()

    assert "error: 64 of 64 files are open" in capsys.readouterr().err


def test_a_scheduling_privilege_denied_to_the_loop_is_reported(
    between: Between, capsys: pytest.CaptureFixture[str]
) -> None:
    granted = {"fifo": False, "refused": ["SCHED_FIFO"]}

    between.service._handle([Host(granted=granted)])

    said = capsys.readouterr().err
    assert "armrigd: warning: not granted: SCHED_FIFO; timing is less exact\n" in said
    assert between.service._rig.status(None).host == granted


def test_the_recording_contains_every_report_of_the_loop_during_its_run(between: Between) -> None:
    between.begin_run()

    between.service._handle([_sample(0), *odd_records()])

    with _finished(between).open("rb") as file:
        topics = [channel.topic for _, channel, _ in make_reader(file).iter_messages()]
    streams = ["sample", "event", "event", "trace", "gap", "state", "timing", "clock"]
    assert sorted(topics) == sorted(f"/rig/1/{stream}" for stream in streams)


def test_the_clock_offset_of_a_recording_is_measured_at_its_beginning(between: Between) -> None:
    between.service._offset_ns = 0

    between.begin_run()

    with _finished(between).open("rb") as file:
        metadata = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    assert Manifest.of(metadata[OF_RUN]).clock_offset_ns > 10**18


def test_orders_are_forwarded_in_batches_from_a_bounded_queue(between: Between) -> None:
    """R1: between two lots the service looks at the loop; at most 64 orders wait."""
    for n in range(publish.MAX_WAITING):
        between.ask(SetRequest(lease=LEASE, n=n, u=0.0))

    lots = []
    for _ in range(5):
        between.commands.serve()
        lots.append(len(between.loop.orders()))
        between.ask(SetRequest(lease=LEASE, n=100, u=0.0))

    assert lots == [16, 16, 16, 16, 0]


@pytest.mark.parametrize(
    ("request_", "order"),
    [
        (DisarmRequest(lease=LEASE, n=4), pipe.Disarm(order=1, lease=LEASE, n=4)),
        (SetRequest(lease=LEASE, n=4, u=5.0), pipe.Set(order=1, lease=LEASE, n=4, code=65535)),
        (StopRequest(), pipe.Stop(order=1)),
        (StopRequest(by="anna"), pipe.Stop(order=1, reason="stopped by anna")),
        (
            StopRequest(by="\x1b[2J" + 90 * "x"),
            pipe.Stop(order=1, reason=f"stopped by \\x1b[2J{73 * 'x'}"),
        ),
        (StopRequest(by="  "), pipe.Stop(order=1)),
        (AskedReset(), Reset(order=1)),
    ],
)
def test_a_command_is_forwarded_as_an_order_and_answered_by_the_loop(
    between: Between, request_: Any, order: Any
) -> None:
    replies = between.serve(request_)
    assert between.loop.orders() == [order]

    between.service._handle([Answer(order=1)])

    assert next(iter(replies)).ok is not None


MEASURED = Calibration(
    theta_1=Potentiometer(zero_counts=7.5),
    alpha=Potentiometer(zero_counts=32000.0, wraps=False),
    made=Made(
        date="2026-11-20",
        rig="1",
        device_uid="",
        armrig="0.2.0",
        raw_sha256=hashlib.sha256(b"raw").hexdigest(),
    ),
)
ASKED = AskedCalibrate(calibration=MEASURED, raw=b"raw")


def _calibrated(between: Between) -> Any:
    """Have a calibration sent and ordered; return its replies."""
    replies = between.serve(ASKED)
    assert between.loop.orders() == [
        Calibrate(order=1, calibration=msgspec.structs.replace(MEASURED, made=None))
    ]
    return replies


def test_a_second_calibration_replaces_the_first(between: Between, tmp_path: Path) -> None:
    made = msgspec.structs.replace(
        MEASURED.made, date="2026-11-21", raw_sha256=hashlib.sha256(b"second").hexdigest()
    )
    second = msgspec.structs.replace(
        MEASURED, alpha=Potentiometer(zero_counts=31000.0, wraps=False), made=made
    )
    _calibrated(between)
    between.service._handle([Answer(order=1, body={"done": True})])

    between.serve(AskedCalibrate(calibration=second, raw=b"second"))
    (order,) = between.loop.orders()
    between.service._handle([Answer(order=2, body={"done": True})])
    between.begin_run()
    with _finished(between).open("rb") as file:
        reader = make_reader(file)
        attached = {a.name: a.data for a in reader.iter_attachments()}
        (of_run,) = (m.metadata for m in reader.iter_metadata() if m.name == OF_RUN)

    assert order == Calibrate(order=2, calibration=msgspec.structs.replace(second, made=None))
    status = between.service._rig.status(None)
    assert "made 2026-11-21" in status.calibration
    assert status.calibration_sha256 == hashlib.sha256(attached[CALIBRATION]).hexdigest()
    assert status.calibration_sha256 == Manifest.of(of_run).calibration_sha256
    assert msgspec.json.decode(attached[CALIBRATION], type=Calibration) == second
    assert attached[CALIBRATION_RAW] == b"second"


def test_a_calibration_that_the_core_refuses_is_not_in_force(between: Between) -> None:
    before = between.service._rig.status(None)
    replies = _calibrated(between)

    between.service._handle([Answer(order=1, error="anna has the rig", code=RefusalCode.HELD)])

    assert b"anna has the rig" in next(iter(replies)).err.payload.to_bytes()
    now = between.service._rig.status(None)
    assert msgspec.structs.replace(now, now_ns=before.now_ns) == before


def test_a_calibration_confirmed_after_the_timeout_is_in_force(between: Between) -> None:
    replies = _calibrated(between)
    between.commands.refuse_overdue(time.monotonic() + 3.1)
    assert b"the loop did not answer within" in next(iter(replies)).err.payload.to_bytes()
    second = between.serve(ASKED)
    assert b"on its way: try again" in next(iter(second)).err.payload.to_bytes()

    between.service._handle([Answer(order=1, body={"done": True})])

    assert "sent by" in between.service._rig.status(None).calibration
    between.serve(ASKED)
    assert len(between.loop.orders()) == 1


def test_at_most_one_calibration_is_pending(between: Between) -> None:
    """R1: each may have more than a megabyte."""
    between.ask(ASKED)

    refused = between.ask(ASKED)

    assert b"too many commands are waiting: try again" in next(iter(refused)).err.payload.to_bytes()
    assert len(list(between.service._session.waiting(CommandKind.CALIBRATE))) == 1


DRIVEN = msgspec.structs.replace(FREE, phase="active", owner="a test")
HELD = msgspec.structs.replace(FREE, owner="Ada", line="no rig")
OVERSAMPLED = Config(device=DeviceTable(oversampling=30))
TOO_SHORT = "Ts=0.005 s cannot be carried at 500000 baud in scheduled mode with [device]"
SILENT = msgspec.structs.replace(FREE, line="no answer; check the cable")


@pytest.mark.parametrize(
    ("config", "state", "request_", "refusal"),
    [
        (Config(), DRIVEN, RUN, BY_HAND),
        (Config(), HELD, ArmRequest(owner="Bob"), "Ada has the rig: wait until it is free"),
        (Config(), SILENT, ArmRequest(owner="Bob"), "/dev/armrig: no answer; check the cable"),
        (
            OVERSAMPLED,
            FREE,
            ArmRequest(owner="Ada", Ts=0.005),
            f"{TOO_SHORT} oversampling = 30: at least",
        ),
        (
            CONFIG,
            FREE,
            ArmRequest(owner="Ada", Ts=0.0011),
            "Ts=0.0011 s cannot be carried at 250000 baud",
        ),
        (
            CONFIG,
            FREE,
            ArmRequest(owner="Ada", Ts=0.0020005),
            "Ts=0.0020005 must be a whole number of mi",
        ),
        (CONFIG, FREE, SetRequest(lease=LEASE, n=1, u=4.41), "u[0]=4.41 V is outside 0.2 … 4.4 V"),
        (CONFIG, FREE, SetRequest(lease=LEASE, n=1, u=0.0), "u[0]=0 V is outside 0.2 … 4.4 V"),
        (
            CONFIG,
            FREE,
            RunRequest(lease=LEASE, n=1, u=[1.0, 4.1]),
            "u[1] steps by 3.1 V: at most 3 V in",
        ),
    ],
)
def test_a_command_forbidden_by_state_or_limits_is_refused_by_the_service(
    tmp_path: Path, config: Config, state: State, request_: Any, refusal: str
) -> None:
    with closing(Between(tmp_path, config)) as between:
        _ready(between)
        between.service._handle([state])
        between.commands.note_lease(LEASE)
        replies = between.serve(request_)

        assert _refusal(replies).startswith(refusal)
        assert not [order for order in between.loop.orders() if order != Alive()]


def test_the_slew_limit_of_runs_does_not_apply_to_a_manual_voltage(narrow: Between) -> None:
    _ready(narrow)
    narrow.serve(SetRequest(lease=LEASE, n=4, u=4.4))
    narrow.serve(ArmRequest(owner="Ada", Ts=0.002))

    held, taken = narrow.loop.orders()
    assert isinstance(held, pipe.Set)
    assert (held.n, held.code, held.lease) == (4, round(4.4 / 5 * 65_535), LEASE)
    assert isinstance(taken, pipe.Arm)
    assert (taken.owner, taken.ts_us) == ("Ada", 2000)


def test_a_note_is_recorded_as_a_field_and_not_sent_to_the_loop(
    between: Between, capsys: pytest.CaptureFixture[str]
) -> None:
    """S5: each is written with its author and time, also if two have one text."""
    between.begin_run()
    before_ns = time.monotonic_ns()
    replies = [between.ask(NoteRequest(text="note 1: *touched*", owner="Ada")) for _ in range(2)]
    came_ns = time.monotonic_ns()

    between.commands.serve()

    assert between.loop.orders() == []
    assert [msgspec.json.decode(next(iter(r)).ok.payload.to_bytes()) for r in replies] == [
        {"done": True}
    ] * 2
    assert capsys.readouterr().err.count("note by Ada: note 1: *touched*") == 2
    # As others read it: by the schema that the file itself carries.
    with _finished(between).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [event for *_, event in reader.iter_decoded_messages("/rig/1/event")]
    notes = [event for event in found if event.name == "note"]
    assert [(event.message, event.owner) for event in notes] == [("note 1: *touched*", "Ada")] * 2
    assert all(before_ns <= event.t_host_ns <= came_ns for event in notes)
    others = [(event.name, event.t_host_ns) for event in found if event not in notes]
    assert others == [("armrigd", 0)]  # the recording's name


def test_the_reply_to_a_note_outside_a_run_reports_that_it_is_not_recorded(
    between: Between,
) -> None:
    replies = between.serve(NoteRequest(text="the belt was changed"))

    answer = next(iter(replies)).ok
    assert answer is not None
    assert msgspec.json.decode(answer.payload.to_bytes()) == {"done": False}
    past = between.service._session._past(0, 0)
    assert b"the belt was changed" in past
    assert b"somebody on this machine" in past


def test_notes_are_limited_to_a_burst_of_twenty_and_two_per_second(
    between: Between, monkeypatch: pytest.MonkeyPatch
) -> None:
    """R1: the others are refused for the moment."""
    now_s = time.monotonic()
    monkeypatch.setattr("armrig_daemon.service.commands.time.monotonic", lambda: now_s)
    asked = [between.ask(NoteRequest(text=f"{i}")) for i in range(21)]
    for _ in range(2):
        between.commands.serve()
    now_s += 0.5
    asked += [between.ask(NoteRequest(text="later")) for _ in range(2)]

    between.commands.serve()

    replies = [next(iter(one)) for one in asked]
    refused = [i for i, reply in enumerate(replies) if reply.err is not None]
    assert refused == [20, 22]
    assert b"too many notes, at most 2 a second are accepted: try again" in (
        replies[20].err.payload.to_bytes()
    )


def _ready(between: Between) -> None:
    """Have the loop report a state and a sample of a rig that may be armed."""
    between.service._handle([FREE, _sample(1)])
    between.commands.note_lease(LEASE)


def test_a_log_line_has_its_subject_and_a_debug_line_is_only_published(
    between: Between, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A field of the line itself has precedence over the current run, holder and rig."""
    printed: list[tuple[str, str, dict[str, str]]] = []
    monkeypatch.setattr(
        "armrig_daemon.service.service.print_line", lambda *line: printed.append(line)
    )
    held = msgspec.structs.replace(FREE, owner="Ada (user ada)", owner_checked="user ada")
    between.service._handle([held, Log(t_host_ns=1, level="debug", message="for developers")])
    run_id = between.begin_run()
    between.service._say("warning", "late", run="7", cause="load")

    about = {"rig": "1", "run": run_id, "owner": "Ada (user ada)", "owner_checked": "user ada"}
    (begun,) = [line for line in printed if line[1].startswith("recording ")]
    assert (begun[0], begun[2]) == ("info", about)
    assert printed[-1] == ("warning", "late", about | {"run": "7", "cause": "load"})
    assert not [line for line in printed if line[1] == "for developers"]
    assert b"for developers" in between.service._session._past(0, 0)
    _finished(between)


def test_recovery_and_retention_pause_during_a_run(between: Between) -> None:
    told: list[str] = []
    between.service._left_over = SimpleNamespace(
        rest=lambda: told.append("rest"), go_on=lambda: told.append("go on"), lines=list
    )

    between.pass_a_second()
    between.begin_run()
    between.pass_a_second()
    assert told == ["go on", "rest"]
    _finished(between)
    between.pass_a_second()

    assert told == ["go on", "rest", "go on"]


def test_a_delayed_log_line_is_recorded_before_the_end_of_its_run(between: Between) -> None:
    run_id = between.begin_run()
    now_ns = time.monotonic_ns()
    lines = [Log(t_host_ns=now_ns, level="warning", message=f"late by {n} ms") for n in (1, 2)]
    ended = RunEnded(run_id=run_id, outcome="stopped", outcome_code=OutcomeCode.STOPPED)

    between.service._handle([*lines, ended])

    assert between.service._runs.completion_line(30)[0] == "info"
    last = between.service._runs.last
    assert last is not None
    with Path(last.recording).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        events = [m.message for *_, m in reader.iter_decoded_messages("/rig/1/event")]
    assert events[-2:] == ["late by 1 ms", "late by 2 ms"]


class _Asked:
    """A command of a client whose identity was checked; `told` is the answer or the refusal."""

    def __init__(self, request: Any, by: str) -> None:
        self.name, self.by, self.came_s = request.name, by, time.monotonic()
        self.payload = msgspec.json.encode(request)
        self.told: Any = None

    def answer(self, body: Any) -> None:
        """Note the answer."""
        self.told = body

    def refuse(self, refusal: Any) -> None:
        """Note the refusal."""
        self.told = refusal.code


def _tried(between: Between, request: Any, by: str = "") -> _Asked:
    """Have a command tried that a client with the checked identity `by` has sent."""
    asked = _Asked(request, by)
    between.commands._try(asked)  # type: ignore[arg-type]
    between.handle()
    return asked


def test_a_lease_used_by_another_client_is_refused(between: Between) -> None:
    """Over a network, the lease alone does not make a client the holder."""
    _ready(between)
    arming = _tried(between, ArmRequest(owner="Ada"), "certificate ada")
    (arm,) = between.loop.orders()
    assert isinstance(arm, pipe.Arm)
    assert (arm.owner, arm.owner_checked) == ("Ada (certificate ada)", "certificate ada")
    between.service._handle([Answer(order=arm.order, body={"Ts": 0.01})])

    soon_ns = arming.told["now_ns"] + 10**10
    asked = [
        _tried(between, SetRequest(lease=arm.lease, n=n, u=1.0, valid_until_ns=soon_ns), by)
        for n, by in enumerate(("", "certificate bob", "certificate ada"))
    ]

    assert arming.told["Ts"] == 0.01
    assert [one.told for one in asked] == [RefusalCode.NOT_HELD, RefusalCode.NOT_HELD, None]
    assert [type(order) for order in between.loop.orders()] == [pipe.Set]


@pytest.mark.parametrize("pending", [15, 16])
def test_the_last_places_for_unanswered_orders_are_reserved_for_the_holder(
    between: Between, pending: int
) -> None:
    for n in range(pending):
        _tried(between, SetRequest(lease=LEASE, n=n, u=0.0))

    reset = _tried(between, AskedReset())
    disarm = _tried(between, DisarmRequest(lease=LEASE, n=pending))

    assert (reset.told, disarm.told) == (RefusalCode.TOO_MANY if pending > 15 else None, None)
    assert len(between.loop.orders()) == 17


def test_an_arming_that_finds_no_place_after_the_look_at_the_disk_is_refused(
    between: Between,
) -> None:
    _ready(between)
    arming = _Asked(ArmRequest(owner="Ada"), "")
    between.commands._try(arming)  # type: ignore[arg-type]
    for n in range(16):
        between.commands._try(_Asked(SetRequest(lease=LEASE, n=n, u=0.0), ""))  # type: ignore[arg-type]

    between.handle()

    assert arming.told == RefusalCode.TOO_MANY


def test_a_command_is_refused_three_seconds_after_its_arrival(between: Between) -> None:
    before_s = time.monotonic()
    asked = _tried(between, DisarmRequest(lease=LEASE, n=4))
    told = []
    for now_s in (before_s + 3.0, time.monotonic() + 3.001):
        between.commands.refuse_overdue(now_s)
        told.append(asked.told)

    assert told == [None, RefusalCode.NO_ANSWER]


@pytest.mark.parametrize(
    ("request_", "by", "line", "fields"),
    [
        (
            StopRequest(by="anna"),
            "user eve",
            "stop: by anna (user eve)",
            ["stopped by anna (user eve)"],
        ),
        (StopRequest(), "", "stop: by somebody on this machine", ["stopped"]),
        (DisarmRequest(lease=LEASE, n=4), "", "disarm: by somebody on this machine", [""]),
        (AskedReset(fault="", valid_until_ns=2**61), "user eve", "reset: by user eve", [""]),
        (SetRequest(lease=LEASE, n=4, u=1.0), "", "", []),
    ],
)
def test_the_log_names_the_client_of_each_command(
    between: Between, request_: Any, by: str, line: str, fields: list[str]
) -> None:
    """A voltage that is held by hand may change many times a second."""
    said: list[Any] = []
    between.commands._say = lambda *line, **of: said.append((line, of))
    asked = _tried(between, request_, by)
    (order,) = between.loop.orders()

    between.service._handle([Answer(order=order.order, body={"done": True})])

    assert asked.told == {"done": True}
    assert [line for line, _ in said] == ([("info", line)] if line else [])
    assert [of["cause"] for _, of in said] == fields
    assert [(of["command"], of["owner_checked"]) for _, of in said] == [
        (request_.name, by) for _ in fields
    ]


def test_a_stall_of_the_emulator_is_reported_and_its_end_is_not_waited_for(
    between: Between, capsys: pytest.CaptureFixture[str]
) -> None:
    between.begin_run()
    out, into = os.pipe()
    between.service._stalls_fd = out
    os.write(into, b"264000000\n7500000\n")
    os.close(into)

    for _ in range(2):
        between.service._hear_of_stalls(out)
    os.close(out)

    assert between.service._stalls_fd is None
    assert "warning: emulator held up 264 ms by this machine" in capsys.readouterr().err
    with _finished(between).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        events = [m for *_, m in reader.iter_decoded_messages("/rig/1/event")]
    assert [m.emulator_stall_ns for m in events if "held up" in m.message] == [
        264_000_000,
        7_500_000,
    ]


def test_the_reports_of_the_loop_are_forwarded_to_systemd(between: Between) -> None:
    """A loop that hangs reports no timing: then systemd ends the service."""
    told: list[str] = []
    between.service._notifier = SimpleNamespace(
        ready=lambda: told.append("ready"),
        progress=lambda: told.append("progress"),
        status=told.append,
        stopping=lambda: told.append("stopping"),
    )

    between.service._handle([_sample(1), Host(granted={"refused": []})])
    between.service._handle([FREE, odd_records()[0]])
    between.pass_a_second()
    between.service._quit("a test")

    assert told == ["ready", "safe, nobody has it", "progress", "safe, nobody has it", "stopping"]


def test_the_state_is_published_each_second_with_the_time(between: Between) -> None:
    def states() -> list[Any]:
        past = decode_past(between.service._session._past(0, 0))
        return [
            protobuf.decode_message(protobuf.STATE, data)
            for of, data in past.messages
            if of == "state"
        ]

    between.pass_a_second()
    assert states() == []
    between.service._handle([FREE])
    before_ns = time.monotonic_ns()
    between.pass_a_second()

    told, again = states()
    assert told.t_host_ns == FREE.t_host_ns
    assert before_ns <= again.t_host_ns <= time.monotonic_ns()
    assert (told.phase, again.phase) == ("safe", "safe")


def test_an_unresponsive_loop_is_killed_once(
    between: Between, capsys: pytest.CaptureFixture[str]
) -> None:
    between.service._kill_at = time.monotonic() - 1
    between.answers([[], [], [], None])

    between.service._serve()

    assert capsys.readouterr().err.count("error: the loop does not end: killed") == 1


def _network(endpoint: str, **changes: Any) -> Network:
    fields: dict[str, Any] = {
        "access_control": {},
        "low_pass_filter": [],
        "tls": {},
        "operators": 2,
        "observers": 5,
        "expires": datetime(2100, 1, 1, tzinfo=UTC),
    }
    return Network(endpoint=endpoint, **{**fields, **changes})


@pytest.mark.parametrize("is_well", [True, False])
def test_the_service_logs_its_endpoints_clients_and_faults_at_its_start(
    narrow: Between, tmp_path: Path, is_well: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[tuple[str, str]] = []
    narrow.service._say = lambda *line: said.append(line)
    monkeypatch.setattr(
        "armrig_daemon.service.service.unreachable",
        lambda where, _: "" if is_well else f"nobody reaches {where}",
    )
    narrow.service._notifier = SimpleNamespace(is_asked=not is_well)
    if not is_well:
        full = build_refusal(RefusalCode.NO_ROOM, "the disk is full")
        narrow.service._runs.no_room = lambda: full
    ways = [_network("tls/0.0.0.0:7447"), _network("tls/lab:7447", is_router=True)]

    narrow.service._announce(ways, has_left_fifo=is_well)

    by = "Ctrl-C" if is_well else "`systemctl stop`"
    expected = [
        ("warning", "not granted: the ordinary policy for the service, whose threads may delay "),
        ("info", f"rig lab-2 at unixsock-stream/{tmp_path}/s"),
        ("info", "also at tls/0.0.0.0:7447: 2 may drive and 5 may watch, by certificate"),
        ("warning", "nobody reaches tls/0.0.0.0:7447"),
        ("info", "also through the router tls/lab:7447"),
        ("warning", "nobody reaches tls/lab:7447"),
        ("info", f"{line_and_limits(CONFIG)}; ask it with `armrig status --rig lab-2`, end it w"),
        ("warning", "nothing can be recorded: the disk is full"),
    ]
    expected = [line for line in expected if line[0] == "info" or not is_well]
    assert [level for level, _ in said] == [level for level, _ in expected]
    for (_, text), (_, begin) in zip(said, expected, strict=True):
        assert text.startswith(begin)
    assert [text for _, text in said if text.endswith(f"end it with {by}")]


def test_a_stop_precedes_all_queued_commands(between: Between) -> None:
    """The others keep their order: the holder's orders, then those of everybody."""
    for request in (
        AskedReset(),
        SetRequest(lease=LEASE, n=4, u=1.0),
        DisarmRequest(lease=LEASE, n=5),
        StopRequest(by="anna"),
    ):
        between.ask(request)

    between.commands.serve()

    kinds = [type(order) for order in between.loop.orders()]
    assert kinds == [pipe.Stop, pipe.Set, pipe.Disarm, Reset]


def test_the_network_guard_depends_on_whether_the_rig_is_held(between: Between) -> None:
    busy: list[bool] = []
    between.service._guard = SimpleNamespace(look=lambda _, is_busy: busy.append(is_busy))

    for owner in ("", "Ada"):
        between.service._handle([msgspec.structs.replace(FREE, owner=owner)])
        between.pass_a_second()

    assert busy == [False, True]


def test_a_report_of_another_thread_is_logged_with_its_level(between: Between) -> None:
    run_id = between.begin_run()
    lines = [("info", "a.mcap: recovered"), ("warning", "b.mcap: another user's file")]
    between.service._left_over.lines = lambda: lines
    between.service._runs.end(Ending(OutcomeCode.STOPPED, "stopped by anna"))
    said: list[Any] = []
    between.service._say = lambda *line, **of: said.append((line, of))

    between.service._say_finished(30)
    between.service._handle_wake()

    (finished, fields), *others = said
    assert finished[0] == "info"
    assert "stopped by anna, 0 samples, 0 missing" in finished[1]
    assert fields == {"run": run_id, "cause": "stopped by anna"}
    assert others == [(line, {}) for line in lines]


def test_a_sleep_of_the_computer_is_reported_and_is_the_cause_of_a_late_stop(
    between: Between, capsys: pytest.CaptureFixture[str]
) -> None:
    between.begin_run()
    between.service._sleep.look = iter(["this computer slept for 30 s", "", ""]).__next__
    between.pass_a_second()
    causes = [between.service._note_sleep()]
    between.service._begin_run(RunStarted(run_id="next", k_first=0, count=3, t_host_ns=0))
    causes.append(between.service._note_sleep())

    assert causes == ["this computer slept for 30 s", ""]
    assert "warning: this computer slept for 30 s" in capsys.readouterr().err


def test_a_command_that_arrives_during_a_wakeup_wakes_the_service_again(between: Between) -> None:
    signals, reader = between.service._signals, between.service._signals._reader

    def interrupted(n: int) -> bytes:
        signals.wake()
        return reader.recv(n)

    signals.wake()
    signals._reader = SimpleNamespace(recv=interrupted)
    between.service._handle_wake()
    signals._reader = reader
    signals.wake()

    assert select.select([signals.fd], [], [], 0)[0]
