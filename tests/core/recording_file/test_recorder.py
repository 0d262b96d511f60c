"""Recordings: readable by others, and whole up to the last flush after any event."""

from __future__ import annotations

import os
import resource
import threading
from pathlib import Path

import pytest
from armrig_core.commands.codes import COMPLETE, Ending, GapCode, OutcomeCode
from armrig_core.recording_file import recorder
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.manifest import OUTCOME, Outcome
from armrig_core.recording_file.recorder import RecordingError
from armrig_core.recording_file.recording_part import RecordingPart
from armrig_daemon.pipe import Gap
from armrig_daemon.service.protobuf_out import outgoing
from mcap.reader import make_reader
from msgspec.structs import replace

from tests.core.recording_file.made import MANIFEST, Setter, begun, finished, sample, until

_MAGIC = b"\x89MCAP0\r\n"  # how a whole file ends


def test_the_times_of_messages_are_those_of_samples_and_never_decrease(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recording = begun(path)
    late = Gap(
        k_first=1,
        count=1,
        t_from_ns=0,
        t_to_ns=15_000_000,
        u_held_v=0,
        reason="late",
        code=GapCode.HOST_LATE,
    )
    early = sample(3)._replace(t_host_ns=29_999_000)
    overtaken = outgoing(replace(late, t_to_ns=19_000_000), 0)

    recording.add([sample(1), outgoing(late, 0), sample(2), overtaken, early])
    finished(recording)

    with path.open("rb") as file:
        messages = [m for _, _, m in make_reader(file).iter_messages(log_time_order=False)]
    offset = MANIFEST.clock_offset_ns
    logged = [m.log_time - offset for m in messages]
    assert logged == [10_000_005, 10_000_005, 20_000_005, 20_000_005, 29_999_000]
    published = [messages[i].publish_time - offset for i in (0, 2, 4)]
    assert published == [10_000_000, 20_000_000, 29_999_000]


def test_a_sample_number_beyond_32_bits_is_recorded(tmp_path: Path) -> None:
    """The sequence of MCAP has 32 bits, k has more: a daemon may sample for months."""
    recording = begun(tmp_path / "run.mcap")

    recording.add([sample((1 << 32) + 7)])
    finished(recording)

    assert recording.error == ""
    with recording.path.open("rb") as file:
        (found,) = [message for _, _, message in make_reader(file).iter_messages()]
    assert found.sequence == 7


def test_the_recorder_flushes_ten_times_a_second() -> None:
    """As docs/telemetry.md says."""
    assert recorder.FLUSH_S == 0.1


@pytest.mark.parametrize("way", ["file", "folder", "folder above"])
def test_a_moved_recording_is_completed_at_its_new_place(tmp_path: Path, way: str) -> None:
    changed, directory = threading.Event(), tmp_path / "above" / "recordings"
    directory.mkdir(parents=True)
    recording = begun(directory / "run.mcap", changed)
    recording.add([sample(k) for k in range(50)])
    was, to = {
        "file": (recording.active, directory / "other.mcap.active"),
        "folder": (directory, directory.with_name("elsewhere")),
        "folder above": (directory.parent, tmp_path / "elsewhere"),
    }[way]
    was.rename(to)

    assert changed.wait(30)
    assert recording.moved == "its recording was moved while it was written"
    recording.add([sample(k) for k in range(50, 60)])
    finished(recording, Ending(OutcomeCode.MOVED, recording.moved))

    assert recording.error == ""
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == [recording.kept]
    assert recording.kept.name == ("other.mcap" if way == "file" else "run.mcap")
    with recording.kept.open("rb") as file:
        assert len(list(make_reader(file).iter_messages())) == 60


@pytest.mark.parametrize("is_replaced", [False, True])
def test_a_removed_recording_is_reported_during_the_run(tmp_path: Path, is_replaced: bool) -> None:
    changed = threading.Event()
    recording = begun(tmp_path / "run.mcap", changed)
    recording.active.unlink()
    if is_replaced:
        recording.active.write_text("precious")

    assert changed.wait(30)
    assert recording.error.endswith(
        "run.mcap.active: the file was removed during the recording; its samples are lost"
    )
    finished(recording, Ending(OutcomeCode.STOPPED, "stopped"))
    assert [p.read_text() for p in tmp_path.iterdir()] == ["precious"] * is_replaced


def test_an_unexpected_error_of_the_writer_is_reported(tmp_path: Path, instead: Setter) -> None:
    def broken(source: Path, target: Path) -> None:
        raise RuntimeError("unexpected")

    instead(compact=broken)
    recording = begun(tmp_path / "run.mcap")
    finished(recording)

    assert recording.done
    assert "unexpected" in recording.error


@pytest.mark.parametrize("is_named", [False, True])
def test_a_slow_rewriting_loses_no_sample(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, is_named: bool
) -> None:
    asked, answers = threading.Event(), threading.Event()

    def slow(part: RecordingPart) -> None:
        if part.is_named == is_named:
            asked.set()
            answers.wait(30)

    monkeypatch.setattr(RecordingPart, "compact", slow)
    recording = begun(tmp_path / "run.mcap", part=40, k_first=0)
    recording.add([sample(k) for k in range(50)])
    recording.finish(COMPLETE)
    assert asked.wait(30)
    recording.join(0.0)

    late = f"{recording.active}: not renamed; all 50 samples are on the disk; "
    assert (recording.done, recording.synced) == (True, 50)
    assert recording.error == ("" if is_named else f"{late}`armrig recover` the file")
    answers.set()
    recording._thread.join(30)


def test_a_recording_that_cannot_be_created_leaves_no_file(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    try:
        with pytest.raises(RecordingError, match="File too large; free disk space"):
            begun(tmp_path / "run.mcap")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

    assert list(tmp_path.iterdir()) == []


def test_batches_beyond_the_queue_are_discarded_and_counted(
    tmp_path: Path, pace: Setter, instead: Setter
) -> None:
    asked, answers, flush = threading.Event(), threading.Event(), RecordingPart.flush

    def answer(part: RecordingPart) -> None:
        asked.set()
        answers.wait()
        flush(part)

    instead(flush=answer)
    pace(QUEUE=3)
    recording = begun(tmp_path / "run.mcap")
    assert asked.wait(30)
    for k in range(9):
        recording.add([sample(k)])
    recording.finish(COMPLETE)

    assert not recording.done
    answers.set()
    recording.join(30)
    assert recording.done
    assert not recording.error
    assert (recording.samples, recording.dropped) == (3, 6)
    with recording.path.open("rb") as file:
        metadata = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    assert Outcome.of(metadata[OUTCOME]).missing == recording.dropped


def test_a_sample_that_was_not_flushed_is_not_acknowledged(
    tmp_path: Path, pace: Setter, instead: Setter
) -> None:
    """A sync between two flushes does not reach it."""
    pace(SYNC_S=0.0, FLUSH_S=30.0)
    flush, sync, seen = RecordingPart.flush, RecordingPart.sync, []

    def flushed(part: RecordingPart) -> None:
        seen.append(("flush", part.samples, recording.synced))
        flush(part)

    def synced(part: RecordingPart) -> None:
        seen.append(("sync", part.samples, recording.synced))
        sync(part)

    instead(flush=flushed, sync=synced)
    recording = begun(tmp_path / "run.mcap")
    recording.add([sample(k) for k in range(50)])
    until(lambda: seen)
    finished(recording)

    first = [what for what, _, _ in seen].index("flush")
    assert first > 0
    assert {synced for _, _, synced in seen[: first + 1]} == {0}
    assert recording.synced == 50


def test_each_file_is_synced_before_the_next_step(tmp_path: Path, instead: Setter) -> None:
    """L1: the first file before its copy, the copy before it replaces the first, then the name."""
    synced = []
    fsync = os.fsync

    def noted(fd: int) -> None:
        fsync(fd)
        path = Path(f"/proc/self/fd/{fd}").readlink()
        names = sorted(p.name for p in tmp_path.iterdir())
        synced.append((path.name, path.is_dir() or path.read_bytes().endswith(_MAGIC), names))

    instead(fsync=noted)
    recording = begun(tmp_path / "run.mcap")
    recording.add([sample(k) for k in range(50)])
    finished(recording)

    assert synced == [
        ("run.mcap.active", True, ["run.mcap.active"]),
        ("run.mcap.compact", True, ["run.mcap.active", "run.mcap.compact"]),
        (tmp_path.name, True, ["run.mcap"]),
    ]


@pytest.mark.parametrize(
    "err", [OSError(28, "No space left on device"), DamageError("read back otherwise")]
)
def test_the_recording_is_kept_without_room_for_its_compact_copy(
    tmp_path: Path, instead: Setter, err: Exception
) -> None:
    def full(source: Path, target: Path) -> None:
        target.write_bytes(source.read_bytes()[:100])
        raise err

    instead(compact=full)
    recording = begun(tmp_path / "run.mcap")

    recording.add([sample(k) for k in range(50)])
    finished(recording)

    with recording.path.open("rb") as file:
        assert len(list(make_reader(file).iter_messages())) == 50
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.mcap"]


@pytest.mark.parametrize("is_link", [False, True])
@pytest.mark.parametrize("name", ["run.mcap", "run.mcap.active", "run.mcap.compact"])
def test_a_recording_replaces_and_follows_nothing_at_its_names(
    tmp_path: Path, name: str, is_link: bool
) -> None:
    """Only an incomplete copy, which a dead process has left, is replaced."""
    taken, elsewhere = tmp_path / name, tmp_path / "elsewhere"
    elsewhere.write_bytes(b"precious")
    taken.symlink_to(elsewhere) if is_link else taken.write_bytes(b"precious")

    if name.endswith(".compact"):
        recording = begun(tmp_path / "run.mcap")
        finished(recording)
        assert (recording.error, recording.path.is_symlink()) == ("", False)
    else:
        with pytest.raises(RecordingError, match=rf"{name}: File exists"):
            begun(tmp_path / "run.mcap")
        assert (taken.is_symlink(), taken.read_bytes()) == (is_link, b"precious")
    assert len([*tmp_path.iterdir()]) == 2
    assert elsewhere.read_bytes() == b"precious"


def test_a_file_created_meanwhile_under_the_final_name_is_kept(tmp_path: Path) -> None:
    recording = begun(tmp_path / "run.mcap")
    recording.add([sample(k) for k in range(50)])
    (tmp_path / "run.mcap").write_bytes(b"precious")

    finished(recording)

    assert (tmp_path / "run.mcap").read_bytes() == b"precious"
    assert recording.error.endswith(
        "run.mcap.active: File exists; the flushed samples are kept there"
    )
    with recording.active.open("rb") as file:
        assert len(list(make_reader(file).iter_messages())) == 50
