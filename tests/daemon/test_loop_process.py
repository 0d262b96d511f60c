"""The loop's pipes and its line, by the real descriptors."""

from __future__ import annotations

import os
import select
import tty
from collections.abc import Iterator

import pytest
from armrig_daemon import realtime
from armrig_daemon.config import Config
from armrig_daemon.link import READ
from armrig_daemon.loop_process import ProcessPorts, Settings
from armrig_daemon.records import Alive, record_bytes
from armrig_daemon.state import LinkDown, LinkUp, Ordered, Received, ServiceGone

MS = 1_000_000


@pytest.fixture
def pipes() -> Iterator[dict[str, int]]:
    """Give both pipes and a pseudo-terminal; what the test has closed stays closed."""
    master, slave = os.openpty()
    orders_out, orders_in = os.pipe()
    records_out, records_in = os.pipe()
    for fd in (orders_out, records_in):
        os.set_blocking(fd, False)
    given = {
        "orders_out": orders_out,
        "orders_in": orders_in,
        "records_out": records_out,
        "records_in": records_in,
        "master": master,
        "slave": slave,
    }
    yield given
    for fd in given.values():
        os.close(fd)


@pytest.fixture
def ports(pipes: dict[str, int]) -> ProcessPorts:
    """Return ports whose line is open."""
    settings = Settings(
        rules=Config().rules(),
        port=os.ttyname(pipes["slave"]),
        baud=115_200,
        priority=0,
        cpu=None,
        spin_ns=0,
    )
    ports = ProcessPorts(settings, pipes["orders_out"], pipes["records_in"])
    assert ports.wait(realtime.now_ns()) == [LinkUp()]
    return ports


def test_a_record_that_nobody_takes_does_not_hide_the_end_of_the_service(
    ports: ProcessPorts, pipes: dict[str, int]
) -> None:
    """A killed service: the loop may write before it reads, and must stop all the same."""
    os.close(pipes.pop("records_out"))
    assert not ports.put(b"a record")

    os.close(pipes.pop("orders_in"))

    assert ports.wait(realtime.now_ns() + 100 * MS) == [ServiceGone()]
    assert ports.wait(realtime.now_ns() + MS) == []


def test_what_comes_at_once_is_handed_on_in_pieces_and_without_another_wait(
    ports: ProcessPorts, pipes: dict[str, int]
) -> None:
    """A piece fits into a record of the trace; the terminal tells of all of them once."""
    tty.setraw(pipes["slave"])
    sent = bytes(range(1, 251)) * 12
    os.write(pipes["master"], sent)

    come = []
    while sum(map(len, come)) < len(sent):
        (event,) = ports.wait(realtime.now_ns() + 10_000 * MS)
        assert isinstance(event, Received)
        come.append(event.data)

    assert b"".join(come) == sent
    assert max(map(len, come)) <= READ


def test_a_line_that_is_cut_is_read_to_its_end_and_then_said_to_be_gone(
    ports: ProcessPorts, pipes: dict[str, int]
) -> None:
    """The kernel tells both at once, and once only."""
    tty.setraw(pipes["slave"])
    os.write(pipes["master"], b"last words")
    os.close(pipes.pop("master"))

    events = []
    while not any(isinstance(event, LinkDown) for event in events):
        events += ports.wait(realtime.now_ns() + 10_000 * MS)

    assert len([event for event in events if isinstance(event, LinkDown)]) == 1


def test_an_order_and_an_answer_that_came_together_are_both_taken(
    ports: ProcessPorts, pipes: dict[str, int]
) -> None:
    """The answer is told once: what stands beside it must not hide it."""
    tty.setraw(pipes["slave"])
    os.write(pipes["orders_in"], record_bytes(Alive()))
    os.write(pipes["master"], b"answer")
    select.select([pipes["slave"]], [], [])  # both are there

    events = ports.wait(realtime.now_ns() + 10_000 * MS)
    while len(events) < 2:
        events += ports.wait(realtime.now_ns() + 10_000 * MS)

    assert {type(event) for event in events} == {Ordered, Received}
