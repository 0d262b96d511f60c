"""A live stream has no silent break: a missing sample is a value of the stream."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isnan
from typing import Any

import pytest
import zenoh
from armrig.cli import main
from armrig.rig import telemetry_stream
from armrig.rig.session import open_session
from armrig.rig.telemetry_stream import LiveGap, Newest, arrivals, gaps_between, stream
from armrig_core.commands.codes import GapCode
from armrig_core.telemetry import telemetry
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.clients.fake_daemon import FakeDaemon
from tests.clients.made_recordings import event, gap, sample

spans = st.lists(st.tuples(st.integers(0, 60), st.integers(1, 20)), max_size=8)


@given(st.integers(0, 50), st.integers(0, 50), spans)
def test_missing_samples_are_reported_once_and_in_order(
    first: int, second: int, told: list[tuple[int, int]]
) -> None:
    gaps = [gap(k, n, 1.0) for k, n in told]

    found = list(gaps_between(sample(first), sample(second), gaps))

    assert [k for g in found for k in range(g.k_first, g.k_first + g.count)] == list(
        range(first + 1, second)
    )
    for one in found:
        inside = range(one.k_first, one.k_first + one.count)
        covered = {k for k in inside if any(a <= k < a + n for a, n in told)}
        assert covered == (set() if one.published else set(inside))
        assert isnan(one.u_held_v) == one.published


def published(daemon: FakeDaemon, k: int) -> None:
    daemon.session.put("rig/1/sample", telemetry.encode_sample(sample(k)))


def up_to(samples: Iterator[Any], k: int) -> list[Any]:
    values = [next(samples)]
    while getattr(values[-1], "k", -1) != k:
        values.append(next(samples))
    return values


def test_a_slow_listener_is_notified_of_its_missing_samples(
    daemon: FakeDaemon, where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(telemetry_stream, "_RING_MESSAGES", 10)
    samples = stream("rig/1/sample", connect=where)
    begun = threading.Event()

    def publish() -> None:
        k = 0
        while not begun.wait(0.005):
            published(daemon, k)
            k += 1
        for later in range(k, k + 1000):
            published(daemon, later)

    thread = threading.Thread(target=publish)
    thread.start()
    first = next(samples)
    begun.set()
    thread.join()  # meanwhile nobody reads
    published(daemon, 9999)
    found = [first, *up_to(samples, 9999)]
    samples.close()

    counted = [
        k
        for f in found
        for k in (range(f.k_first, f.k_first + f.count) if isinstance(f, LiveGap) else [f.k])
    ]
    assert counted == list(range(first.k, 10_000))
    assert {f.code for f in found if isinstance(f, LiveGap)} == {GapCode.LISTENER_LATE}


@pytest.fixture
def lots(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Give a function that replaces the line by lots: no machine makes the same lots twice."""

    def come(samples: list[list[int]], gaps: list[list[tuple[int, int]]]) -> None:
        script = {
            "sample": [[sample(k) for k in lot] for lot in samples],
            "gap": [[gap(k, count, 2.5) for k, count in lot] for lot in gaps],
            "control": [],
        }

        @contextmanager
        def arrivals(_: zenoh.Session, key: str) -> Iterator[Callable[[], list[Any]]]:
            of_stream = iter(script[key.rsplit("/", 1)[1]])
            yield lambda: next(of_stream, [])

        monkeypatch.setattr(telemetry_stream, "arrivals", arrivals)

    return come


@pytest.mark.parametrize(
    ("samples", "gaps", "expected"),
    [
        pytest.param([[1, 5, 6]], [[(2, 3)]], [1, (2, 3, "unknown"), 5, 6], id="in its place"),
        pytest.param([[1, 2, 6, 7]], [], [1, 2, (3, 3, "listener_late"), 6, 7], id="dropped"),
        pytest.param([[900, 901, 5, 6]], [], [900, 901, 5, 6], id="the daemon counts again"),
        pytest.param(
            [[1, 2, 5, 6], [7], [9]],
            [[(3, 2), (8, 1)]],
            [1, 2, (3, 2, "unknown"), 5, 6, 7, (8, 1, "unknown"), 9],
            id="the gap came before its place",
        ),
        pytest.param(
            [[1, 4], [1, 4, 5]],
            [[(2, 2)]],
            [1, (2, 2, "unknown"), 4, 1, (2, 2, "listener_late"), 4, 5],
            id="a gap covers only samples before the daemon counts again",
        ),
    ],
)
@pytest.mark.usefixtures("daemon")
def test_a_stream_contains_each_gap_between_its_samples(
    lots: Callable[..., None],
    where: str,
    samples: list[list[int]],
    gaps: list[list[tuple[int, int]]],
    expected: list[Any],
) -> None:
    lots(samples, gaps)
    heard = stream("rig/1/sample", connect=where)
    found = up_to(heard, samples[-1][-1])
    heard.close()

    shown = [(f.k_first, f.count, f.code) if isinstance(f, LiveGap) else f.k for f in found]
    assert shown == expected


def test_another_publisher_cannot_fill_the_memory_of_a_listener(
    daemon: FakeDaemon, where: str
) -> None:
    """100 MB arrive without a reader: the newest 16 MiB are kept."""
    large = event(0, "x" * (1 << 20)).SerializeToString()
    last = event(0, "last").SerializeToString()
    with (
        open_session(where, rig="1") as session,
        arrivals(session, "rig/1/event") as events_since,
        arrivals(session, "rig/1/gap") as gaps_since,
    ):
        while not gaps_since():  # until the daemon has heard of us
            daemon.session.put("rig/1/gap", gap(1, 1, 1.0).SerializeToString())
            time.sleep(0.01)
        all_come = {"congestion_control": zenoh.CongestionControl.BLOCK}
        for data in (*[large] * 100, last):
            daemon.session.put("rig/1/event", data, **all_come)
        daemon.session.put("rig/1/gap", gap(2, 1, 1.0).SerializeToString(), **all_come)
        while not any(g.k_first == 2 for g in gaps_since()):
            time.sleep(0.01)

        kept = events_since()

    assert len(kept) == 16
    assert kept[-1].message == "last"
    assert sum(one.ByteSize() for one in kept) <= 16 << 20


@pytest.mark.usefixtures("daemon")
def test_watch_shows_a_gap(
    lots: Callable[..., None], where: str, capsys: pytest.CaptureFixture[str]
) -> None:
    lots([[0, 3, 6]], [])

    assert main(["watch", "--connect", where, "--count", "4"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert main(["watch", "--connect", where, "--count", "4", "--json"]) == 0
    values = [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    assert sum(f"2 missing: {GapCode.LISTENER_LATE.sentence}" in line for line in lines) == 2
    assert [value["count"] for value in values if "k_first" in value] == [2, 2]


@settings(max_examples=30)
@example([12, 8, 1, 1, 1, 1, (4,), 12, 8, None, 12, 8])
@given(st.lists(st.none() | st.integers(0, 12) | st.tuples(st.integers(0, 40)), max_size=40))
def test_a_bounded_queue_keeps_the_newest_messages(steps: list[int | tuple[int] | None]) -> None:
    """At most 4 items and 20 B."""
    queue, model = Newest[tuple[int, int]](4, 20), list[tuple[int, int]]()
    for number, step in enumerate(steps):
        if step is None:
            assert queue.take() == model
            model.clear()
        elif isinstance(step, tuple):
            last = step[0]
            queue.forget_while(lambda one, last=last: one[0] < last)  # type: ignore[misc]
            model = [one for one in model if one[0] >= last]
        else:
            queue.add((number, step), step)
            model.append((number, step))
            while len(model) > 4 or sum(size for _, size in model) > 20:
                del model[0]

        assert (list(queue), len(queue)) == (model, len(model))
