"""The benchmark `make timing`: parsers and statistics on fixed inputs, and one short run."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from armrig_core.commands.codes import GapCode
from armrig_core.errors import OperationError
from armrig_core.rig.volts import code_of, device_code, volts_of

from tests.benchmarks.host_timing import targets, turns
from tests.benchmarks.host_timing.__main__ import run
from tests.benchmarks.host_timing.targets import Rate
from tests.clients.running import running
from tests.integration.processes import children, state_of, wait_for
from tests.sampling import sampled

HISTOGRAM = """\
# /dev/cpu_dma_latency set to 0us
# Histogram
000000 000000
000012 000003
000013 000006
000055 000001
# Total: 000000010
# Max Latencies: 00055
# Histogram Overflows: 00000
# Thread 0:
"""
SAMPLES = np.dtype(
    {
        "names": ["k", "t_sched_ns", "t_host_ns", "u_cmd_v", "u_applied_v"],
        "formats": ["<u8", "<i8", "<i8", "<f8", "<f8"],
    }
)


def samples(k: list[int], late_ns: int = 0, u: list[float] | None = None) -> Any:
    """Return samples at 1 kHz, all late by as much, of a device with a duty of 10 bits."""
    made = np.zeros(len(k), SAMPLES)
    made["k"] = k
    made["t_sched_ns"] = np.array(k) * 1_000_000
    made["t_host_ns"] = made["t_sched_ns"] + late_ns
    codes = [code_of(v) for v in u or [0.0] * len(k)]
    made["u_cmd_v"] = [volts_of(c) for c in codes]
    made["u_applied_v"] = [volts_of(device_code(c, 10)) for c in codes]
    return made


def test_cyclictest_histogram_becomes_single_times() -> None:
    late = turns.cyclictest_lateness_us(HISTOGRAM)

    assert late.tolist() == [12.0] * 3 + [13.0] * 6 + [55.0]


def test_overflows_of_the_histogram_count_in_favour_of_cyclictest() -> None:
    printed = HISTOGRAM.replace("Overflows: 00000", "Overflows: 00003")

    late = turns.cyclictest_lateness_us(printed.replace("Latencies: 00055", "Latencies: 31000"))

    assert late[-4:].tolist() == [55.0, 20_000.0, 20_000.0, 31_000.0]


@pytest.mark.parametrize("printed", ["", "Unable to change scheduling policy!\n"])
def test_output_without_a_histogram_is_refused(printed: str) -> None:
    with pytest.raises(OperationError, match="no histogram"):
        turns.cyclictest_lateness_us(printed)


def test_percentiles_are_computed_over_all_rounds() -> None:
    made = Rate(rate_hz=1000)
    made.add(targets.DAEMON, np.arange(500.0))
    made.add(targets.DAEMON, np.arange(500.0, 1001.0))

    assert made.tails()[targets.DAEMON] == pytest.approx([1001, 500.0, 990.0, 999.0, 1000.0])


def test_lateness_includes_the_ticks_that_the_host_skipped() -> None:
    gaps = [(2, 3, GapCode.HOST_LATE), (6, 1, GapCode.FRAME_LOST)]

    late = targets.wake_lateness_us(samples([0, 1, 5, 7], late_ns=20_000), gaps, 0.001)

    assert late.tolist() == [20.0, 20.0, 3020.0, 20.0]


def test_an_input_at_the_index_of_its_neighbour_is_misplaced() -> None:
    u = [0.5, 1.0, 1.5, 2.0]

    assert targets.misplaced(u, samples([10, 11, 13], u=[0.5, 1.0, 2.0]), 10, 10) == 0
    assert targets.misplaced(u, samples([10, 11, 12], u=[0.5, 1.5, 1.0]), 10, 10) == 2
    assert targets.misplaced(u, samples([9, 14], u=[0.5, 2.0]), 10, 10) == 2
    off = samples([10], u=[0.5])
    off["u_applied_v"] += 5 / 1024
    assert targets.misplaced(u, off, 10, 10) == 1


def test_cpu_time_per_tick_is_measured_between_readings_during_the_run() -> None:
    ticks_ns = np.arange(0, 1_000, 10)
    readings = [(-50, 0), (5, 1_000_000), (505, 6_000_000), (985, 6_960_000), (2000, 99_000_000)]

    assert targets.cpu_per_tick_us(readings, ticks_ns).tolist() == [100.0, 20.0]
    assert targets.cpu_per_tick_us([], ticks_ns).size == 0
    assert targets.cpu_per_tick_us(readings, ticks_ns[:0]).size == 0


def test_time_to_a_subscriber_is_in_microseconds_and_of_this_run() -> None:
    made = Rate(rate_hz=1000)
    received = np.array([[4, 0, 9_000_000], [5, 1_000, 121_000], [6, 2_000, 142_000]])

    turns.add_received(made, np.array([5, 6, 7]), [received])

    assert made.times_us[targets.SUBSCRIBER][0].tolist() == [120.0, 140.0]
    assert made.counts["subscribers missed"] == 1


@pytest.mark.parametrize(
    ("rate_hz", "times_us", "expected"),
    [
        (1000, {targets.REFERENCE: 20.0, targets.DAEMON: 1.0}, ["0.05 met", "0.05 met"]),
        (1000, {targets.REFERENCE: 20.0, targets.DAEMON: 9.0}, ["0.45 NOT MET", "0.45 met"]),
        (1000, {targets.REFERENCE: 20.0, targets.DAEMON: 21.0}, ["1.05 NOT MET", "1.05 NOT MET"]),
        (500, {targets.REFERENCE: 20.0, targets.DAEMON: 1.0}, ["0.05 -", "0.05 -"]),
        (500, {targets.BARE_CPU: 100.0, targets.DAEMON_CPU: 155.0}, ["55 met"]),
        (500, {targets.BARE_CPU: 100.0, targets.DAEMON_CPU: 165.0}, ["65 NOT MET"]),
        (500, {targets.PUT: 100.0, targets.SUBSCRIBER: 129.0}, ["1.29 met"]),
        (500, {targets.PUT: 100.0, targets.SUBSCRIBER: 131.0}, ["1.31 NOT MET"]),
    ],
)
def test_times_are_compared_with_their_targets(
    rate_hz: int, times_us: dict[str, float], expected: list[str]
) -> None:
    """The target of p99 is a tenth of cyclictest's, the target of p99.9 is cyclictest's."""
    made = Rate(rate_hz=rate_hz)
    for name, value in times_us.items():
        made.add(name, [value] * 10)

    assert [f"{t.value:.3g} {t.verdict}" for t in targets.against_targets(made, 20)] == expected


@pytest.mark.parametrize(
    ("rate_hz", "seconds", "lost", "verdict"),
    [
        (2000, 60.0, 0, "met"),
        (2000, 60.0, 1, "NOT MET"),
        (2000, 20.0, 1, "NOT MET"),
        (2000, 20.0, 0, "-"),
        (1000, 60.0, 0, "-"),
    ],
)
def test_no_loss_is_claimed_only_after_the_full_time(
    rate_hz: int, seconds: float, lost: int, verdict: str
) -> None:
    made = Rate(rate_hz=rate_hz)
    made.counts.update({"scheduled requested": 1000, "scheduled lost": lost})

    assert [t.verdict for t in targets.against_targets(made, seconds)] == [verdict]


def test_the_rounds_share_the_time_of_a_program() -> None:
    assert turns.ticks_of_a_turn(1000, 20) * turns.ROUNDS == 20_000
    assert turns.ticks_of_a_turn(1, 1) == 10


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--rates", "fast"], "whole numbers of Hz"),
        (["--rates", "300"], "period of whole µs"),
        (["--rates", "4000"], "1 to 2000"),
        (["--seconds", "0"], "0.1 to 600"),
    ],
)
def test_impossible_settings_are_refused_before_the_measurement(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments) == 1

    printed = capsys.readouterr()
    assert printed.out == ""
    assert words in printed.err
    assert printed.err.count("\n") == 1


def test_a_program_that_fails_or_does_not_end_is_named() -> None:
    with (
        turns.program("sh", "-c", "exit 3") as process,
        pytest.raises(OperationError, match=r"sh exit 3 ended with exit code 3"),
    ):
        turns.output(process, 10)
    with (
        turns.program("sleep", "60") as process,
        pytest.raises(OperationError, match="sleep 60 did not end"),
    ):
        turns.output(process, 0.1)
    assert process.returncode is not None


@pytest.mark.exhaustive
def test_a_short_run_measures_all_programs(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(turns, "ROUNDS", 1)
    monkeypatch.setattr(turns, "SUBSCRIBERS", 1)  # each is a process, three times

    assert run(["--seconds", "0.5", "--rates", "100"]) == 0

    out = capsys.readouterr().out
    for name in targets.DEFINITIONS:
        found = re.search(rf"^  {name} +\d+ +[\d.]+", out, re.MULTILINE)
        assert found or (name == targets.REFERENCE and "cyclictest is not installed" in out)
    for pacing in ("exchange", "scheduled"):
        assert re.search(rf"^  {pacing} requested +50$", out, re.MULTILINE)
        assert re.search(rf"^  {pacing} misplaced +0$", out, re.MULTILINE)
    for what in ("own work per tick", "sample to subscriber p50", "scheduled: lost or misplaced"):
        assert re.search(rf"^  {what} +100 ", out, re.MULTILINE)


@pytest.mark.parametrize("number", sampled([signal.SIGINT, signal.SIGKILL]))
def test_no_program_keeps_running_after_an_early_end(number: signal.Signals) -> None:
    command = [sys.executable, "-m", "tests.benchmarks.host_timing", "--rates", "1000"]
    with running(command, cwd=turns.ROOT, stderr=subprocess.DEVNULL) as bench:
        wait_for(lambda: children(bench.pid))
        started = children(bench.pid)
        bench.send_signal(number)
        bench.wait(timeout=30)

    assert bench.returncode == (130 if number == signal.SIGINT else -number)
    wait_for(lambda: all(map(_is_gone, started)))


def _is_gone(pid: int) -> bool:
    with suppress(OSError):
        return state_of(pid) == "Z"
    return True
