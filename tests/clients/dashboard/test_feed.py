"""The dashboard's memory of a rig: gaps, lateness, the past, and the rows that are new."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace as other
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from armrig.dashboard import feed as feed_module
from armrig.dashboard.feed import COARSE_S, FINE_S, HISTORY_S, LATE_US, Feed
from armrig.dashboard.stream import live_facts
from armrig_core.telemetry.telemetry import Sample

from tests.clients.fake_daemon import status_report
from tests.clients.made_recordings import event, gap, note, sample


def samples(*numbers: int) -> list[Sample]:
    """Return samples of these k, 10 ms apart."""
    return [sample(k) for k in numbers]


def late(k: int, lateness_us: float) -> Sample:
    """Return sample k with a late request."""
    plain = sample(k)
    return plain._replace(t_host_ns=plain.t_sched_ns + round(lateness_us * 1e3))


def state(t_s: int, phase: str) -> Any:
    """Return a state that the daemon publishes."""
    return SimpleNamespace(t_host_ns=t_s * 10**9, phase=phase)


def counted(feed: Feed) -> tuple[int, int, str]:
    """Return the missing and the unheard samples, and the last reason."""
    timing = feed.timing()
    return timing.missing, timing.unheard, timing.last_gap


def test_a_gap_that_is_reported_before_its_next_sample_is_counted() -> None:
    feed = Feed()
    feed.add_samples(samples(0, 1))
    feed.add_gaps([gap(3, 4, 1.0, "link silent")])
    feed.add_samples(samples(2))
    assert counted(feed) == (0, 0, "")

    feed.add_samples(samples(7, 8))

    assert counted(feed) == (4, 0, "link silent")


def test_a_repeated_sample_is_ignored() -> None:
    feed = Feed()
    feed.add_samples(samples(0, 1, 2))
    feed.add_samples(samples(1, 2, 3), live=False)

    assert feed.news().rows[:, 0].tolist() == [sample(k).t_sched_ns / 1e9 for k in range(4)]
    assert counted(feed) == (0, 0, "")


def test_each_new_row_is_reported_once() -> None:
    feed = Feed()
    feed.add_samples(samples(0, 1))
    first = feed.news()
    feed.add_samples(samples(2))

    second = feed.news(first.pieces)
    third = feed.news(second.pieces)

    assert [n.rows.shape[0] for n in (first, second, third)] == [2, 1, 0]
    assert feed.news(first.pieces).rows.shape[0] == 1  # another door has its own
    assert second.newest is not None
    assert third.newest is not None
    assert (second.newest.k, third.newest.k) == (2, 2)


def test_the_rate_does_not_depend_on_the_size_of_the_batches() -> None:
    """The rate is a slope over ten samples, most of which came in earlier pieces."""
    whole, piecewise = Feed(), Feed()
    whole.add_samples(samples(*range(30)))
    for k in range(0, 30, 3):
        piecewise.add_samples(samples(k, k + 1, k + 2))

    rates = whole.news().rows[:, 5:7]

    assert np.isfinite(rates[10:]).all()
    np.testing.assert_array_equal(piecewise.news().rows[:, 5:7], rates)


def test_news_are_collected_under_one_lock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise a row that the listener adds in between would be lost."""
    feed = Feed()
    feed.add_samples(samples(0))
    held: list[bool] = []
    feed._rows = _Watched(feed._rows, lambda: held.append(feed._lock.locked()))

    def now() -> float:
        held.append(feed._lock.locked())
        return 0.0

    monkeypatch.setattr(feed_module.time, "monotonic", now)
    feed.news()

    assert held
    assert all(held)


class _Watched(deque[Any]):
    """Rows that count how often they are read."""

    def __init__(self, rows: deque[Any], is_read: Any) -> None:
        super().__init__(rows)
        self._is_read = is_read

    def __reversed__(self) -> Iterator[Any]:
        self._is_read()
        return super().__reversed__()


def test_a_lateness_exactly_at_an_edge_belongs_to_the_lower_bar() -> None:
    """50 µs belongs to the first bar, because the title of a bar is "at most"."""
    feed = Feed()
    edges = [late(k, edge) for k, edge in enumerate(LATE_US)]
    feed.add_samples([*edges, late(len(LATE_US), LATE_US[-1] + 1)])

    assert feed.timing().late == [1] * (len(LATE_US) + 1)


def test_the_history_is_fine_up_to_its_edge_and_coarse_before_it() -> None:
    feed = Feed()
    # A second has 100 rows; one row a second is enough to see the edges.
    step, n = 100, round(HISTORY_S) + 3
    for k in range(n):
        feed.add_samples([sample(step * k)], live=False)

    t = feed.history()[:, 0]

    newest = sample(step * (n - 1)).t_sched_ns / 1e9
    assert t[-1] == newest
    assert t[0] == newest - HISTORY_S
    assert np.count_nonzero(t >= newest - FINE_S) == FINE_S + 1


def test_the_coarse_history_ends_where_the_fine_part_begins() -> None:
    """Five rows of 10 ms become one if they are 30 s older than the newest."""
    feed = Feed()
    feed.add_samples(samples(*range(3200)), live=False)

    t = feed.history()[:, 0]

    old, fine = t[t < t[-1] - FINE_S - 1e-9], t[t >= t[-1] - FINE_S - 1e-9]
    np.testing.assert_allclose(np.diff(old), COARSE_S, atol=1e-6)
    np.testing.assert_allclose(np.diff(fine), 0.01, atol=1e-6)
    assert fine.size >= FINE_S / 0.01


@pytest.mark.parametrize(("age_s", "is_stale"), [(0.3, False), (0.301, True), (np.inf, True)])
def test_data_are_stale_beyond_the_limit(age_s: float, is_stale: bool) -> None:
    facts = live_facts(other(Feed().news(), age_s=age_s), None)

    assert facts["is_stale"] is is_stale
    assert facts["age_s"] == (None if age_s == np.inf else age_s)


def test_a_restarted_clock_clears_the_history() -> None:
    """A restarted machine counts from 0; a sample that is a little late is no new clock."""
    feed = Feed()
    feed.add_samples(samples(500, 501))
    feed.add_samples(samples(450))
    assert feed.history().shape[0] == 2

    feed.add_samples(samples(0, 1, 2))

    assert feed.history().shape[0] == 3
    assert feed.news().newest == sample(2)


def test_samples_that_a_frozen_daemon_sends_late_clear_no_history() -> None:
    """The dashboard has read them already among the samples that the daemon keeps."""
    feed = Feed()
    feed.take_status(status_report(Ts=0.01))
    feed.add_samples(samples(*range(500, 1000)), live=False)

    feed.add_samples(samples(600, 601))

    assert feed.history().shape[0] == 500


def test_the_histogram_counts_live_samples_of_the_last_minute(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """62 s with one sample each: 60 samples count."""
    now = 1000.5  # a thread of another test may read the clock, too
    monkeypatch.setattr(feed_module.time, "monotonic", lambda: now)
    feed = Feed()
    feed.add_samples(samples(*range(5)), live=False)

    for k in range(5, 67):
        now = 995.5 + k
        feed.add_samples([late(k, 60.0 if k < 7 else 300.0)])

    assert sum(feed.timing().late) == 60
    assert feed.timing().late[1] == 0


def test_start_end_and_trip_are_marked() -> None:
    feed = Feed()
    phases = [
        "active",
        "active",
        "armed",
        "active",
        "safe",
        "active",
        "fault",
        "fault",
        "init",
        "safe",
    ]
    for k, phase in enumerate(phases):
        feed.add_states([state(k, phase)])
    told = feed.marks()
    feed.add_samples(samples(31_000))  # 310 s: what is older than five minutes is not shown

    assert [mark[:2] for mark in told] == [
        *((2.0, "end"), (3.0, "start"), (4.0, "end"), (5.0, "start"), (6.0, "trip")),
    ]
    assert feed.marks() == []


def test_repeated_states_are_marked_once() -> None:
    feed = Feed()
    phases = ("safe", "armed", "active", "safe", "armed", "active")
    states = [state(k, phase) for k, phase in enumerate(phases)]

    for part in (states[:4], states, states[4:]):
        feed.add_states(part)

    assert [mark[:2] for mark in feed.marks()] == [(2.0, "start"), (3.0, "end"), (5.0, "start")]


def test_a_restarted_clock_removes_earlier_marks() -> None:
    """Marks of the old clock would lie in the future."""
    feed = Feed()
    feed.add_samples(samples(100_000))
    feed.add_states([state(900, "safe"), state(901, "active")])
    feed.add_events([note(90_000, "before")])
    feed.add_states([state(1, "safe"), state(2, "active")])
    feed.add_events([note(200, "after")])

    feed.add_samples(samples(300))

    assert [mark[1:] for mark in feed.marks()] == [("start", ""), ("note", "after")]
    assert max(mark[0] for mark in feed.marks()) < 100.0


def test_a_note_is_marked_once_and_does_not_displace_a_start() -> None:
    feed = Feed()
    notes = [note(k, f"valve {k}") for k in range(500)]

    feed.add_states([SimpleNamespace(t_host_ns=1, phase=p) for p in ("safe", "active")])
    feed.add_events([*notes, *notes[-50:], event(7, "note by Ada: note")])

    (start, *marks) = feed.marks()
    assert start == (1e-9, "start", "")
    assert {mark[1] for mark in marks} == {"note"}
    assert marks[-1] == (sample(499).t_host_ns / 1e9, "note", "valve 499")
    assert len(marks) == len(set(marks)) == 100
