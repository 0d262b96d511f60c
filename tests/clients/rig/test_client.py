"""A rig through its daemon: requests, answers and messages."""

from __future__ import annotations

import getpass
import inspect
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig.rig import telemetry_stream
from armrig.rig.client import Rig
from armrig.rig.replies import RefusedError, RunEndedError
from armrig.rig.session import NoReplyError, RigError, open_session
from armrig.rig.telemetry_stream import stream
from armrig_core.commands import commands
from armrig_core.commands.commands import Rehearsal
from armrig_core.errors import InputError
from armrig_core.rig.description import Input
from armrig_core.telemetry import telemetry

from tests.clients.fake_daemon import FakeDaemon
from tests.clients.made_recordings import sample

ALIVE = """
import sys, time
sys.path.insert(0, sys.argv[1])
from armrig_core.telemetry import telemetry
from tests.clients.fake_daemon import FakeDaemon
from tests.clients.made_recordings import sample
with FakeDaemon(sys.argv[2]) as daemon:
    print("up", flush=True)
    for k in range(10_000):
        daemon.session.put("rig/1/sample", telemetry.encode_sample(sample(k)))
        time.sleep(0.01)
"""


@pytest.fixture
def rig(daemon: FakeDaemon, where: str) -> Iterator[Rig]:
    with Rig("1", connect=where) as rig:
        yield rig


@pytest.mark.parametrize("rig", ["", "Arm", "../1", "a b", "*"])
def test_a_rig_id_that_is_not_a_valid_key_is_refused(rig: str) -> None:
    with pytest.raises(ValueError, match="each a-z, 0-9 or -"):
        Rig(rig)


def test_no_input_has_the_name_of_an_option_of_a_run() -> None:
    options = [
        name for name in inspect.signature(Rig.run).parameters if name not in ("self", "values")
    ]

    for name in options[1:]:
        with pytest.raises(InputError, match=f"input name = '{name}'"):
            Input(name=name)
    assert Input(name=options[0])  # u, the voltage at the pin


def test_a_sampling_time_above_1_s_is_made_by_the_client(daemon: FakeDaemon, rig: Rig) -> None:
    granted = rig.arm("me", Ts=2.5)
    rig.run([0.5, 4.5], details={"seed": 3})

    (arm,) = [asked for asked in daemon.asked if isinstance(asked, commands.ArmRequest)]
    (run,) = [asked for asked in daemon.asked if isinstance(asked, commands.RunRequest)]
    assert (granted.Ts, arm.Ts) == (2.5, 0.625)
    assert (run.u, run.details) == ([0.5] * 4 + [4.5] * 4, {"seed": 3, "every": 4})
    with pytest.raises(InputError, match="'every' is the name of the samples per voltage"):
        rig.run([0.5], details={"every": 4})


def test_the_client_sends_a_whole_run_and_waits_for_its_end(daemon: FakeDaemon, rig: Rig) -> None:
    seen: list[tuple[int, int]] = []
    rig.arm("me", Ts=0.02)
    path = rig.run(
        [0.5, 4.5, 0.5],
        experiment="blackbox",
        details={"seed": 3},
        progress=lambda done, total: seen.append((done, total)),
    )

    assert path == Path(daemon.recording)
    arm, run = [r for r in daemon.asked if not isinstance(r, commands.Status)][:2]
    assert arm == commands.ArmRequest(owner="me", Ts=0.02)
    assert run == commands.RunRequest(
        lease="0" * 32, n=1, u=[0.5, 4.5, 0.5], experiment="blackbox", details={"seed": 3}
    )
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert daemon.names() == ["arm", "run"]


def test_a_sleep_during_a_run_is_reported_once(
    daemon: FakeDaemon, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept, told = iter(["this computer slept for 30 s"]), list[str]()
    monkeypatch.setattr("armrig.rig.client.Standstill.look", lambda _: next(slept, ""))

    rig.arm("ada")
    rig.run([1.0, 2.0], dead_man=2.0, tell=told.append)

    assert told == ["this computer slept for 30 s"]


def test_a_client_with_a_dead_man_sends_signs_of_life_during_its_run(
    daemon: FakeDaemon, rig: Rig
) -> None:
    daemon.polls_per_run = 4
    rig.arm("me")
    rig.run([1.0, 2.0], dead_man=2.0)
    rig.arm("me")
    daemon.refusals["renew"] = "no run of this lease is planned or running"
    rig.run([1.0, 2.0], dead_man=2.0)

    first = [r for r in daemon.asked if isinstance(r, commands.LeasedRequest)][:4]
    assert [r.name for r in first] == ["run", "renew", "renew", "renew"]
    assert [r.n for r in first] == [1, 2, 3, 4]
    assert isinstance(first[0], commands.RunRequest)
    assert first[0].dead_man == 2.0
    assert {r.lease for r in first} == {"0" * 32}


def test_the_rehearsal_is_returned_before_the_end_of_the_run(daemon: FakeDaemon, rig: Rig) -> None:
    daemon.rehearsal = Rehearsal(revolutions=3.5, alpha_rad=0.2, turned_rad=21.0)
    seen: list[Any] = []
    rig.arm("me")
    rig.run([1.0], accepted=seen.append, progress=lambda done, total: seen.append(done))

    assert seen[0].rehearsal == daemon.rehearsal
    assert seen[1:] != []


def test_the_sender_of_a_note_or_a_stop_is_named(daemon: FakeDaemon, rig: Rig) -> None:
    assert rig.note("0")
    rig.stop()
    rig.arm("a student")
    rig.note("1")
    rig.stop()
    rig.note("2", "the teacher")
    rig.stop("the teacher")

    names = [getpass.getuser(), "a student", "the teacher"]
    assert [r.by for r in daemon.asked if isinstance(r, commands.StopRequest)] == names
    notes = [(r.text, r.owner) for r in daemon.asked if isinstance(r, commands.NoteRequest)]
    assert notes == [*zip("012", names, strict=True)]


def test_a_stop_without_a_name_is_sent_to_an_older_daemon(daemon: FakeDaemon, rig: Rig) -> None:
    carry_out = daemon._carry_out

    def earlier(request: commands.DaemonRequest) -> Any:
        if isinstance(request, commands.StopRequest) and request.by:
            raise ValueError("stop: Object contains unknown field `by`")
        return carry_out(request)

    daemon._carry_out = earlier
    rig.stop()

    assert [r.by for r in daemon.asked if isinstance(r, commands.StopRequest)] == [""]


def test_a_name_that_is_no_unicode_does_not_prevent_a_stop(
    daemon: FakeDaemon, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LOGNAME", b"jos\xe9".decode(errors="surrogateescape"))
    rig.stop()
    rig.stop("\ud800")

    assert [r.by for r in daemon.asked if isinstance(r, commands.StopRequest)] == ["jos?", ""]
    with pytest.raises(InputError, match=r"arm: the text '.*' is no Unicode"):
        rig.arm("\ud800")


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_a_number_that_is_not_finite_is_refused_and_not_the_default(
    daemon: FakeDaemon, rig: Rig, number: float
) -> None:
    """JSON has no NaN: it would mean a run without a dead-man, or the default Ts."""
    with pytest.raises(InputError, match=r"Ts.*must be"):
        rig.arm("me", Ts=number)
    rig.arm("me")
    with pytest.raises(InputError, match=r"dead_man=.* must be a finite number"):
        rig.run([1.0], dead_man=number)
    assert not [r for r in daemon.asked if isinstance(r, commands.RunRequest)]


@pytest.mark.parametrize("answer", [{}, {"stopped": True}, {"done": False}, [], "done"])
def test_an_unconfirmed_stop_raises_an_error(daemon: FakeDaemon, rig: Rig, answer: Any) -> None:
    daemon._carry_out = lambda _: answer

    with pytest.raises(RigError, match="the answer to 'stop'"):
        rig.stop()


def test_a_command_without_arming_is_not_sent(daemon: FakeDaemon, rig: Rig) -> None:
    with pytest.raises(RefusedError, match=r"call arm\(owner\)"):
        rig.run([1.0])

    assert daemon.asked == []


def test_a_voltage_outside_the_granted_limits_is_not_sent(daemon: FakeDaemon, rig: Rig) -> None:
    daemon.limits_v = (0.5, 4.5)
    rig.arm("me")
    with pytest.raises(ValueError, match=r"u\[2\] = 4.8 V is outside 0.5 … 4.5 V"):
        rig.run([1.0, 4.5, 4.8, 0.0])
    with pytest.raises(ValueError, match=r"u\[1\] = 0.4 V is outside 0.5 … 4.5 V"):
        rig.run([1.0, 0.4, 4.8, 0.3])
    for volts in (0.0, float("nan")):
        with pytest.raises(ValueError, match=rf"u\[0\] = {volts:g} V is outside 0.5 … 4.5 V"):
            rig.set(volts)

    assert not {"run", "set"} & {request.name for request in daemon.asked}


@pytest.mark.parametrize("u", [[[1.0, 2.0], [3.0, 4.0]], 1.0, []])
def test_an_input_that_is_not_a_vector_of_voltages_is_refused(
    u: Any, daemon: FakeDaemon, rig: Rig
) -> None:
    rig.arm("me")
    with pytest.raises(ValueError, match=r"u has shape \(.*\), it must be \(N,\)"):
        rig.run(np.array(u))

    assert "run" not in daemon.names()


def test_a_run_without_a_reply_is_stopped(daemon: FakeDaemon, rig: Rig) -> None:
    rig.arm("me")
    prepared = rig._wait_for_beginning

    def interrupted(request: commands.RunRequest, samples: int) -> None:
        prepared(request, samples)
        raise KeyboardInterrupt

    rig._wait_for_beginning = interrupted
    with pytest.raises(KeyboardInterrupt):
        rig.run([1.0])

    assert daemon.names() == ["arm", "run", "stop"]


def test_a_run_that_ends_early_reports_reason_and_recording(daemon: FakeDaemon, where: str) -> None:
    daemon.outcome = "no answer from the device for 60 ms"
    with Rig("1", connect=where) as rig:
        rig.arm("me")
        with pytest.raises(RunEndedError, match="60 ms; recorded in /nowhere") as caught:
            rig.run([1.0, 2.0])

    assert caught.value.recording == Path(daemon.recording)
    assert "stop" not in daemon.names()


def test_ctrl_c_during_a_run_stops_the_rig(daemon: FakeDaemon, rig: Rig) -> None:
    def interrupted(done: int, total: int) -> None:
        raise KeyboardInterrupt

    rig.arm("me")
    with pytest.raises(KeyboardInterrupt):
        rig.run([1.0] * 100, progress=interrupted)

    assert daemon.names() == ["arm", "run", "stop"]


def test_an_invalid_endpoint_is_reported() -> None:
    with (
        pytest.raises(RigError, match="not a zenoh endpoint, such as"),
        Rig("1", connect="nonsense"),
    ):
        pass


def test_a_rig_outside_a_with_block_is_refused(where: str) -> None:
    """Otherwise the session would never be closed."""
    with pytest.raises(RigError, match="with block"):
        Rig("1", connect=where).status()


def test_a_stream_ends_with_the_process_of_its_daemon(
    where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    is_alive = telemetry_stream._is_alive
    program = [sys.executable, "-c", ALIVE, str(Path(__file__).parents[3]), where]
    with subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as daemon:
        assert daemon.stdout is not None
        assert daemon.stdout.readline() == b"up\n"
        samples = stream("rig/1/sample", connect=where)
        assert next(samples).k >= 0
        with open_session(where, rig="1") as session, monkeypatch.context() as patched:
            was_alive = is_alive(session, "1")
            patched.setattr(telemetry_stream, "_LOOK_TIMEOUT_S", 0.1)
            daemon.send_signal(signal.SIGSTOP)
            os.waitid(os.P_PID, daemon.pid, os.WSTOPPED)  # until its last thread stands still
            stood_alive = is_alive(session, "1")
            daemon.send_signal(signal.SIGCONT)
        daemon.kill()
        daemon.wait()
        assert (was_alive, stood_alive) == (True, False)

        with pytest.raises(NoReplyError, match="stopped"):
            for _ in samples:
                pass


def test_a_stream_continues_after_the_silence_of_a_living_daemon(
    daemon: FakeDaemon, where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(telemetry_stream, "SILENCE_S", 0.0)
    looked = threading.Event()
    is_alive = telemetry_stream._is_alive

    def counted(*arguments: Any) -> bool:
        found = is_alive(*arguments)
        looked.set()  # answered, so the daemon has heard of the subscriber, too
        return found

    monkeypatch.setattr(telemetry_stream, "_is_alive", counted)

    def publish() -> None:
        looked.wait()
        daemon.session.put("rig/1/sample", telemetry.encode_sample(sample(7)))

    thread = threading.Thread(target=publish)
    thread.start()
    assert next(stream("rig/1/sample", connect=where)).k == 7
    thread.join()


def test_a_stream_of_a_missing_rig_ends(daemon: FakeDaemon, where: str) -> None:
    with pytest.raises(NoReplyError, match="rig 2: its daemon stopped"):
        next(stream("rig/2/sample", connect=where))


@pytest.mark.parametrize("key", ["rig/1", "rig/1/nothing", "rig/../sample", "sample"])
def test_a_key_without_a_stream_is_refused(key: str) -> None:
    with pytest.raises(ValueError, match=r"key|a-z"):
        next(stream(key))


CENTRED = Input(name="armature", per_volt=4.8, offset=-12.0, rest_v=2.5)


@pytest.mark.parametrize(
    ("u", "own", "expected"),
    [
        (None, {"armature": [0.0, 12.0, -12.0]}, [2.5, 5.0, 0.0]),
        ([2.5], {}, "voltage at the pin, and rig 1 rests at 2.5 V: give the value in V"),
        (None, {"power": [1.0]}, "power: the input of rig 1 is armature: give armature=0"),
        (
            [1.0],
            {"armature": [1.0]},
            "u and armature: the input of rig 1 is armature: give armature=0",
        ),
        (None, {"armature": [12.1]}, "V is outside 0 … 5 V"),
    ],
)
def test_a_rig_with_another_rest_takes_its_input_by_name(
    u: list[float] | None, own: dict[str, list[float]], expected: list[float] | str
) -> None:
    rig = Rig("1")
    rig._rest_v, rig._input = CENTRED.rest_v, CENTRED

    if isinstance(expected, str):
        with pytest.raises(InputError, match=re.escape(expected)):
            rig._volts(u, own)
    else:
        assert rig._volts(u, own).tolist() == expected
