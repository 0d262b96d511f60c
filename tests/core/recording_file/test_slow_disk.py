"""A slow disk, a disk that does not answer, and a file that another program changes."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import armrig
import pytest
from armrig_core.commands.codes import COMPLETE, Ending, OutcomeCode
from armrig_core.recording_file import recording_part
from armrig_core.recording_file.recorder import Syncer
from mcap.reader import make_reader

from tests.core.recording_file.made import Setter, begun, finished, sample, until

N = 1600


@pytest.fixture
def answers(instead: Setter) -> threading.Event:
    """Return the event until which `fdatasync` does not return."""
    answers = threading.Event()
    instead(fdatasync=lambda _fd: answers.wait(60))
    return answers


def test_no_flush_waits_for_a_sync(tmp_path: Path, answers: threading.Event, pace: Setter) -> None:
    """L1: batches of one sample are all in the file while the first sync waits."""
    pace(SYNC_S=0.0)
    recording = begun(tmp_path / "run.mcap")
    for k in range(N):
        recording.add([sample(k)])

    until(lambda: recording._flushed == N)
    assert armrig.load(recording.active).samples.size == N
    assert recording.synced == 0

    answers.set()
    finished(recording)
    assert (recording.synced, recording.error, recording.dropped) == (N, "", 0)


def test_the_next_sync_is_due_after_the_end_of_the_last(tmp_path: Path) -> None:
    asked, answers = threading.Event(), threading.Event()

    class Slow:
        def sync(self) -> None:
            asked.set()
            answers.wait(30)

    syncer = Syncer()
    syncer.request(Slow(), 3)  # type: ignore[arg-type]
    assert asked.wait(30)
    assert syncer.ended_s == float("inf")  # no sync is due
    released_s = time.monotonic()
    answers.set()
    syncer.join()

    assert released_s <= syncer.ended_s <= time.monotonic()
    assert syncer.synced == 3


def test_a_disk_that_does_not_answer_ends_the_recording_with_the_number_of_samples(
    tmp_path: Path, answers: threading.Event
) -> None:
    recording = begun(tmp_path / "run.mcap")
    recording.add([sample(k) for k in range(50)])
    recording.finish(COMPLETE)
    until(lambda: recording._flushed == 50)

    recording.look()
    assert not recording.done  # 30 s are not over
    recording.join(0.1)

    assert recording.done
    assert recording.error.startswith(f"{recording.active}: the disk did not answer for ")
    assert recording.error.endswith(
        "; up to 50 of 50 samples are lost; `armrig recover` the others"
    )
    assert not armrig.load(recording.active).truncated  # the kernel has all of them
    answers.set()
    until(recording.path.exists)


def test_an_abandoned_recording_writes_no_more_bytes(
    tmp_path: Path, answers: threading.Event
) -> None:
    recording = begun(tmp_path / "run.mcap")
    recording.add([sample(k) for k in range(50)])
    until(lambda: recording._flushed == 50)

    recording.look(0.0)
    error = recording.error
    until(lambda: recording._part._file.closed)
    recording.add([sample(k) for k in range(50, 60)])
    recording.finish(Ending(OutcomeCode.RECORDING, error))
    answers.set()
    recording._thread.join(30)

    assert recording.error == error
    assert armrig.load(recording.active).samples.size == 50


def test_a_folder_without_permissions_does_not_lose_flushed_samples(
    tmp_path: Path, instead: Setter, monkeypatch: pytest.MonkeyPatch
) -> None:
    changed = threading.Event()
    recording = begun(tmp_path / "run.mcap", changed)
    recording.add([sample(k) for k in range(50)])
    until(lambda: recording._flushed == 50)

    def forbidden(_path: Path) -> os.stat_result:
        raise PermissionError(13, "Permission denied")

    instead(lstat=forbidden)
    assert changed.wait(30)
    monkeypatch.undo()
    finished(recording)

    assert recording.error == (
        f"{recording.active}: Permission denied; the flushed samples are kept there"
    )
    assert armrig.load(recording.active).samples.size == 50


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_file_truncated_by_another_program_is_reported(tmp_path: Path, share: float) -> None:
    changed = threading.Event()
    recording = begun(tmp_path / "run.mcap", changed)
    recording.add([sample(k) for k in range(50)])
    until(lambda: recording._flushed == 50)
    size = recording.active.stat().st_size
    left = int(share * size)

    os.truncate(recording.active, left)
    recording.add([sample(50)])
    assert changed.wait(30)
    finished(recording)

    assert recording.error == (
        f"{recording.active}: another program cut the file to {left} of {size} B; the rest is lost"
    )
    assert recording.active.stat().st_size == left  # no zeros take the place of the samples
    assert not recording.path.exists()


def test_a_file_truncated_during_its_rewriting_is_not_complete(
    tmp_path: Path, instead: Setter
) -> None:
    compact = recording_part.compact

    def cut(source: Path, target: Path) -> None:
        os.truncate(source, 1000)
        compact(source, target)

    instead(compact=cut)
    recording = begun(tmp_path / "run.mcap")
    recording.add([sample(k) for k in range(50)])
    finished(recording)

    assert ": another program cut the file to 1000 of " in recording.error
    assert not recording.path.exists()


@pytest.mark.parametrize("damaged", [0, 1])
def test_a_damaged_chunk_loses_at_most_10_s(tmp_path: Path, damaged: int) -> None:
    """The first chunk contains the channels; the index contains them, too."""
    path = tmp_path / "run.mcap"
    recording = begun(path)
    recording.add([sample(k) for k in range(2500)])
    finished(recording)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunks = summary.chunk_indexes
    spans_s = [(c.message_end_time - c.message_start_time) / 1e9 for c in chunks]
    assert spans_s == pytest.approx([9.99, 9.99, 4.99])

    data = bytearray(path.read_bytes())
    data[chunks[damaged].chunk_start_offset + 200] ^= 1
    path.write_bytes(data)
    loaded = armrig.load(path)

    lost = range(1000 * damaged, 1000 * (damaged + 1))
    assert loaded.samples["k"].tolist() == [k for k in range(2500) if k not in lost]
    assert "the other records were found by the file's index, 1 record left out" in loaded.damage
    assert loaded.truncated
