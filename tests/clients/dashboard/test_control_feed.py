"""Run in control: its reference, the limits of its law, and its shares."""

from __future__ import annotations

from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from armrig.dashboard.control_feed import ControlFeed, law_of_run
from armrig.dashboard.feed import Feed
from armrig_core.control.control_law import ControlLaw, LawOutput, Reference

from tests.clients.fake_daemon import FakeDaemon
from tests.core.control.laws import arm_law

SPEED = arm_law(hi=3.2)
HEATER = ControlLaw(
    Ts_us=1_000_000,
    input="power",
    outputs=(LawOutput(name="T1", unit="degC", y0=33.0),),
    reference=Reference(name="T1", unit="degC", low=23.0, high=60.0),
    A=(),
    B=(),
    C=(),
    D=0.1,
    x0=(),
)


def decision(k: int, r: float = 2.0, **changes: Any) -> Any:
    """Return a decision of the stream `control`, 10 ms after the one before."""
    bits = {"is_low": False, "is_high": False, "is_slewed": False, "predicted": 0}
    return SimpleNamespace(k=k, t_host_ns=1_000_000_000 + 10_000_000 * k, r=r, **bits | changes)


def state(phase: str, k: int) -> Any:
    return SimpleNamespace(phase=phase, t_host_ns=1_000_000_000 + 10_000_000 * k)


def control_feed(law: ControlLaw, ks: range, **changes: Any) -> ControlFeed:
    """Return a feed with decisions of a law."""
    feed = ControlFeed()
    feed.add([decision(k, **changes) for k in ks], 300.0)
    feed.take_law(law)
    return feed


def facts(feed: ControlFeed, *, is_going: bool = True) -> Any:
    return feed.facts(is_going=is_going)


def test_the_page_is_told_what_r_is() -> None:
    feed = control_feed(HEATER, range(3))

    found = facts(feed)
    assert (found["name"], found["unit"], found["span"], found["output"]) == ("T1", "°C", 37, "T1")
    assert found["law"] == HEATER.sha256
    assert feed.rows().tolist() == [[1.0, 2, 2], [1.01, 2, 2], [1.02, 2, 2]]


def test_decisions_that_arrive_twice_count_once() -> None:
    feed = control_feed(SPEED, range(4), is_high=True)
    feed.add([decision(k) for k in range(8)], 300.0)

    assert facts(feed, is_going=False)["shares"] == "input at its limit in 50 % of samples"
    assert feed.rows().shape == (8, 3)


def test_the_limits_of_a_law_are_in_force_while_its_run_is_in_progress() -> None:
    feed = control_feed(SPEED, range(4))

    assert facts(feed)["limits"] == (-inf, 3.2)
    assert facts(feed, is_going=False)["limits"] == (-inf, inf)


def test_another_law_begins_without_the_reference_of_the_previous_law() -> None:
    feed = control_feed(SPEED, range(4))
    before, seen = facts(feed)["first_s"], feed.pieces
    feed.begin(decision(100).t_host_ns)
    feed.add([decision(k, predicted=1) for k in range(100, 103)], 300.0)
    feed.take_law(SPEED)
    assert facts(feed)["first_s"] == before
    feed.begin(decision(200).t_host_ns)
    feed.add([decision(k, predicted=1) for k in range(200, 203)], 300.0)
    feed.take_law(HEATER)

    found = facts(feed, is_going=False)
    assert (found["first_s"], found["name"]) == (3.0, "T1")
    assert found["shares"].endswith("0 % of samples, 3 decisions without the newest sample")
    assert feed.rows(seen).shape == (6, 3)


def test_the_law_is_looked_for_in_the_recording_until_it_can_be_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    feed = Feed()
    feed.take_status(FakeDaemon("there").status())
    laws = [None, None, SPEED]
    monkeypatch.setattr("armrig.dashboard.feed.law_of_run", lambda _: laws.pop(0))
    feed.add_states([state("armed", 0), state("active", 1)])
    feed.add_decisions([decision(k, predicted=1) for k in range(4)])
    while feed.control() is None:
        feed._control._looked_s = -inf
        feed.look_for_law()
    feed.look_for_law()  # the law is known

    found: Any = feed.control()
    assert (laws, found["law"]) == ([], SPEED.sha256)
    assert found["shares"].endswith("3 decisions without the newest sample")  # since the start
    assert feed.news().reference.shape == feed.reference().shape == (4, 3)


def test_a_run_without_a_known_law_has_its_reference_and_its_limits() -> None:
    feed = ControlFeed()
    feed.add([decision(0, predicted=1)], 300.0)
    for _ in range(8):
        assert facts(feed) is None
        feed.take_law(None)

    assert facts(feed) == {"first_s": -1e-9, "shares": "input at its limit in 0 % of samples"}


def test_old_decisions_are_forgotten() -> None:
    feed = control_feed(SPEED, range(2))
    feed.add([decision(40_000)], 300.0)

    assert feed.rows()[:, 0].tolist() == [401.0]


def test_a_file_that_is_no_recording_names_no_law(tmp_path: Path) -> None:
    daemon = FakeDaemon("there")
    daemon.recording = str(tmp_path / "a.mcap")
    (tmp_path / "a.mcap").write_bytes(b"x")

    assert law_of_run(daemon.status()) is None
    assert law_of_run(None) is None
