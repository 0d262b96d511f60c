"""A full disk ends a recording, and costs nothing of what came before."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import armrig
import pytest
from armrig.recordings.files.verification import verify
from armrig_core.commands.codes import Ending, OutcomeCode
from armrig_core.recording_file import recording_part
from armrig_core.recording_file.recorder import ActiveRecording
from armrig_core.recording_file.recovery import Recovery
from armrig_core.telemetry.telemetry import Outgoing

from tests.core.recording_file.made import Setter, begun, finished, sample, until
from tests.daemon.failing_disk import Disk

STOPPED = Ending(OutcomeCode.STOPPED, "stopped")
ENDED = "its recording ended: No space left on device"


def _samples(first: int, end: int) -> list[Outgoing]:
    """Return samples that do not pack well, as a rig's do not."""
    batch = []
    for k in range(first, end):
        noise = (k * 2_654_435_761) % 2**32
        readings = noise % 65536, noise // 65536
        batch.append(sample(k, theta_1=noise, counts=readings))
    return batch


def _begun(path: Path, changed: threading.Event | None = None) -> ActiveRecording:
    return begun(path, changed, files={}, samples=100_000, k_first=0)


def _until_it_fails(recording: ActiveRecording, changed: threading.Event) -> None:
    for k in range(0, 100_000, 500):
        recording.add(_samples(k, k + 500))
        if changed.wait(0.005):
            return


def _check(path: Path, recorded: int, error: str) -> None:
    """Check that a recording ended early, whole, with all its stated content."""
    loaded = armrig.load(path)
    assert not loaded.truncated
    assert loaded.samples["k"].tolist() == list(range(recorded))
    assert loaded.outcome is not None
    assert (loaded.outcome.outcome, loaded.outcome.samples) == (ENDED, recorded)
    (file,) = [c for c in verify(path).checks if c.about == "file"]
    assert file.level == "good"
    assert error == (
        f"{path}: No space left on device; the recording ended early; all samples "
        "until then are in the file; free disk space"
    )


_ON_A_SMALL_DISK = """
import json, sys, threading
from pathlib import Path
sys.path[:0] = {path!r}
import tests.core.recording_file.test_disk_full as here
folder = Path(sys.argv[1])
changed = threading.Event()
recording = here._begun(folder / "run.mcap", changed)
here._until_it_fails(recording, changed)
here.finished(recording, here.STOPPED)
here._check(folder / "run.mcap", recording.synced, recording.error)
print(json.dumps({{"synced": recording.synced, "names": sorted(p.name for p in folder.iterdir())}}))
"""


def test_on_a_disk_that_runs_full_the_file_is_completed_from_the_reserve(tmp_path: Path) -> None:
    """A file system of 3 MB."""
    program = _ON_A_SMALL_DISK.format(path=sys.path)
    mounted = f"mount -t tmpfs -o size=3m none {tmp_path} && exec {sys.executable} - {tmp_path}"
    unshare = shutil.which("unshare") or "/nowhere/unshare"
    if subprocess.run([unshare, "-rm", "true"], check=False, capture_output=True).returncode:
        pytest.skip("no file system can be mounted here")

    done = subprocess.run(
        [unshare, "-rm", "sh", "-c", mounted],
        input=program,
        text=True,
        capture_output=True,
        check=False,
        timeout=120,
    )

    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["names"] == ["run.mcap"]
    assert told["synced"] > 10_000


@pytest.mark.parametrize("kind", ["write", "posix_fallocate"])
def test_samples_in_memory_are_kept_when_the_disk_is_full(
    tmp_path: Path, pace: Setter, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    pace(FLUSH_S=0.0)
    monkeypatch.setattr(recording_part, "_INDEX_BYTES", 1 << 20)  # grows with each chunk
    changed = threading.Event()
    disk = Disk(kind, 3)
    with disk.installed():
        recording = _begun(disk.path(tmp_path / "run.mcap"), changed)
        for k in range(0, 300, 100):
            recording.add(_samples(k, k + 100))
            until(lambda k=k: recording._flushed >= k + 100 or disk.failed)
            if disk.failed:
                break
        recording.add(_samples(10_000, 10_100))  # no hole in silence: nothing more is written
        finished(recording, STOPPED)

    assert disk.failed == 1
    _check(tmp_path / "run.mcap", recording.synced, recording.error)
    assert recording.synced == k + 100


@pytest.mark.parametrize("number", [errno.EIO, errno.EFBIG, errno.ENOSPC])
def test_a_failing_disk_leaves_the_flushed_prefix_for_recovery(
    tmp_path: Path, instead: Setter, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    recording = _begun(tmp_path / "run.mcap")
    recording.add(_samples(0, 100))
    until(lambda: recording._flushed)
    fails = threading.Event()

    def failing(self: recording_part.RecordingPart) -> None:
        fails.set()
        self._file.write(b"torn")
        raise OSError(number, os.strerror(number))

    instead(_write_pending=failing)
    recording.add(_samples(100, 200))
    assert fails.wait(30)
    finished(recording, STOPPED)
    monkeypatch.undo()

    left = tmp_path / "run.mcap.active"
    why = os.strerror(number)
    assert recording.error == f"{left}: {why}; the flushed samples are kept there"
    assert armrig.load(left).samples["k"].tolist() == list(range(100))
    done = Recovery(armrig="0", now=lambda: "").recover(left)
    assert done.outcome.samples == 100
    assert done.recovered.cut_off_bytes == 0


@pytest.mark.parametrize("n", [2, 3])
def test_a_run_that_ended_just_before_the_disk_was_full_is_complete(
    tmp_path: Path, pace: Setter, n: int
) -> None:
    pace(FLUSH_S=60.0)
    disk = Disk("write", n)
    with disk.installed():
        recording = _begun(disk.path(tmp_path / "run.mcap"))
        recording.add(_samples(0, 100))
        finished(recording)

    assert (disk.failed, recording.error) == (1, "")
    loaded = armrig.load(tmp_path / "run.mcap")
    assert loaded.outcome is not None
    assert (loaded.outcome.outcome, loaded.samples.size) == ("complete", 100)
