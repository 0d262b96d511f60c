"""The loop's pipes and its line, by the real descriptors."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest
from armrig_daemon import realtime
from armrig_daemon.config import Config
from armrig_daemon.loop_process import ProcessPorts, Settings
from armrig_daemon.state import LinkUp, ServiceGone

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
