"""If there are too many connections one is closed, but none that is answered and reads."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import pytest
import uvicorn
from armrig.dashboard.guard import MOST_CONNECTIONS, Address, BoundedProtocol, Connections
from armrig.dashboard.serving import QUIET
from uvicorn.server import ServerState


class Table:
    """Connections by a letter each, with room for three of them, and which of them were closed."""

    def __init__(self) -> None:
        self.all = Connections()
        self.closed: list[str] = []
        for k in range(MOST_CONNECTIONS - 3):
            self.add(chr(1000 + k), is_asked=True)

    def add(self, name: str, *, is_asked: bool = False, is_unread: bool = False) -> None:
        """Take one more."""
        transport = SimpleNamespace(abort=lambda: self.closed.append(name))
        protocol: Any = SimpleNamespace(is_asked=is_asked, is_unread=is_unread, transport=transport)
        self.all.add(self.address(name), protocol)

    @staticmethod
    def address(name: str) -> Address:
        """Return the address of a letter."""
        return (name, ord(name))


@pytest.fixture
def table() -> Table:
    """Give a table."""
    return Table()


def test_the_oldest_connection_without_a_request_is_closed_first(table: Table) -> None:
    table.add("a", is_asked=True)
    table.add("b")
    table.add("c", is_asked=True, is_unread=True)
    assert table.closed == []
    table.add("d", is_asked=True)

    assert table.closed == ["b"]


def test_the_oldest_unread_connection_is_closed_next_and_the_new_one_last(table: Table) -> None:
    table.add("a", is_asked=True)
    table.add("b", is_asked=True, is_unread=True)
    table.add("c", is_asked=True, is_unread=True)
    for name in "def":
        table.add(name, is_asked=name != "f")

    assert table.closed == ["b", "c", "f"]


def test_a_closed_connection_frees_its_place_and_the_end_closes_all(table: Table) -> None:
    for name in "abc":
        table.add(name)
    table.all.remove(table.address("b"))
    table.all.remove(table.address("b"))
    table.add("d")
    table.all.abort(table.address("a"))
    table.all.end()
    table.all.end()

    assert table.closed[0] == "a"
    assert table.closed[-2:] == ["c", "d"]
    assert len(table.closed) == MOST_CONNECTIONS


def test_a_connection_is_busy_from_its_request_to_the_end_of_its_response() -> None:
    seen: list[bool] = []
    table, made = Connections(), list[BoundedProtocol]()

    async def app(scope: Any, receive: Any, send: Callable[[Any], Awaitable[None]]) -> None:
        seen.append(made[0].is_asked)  # its body has not come
        while (await receive()).get("more_body"):
            pass
        seen.append(made[0].is_asked)
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b"ab", "more_body": True})
        seen.append(made[0].is_asked)
        await send({"type": "http.response.body", "body": b"c"})

    async def talk() -> list[Any]:
        config = uvicorn.Config(app, **QUIET)
        config.load()
        loop, kind = asyncio.get_running_loop(), table.protocol()

        def new() -> BoundedProtocol:
            made.append(kind(config, ServerState(), {}, loop))
            return made[-1]

        server = await loop.create_server(new, "127.0.0.1", 0)
        address = server.sockets[0].getsockname()
        reader, writer = await asyncio.open_connection(*address)
        _, other = await asyncio.open_connection(*address)
        writer.write(b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 4\r\n\r\nbo")
        while not seen:
            await asyncio.sleep(0.001)
        writer.write(b"dy")
        await reader.readuntil(b"c\r\n0\r\n")
        seen.append(made[0].is_asked)
        limits = made[0].transport.get_write_buffer_limits()
        found: list[Any] = [len(table._open), limits[1]]
        writer.close()
        while len(table._open) > 1:
            await asyncio.sleep(0.001)
        found.append([*table._open] == [other.get_extra_info("sockname")])
        table.end()
        server.close()
        other.close()
        for one in (writer, other):
            with suppress(ConnectionError):
                await one.wait_closed()
        return found

    found = asyncio.run(asyncio.wait_for(talk(), 20.0))

    assert seen == [False, True, True, False]
    assert found == [2, 16_384, True]
