"""A long run is recorded in parts, each a whole recording, read as one."""

from __future__ import annotations

import os
import shutil
import threading
from pathlib import Path

import armrig
import numpy as np
import pytest
from armrig.recordings.files.verification import verify
from armrig_core.commands.codes import GapCode, OutcomeCode
from armrig_core.recording_file.manifest import CONFIG, INPUT
from armrig_core.recording_file.part_names import part_paths
from armrig_core.recording_file.recorder import ActiveRecording, RecordingError
from armrig_core.recording_file.recovery import Recovery
from armrig_core.telemetry.telemetry import Outgoing
from armrig_daemon.pipe import Gap
from armrig_daemon.service.protobuf_out import outgoing
from mcap.reader import make_reader

from tests.core.recording_file.made import Setter, begun, finished, sample, until
from tests.daemon.failing_disk import Disk

N, FIRST = 100, 1000
ATTACHED = {CONFIG: b"{}", INPUT: b"u_v\n" + b"1.0\n" * N}


def _gap(first: int, count: int) -> Outgoing:
    t_ns = first * 10_000_000
    end_ns = t_ns + count * 10_000_000
    record = Gap(
        k_first=first,
        count=count,
        t_from_ns=t_ns,
        t_to_ns=end_ns,
        u_held_v=1.0,
        reason="late",
        code=GapCode.HOST_LATE,
    )
    return outgoing(record, 0)


def _recorded(path: Path, batches: list[list[Outgoing]], part: int) -> ActiveRecording:
    """Record batches one after the other, to the end of the run."""
    recording = _begun(path, part)
    for batch in batches:
        recording.add(batch)
    assert finished(recording).done
    return recording


def _begun(path: Path, part: int) -> ActiveRecording:
    return begun(path, None, part, files=ATTACHED, t_first_ns=FIRST * 10_000_000, k_first=FIRST)


def _each(messages: list[Outgoing]) -> list[list[Outgoing]]:
    return [[message] for message in messages]


def _ks(path: Path) -> list[int]:
    ks: list[int] = armrig.load(path).samples["k"].tolist()
    return ks


WHOLE = [sample(k) for k in range(FIRST, FIRST + N)]
HOLED = [*WHOLE[:28], _gap(FIRST + 28, 4), *WHOLE[32:60], _gap(FIRST + 60, 1), *WHOLE[61:]]


def test_the_parts_contain_the_messages_of_one_file(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    one = _recorded(tmp_path / "one" / "run.mcap", _each(HOLED), 0)

    parts = _recorded(tmp_path / "run.mcap", _each(HOLED), 30)

    assert parts.kept == tmp_path / "run.mcap"
    assert not parts.kept.exists()
    paths = part_paths(parts.kept)
    assert [p.name for p in paths] == [f"run.part-000{i}.mcap" for i in (1, 2, 3, 4)]
    assert sorted(tmp_path.glob("*.mcap*")) == paths
    whole, joined = armrig.load(one.kept), armrig.load(parts.kept)
    assert joined.samples.tobytes() == whole.samples.tobytes()
    for name in ("t", "u", "alpha", "valid", "present"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(whole, name))
    assert joined.gaps == whole.gaps
    assert joined.outcome is not None
    assert joined.outcome.outcome == "complete"
    assert (parts.samples, parts.synced, parts.missing) == (N - 5, N - 5, 5)
    for path in (parts.kept, *paths):
        checks = {c.about: c.level for c in verify(path).checks}
        assert (checks["file"], checks["samples"]) == ("good", "good"), path


def test_a_part_has_its_number_and_ends_after_a_sample(tmp_path: Path) -> None:
    _recorded(tmp_path / "run.mcap", _each(HOLED), 30)

    loaded = [armrig.load(tmp_path / f"run.part-000{i}.mcap") for i in (1, 2, 3, 4)]
    assert [r.manifest.part for r in loaded] == [1, 2, 3, 4]
    assert {(r.manifest.k_first, r.manifest.samples) for r in loaded} == {(FIRST, N)}
    # The first is full at sample 30, which is missing: it ends with the next one that came.
    begins = [r.manifest.part_k_first - FIRST for r in loaded]
    assert begins == [0, 33, 63, 93]
    assert [r.k_first - FIRST for r in loaded] == begins
    ended = [(r.outcome.code, r.outcome.samples, r.outcome.missing) for r in loaded if r.outcome]
    assert [r.outcome.outcome for r in loaded if r.outcome] == [code for code, _, _ in ended]
    continued = OutcomeCode.CONTINUED
    assert ended == [
        *((continued, 29, 4), (continued, 29, 1), (continued, 30, 0), ("complete", 7, 0))
    ]
    assert [[gap.k_first - FIRST for gap in r.gaps] for r in loaded] == [[28], [60], [], []]


def test_a_gap_at_the_end_of_a_part_is_reported_in_the_next_part(tmp_path: Path) -> None:
    messages = [*WHOLE[:30], _gap(FIRST + 30, 5), *WHOLE[35:]]

    _recorded(tmp_path / "run.mcap", _each(messages), 30)

    first, second = (armrig.load(tmp_path / f"run.part-000{i}.mcap") for i in (1, 2))
    assert (first.N, first.missing, len(first.gaps)) == (30, 0, 0)
    assert (second.k_first, second.missing, len(second.gaps)) == (FIRST + 30, 5, 1)


def test_a_run_that_ends_with_a_full_part_has_no_empty_part(tmp_path: Path) -> None:
    _recorded(tmp_path / "run.mcap", _each(WHOLE), N // 2)

    assert [p.name for p in part_paths(tmp_path / "run.mcap")] == [
        *("run.part-0001.mcap", "run.part-0002.mcap")
    ]


def test_a_part_is_on_the_disk_before_it_is_named_and_no_flush_waits_for_it(
    tmp_path: Path, instead: Setter
) -> None:
    """The next part is flushed meanwhile; its samples count as safe only after the first part."""
    first, answers, fsync = tmp_path / "run.part-0001.mcap", threading.Event(), os.fsync
    named: list[bool] = []

    def slow(fd: int) -> None:
        if Path(f"/proc/self/fd/{fd}").readlink().name == "run.part-0001.mcap.active":
            assert answers.wait(30)
            named.append(first.exists())
        fsync(fd)

    instead(fsync=slow)
    recording = _begun(tmp_path / "run.mcap", 60)
    recording.add(WHOLE)
    second = tmp_path / "run.part-0002.mcap.active"
    until(lambda: recording._flushed == N)
    assert armrig.load(second).samples.size == N - 60
    assert not armrig.load(first.with_name(f"{first.name}.active")).truncated
    assert recording.synced <= 60

    answers.set()
    finished(recording)

    assert named[0] is False
    assert (recording.synced, recording.error) == (N, "")
    assert _ks(recording.kept) == list(range(FIRST, FIRST + N))


def test_every_completed_part_has_full_chunks(tmp_path: Path, pace: Setter) -> None:
    pace(FLUSH_S=0.0)

    _recorded(tmp_path / "run.mcap", _each(WHOLE), 40)

    for path in part_paths(tmp_path / "run.mcap"):
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        assert summary is not None
        assert len(summary.chunk_indexes) == 1


def test_a_part_that_cannot_be_begun_ends_the_recording(tmp_path: Path) -> None:
    disk = Disk("open", 2)
    with disk.installed():
        recording = _recorded(disk.path(tmp_path / "run.mcap"), _each(WHOLE), 60)

    told = f"{recording.kept}: No space left on device; part 2 cannot begin"
    assert (
        recording.error
        == f"{told}; the recording ended early; all samples until then are in the file; "
        "free disk space"
    )
    assert [p.name for p in tmp_path.iterdir()] == ["run.part-0001.mcap"]
    loaded = armrig.load(recording.kept)
    assert (loaded.truncated, loaded.samples.size, recording.synced) == (False, 60, 60)
    assert loaded.outcome is not None
    assert loaded.outcome.outcome.startswith("its recording ended: No space left on device")


@pytest.mark.parametrize("on", [False, True])
def test_a_failing_system_call_leaves_a_prefix_of_the_samples(
    tmp_path: Path, pace: Setter, *, on: bool
) -> None:
    pace(FLUSH_S=0.0, SYNC_S=0.0)
    batches = [WHOLE[i : i + 10] for i in range(0, N, 10)]
    counted = Disk()
    (tmp_path / "counted").mkdir()
    with counted.installed():
        _recorded(counted.path(tmp_path / "counted" / "run.mcap"), batches, 40)
    assert counted.calls["write"] > 10
    failed = 0
    for kind, calls in counted.calls.items():
        for n in range(1 + calls % 5, calls + 1, 5):
            folder = tmp_path / f"{kind}-{n}"
            folder.mkdir()
            disk = Disk(kind, n, on=on)
            with disk.installed():
                try:
                    path = disk.path(folder / "run.mcap")
                    recording = _recorded(path, batches, 40)
                except RecordingError:
                    assert not list(folder.iterdir())
                    continue
            failed += disk.failed > 0
            paths = part_paths(folder / "run.mcap")
            assert sorted(folder.iterdir()) == paths, (kind, n)
            ks = _ks(folder / "run.mcap")
            assert ks == list(range(FIRST, FIRST + len(ks))), (kind, n)
            assert recording.synced <= len(ks), (kind, n)
            assert len(ks) == N or recording.error, (kind, n)
            assert not any(armrig.load(p).truncated for p in paths[:-1]), (kind, n)
    assert failed > 5


def test_the_parts_of_a_dead_daemon_are_read_as_one_after_recovery(
    tmp_path: Path,
) -> None:
    recording = _begun(tmp_path / "run.mcap", 40)
    recording.add([*WHOLE[:60], _gap(FIRST + 60, 3), *WHOLE[63:70]])
    until(lambda: recording._flushed == 67)
    for path in tmp_path.iterdir():
        shutil.copy(path, path.with_name(path.name.replace("run", "dead")))
    finished(recording)

    done = Recovery(armrig="0", now=lambda: "").recover(tmp_path / "dead.part-0002.mcap.active")

    assert (done.outcome.samples, done.outcome.missing) == (27, 3)
    joined = armrig.load(tmp_path / "dead.mcap")
    assert joined.samples["k"].tolist() == [
        *range(FIRST, FIRST + 60),
        *range(FIRST + 63, FIRST + 70),
    ]
    assert (joined.missing, joined.truncated) == (3, False)
    assert joined.recovered is not None


def test_only_the_name_of_a_recording_selects_parts(tmp_path: Path) -> None:
    for name in ("run.part-0010.mcap", "run.part-0009.mcap", "run-2.part-0001.mcap"):
        (tmp_path / name).touch()

    found = [path.name for path in part_paths(tmp_path / "run.mcap")]

    assert found == ["run.part-0009.mcap", "run.part-0010.mcap"]
    for other in ("run.csv", "run", "run.mcap.active", "ru.mcap"):
        assert part_paths(tmp_path / other) == [tmp_path / other]
