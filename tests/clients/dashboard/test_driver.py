"""The page's runs, one after the other, and its stop, which none of them outlives."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from armrig.dashboard.driver import BusyDriverError, CommandSender
from armrig.rig.session import NoReplyError
from armrig_core.commands import commands
from armrig_core.commands.commands import Rehearsal

from tests.clients.fake_daemon import FakeDaemon, step_plan

PLAN = step_plan("a page")


@pytest.fixture
def driver(daemon: FakeDaemon) -> Iterator[CommandSender]:
    """Give what drives the daemon's rig."""
    made = CommandSender(rig="1", connect=daemon.endpoint)
    yield made
    made.end()


def _play(driver: CommandSender, asked_s: float = 0.0) -> None:
    """Have the driver play a plan to its end; without a time, as requested now."""
    driver.start(PLAN, asked_s=asked_s or time.monotonic())
    while driver.run.is_going:
        time.sleep(0.01)


def test_a_stop_cancels_a_run_requested_before_it(
    driver: CommandSender, daemon: FakeDaemon
) -> None:
    """The daemon stops only an armed run, and a run is armed some time after its request."""
    asked_s = time.monotonic()
    driver.stop("somebody")
    _play(driver, asked_s)

    assert driver.run.error == "not started: stopped by somebody"
    assert daemon.names() == ["stop", "arm", "disarm"]


def test_a_stop_does_not_cancel_the_next_run(driver: CommandSender, daemon: FakeDaemon) -> None:
    driver.stop("somebody")
    _play(driver)

    assert daemon.names() == ["stop", "arm", "run"]


def test_a_run_starts_without_the_error_of_the_previous_run(
    driver: CommandSender, daemon: FakeDaemon
) -> None:
    daemon.refusals["arm"] = "busy"
    _play(driver)
    before = driver.run.error

    daemon.refusals.clear()
    _play(driver)

    assert (before != "", driver.run.error) == (True, "")


def test_a_closed_driver_accepts_no_run(driver: CommandSender, daemon: FakeDaemon) -> None:
    driver.end()
    with pytest.raises(BusyDriverError, match="the dashboard is ending"):
        driver.start(PLAN, asked_s=time.monotonic())

    assert not driver.run.is_going
    driver.end()  # nothing is held
    assert daemon.names() == []


class SlowDaemon(FakeDaemon):
    """Answers an arming when it is let."""

    def __init__(self, endpoint: str) -> None:
        super().__init__(endpoint)
        self.is_asked, self.answers = threading.Event(), threading.Event()

    def _carry_out(self, request: commands.DaemonRequest) -> Any:
        if request.name == "arm":
            self.is_asked.set()
            self.answers.wait(30.0)
        return super()._carry_out(request)


def test_the_end_of_a_driver_waits_for_an_arming(where: str) -> None:
    with SlowDaemon(where) as daemon:
        driver = CommandSender(rig="1", connect=daemon.endpoint)
        arming = threading.Thread(target=driver.arm, args=("a page", None))
        arming.start()
        daemon.is_asked.wait(30.0)
        threading.Timer(0.2, daemon.answers.set).start()
        driver.end()
        arming.join()

        assert daemon.names() == ["arm", "disarm"]


def test_a_run_is_reported_completely_at_its_end(
    driver: CommandSender, daemon: FakeDaemon, three_recordings: tuple[Path, Path, Path]
) -> None:
    daemon.recording = str(three_recordings[1])
    daemon.rehearsal = Rehearsal(revolutions=3.5, alpha_rad=0.2, turned_rad=21.0)
    _play(driver)

    run = driver.run
    assert (run.experiment, run.done, run.total, run.error) == ("step", 100, 100, "")
    assert "the chassis turns 3.5 times" in run.told
    assert run.recording == "estimation.mcap"
    assert run.verdict.startswith("the data are good: signal to noise")


def test_a_run_that_ends_early_has_a_recording_and_a_reason_without_a_remedy(
    driver: CommandSender, daemon: FakeDaemon, three_recordings: tuple[Path, Path, Path]
) -> None:
    daemon.recording, daemon.outcome = str(three_recordings[1]), "stopped by Ada"
    _play(driver)

    assert driver.run.recording == "estimation.mcap"
    assert driver.run.error == "the run ended after 100 of 100 samples: stopped by Ada"


def test_a_trip_is_reported_with_the_page_s_own_button(
    driver: CommandSender, daemon: FakeDaemon
) -> None:
    daemon.fault, daemon.remedy = "the link is silent", "see to the cable"
    daemon.refusals["arm"] = "in fault"
    _play(driver)

    assert driver.run.error == (
        "rig 1 is in fault: the link is silent; see to the cable; then press Reset"
    )


def test_a_reference_needs_a_run_under_a_law(driver: CommandSender) -> None:
    with pytest.raises(BusyDriverError, match="no run of this page is under a law"):
        driver.set_reference(1.0)


def test_a_stop_reaches_a_restarted_daemon(where: str) -> None:
    driver = CommandSender(rig="1", connect=where)
    with FakeDaemon(where):
        driver.stop("Ada")
    with FakeDaemon(where) as daemon:
        driver.stop("Ada")
        assert daemon.names() == ["stop"]
    with pytest.raises(NoReplyError):
        driver.stop("Ada")
    driver.end()


def test_a_stop_uses_the_connection_that_was_opened_for_it(
    driver: CommandSender, daemon: FakeDaemon
) -> None:
    driver.be_ready_to_stop()
    ready = driver._stopper
    driver.stop("Ada")

    assert ready is not None
    assert driver._stopper is ready
    assert daemon.names() == ["stop"]


def test_a_rig_held_by_the_page_is_released_once(driver: CommandSender, daemon: FakeDaemon) -> None:
    driver.arm("a page", 0.04)
    driver.arm("a page", None)

    assert [driver.release(), driver.release()] == [True, False]
    assert daemon.names() == ["arm", "disarm", "arm", "disarm"]
    asked = [r.Ts for r in daemon.asked if isinstance(r, commands.ArmRequest)]
    assert asked == [0.04, None]
