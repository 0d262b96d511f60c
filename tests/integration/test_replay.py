"""`armrig replay`: a real run through the very function that decided it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import armrig
import pytest
from armrig.cli.replay import replay
from armrig.rig.replies import RunEndedError
from armrig_core.errors import FileError
from armrig_daemon.decisions import setpoints

from tests.integration.processes import Bench
from tests.sampling import sampled


@pytest.mark.parametrize("pacing", sampled(["scheduled", "exchange"]))
def test_a_real_run_is_decided_again_to_the_last_bit(
    served: Bench, pacing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    u = armrig.telegraph(400, 0.1, low=0.0, high=5.0, seed=1)
    with served.rig() as rig:
        rig.arm("a test", Ts=0.005)
        path = rig.run(u, pacing=pacing)

    found = replay(path)

    assert found.difference == ""
    assert found.samples == armrig.load(path).samples.size
    # A tick that a stall of this machine costs is asked for by no frame.
    assert found.frames > (10 if pacing == "scheduled" else found.samples)
    assert found.seconds > 1.9
    if pacing == "scheduled":
        monkeypatch.setattr(setpoints, "PING_INTERVAL_US", 10_000_000)
        assert "now decides nothing" in replay(path).difference


@pytest.mark.exhaustive
def test_a_file_that_was_cut_off_is_replayed_as_far_as_it_goes(
    served: Bench, tmp_path: Path
) -> None:
    growing = tmp_path / "growing.mcap.active"

    def copy(done: int, total: int) -> None:
        if done > 300 and not growing.exists():
            (active,) = served.recordings.glob("*.active")
            growing.write_bytes(active.read_bytes())

    with served.rig() as rig:
        u = armrig.telegraph(600, 0.1, low=0.0, high=5.0, seed=1)
        rig.arm("a test", Ts=0.005)
        path = rig.run(u, progress=copy)
    whole, half = path.read_bytes(), tmp_path / "half.mcap"
    half.write_bytes(whole[: len(whole) // 4])

    partly, all_of_it = replay(growing), replay(path)

    assert "the file is cut off" in partly.until
    assert partly.difference == all_of_it.difference == all_of_it.until == ""
    assert 100 < partly.samples < all_of_it.samples
    with pytest.raises(FileError, match="nothing to replay: the file is cut off"):
        replay(half)


@pytest.mark.exhaustive
def test_the_command_says_what_it_replayed(bench: Bench) -> None:
    emulator = bench.emulate()
    bench.serve()
    with bench.rig() as rig:
        rig.arm("a test", Ts=0.005)

        def unplug(done: int, total: int) -> None:
            if done > 50:
                emulator.end()  # takes the link to its port away, as unplugging does

        with pytest.raises(RunEndedError) as stopped:
            rig.run(armrig.telegraph(2000, 0.1, seed=1), progress=unplug)
    path = stopped.value.recording

    said = subprocess.run(
        [sys.executable, "-m", "armrig", "replay", path], capture_output=True, text=True, check=True
    )

    assert "replay made the same decisions, to the last bit" in said.stdout
    assert "stopped at 0 V" in said.stdout
    assert str(stopped.value).split(";")[0].split(": ")[-1] in said.stdout


def test_a_recording_without_steps_is_reported(tmp_path: object) -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere\.mcap"):
        replay(f"{tmp_path}/nowhere.mcap")
    with pytest.raises(FileError, match=r"test_replay\.py: not made by armrig"):
        replay(__file__)
