"""If there are too many connections one is closed, but none that is answered and reads."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from armrig.dashboard import connections
from armrig.dashboard.connections import Address, Connections


class Table:
    """Connections by a letter each, and which of them were closed."""

    def __init__(self) -> None:
        self.all = Connections()
        self.closed: list[str] = []

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
def table(monkeypatch: pytest.MonkeyPatch) -> Table:
    """Give a table for three."""
    monkeypatch.setattr(connections, "MOST", 3)
    return Table()


def test_the_oldest_that_asks_nothing_gives_way(table: Table) -> None:
    table.add("a", is_asked=True)
    table.add("b")
    table.add("c", is_asked=True, is_unread=True)
    assert table.closed == []
    table.add("d", is_asked=True)

    assert table.closed == ["b"]


def test_else_the_oldest_that_does_not_read_gives_way_and_at_last_the_new_one(table: Table) -> None:
    table.add("a", is_asked=True)
    table.add("b", is_asked=True, is_unread=True)
    table.add("c", is_asked=True, is_unread=True)
    for name in "def":
        table.add(name, is_asked=name != "f")

    assert table.closed == ["b", "c", "f"]


def test_one_that_has_left_makes_room_and_the_end_closes_the_rest(table: Table) -> None:
    for name in "abc":
        table.add(name)
    table.all.remove(table.address("b"))
    table.all.remove(table.address("b"))
    table.add("d")
    table.all.abort(table.address("a"))
    table.all.end()
    table.all.end()

    assert table.closed == ["a", "c", "d"]
