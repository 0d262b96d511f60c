"""Each viewer has a bound, and who does not read is dropped."""

from __future__ import annotations

import asyncio

import pytest
from armrig.dashboard.stream import MOST_VIEWERS, TooManyViewersError, Viewer, Viewers


def test_the_number_of_viewers_is_limited() -> None:
    async def tried() -> None:
        viewers = Viewers()
        for _ in range(MOST_VIEWERS):
            viewers.add(last := Viewer(lambda: None))
        with pytest.raises(TooManyViewersError, match="close one"):
            viewers.add(Viewer(lambda: None))
        viewers.remove(last)
        viewers.add(Viewer(lambda: None))

    asyncio.run(tried())


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
