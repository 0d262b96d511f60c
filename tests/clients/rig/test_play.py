"""A recording played again: the same messages in the same order, and never taken for a rig."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
import zenoh
from armrig.cli import main
from armrig.rig import playback
from armrig.rig.client import Rig
from armrig.rig.playback import open_stage, play, read_run
from armrig.rig.session import NoReplyError, RigError, open_session
from armrig.rig.telemetry_stream import LiveGap, stream
from armrig_core.rig.channels import sample_names
from armrig_core.rig.description import builtin
from armrig_core.telemetry import telemetry
from armrig_core.telemetry.topics import check_own_id
from armrig_daemon.config import RigIdentity as RigTable

from tests.clients.fake_clock import FakeClock
from tests.clients.made_recordings import event, gap, manifest, recorded, sample, timing, written
from tests.sampling import sampled

N = 60


def run_of(directory: Path, **changes: Any) -> Path:
    """Write a recording of samples, a gap, an event and a report of timing."""
    messages: list[Any] = [event(0, "begun")]
    for k in range(N):
        if k == 20:
            messages.append(gap(20, 5, 1.0))
        if not 20 <= k < 25:
            messages.append(sample(k))
        if k == 40:
            messages.append(timing(40))
    about = manifest(k_first=0, samples=N, **changes)
    return written(directory, recorded(messages, manifest=about, flush_every=10))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return run_of(tmp_path)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    clock = FakeClock()
    monkeypatch.setattr(playback, "time", clock)
    return clock


@pytest.fixture
def nobody_listens(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail where a listener is waited for, and not for ever: none comes."""

    def wait(stage: playback.Stage) -> None:
        pytest.fail("play waits for a listener, and --wait was not given")

    monkeypatch.setattr(playback.Stage, "wait_for_listener", wait)


def test_samples_are_taken_in_pieces(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = list(read_run(run).messages())
    monkeypatch.setattr(playback, "_BLOCK_SAMPLES", 7)

    assert list(read_run(run).messages()) == whole


@pytest.mark.parametrize(
    ("start", "stop", "told"),
    [(0.2, 0.3, ["begins", "gap"]), (0.1, 0.2, []), (0.25, 0.3, ["gap"]), (0.2, 0.25, ["begins"])],
)
def test_a_part_includes_its_start_time_and_excludes_its_end_time(
    tmp_path: Path, start: float, stop: float, told: list[str]
) -> None:
    """Two consecutive parts therefore contain each message once."""
    messages = [sample(k) for k in range(N)]
    begins, lost = timing(20), gap(23, 2, 1.0)
    begins.t_host_ns = messages[20].t_sched_ns
    messages[23:25] = [lost]
    messages[20:20] = [begins]
    run = read_run(written(tmp_path, recorded(messages, manifest=manifest(samples=N))), start, stop)

    others = {"timing": "begins", "gap": "gap"}
    assert [others[m.stream] for m in run.messages() if m.stream in others] == told


@pytest.mark.parametrize("after_us", [-5, 0, 5])
def test_a_gap_is_published_at_its_end(tmp_path: Path, after_us: int) -> None:
    lost, last = gap(3, 2, 1.0), gap(8, 2, 1.0)
    behind = sample(5)
    lost.t_to_ns = behind.t_host_ns + 1000 * after_us
    samples = [sample(0), sample(1), sample(2), lost, behind, sample(6), sample(7)]
    messages = [event(0, "begun"), *samples, event(7, "ended"), last]
    run = read_run(written(tmp_path, recorded(messages)))

    found = list(run.messages())

    order = ["event", *["sample"] * 3, "gap", *["sample"] * 2, "event", "sample", "gap"]
    assert [m.stream for m in found] == order
    assert found[4].t == pytest.approx(0.05 + 3e-6 + min(after_us, 0) * 1e-6, abs=1e-9)
    assert found[-1].t == pytest.approx(0.1)


@pytest.mark.parametrize("speed", [0.5, 1.0, 20.0])
def test_each_message_is_published_when_it_is_due(
    run: Path, speed: float, clock: FakeClock
) -> None:
    sent: list[float] = []

    messages = list(play(read_run(run), lambda *_: sent.append(clock.now_s), speed=speed))

    due = [100.0 + (m.t - messages[0].t) / speed for m in messages]
    assert sent == pytest.approx(due, abs=1e-9)
    assert max(clock.slept) <= 1.0


def test_a_long_pause_is_divided_into_short_sleeps(tmp_path: Path, clock: FakeClock) -> None:
    late = [sample(0), sample(1, t_host_ns=2**62)]
    run = read_run(written(tmp_path, recorded(late)))
    clock.most_sleeps = 5

    with pytest.raises(KeyboardInterrupt):
        list(play(run, lambda *_: None, speed=1.0))

    assert clock.slept == [1.0] * 5


def test_a_listener_receives_the_recorded_messages(run: Path, where: str) -> None:
    heard: list[Any] = []

    with open_stage(where, "played-1") as stage:
        samples = stream("rig/played-1/sample", connect=where)

        def listen() -> None:
            for value in samples:
                heard.append(value)
                if getattr(value, "k", 0) == N - 1:
                    break

        thread = threading.Thread(target=listen)
        thread.start()
        stage.wait_for_listener()
        list(play(read_run(run), stage.publish, speed=1.0))
        thread.join(30)
        samples.close()

    assert [v for v in heard if not isinstance(v, LiveGap)] == [
        sample(k) for k in range(N) if not 20 <= k < 25
    ]
    [missing] = [v for v in heard if isinstance(v, LiveGap)]
    assert (missing.k_first, missing.count, missing.reason) == (20, 5, "link silent")


@pytest.mark.parametrize(("name", "field"), [("arm", "theta_1_rad"), ("heater", "T1_degC")])
def test_a_live_sample_has_the_names_of_its_rig(
    name: str, field: str, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    channels = builtin(name).channels
    one = sample(7)._replace(value_0=0.5)
    with open_stage(where, "played-1", channels) as stage:
        samples = stream("rig/played-1/sample", connect=where)
        ends = threading.Event()

        def publish() -> None:
            while not ends.wait(0.01):
                stage.publish("sample", telemetry.encode_sample(one))

        thread = threading.Thread(target=publish)
        thread.start()
        try:
            heard = next(samples)
            watch = f"watch --rig played-1 --connect {where} --count 1".split()
            codes = main(watch), main([*watch, "--json"])
        finally:
            ends.set()
            thread.join()
            samples.close()

    assert (heard, tuple(heard._asdict())) == (one, sample_names(channels))
    assert getattr(heard, field) == heard.value_0 == 0.5
    assert f"{field}=0.5" in repr(heard)
    assert hasattr(heard, "theta_1_rad") == (name == "arm")
    head, line, found = capsys.readouterr().out.splitlines()
    assert codes == (0, 0)
    assert head.split()[3:7:2] == [c.name for c in channels]
    assert line.split()[2] == ("28.65" if name == "arm" else "0.50")
    assert json.loads(found)[field] == 0.5


def test_a_slow_listener_does_not_delay_the_player(run: Path, where: str) -> None:
    with open_stage(where, "played-1") as stage, open_session(where, rig="played-1") as listener:
        heard = listener.declare_subscriber("rig/played-1/*", zenoh.handlers.FifoChannel(200))
        stage.wait_for_listener()
        list(play(read_run(run), stage.publish, speed=1000.0))
        received = [heard.recv() for _ in range(len(read_run(run)))]

    assert {str(r.key_expr).rsplit("/", 1)[1] for r in received} == {
        "sample",
        "gap",
        "event",
        "timing",
    }
    assert all(r.congestion_control == zenoh.CongestionControl.DROP for r in received)


def test_a_command_to_a_played_recording_is_refused(where: str) -> None:
    with open_stage(where, "played-1"):
        assert Path(where.removeprefix("unixsock-stream/")).stat().st_mode & 0o777 == 0o770
        with Rig("played-1", connect=where) as rig:
            with pytest.raises(NoReplyError, match="a played recording takes no"):
                rig.status()
            with pytest.raises(NoReplyError):
                rig.arm("somebody")
        with (
            open_session(where, rig="played-1") as stranger,
            open_session(where, rig="played-1") as other,
        ):
            heard = other.declare_subscriber("rig/**", zenoh.handlers.RingChannel(10))
            stranger.put("rig/played-1/sample", telemetry.encode_sample(sample(1)))
            replies = list(stranger.get("rig/*/cmd/status", timeout=0.5))
            tokens = [r.ok.key_expr for r in other.liveliness().get("rig/*/alive") if r.ok]
            schemas = list(other.get("rig/played-1/schema/armrig.v1.Sample"))
            assert heard.try_recv() is None
    assert replies == []
    assert [str(token) for token in tokens] == ["rig/played-1/alive"]
    assert len(schemas) == 1
    for refused in (check_own_id, lambda rig: RigTable(id=rig)):
        with pytest.raises(
            ValueError, match="an id that begins with played- belongs to a recording that"
        ):
            refused("played-1")


def test_an_endpoint_in_use_is_reported(where: str) -> None:
    with (
        open_stage(where, "played-1"),
        pytest.raises(RigError, match="played there already"),
        open_stage(where, "played-1"),
    ):
        pass
    with pytest.raises(RigError, match="--listen"), open_stage("nonsense", "played-1"):
        pass


def test_the_repetition_of_a_run_begins_after_its_last_sample(
    tmp_path: Path, clock: FakeClock
) -> None:
    one = read_run(written(tmp_path, recorded([sample(0)])))

    playback.rest(one, speed=0.5)

    assert sum(clock.slept) == pytest.approx(0.02)


@pytest.mark.parametrize("number", sampled([signal.SIGINT, signal.SIGTERM]))
def test_ctrl_c_ends_a_player(run: Path, where: str, number: signal.Signals) -> None:
    sockets = Path(where.removeprefix("unixsock-stream/")).parent
    with subprocess.Popen(
        [sys.executable, "-m", "armrig", "play", str(run), "--loop", "--wait", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "XDG_RUNTIME_DIR": str(sockets)},
    ) as process:
        assert process.stdout is not None
        try:
            where = json.loads(process.stdout.readline())["endpoint"]
            samples = stream("rig/played-1/sample", connect=where)
            ks = (value.k for value in samples if not isinstance(value, LiveGap))
            while next(ks) < N - 1:
                pass
            assert next(ks) < N - 1  # again from the start
            next(ks)  # the sample before it is counted
            samples.close()
            process.send_signal(number)
            out, err = process.communicate(timeout=30)
        finally:
            process.kill()

    assert process.returncode == (0 if number == signal.SIGINT else 128 + number)
    assert json.loads(out)["published"] >= 60  # 58, an event and a sample
    assert "Traceback" not in err
    with open_stage(where, "played-1"):
        pass


@pytest.mark.usefixtures("nobody_listens")
def test_a_damaged_file_is_played_up_to_its_damage(
    tmp_path: Path, where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = run_of(tmp_path).read_bytes()
    cut = written(tmp_path, whole[: len(whole) // 4], "cut.mcap")
    assert main(["play", str(cut), "--listen", where, "--speed", "1000"]) == 0
    told = capsys.readouterr()
    assert re.search(r"published [1-9]0 messages", told.out)
    assert "the undamaged part is played" in told.err
    assert main(["play", str(cut), "--speed", "inf"]) == 1
    assert "--speed inf: must be more than 0" in capsys.readouterr().err

    far = [event(0, "x"), gap(0, 1, 1.0), sample(5)]
    far[1].count, far[1].t_to_ns = 2**64 - 1, -(2**63)
    far[0].timestamp.seconds = 2**62 // 10**9
    data = recorded(far, manifest=manifest(samples=10, k_first=0))
    assert len(list(read_run(written(tmp_path, data, "far.mcap")).messages())) == 3
