"""A daemon that refuses for the moment: the client repeats the request, and gives up in time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from armrig.rig import client as rig_module
from armrig.rig.client import Rig
from armrig.rig.replies import BusyError, RefusedError
from armrig_core.commands import commands

from tests.clients.fake_clock import FakeClock
from tests.clients.fake_daemon import FakeDaemon

BUSY = "too many commands are waiting: try again"


class BusyDaemon(FakeDaemon):
    """Refuses the first commands of some names."""

    def __init__(self, endpoint: str) -> None:
        super().__init__(endpoint)
        self.busy: dict[str, int] = {}
        self.refused: Counter[str] = Counter()
        self.is_busy: Callable[[], bool] = lambda: False

    def _carry_out(self, request: commands.DaemonRequest) -> Any:
        if self.is_busy():
            raise ValueError(BUSY)
        if self.refused[request.name] < self.busy.get(request.name, 0):
            self.refused[request.name] += 1
            raise ValueError(BUSY)
        return super()._carry_out(request)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    """Give the clock by which the client gives up: a busy host must not end its patience."""
    clock = FakeClock()
    monkeypatch.setattr(rig_module, "time", clock)
    return clock


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[BusyDaemon]:
    with BusyDaemon(f"unixsock-stream/{tmp_path}/1.sock") as daemon:
        yield daemon


def test_a_busy_daemon_does_not_end_a_run(daemon: BusyDaemon) -> None:
    daemon.busy = {"status": 4, "renew": 1}

    with Rig(connect=daemon.endpoint) as rig:
        rig.arm("a test")
        path = rig.run([1.0, 2.0], dead_man=1.0)

    assert str(path) == daemon.recording
    assert daemon.refused == {"status": 4, "renew": 1}
    assert daemon.names().count("renew") >= 4
    assert "stop" not in daemon.names()


def test_arming_is_repeated_for_more_than_two_seconds(daemon: BusyDaemon, clock: FakeClock) -> None:
    """A stall between two reports of the timing spoils both; the next is two seconds later."""
    daemon.is_busy = lambda: clock.now_s < 102.4

    with Rig(connect=daemon.endpoint) as rig:
        rig.arm("a test")
        daemon.is_busy = lambda: True
        with pytest.raises(BusyError, match="too many commands"):
            rig.arm("a test")
        gave_up_s, daemon.is_busy = clock.now_s, lambda: False
        daemon.refusals["arm"] = "a student has the rig"
        with pytest.raises(RefusedError, match="a student has the rig"):
            rig.arm("a test")

    assert clock.now_s == gave_up_s < 106.0


@pytest.mark.usefixtures("clock")
def test_commands_are_repeated_after_a_temporary_refusal(
    daemon: BusyDaemon, tmp_path: Path
) -> None:
    daemon.busy = dict.fromkeys(("arm", "status", "reset", "calibrate"), 3)
    file = tmp_path / "calibration.toml"
    file.write_text("[theta_1]\nrad_per_count = 1e-4\n")

    with Rig(connect=daemon.endpoint) as rig:
        rig.calibrate(file)
        assert rig.status().phase == "safe"
        assert rig.reset() is True
        rig.arm("a test")

    assert daemon.refused == daemon.busy
    assert daemon.names() == ["calibrate", "reset", "arm", "disarm"]


def test_a_permanent_refusal_stops_the_run_of_its_client(daemon: BusyDaemon) -> None:
    daemon.refusals["status"] = "not for you"

    with Rig(connect=daemon.endpoint) as rig:
        rig.arm("a test")
        with pytest.raises(RefusedError, match="not for you"):
            rig.run([1.0, 2.0])

    assert "stop" in daemon.names()
