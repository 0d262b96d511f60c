"""The benchmark: parsers and statistics on fixed inputs, and one short run of the real thing."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pytest
from armrig.cli import main
from armrig.lab.host import PRIORITY
from armrig.rig.session import RigError
from armrig_core.codes import GapCode
from armrig_core.errors import OperationError
from armrig_core.volts import applied_code, code_of, volts_of

from tests.benchmarks.host_timing import cyclictest, programs, rounds, targets
from tests.benchmarks.host_timing.__main__ import run
from tests.benchmarks.host_timing.machine import machine
from tests.benchmarks.host_timing.programs import program
from tests.benchmarks.host_timing.rounds import ROUNDS, Plan
from tests.benchmarks.host_timing.sleeper import Done, Task
from tests.benchmarks.host_timing.targets import Rate, Target, against_targets
from tests.clients.made_recordings import recorded, sample, written
from tests.clients.running import running
from tests.sampling import sampled

if TYPE_CHECKING:
    from armrig.recordings.recording import Recording

SAID = """\
# /dev/cpu_dma_latency set to 0us
# Histogram
000000 000000
000012 000003
000013 000006
000055 000001
# Total: 000000010
# Min Latencies: 00012
# Avg Latencies: 00017
# Max Latencies: 00055
# Histogram Overflows: 00000
# Histogram Overflow at cycle number:
# Thread 0:
"""

SAMPLES = np.dtype(
    [
        *(("k", "<u8"), ("t_sched_ns", "<i8"), ("t_host_ns", "<i8"), ("t_device_us", "<u8")),
        *(("u_cmd_v", "<f8"), ("u_applied_v", "<f8")),
    ]
)


def samples(k: list[int], late_ns: int = 0, u: list[float] | None = None) -> Any:
    """Return samples at 1 kHz, all late by as much, of a device with a duty of 10 bits."""
    made = np.zeros(len(k), SAMPLES)
    made["k"] = k
    made["t_sched_ns"] = np.array(k) * 1_000_000
    made["t_host_ns"] = made["t_sched_ns"] + late_ns
    codes = [code_of(v) for v in u or [0.0] * len(k)]
    made["u_cmd_v"] = [volts_of(c) for c in codes]
    made["u_applied_v"] = [volts_of(applied_code(c, 10)) for c in codes]
    return made


def rate(rate_hz: int = 1000, **times_us: list[float]) -> Rate:
    """Return a rate at which this was measured."""
    made = Rate(rate_hz=rate_hz)
    for name, values in times_us.items():
        made.add(getattr(targets, name), values)
    return made


def of(made: list[Target], what: str) -> Target:
    """Return the one target of something."""
    (target,) = (v for v in made if v.what.startswith(what))
    return target


def test_cyclictests_histogram_is_read_as_single_times() -> None:
    late = cyclictest.lateness_us(SAID)

    assert late.tolist() == [12.0] * 3 + [13.0] * 6 + [55.0]


def test_what_overflows_the_histogram_counts_in_cyclictests_favour() -> None:
    said = SAID.replace("Overflows: 00000", "Overflows: 00003").replace(
        "Max Latencies: 00055", "Max Latencies: 31000"
    )

    late = cyclictest.lateness_us(said)

    assert late[-4:].tolist() == [55.0, 20_000.0, 20_000.0, 31_000.0]


@pytest.mark.parametrize("said", ["", "Unable to change scheduling policy!\n"])
def test_what_is_no_histogram_is_refused(said: str) -> None:
    with pytest.raises(OperationError, match="no histogram"):
        cyclictest.lateness_us(said)


def test_cyclictest_runs_at_the_loops_priority() -> None:
    asked = {"period_us": 1000, "count": 50, "priority": 80}

    locked = cyclictest.command("cyclictest", **asked, lock=True)
    loose = cyclictest.command("cyclictest", **asked, lock=False)

    assert " ".join(locked) == "cyclictest -q -m -p 80 -i 1000 -l 50 -h 20000"
    assert " ".join(loose) == "cyclictest -q -p 80 -i 1000 -l 50 -h 20000"


def test_a_tail_is_that_of_all_rounds_together() -> None:
    """Pooled, not averaged over rounds."""
    made = Rate(rate_hz=1000)
    made.add(targets.DAEMON, np.arange(500.0))
    made.add(targets.DAEMON, np.arange(500.0, 1001.0))

    tail = made.tails()[targets.DAEMON]

    assert (tail.n, tail.p50, tail.p99, tail.max) == (1001, 500.0, 990.0, 1000.0)
    assert tail.p999 == pytest.approx(999.0)


def test_ticks_that_the_host_slept_over_are_not_hidden() -> None:
    made = samples([0, 1, 5, 7], late_ns=20_000)
    gaps = [(2, 3, GapCode.HOST_LATE), (6, 1, GapCode.FRAME_LOST)]

    late = targets.wake_lateness_us(made, gaps, 0.001)

    assert late.tolist() == [20.0, 20.0, 3020.0, 20.0]


def test_an_input_on_its_neighbours_index_is_seen() -> None:
    u = [0.5, 1.0, 1.5, 2.0]

    assert targets.misplaced(u, samples([10, 11, 13], u=[0.5, 1.0, 2.0]), 10, 10) == 0
    assert targets.misplaced(u, samples([10, 11, 12], u=[0.5, 1.5, 1.0]), 10, 10) == 2
    assert targets.misplaced(u, samples([9, 14], u=[0.5, 2.0]), 10, 10) == 2
    off = samples([10], u=[0.5])
    off["u_applied_v"] += 5 / 1024
    assert targets.misplaced(u, off, 10, 10) == 1


def test_cpu_time_per_tick_is_taken_between_readings_inside_the_run() -> None:
    ticks_ns = np.arange(0, 1_000, 10)  # 100 of them
    readings = [(-50, 0), (5, 1_000_000), (505, 6_000_000), (985, 6_960_000), (2000, 99_000_000)]

    per_tick = targets.cpu_per_tick_us(readings, ticks_ns)

    assert per_tick.tolist() == [100.0, 20.0]
    assert targets.cpu_per_tick_us([], ticks_ns).size == 0
    assert targets.cpu_per_tick_us(readings, ticks_ns[:0]).size == 0


@pytest.mark.parametrize(
    ("daemon_us", "p99_met", "p999_met"), [(1.0, True, True), (9.0, False, True)]
)
def test_wake_lateness_is_judged_against_cyclictest_at_1_khz(
    daemon_us: float, p99_met: bool, p999_met: bool
) -> None:
    """p99 is at most a tenth of cyclictest's, p99.9 at most equal."""
    made = rate(REFERENCE=[20.0] * 2000, DAEMON=[daemon_us] * 2000)

    p99, p999 = against_targets(made, 20)

    assert (p99.what, p99.value, p99.met) == ("wake lateness p99", daemon_us / 20, p99_met)
    assert (p999.what, p999.value, p999.met) == ("wake lateness p99.9", daemon_us / 20, p999_met)


def test_a_target_is_judged_at_its_own_rate_and_reference_only() -> None:
    elsewhere = rate(500, REFERENCE=[20.0] * 10, DAEMON=[1.0] * 10)
    stand_in = rate(1000, STAND_IN=[20.0] * 10, DAEMON=[1.0] * 10)

    for made, remark in ((elsewhere, "1000 Hz"), (stand_in, "stand-in")):
        assert [v.met for v in against_targets(made, 20)] == [None, None]
        assert all(remark in v.remark for v in against_targets(made, 20))


@pytest.mark.parametrize(("daemon_us", "met"), [(155.0, True), (165.0, False)])
def test_own_work_is_what_the_bare_loop_does_not_need(daemon_us: float, met: bool) -> None:
    made = rate(BARE_CPU=[90.0, 100.0, 900.0], DAEMON_CPU=[daemon_us] * 3)

    target = of(against_targets(made, 20), "own work")

    assert (target.value, target.met) == (daemon_us - 100, met)


@pytest.mark.parametrize(("way_us", "met"), [(129.0, True), (131.0, False)])
def test_the_way_to_a_subscriber_is_judged_against_a_bare_put(way_us: float, met: bool) -> None:
    made = rate(PUT=[100.0] * 5, SUBSCRIBER=[way_us] * 5)

    target = of(against_targets(made, 20), "sample to subscriber")

    assert (target.value, target.met) == (pytest.approx(way_us / 100), met)


def test_the_way_to_a_subscriber_is_counted_in_microseconds_of_this_run() -> None:
    made, run = rate(), SimpleNamespace(samples=samples([5, 6, 7]), Ts=0.001)
    heard = np.array([[4, 0, 9_000_000], [5, 1_000, 121_000], [6, 2_000, 142_000]])

    rounds._scheduled(made, cast("Recording", run), [heard])

    assert made.pooled(targets.SUBSCRIBER).tolist() == [120.0, 140.0]
    assert made.counts["subscribers missed"] == 1


def test_the_cost_of_the_load_and_a_pipe_is_printed_with_the_ratios() -> None:
    waking = rate(REFERENCE=[10.0] * 10, DAEMON=[30.0] * 10, BESIDE=[60.0] * 10)
    passing = rate(PUT=[100.0] * 5, SUBSCRIBER=[150.0] * 5, PIPED=[140.0] * 5)

    p99, p999 = against_targets(waking, 20)

    assert (p99.remark, p999.remark) == ("", "0.50 × cyclictest beside the daemon")
    assert p999.met is False
    assert "behind a pipe 1.40 ×" in of(against_targets(passing, 20), "sample to subscriber").remark


@pytest.mark.parametrize(
    ("rate_hz", "seconds", "lost", "met"),
    [
        (2000, 60.0, 0, True),
        (2000, 60.0, 1, False),
        (2000, 20.0, 1, False),
        (2000, 20.0, 0, None),
        (1000, 60.0, 0, None),
    ],
)
def test_nothing_lost_is_claimed_after_the_full_time_only(
    rate_hz: int, seconds: float, lost: int, met: bool | None
) -> None:
    made = rate(rate_hz)
    for name, n in (("asked", 1000), ("lost", lost), ("misplaced", 0)):
        made.count(f"scheduled {name}", n)

    assert of(against_targets(made, seconds), "scheduled").met is met


def test_the_time_of_a_contestant_is_shared_by_the_rounds() -> None:
    assert Plan(rates_hz=(1000,), seconds=20).ticks(1000) * ROUNDS == 20_000
    assert Plan(rates_hz=(1,), seconds=1).ticks(1) == 10


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--rates", "fast"], "whole numbers of Hz"),
        (["--rates", "300"], "period of whole µs"),
        (["--rates", "4000"], "1 to 2000"),
        (["--seconds", "0"], "0.1 to 600"),
        (["--plot", "bench.xyz"], "ends in one of"),
        (["--plot", "/nowhere/at/all.png"], "there is no directory"),
    ],
)
def test_what_cannot_be_measured_is_reported_before_anything_starts(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments) != 0

    said = capsys.readouterr()
    assert said.out == ""
    assert words in said.err
    assert said.err.count("\n") == 1


def test_a_program_that_fails_is_quoted() -> None:
    with (
        program("sh", "-c", "echo no way >&2; exit 3", module=False) as process,
        pytest.raises(RigError, match=r"^sh ended with exit code 3 no way$"),
    ):
        programs.output(process, 10)


def test_a_program_that_does_not_end_is_ended() -> None:
    with (
        program("sleep", "60", module=False) as process,
        pytest.raises(RigError, match="sleep did not end"),
    ):
        programs.output(process, 0.1)

    assert process.returncode is not None


@pytest.mark.parametrize(("fifo", "priority"), [(True, PRIORITY), (False, 0)])
def test_the_bare_loop_has_the_daemons_priority_where_that_is_allowed(
    fifo: bool, priority: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the priority, other programs would delay the bare loop and flatter the daemon."""
    tasks = list[Task]()

    def slept(task: Task, _: float) -> Done:
        tasks.append(task)
        return Done(fifo=fifo, late_ns=[1], trip_ns=[1], cpu_ns=[1])

    monkeypatch.setattr(rounds, "_slept", slept)
    monkeypatch.setattr(rounds, "program", lambda _: nullcontext())
    monkeypatch.setattr(rounds, "line", lambda _: "/dev/echo")

    rounds._bare(Rate(rate_hz=100), 1, replace(machine(), fifo=fifo))

    assert [task.priority for task in tasks] == [priority]


@pytest.mark.parametrize(("installed", "fifo"), [(None, True), ("/usr/bin/cyclictest", False)])
def test_without_cyclictest_its_replacement_is_named(
    installed: str | None, fifo: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cyclictest, "find", lambda: installed)
    made = Rate(rate_hz=1000)

    rounds._reference(made, 20, replace(machine(), fifo=fifo))

    assert list(made.tails()) == [targets.STAND_IN]
    assert made.tails()[targets.STAND_IN].n == 20


@pytest.mark.exhaustive
def test_a_short_run_measures_all_contestants(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.benchmarks.host_timing.rounds.ROUNDS", 1)
    # Of 4: a process each, 4 times.
    monkeypatch.setattr("tests.benchmarks.host_timing.programs.SUBSCRIBERS", 2)
    told, figure = tmp_path / "bench.json", tmp_path / "bench.png"
    arguments = ["--seconds", "1", "--rates", "100", "--json", str(told), "--plot", str(figure)]

    assert run(arguments) == 0

    out = capsys.readouterr().out
    facts = json.loads(told.read_text())
    (at_100,) = facts["rates"]
    reference = {targets.REFERENCE, targets.STAND_IN} & set(at_100["times_us"])
    of_cyclictest = {targets.REFERENCE, targets.BESIDE}
    absent = of_cyclictest if targets.STAND_IN in reference else {targets.STAND_IN}
    assert set(at_100["times_us"]) == set(targets.DEFINITIONS) - absent
    assert len(reference) == 1
    assert at_100["counts"]["scheduled asked"] == at_100["counts"]["exchange asked"] == 100
    assert at_100["counts"]["scheduled misplaced"] == at_100["counts"]["exchange misplaced"] == 0
    assert {v["what"] for v in facts["verdicts"]} == {
        *("wake lateness p99", "wake lateness p99.9", "own work per tick"),
        *("sample to subscriber p50", "scheduled: lost or misplaced"),
    }
    for name in at_100["times_us"]:
        assert re.search(rf"^  {name} +\d+", out, re.MULTILINE)
        assert f"{name}: {targets.DEFINITIONS[name]}" in out
    assert figure.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("number", sampled([signal.SIGINT, signal.SIGKILL]))
def test_no_process_is_left(number: signal.Signals) -> None:
    mark = f"BENCH_TEST={os.getpid()}-{number}"
    command = [sys.executable, "-m", "tests.benchmarks.host_timing"]
    command += ["--seconds", "60", "--rates", "1000"]
    command += ["--burn"]
    environment = {**os.environ, **programs.OURS, "BENCH_TEST": mark.partition("=")[2]}
    with running(
        command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as bench:
        _wait_until(lambda: len(_marked(mark)) >= 3)  # it, a burner, and the next one
        bench.send_signal(number)
        bench.communicate(timeout=30)

    if number == signal.SIGINT:
        assert bench.returncode == 130
        assert _marked(mark) == []
    _wait_until(lambda: not _marked(mark))


def test_ctrl_c_while_a_program_starts_leaves_none(monkeypatch: pytest.MonkeyPatch) -> None:
    started = []
    start = subprocess.Popen

    def interrupted(*arguments: Any, **options: Any) -> subprocess.Popen[bytes]:
        started.append(start(*arguments, **options))
        signal.raise_signal(signal.SIGINT)
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", interrupted)

    with pytest.raises(KeyboardInterrupt), program("sleep", "60", module=False):
        pass

    assert started[0].returncode is not None


@pytest.mark.exhaustive
def test_a_started_daemon_ends_with_its_starter() -> None:
    with programs.daemon() as running:
        loop = running.loop_pid()
        assert loop is not None
        assert Path(f"/proc/{loop}").exists()
        directory = running.log.parent

    _wait_until(lambda: not Path(f"/proc/{loop}").exists())
    assert not directory.exists()


def test_info_draws_the_timing_of_a_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(tmp_path, recorded([sample(k) for k in range(50)]))
    figure = tmp_path / "timing.png"

    assert main(["info", str(file), "--plot", str(figure)]) == 0

    assert figure.read_bytes().startswith(b"\x89PNG")
    assert "jitter" in capsys.readouterr().out


def _marked(mark: str) -> list[int]:
    """Return the processes that carry a mark in their environment, zombies left out."""
    found = []
    for environ in Path("/proc").glob("[0-9]*/environ"):
        try:
            if mark.encode() in environ.read_bytes().split(b"\0"):
                found.append(int(environ.parent.name))
        except OSError:
            continue
    return found


def _wait_until(what: Any, within_s: float = 30.0) -> None:
    until = time.monotonic() + within_s
    while not what():
        assert time.monotonic() < until, "it did not happen in time"
        time.sleep(0.05)
