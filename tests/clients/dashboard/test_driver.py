"""The page's runs, one after the other, and its stop, which none of them outlives."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from armrig.dashboard.driver import Driver
from armrig.rig.collection import Plan
from fake_daemon import FakeDaemon

PLAN = Plan(
    experiment="step",
    make=lambda N, _: np.ones(N),
    details={},
    seconds=1.0,
    Ts=None,
    pacing="scheduled",
    owner="a page",
)


@pytest.fixture
def driver(daemon: FakeDaemon) -> Iterator[Driver]:
    """Give what drives the daemon's rig."""
    made = Driver(rig="1", connect=daemon.endpoint)
    yield made
    made.end()


def _wait_for_the_end(driver: Driver) -> None:
    while driver.run.is_going:
        time.sleep(0.01)


def test_a_stop_holds_for_a_run_that_was_asked_for_before(
    driver: Driver, daemon: FakeDaemon
) -> None:
    """A run is armed some time after it was asked for, and the daemon stops what is armed only."""
    asked_s = time.monotonic()
    driver.stop("somebody")
    driver.start(PLAN, asked_s=asked_s)
    _wait_for_the_end(driver)

    assert driver.run.error == "not begun: stopped by somebody"
    assert daemon.names() == ["stop", "arm", "disarm"]


def test_a_stop_does_not_hold_for_the_next_run(driver: Driver, daemon: FakeDaemon) -> None:
    """Who asks for a run after a stop means it."""
    driver.stop("somebody")
    driver.start(PLAN, asked_s=time.monotonic())
    _wait_for_the_end(driver)

    assert daemon.names() == ["stop", "arm", "run"]
