"""Faults of the recordings' directory, in addition to `test_recorder.py`."""

from __future__ import annotations

import resource
import time
from pathlib import Path

import armrig
import pytest
from armrig_core.commands.codes import COMPLETE
from armrig_core.recording_file.manifest import Manifest
from armrig_core.recording_file.recorder import Recording, RecordingError

from tests.integration.driving import (
    STOPPED_S,
    check_every_k,
    check_volts,
    driven,
    outcome,
    recorded,
)
from tests.integration.processes import Bench, wait_for

ROOM = 8 << 10  # B
MANIFEST = Manifest(
    **{"rig": "1", "run_id": "r", "experiment": "test", "details": {}, "Ts": 0.01},
    **{"samples": 1, "started": "2026-01-01T00:00:00+00:00", "clock_offset_ns": 0},
    **{"armrig": "0", "protocol": "1"},
)


def test_a_disk_that_fills_during_a_run_stops_it_and_keeps_its_samples(bench: Bench) -> None:
    """RLIMIT_FSIZE."""
    bench.emulate()
    daemon = bench.serve()
    with driven(bench, samples=3000):  # it would go on for longer than anybody waits here
        wait_for(lambda: list(bench.recordings.glob("*.active")))
        (active,) = bench.recordings.glob("*.active")
        _, most = resource.prlimit(daemon.popen.pid, resource.RLIMIT_FSIZE)
        full = (active.stat().st_size + ROOM, most)
        resource.prlimit(daemon.popen.pid, resource.RLIMIT_FSIZE, full)

        wait_for(lambda: bench.volts() == 0.0)
        with bench.rig() as rig:
            wait_for(lambda: (last := rig.status().last_run) is not None and last.finished)
            last = rig.status().last_run
    assert last is not None
    assert "File too large; the flushed samples are kept there" in last.outcome
    assert Path(last.recording) == active
    recording = armrig.load(active)
    assert recording.truncated
    assert recording.samples.size > 20
    check_every_k(recording)
    check_volts(bench)

    resource.prlimit(daemon.popen.pid, resource.RLIMIT_FSIZE, (most, most))
    with bench.rig() as rig:
        wait_for(lambda: rig.status().phase == "safe")
        rig.arm("a test")
        assert not armrig.load(rig.run([1.0, 4.0])).truncated


def test_a_directory_moved_during_a_run_keeps_its_recording(bench: Bench) -> None:
    bench.emulate()
    daemon = bench.serve()
    elsewhere = bench.folder / "elsewhere"
    with driven(bench):
        moved_ns = time.monotonic_ns()
        bench.recordings.rename(elsewhere)
        stopped_s = bench.went_to_0_v_after(moved_ns)

        recording = recorded(bench)

    assert stopped_s < STOPPED_S
    assert "was moved while it was written" in outcome(recording)
    assert [recording.path] == [*elsewhere.iterdir()]
    assert not recording.truncated
    assert recording.samples.size > 20
    check_every_k(recording)
    check_volts(bench)
    assert "Traceback" not in daemon.said
    with bench.rig() as rig:
        wait_for(lambda: rig.status().phase == "safe")
        rig.arm("a test")
        assert armrig.load(rig.run([1.0, 4.0])).samples.size == 2


@pytest.mark.parametrize("suffix", [".active", ".compact", ""])
def test_a_symbolic_link_at_a_name_of_a_recording_is_not_followed(
    tmp_path: Path, suffix: str
) -> None:
    directory, elsewhere = tmp_path / "recordings", tmp_path / "elsewhere"
    directory.mkdir()
    elsewhere.write_text("precious")
    path = directory / "run.mcap"
    path.with_name(path.name + suffix).symlink_to(elsewhere)

    if suffix in (".active", ""):  # the recording's own name is as taken as that of its file
        with pytest.raises(RecordingError, match="File exists"):
            Recording(path, MANIFEST, {}, t_first_ns=0, changed=lambda: None)
    else:
        recording = Recording(path, MANIFEST, {}, t_first_ns=0, changed=lambda: None)
        recording.finish(COMPLETE)
        recording.join(30)
        assert recording.error == ""
        assert not path.is_symlink()
        assert not armrig.load(path).truncated
    assert elsewhere.read_text() == "precious"


def test_a_symbolic_link_that_replaces_an_open_file_is_not_followed(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text("precious")
    directory = tmp_path / "recordings"
    directory.mkdir()
    recording = Recording(directory / "run.mcap", MANIFEST, {}, t_first_ns=0, changed=lambda: None)
    recording.active.unlink()
    recording.active.symlink_to(elsewhere)
    recording.finish(COMPLETE)
    recording.join(30)

    assert recording.done
    assert elsewhere.read_text() == "precious"
