"""Whoever connects is told how all is now, and each change from there on."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import suppress

from armrig.dashboard.driver import Driver, RunState
from armrig.dashboard.feed import Feed
from armrig.dashboard.messages import event
from armrig.dashboard.stream import Stream
from armrig.dashboard.viewers import Viewer
from made_recordings import sample

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


def test_a_run_that_is_over_before_the_next_turn_is_told_as_over() -> None:
    """It ends as the last one did, and who came in between has seen it go: he is told its end."""

    async def heard() -> list[bytes]:
        driver = Driver(rig="1", connect=None)
        driver.run = BEFORE
        stream = Stream(Feed(), driver)
        filling = asyncio.create_task(stream.fill())
        await _until("live", stream.messages(Viewer(lambda: None, may_command=True)))
        driver.run = GOING
        late = stream.messages(Viewer(lambda: None, may_command=True))
        told = await _until("run", late)
        driver.run = BEFORE
        told += await _until("live", late) + await _until("live", late)
        filling.cancel()
        with suppress(asyncio.CancelledError):
            await filling
        return [message for message in told if message.startswith(b"event: run\n")]

    assert asyncio.run(heard()) == [event("run", GOING), event("run", BEFORE)]


def test_a_viewer_who_leaves_makes_room() -> None:
    """In the middle of the past, or while the stream waits for what comes."""

    async def counts() -> list[int]:
        stream = Stream(Feed(), Driver(rig="1", connect=None))
        found = []
        for read in (1, 4):
            messages = stream.messages(Viewer(lambda: None, may_command=True))
            for _ in range(read):
                await anext(messages)
            found.append(len(stream.viewers))
            await messages.aclose()  # type: ignore[attr-defined]
            found.append(len(stream.viewers))
        return found

    assert asyncio.run(counts()) == [1, 0, 1, 0]


def test_who_connects_is_told_the_whole_past_and_each_state_once() -> None:
    """The past in pieces, each row once and in order; what does not change is not told again."""

    async def heard() -> tuple[list[bytes], list[bytes]]:
        feed = Feed()
        feed.add_samples([sample(k) for k in range(1203)], live=False)
        feed.news()
        stream = Stream(feed, Driver(rig="1", connect=None))
        messages = stream.messages(Viewer(lambda: None, may_command=True))
        first = await _until("whole", messages)
        filling = asyncio.create_task(stream.fill())
        then = [*await _until("live", messages), *await _until("live", messages)]
        filling.cancel()
        with suppress(asyncio.CancelledError):
            await filling
        return first, then

    first, then = asyncio.run(heard())

    kinds = [message.split(b"\n")[0].decode().removeprefix("event: ") for message in first]
    assert kinds == ["hello", "status", "run", "timing", "past", "past", "past", "whole"]
    rows = [row for m in first if m.startswith(b"event: past") for row in json.loads(m[18:])]
    assert [row[0] for row in rows] == [round(1 + k / 100, 3) for k in range(1203)]
    assert not [m for m in then if m.startswith((b"event: status", b"event: run"))]
