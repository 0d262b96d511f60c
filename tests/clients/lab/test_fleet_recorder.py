"""Errors of a recorder of many rigs, and the next recording of a rig."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from armrig.lab import fleet_recorder
from armrig.lab.fleet_recorder import FleetRecorder
from armrig.rig.remote_recording import DiskError
from armrig.rig.session import RigError


class _Rigs:
    """Rigs whose recordings end as each test says; counts how many began."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
        self.began = 0
        self.errors: list[str] = []
        self.told: list[str] = []
        self.of_samples: Exception | None = None
        self.of_end: Exception | None = None
        self.missing_bytes = 0
        self.during: Callable[[str, threading.Event], None] = lambda *_: self._end(self.of_samples)
        monkeypatch.setattr(shutil, "disk_usage", self._disk_usage)
        monkeypatch.setattr(fleet_recorder, "RemoteRecording", self._recording)
        monkeypatch.setattr(fleet_recorder, "RemoteRecorder", self._recorder)
        session: Any = None
        self.fleet = FleetRecorder(
            session,
            "a router",
            lambda rig: folder / f"{rig}.mcap",
            self.told.append,
            self.errors.append,
        )

    def record(self) -> fleet_recorder.RigRecorded:
        """Record rig 1 to the end of its recording; return what became of it."""
        (recorded,) = self.fleet.record(threading.Event(), 0.05, ["1"])
        return recorded

    def _recording(self, *, rig: str, tell: Any, **_: object) -> Any:
        tell("the sampling time became 0.02 s")
        tell("rig 1 does not answer; waiting for it")
        files = [f"file {self.began}-{i}" for i in range(2)]
        return SimpleNamespace(rig=rig, finish=lambda _: self._end(self.of_end), done=files)

    def _recorder(self, _: object, recording: Any) -> Any:
        self.began += 1
        return SimpleNamespace(begin=lambda: True, record=partial(self.during, recording.rig))

    def _disk_usage(self, _: Path) -> Any:
        return SimpleNamespace(free=fleet_recorder._MIN_FREE_BYTES - self.missing_bytes)

    @staticmethod
    def _end(error: Exception | None) -> None:
        if error is not None:
            raise error


@pytest.fixture
def rigs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> _Rigs:
    return _Rigs(monkeypatch, tmp_path)


@pytest.mark.parametrize(
    ("of_samples", "of_end", "why"),
    [(None, None, ""), (None, "full", "full"), ("full", None, "full"), ("full", "again", "full")],
)
def test_a_recording_that_ends_early_is_one_error(
    rigs: _Rigs, of_samples: str | None, of_end: str | None, why: str
) -> None:
    rigs.of_samples = DiskError(of_samples) if of_samples else None
    rigs.of_end = DiskError(of_end) if of_end else None

    recorded = rigs.record()

    assert recorded.why == why
    assert rigs.told == [
        "rig 1: the sampling time became 0.02 s",
        "rig 1 does not answer; waiting for it",
        "recording rig 1",
    ]
    assert rigs.errors == ([f"rig 1: its recording ended: {why}"] if why else [])


@pytest.mark.parametrize(
    ("error", "later_s", "missing_bytes", "times"),
    [
        (DiskError("full"), 60.0, 0, 2),
        (DiskError("full"), 60.0, 1, 1),
        (DiskError("full"), 29.0, 0, 1),
        (RigError("nonsense"), 60.0, 0, 1),
    ],
)
def test_a_rig_is_recorded_again_after_a_full_disk_with_a_pause_and_room(
    rigs: _Rigs, error: Exception, later_s: float, missing_bytes: int, times: int
) -> None:
    rigs.of_samples, rigs.missing_bytes = error, missing_bytes

    rigs.record().again_s -= later_s
    recorded = rigs.record()
    recorded.again_s -= later_s

    assert rigs.began == times
    files = [f"file {k}-{i}" for k in range(times) for i in range(2)]
    assert [str(file) for file in recorded.files] == files
    rigs.of_samples = None
    for _ in range(2):  # a recording that ends in order is the last
        rigs.record()
    assert rigs.began == times + (times == 2)


def test_recording_continues_until_the_last_rig_has_ended(rigs: _Rigs) -> None:
    begun, goes_on, last = list[str](), list[str](), threading.Event()

    def record(rig: str, is_over: threading.Event) -> None:
        begun.append(rig)
        if rig == "b":
            last.wait(10.0)
            assert not is_over.is_set()
            goes_on.append("b")
            return
        threading.Timer(0.05, last.set).start()
        raise RigError("it ended early")

    rigs.during = record

    found = rigs.fleet.record(threading.Event(), None, ["b", "a"])

    assert goes_on == ["b"]
    assert sorted(begun) == ["a", "b"]
    assert [(one.rig, one.why) for one in found] == [("a", "it ended early"), ("b", "")]
    assert rigs.errors == ["rig a: its recording ended: it ended early"]
