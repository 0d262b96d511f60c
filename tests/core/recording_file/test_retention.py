"""Removal of recordings: whole runs of one rig, the oldest first, and nothing else."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from armrig_core.recording_file.manifest import Outcome
from armrig_core.recording_file.opening import lock
from armrig_core.recording_file.retention import DAY_S, GB, Retention

from tests.clients.made_recordings import manifest, recorded, sample, written

NOW_S = 2_000_000_000.0
COMPLETE = Outcome(outcome="complete", samples=1, missing=0)
CONTINUED = Outcome(outcome="continued", samples=1, missing=0)


def _run(
    folder: Path, name: str, days: float, *, outcome: Outcome | None = COMPLETE, rig: str = "1"
) -> Path:
    """Write a recording that ended so many days ago."""
    data = recorded([sample(0)], manifest=manifest(rig=rig), outcome=outcome)
    return _aged(written(folder, data, name), days)


def _aged(path: Path, days: float) -> Path:
    ended_s = NOW_S - days * DAY_S
    os.utime(path, (ended_s, ended_s))
    return path


def _retention(folder: Path, **changes: Any) -> Retention:
    fields = {"keep_days": 30.0, "keep_gb": 0.0, "owner": os.geteuid(), **changes}
    return Retention(folder=folder, rig="1", **fields)


def _names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_retention_without_limits_is_off(tmp_path: Path) -> None:
    assert not _retention(tmp_path, keep_days=0.0).is_asked


def test_a_run_is_removed_by_its_age_and_each_removal_is_reported(tmp_path: Path) -> None:
    old = _run(tmp_path, "1-a.mcap", 31)
    size = old.stat().st_size
    _run(tmp_path, "1-b.mcap", 29)
    _run(tmp_path, "1-c.mcap", 1)

    (removal,) = _retention(tmp_path).apply(NOW_S)

    assert removal.is_removed
    assert removal.text == f"{old}: removed, {size / 1e6:.1f} MB: older than 30 days"
    assert _names(tmp_path) == {"1-b.mcap", "1-c.mcap"}


def test_the_oldest_runs_are_removed_until_the_size_is_below_its_limit(tmp_path: Path) -> None:
    runs = [_run(tmp_path, f"1-{name}.mcap", days) for name, days in (("a", 1), ("b", 3), ("c", 2))]
    size = runs[0].stat().st_size

    removals = [*_retention(tmp_path, keep_days=0.0, keep_gb=2.5 * size / GB).apply(NOW_S)]

    assert [removal.text.split(":")[0] for removal in removals] == [str(runs[1])]
    assert "the recordings of rig 1 take more than" in removals[0].text


@pytest.mark.parametrize(("more", "removed"), [(1, 0), (-1, 1)])
def test_a_limit_is_exceeded_by_one_byte_or_one_second(
    tmp_path: Path, more: int, removed: int
) -> None:
    runs = [_run(tmp_path, f"1-{name}.mcap", days) for name, days in (("a", 30), ("b", 2))]
    total = sum(run.stat().st_size for run in runs)

    by_size = _retention(tmp_path, keep_days=0.0, keep_gb=(total + more) / GB)
    by_age = _retention(tmp_path)

    assert len([*by_age.apply(NOW_S - more)]) == removed
    _run(tmp_path, "1-a.mcap", 30)
    assert len([*by_size.apply(NOW_S)]) == removed


def test_the_newest_run_is_kept_at_any_age_and_size(tmp_path: Path) -> None:
    _run(tmp_path, "1-a.mcap", 40)
    _run(tmp_path, "1-b.mcap", 35)

    assert [*_retention(tmp_path, keep_gb=1e-9).apply(NOW_S)]

    assert _names(tmp_path) == {"1-b.mcap"}


def test_no_run_is_removed_by_age_if_the_newest_run_is_too_old(tmp_path: Path) -> None:
    """The clock of this machine may be set days ahead."""
    for name, days in (("a", 90), ("b", 61)):
        _run(tmp_path, f"1-{name}.mcap", days)
    retention = _retention(tmp_path)

    (said,) = retention.apply(NOW_S)

    assert not said.is_removed
    assert "the newest recording is older than 30 days, so none is removed by its age" in said.text
    assert [*retention.apply(NOW_S)] == []
    assert _names(tmp_path) == {"1-a.mcap", "1-b.mcap"}
    _run(tmp_path, "1-c.mcap", 0)
    assert [removal.is_removed for removal in retention.apply(NOW_S)] == [True, True]


def test_a_run_in_parts_is_removed_as_a_whole(tmp_path: Path) -> None:
    parts = [
        _run(tmp_path, f"1-a.part-000{n}.mcap", days, outcome=outcome)
        for n, days, outcome in ((1, 40, CONTINUED), (2, 29, COMPLETE))
    ]
    _run(tmp_path, "1-b.mcap", 1)

    assert not [*_retention(tmp_path).apply(NOW_S)]
    _aged(parts[1], 31)
    (removal,) = _retention(tmp_path).apply(NOW_S)

    assert removal.text.startswith(f"{parts[1]} and the 1 part before it: removed")
    assert _names(tmp_path) == {"1-b.mcap"}


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-9])


def _spoil(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[data.index(b"zstd") + 20] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize("damage", [_cut, _spoil])
def test_a_damaged_recording_is_not_removed_and_is_reported_once(
    tmp_path: Path, damage: Any
) -> None:
    broken = _run(tmp_path, "1-a.mcap", 40)
    damage(broken)
    _aged(broken, 40)
    size = _run(tmp_path, "1-b.mcap", 3).stat().st_size
    _run(tmp_path, "1-c.mcap", 2)
    retention = _retention(tmp_path, keep_gb=2.1 * size / GB)

    (report,) = retention.apply(NOW_S)

    assert not report.is_removed
    assert report.text.startswith(f"{broken}: older than 30 days, but it stays, because ")
    assert [*retention.apply(NOW_S)] == []
    assert _names(tmp_path) == {"1-a.mcap", "1-b.mcap", "1-c.mcap"}


@pytest.mark.parametrize("outcome", [None, CONTINUED])
def test_a_run_without_an_outcome_is_not_removed(tmp_path: Path, outcome: Outcome | None) -> None:
    _run(tmp_path, "1-a.part-0001.mcap", 40, outcome=outcome)
    _run(tmp_path, "1-b.mcap", 1)

    (report,) = _retention(tmp_path).apply(NOW_S)

    assert not report.is_removed
    assert _names(tmp_path) == {"1-a.part-0001.mcap", "1-b.mcap"}


def test_a_run_with_a_part_of_another_rig_is_not_removed(tmp_path: Path) -> None:
    _run(tmp_path, "1-a.part-0001.mcap", 40, outcome=CONTINUED)
    _run(tmp_path, "1-a.part-0002.mcap", 40, rig="2")
    _run(tmp_path, "1-b.mcap", 1)

    (report,) = _retention(tmp_path).apply(NOW_S)

    assert not report.is_removed
    assert report.text.endswith("a part of it belongs to another rig")


def test_other_files_of_the_folder_are_unchanged(tmp_path: Path) -> None:
    _run(tmp_path, "1-a.mcap.active", 40)
    _run(tmp_path, "1-b.part-0001.mcap", 40, outcome=CONTINUED)
    _run(tmp_path, "1-b.part-0002.mcap.active", 40)
    _run(tmp_path, "1-c.part-0001.mcap", 40)
    _run(tmp_path, "1-c.part-0001.mcap.compact", 40)
    _run(tmp_path, "1-d-of-rig-1-d.mcap", 40, rig="1-d")
    _run(tmp_path, "2-e.mcap", 40, rig="2")
    (tmp_path / "1-f.mcap").symlink_to(_run(tmp_path, "kept.mcap", 40))
    (tmp_path / "1-g.mcap").mkdir()
    _aged(written(tmp_path, b"a note", "1-h.mcap"), 40)
    os.mkfifo(tmp_path / "1-i.mcap")
    _run(tmp_path, "1-z.mcap", 1)
    before = _names(tmp_path)

    assert [*_retention(tmp_path, keep_gb=1e-9).apply(NOW_S)] == []
    assert _names(tmp_path) == before
    assert [*_retention(tmp_path, owner=os.geteuid() + 1).apply(NOW_S)] == []


def test_a_locked_recording_is_removed_only_after_its_release(tmp_path: Path) -> None:
    path = _run(tmp_path, "1-a.mcap", 40)
    _run(tmp_path, "1-b.mcap", 1)
    retention = _retention(tmp_path)
    with path.open("rb") as file:
        lock(file)

        assert [*retention.apply(NOW_S)] == []

    assert [removal.is_removed for removal in retention.apply(NOW_S)] == [True]


def test_a_partly_removed_run_is_removed_on_the_next_occasion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for n, outcome in ((1, CONTINUED), (2, CONTINUED), (3, COMPLETE)):
        _run(tmp_path, f"1-a.part-000{n}.mcap", 40, outcome=outcome)
    _run(tmp_path, "1-b.mcap", 1)
    unlink, removed = Path.unlink, []

    def once(path: Path, **options: Any) -> None:
        if removed:
            raise OSError(30, "Read-only file system")
        removed.append(path)
        unlink(path, **options)

    monkeypatch.setattr(Path, "unlink", once)
    (report,) = _retention(tmp_path).apply(NOW_S)
    monkeypatch.undo()

    assert not report.is_removed
    assert "reading or removing it failed: Read-only file system" in report.text
    assert [removal.is_removed for removal in _retention(tmp_path).apply(NOW_S)] == [True]
    assert _names(tmp_path) == {"1-b.mcap"}
