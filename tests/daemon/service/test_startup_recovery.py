"""A thread of the service recovers unfinished recordings."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import armrig
import pytest
from armrig_core.recording_file.manifest import Outcome
from armrig_core.recording_file.opening import lock
from armrig_core.recording_file.rewriting import Rewriter
from armrig_daemon.config import RecordingTable
from armrig_daemon.service.host.startup_recovery import StartupRecovery

from tests.clients.made_recordings import manifest, recorded, sample, written

N = 30
DATA = recorded(
    [sample(k) for k in range(N)],
    manifest=manifest(k_first=0, samples=N),
    outcome=None,
    flush_every=10,
)[:-100]


def _names(directory: Path) -> list[str]:
    return sorted(path.name for path in directory.iterdir())


def test_each_unfinished_file_is_recovered_or_reported_independently(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "1-a.mcap.active")
    written(tmp_path, b"", "1-b.mcap.active")
    written(tmp_path, DATA, "2-c.mcap.active")
    written(tmp_path, DATA, "1-e.mcap.active")
    changed: list[None] = []
    left_over = StartupRecovery(tmp_path, "1", lambda: changed.append(None))
    with written(tmp_path, DATA, "1-d.mcap.active").open("rb") as file:
        lock(file)

        left_over.start()
        left_over.join(30)

    lines = list(left_over.lines())
    assert [line[0] for line in lines] == ["warning", "warning", "info"]
    for line, text in zip(lines, ("not a regular", "0 B", f"recovered, {N} samples"), strict=True):
        assert text in line[1]
    assert len(changed) == len(lines)
    assert _names(tmp_path) == [
        *("1-a.mcap.active", "1-b.mcap.active", "1-d.mcap.active", "1-e.mcap", "2-c.mcap.active")
    ]
    assert armrig.load(tmp_path / "1-e.mcap").samples.size == N
    assert list(left_over.lines()) == []  # each is said once


def test_recovery_pauses_during_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path, DATA, "1-a.mcap.active")
    left_over = StartupRecovery(tmp_path, "1", lambda: None)
    begun = threading.Event()
    add = Rewriter.add

    def noted(self: Rewriter, *args: object) -> object:
        begun.set()
        return add(self, *args)  # type: ignore[arg-type]

    monkeypatch.setattr(Rewriter, "add", noted)
    left_over.rest()
    left_over.start()
    assert begun.wait(30)
    left_over.join(0.05)

    assert _names(tmp_path) == ["1-a.mcap.active", "1-a.mcap.compact"]
    left_over.go_on()
    left_over.join(30)

    assert _names(tmp_path) == ["1-a.mcap"]


def test_a_file_name_of_arbitrary_bytes_is_reported_as_text(tmp_path: Path) -> None:
    """A message is UTF-8."""
    Path(os.fsdecode(bytes(tmp_path) + b"/1-\xff.mcap.active")).write_bytes(b"")
    left_over = StartupRecovery(tmp_path, "1", lambda: None)

    left_over.start()
    left_over.join(30)

    (line,) = left_over.lines()
    assert "1-\N{REPLACEMENT CHARACTER}.mcap.active" in line[1]


def test_an_unexpected_error_in_one_file_does_not_stop_the_recovery_of_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in "ab":
        written(tmp_path, DATA, f"1-{name}.mcap.active")
    init = Rewriter.__init__

    begun: list[Rewriter] = []

    def broken(self: Rewriter, *args: object) -> None:
        begun.append(self)
        if len(begun) == 1:
            raise RuntimeError("unexpected")
        init(self, *args)  # type: ignore[arg-type]

    monkeypatch.setattr(Rewriter, "__init__", broken)
    left_over = StartupRecovery(tmp_path, "1", lambda: None)
    left_over.start()
    left_over.join(30)

    first, second = left_over.lines()
    assert first[0] == "error"
    assert "unexpected" in first[1]
    assert second[0] == "info"
    assert f"{tmp_path}/1-b.mcap: recovered, {N} samples, 0.3 s of 0.3 s" in second[1]
    assert _names(tmp_path) == ["1-a.mcap.active", "1-b.mcap"]


def test_an_incomplete_copy_is_removed_unless_it_is_locked(tmp_path: Path) -> None:
    whole = written(tmp_path, DATA, "1-a.part-0001.mcap")
    written(tmp_path, DATA[:100], "1-a.part-0001.mcap.compact")
    (tmp_path / "1-c.mcap.compact").symlink_to(whole)
    left_over = StartupRecovery(tmp_path, "1", lambda: None)
    with written(tmp_path, DATA[:100], "1-b.mcap.compact").open("rb") as file:
        lock(file)

        left_over.start()
        left_over.join(30)

    assert _names(tmp_path) == ["1-a.part-0001.mcap", "1-b.mcap.compact", "1-c.mcap.compact"]
    (line,) = left_over.lines()
    assert line[1] == f"{whole}.compact: incomplete copy of a complete recording, removed"


def test_the_oldest_runs_are_removed_if_the_total_size_exceeds_its_limit(tmp_path: Path) -> None:
    """The newest run stays, however large it is."""
    ended = recorded([sample(0)], outcome=Outcome(outcome="complete", samples=1, missing=0))
    for name, hours in (("1-a.mcap", 3), ("1-b.mcap", 2), ("1-c.mcap", 1)):
        path = written(tmp_path, ended, name)
        ended_s = time.time() - hours * 3600
        os.utime(path, (ended_s, ended_s))
    said = threading.Event()
    most_gb = 2.5 * len(ended) / 1e9
    left_over = StartupRecovery(tmp_path, "1", said.set, RecordingTable(keep_gb=most_gb))

    left_over.start()

    assert said.wait(30)
    (line,) = left_over.lines()
    assert line[0] == "info"
    assert f"the recordings of rig 1 take more than {most_gb:g} GB" in line[1]
    assert _names(tmp_path) == ["1-b.mcap", "1-c.mcap"]
