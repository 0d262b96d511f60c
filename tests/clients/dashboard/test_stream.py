"""A new viewer receives the present state, and each change; who does not read is dropped."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator
from contextlib import suppress

import numpy as np
import pytest
from armrig.dashboard.bins import Rows
from armrig.dashboard.driver import CommandSender, RunState
from armrig.dashboard.feed import LATE_US, Feed
from armrig.dashboard.stream import (
    MOST_VIEWERS,
    OPEN_S,
    HistoryEncoder,
    Stream,
    TooManyViewersError,
    Viewer,
    Viewers,
    event,
    history_messages,
)

from tests.clients.made_recordings import sample

COLUMNS = 9
BEFORE = RunState(experiment="step", error="refused")
GOING = RunState(experiment="step", is_going=True)


async def _until(name: str, messages: AsyncIterator[bytes]) -> list[bytes]:
    """Return the messages up to the first of a name."""
    found: list[bytes] = []
    async for message in messages:
        found.append(message)
        if message.startswith(b"event: %s\n" % name.encode()):
            break
    return found


def test_a_run_that_ends_between_two_updates_is_reported_as_ended() -> None:
    async def heard() -> list[bytes]:
        driver = CommandSender(rig="1", connect=None)
        driver.run = BEFORE
        stream = Stream(Feed(), driver, may_command=True)
        filling = asyncio.create_task(stream.fill())
        await _until("live", stream.messages(Viewer(lambda: None)))
        driver.run = GOING
        late = stream.messages(Viewer(lambda: None))
        told = await _until("run", late)
        driver.run = BEFORE
        told += await _until("live", late) + await _until("live", late)
        filling.cancel()
        with suppress(asyncio.CancelledError):
            await filling
        return [message for message in told if message.startswith(b"event: run\n")]

    assert asyncio.run(heard()) == [event("run", GOING), event("run", BEFORE)]


def test_a_viewer_that_leaves_frees_its_place() -> None:
    async def counts() -> list[int]:
        stream = Stream(Feed(), CommandSender(rig="1", connect=None), may_command=True)
        found = []
        for read in (1, 4):
            messages = stream.messages(Viewer(lambda: None))
            for _ in range(read):
                await anext(messages)
            found.append(len(stream.viewers))
            await messages.aclose()  # type: ignore[attr-defined]
            found.append(len(stream.viewers))
        return found

    assert asyncio.run(counts()) == [1, 0, 1, 0]


def test_a_new_viewer_receives_the_whole_history_and_each_state_once() -> None:
    async def heard() -> tuple[list[bytes], list[bytes]]:
        feed = Feed()
        feed.add_samples([sample(k) for k in range(1203)], live=False)
        feed.news()
        stream = Stream(feed, CommandSender(rig="1", connect=None), may_command=True)
        messages = stream.messages(Viewer(lambda: None))
        first = await _until("whole", messages)
        filling = asyncio.create_task(stream.fill())
        then = [*await _until("live", messages), *await _until("live", messages)]
        filling.cancel()
        with suppress(asyncio.CancelledError):
            await filling
        return first, then

    first, then = asyncio.run(heard())

    kinds = [message.split(b"\n")[0].decode().removeprefix("event: ") for message in first]
    assert kinds[:7] == ["hello", "rig", "status", "run", "marks", "control", "timing"]
    assert kinds[7:] == ["past", "past", "past", "whole"]
    hello = {"may_command": True, "late_us": LATE_US, "command": "armrig dashboard"}
    assert first[0] == event("hello", hello)
    rows = [row for m in first if m.startswith(b"event: past") for row in json.loads(m[18:])]
    assert [row[0] for row in rows] == [round(1 + k / 100, 3) for k in range(1203)]
    assert not [m for m in then if m.startswith((b"event: status", b"event: run"))]


def test_simultaneous_viewers_are_admitted_one_after_the_other() -> None:
    async def times_s() -> list[float]:
        stream = Stream(Feed(), CommandSender(rig="1", connect=None), may_command=True)

        async def let_in_s() -> float:
            await anext(stream.messages(Viewer(lambda: None)))
            return time.monotonic()

        return await asyncio.gather(*(let_in_s() for _ in range(5)))

    times = asyncio.run(times_s())

    assert min(np.diff(times)) > 0.9 * OPEN_S


def test_the_number_of_waiting_viewers_is_limited() -> None:
    async def tried() -> None:
        stream = Stream(Feed(), CommandSender(rig="1", connect=None), may_command=True)
        first = [
            asyncio.create_task(anext(stream.messages(Viewer(lambda: None))))  # type: ignore[arg-type]
            for _ in range(MOST_VIEWERS)
        ]
        await asyncio.sleep(0)
        with pytest.raises(TooManyViewersError, match="try again"):
            await anext(stream.messages(Viewer(lambda: None)))
        assert not any(task.done() for task in first)
        for task in first:
            task.cancel()
        await asyncio.wait(first)
        await anext(stream.messages(Viewer(lambda: None)))

    asyncio.run(tried())


def test_visitors_do_not_take_the_places_of_operators() -> None:
    async def tried() -> None:
        driver = CommandSender(rig="1", connect=None)
        visitors = Stream(Feed(), driver, may_command=False)
        for _ in range(MOST_VIEWERS):
            visitors.viewers.add(Viewer(lambda: None))
        with pytest.raises(TooManyViewersError, match="close one"):
            await anext(visitors.messages(Viewer(lambda: None)))
        await anext(Stream(Feed(), driver, may_command=True).messages(Viewer(lambda: None)))

    asyncio.run(tried())


def test_the_history_is_encoded_once_for_all_waiting_viewers() -> None:
    """A hundred viewers cost one encoding."""
    made: list[int] = []

    def rows() -> dict[str, Rows]:
        made.append(len(made))
        return {"past": np.full((1, COLUMNS), float(len(made)))}

    async def heard() -> list[list[bytes]]:
        history = HistoryEncoder(rows)
        first = [asyncio.create_task(history.messages()) for _ in range(100)]
        found = await asyncio.gather(*first)
        return [*found, await history.messages()]

    found = asyncio.run(heard())

    assert made == [0, 1]
    assert found[:-1] == [history_messages({"past": np.full((1, COLUMNS), 1.0)})] * 100
    assert found[-1] == history_messages({"past": np.full((1, COLUMNS), 2.0)})


def test_a_viewer_that_leaves_does_not_cancel_the_history_of_others() -> None:
    async def heard() -> list[bytes]:
        history = HistoryEncoder(lambda: {"past": np.zeros((0, COLUMNS))})
        gone, stays = (asyncio.create_task(history.messages()) for _ in range(2))
        await asyncio.sleep(0)
        gone.cancel()
        return await stays

    assert asyncio.run(heard()) == history_messages({"past": np.zeros((0, COLUMNS))})


def test_a_long_history_is_sent_in_pieces() -> None:
    rows = np.zeros((1001, COLUMNS))
    rows[:, 0] = np.arange(1001)

    *pieces, last = history_messages({"past": rows})

    sent = [row for piece in pieces for row in json.loads(piece.partition(b"data: ")[2])]
    assert [row[0] for row in sent] == [*range(1001)]
    assert max(map(len, pieces)) < 40_000
    assert last == event("whole", {})


def test_the_end_of_the_server_drops_a_viewer_that_has_not_read_its_messages() -> None:
    async def heard() -> tuple[list[bytes], list[bytes], bool]:
        viewers = Viewers()
        full, other = Viewer(lambda: None), Viewer(lambda: None)
        viewers.add(full)
        viewers.add(other)
        while not full._waiting.full():
            full.offer(b"a")
        other.offer(b"b")
        viewers.end()
        ends = [[message async for message in viewer.messages()] for viewer in (full, other)]
        return ends[0], ends[1], full.is_dropped

    assert asyncio.run(heard()) == ([], [b"b"], True)


def test_each_dropped_viewer_is_counted() -> None:
    async def told() -> tuple[int, list[bytes], bool]:
        viewers = Viewers()
        deaf = [Viewer(lambda: None) for _ in range(3)]
        for viewer in deaf:
            viewers.add(viewer)
        for _ in range(1000):
            viewers.send(b"x")
        late = Viewer(lambda: None)
        viewers.add(late)
        viewers.send(b"y")
        viewers.end()
        heard = []
        for viewer in (*deaf, late):
            heard += [message async for message in viewer.messages()]
        return viewers.dropped, heard, late.is_dropped

    assert asyncio.run(told()) == (3, [b"y"], False)
