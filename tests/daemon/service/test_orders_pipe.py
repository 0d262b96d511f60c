"""The service's ends of the loop's pipes: nothing is lost or torn, and no end blocks."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest
from armrig_daemon.pipe import Alive, Run

from tests.daemon.loop_ends import LoopEnds

RUN = Run(lease="a" * 32, n=1, run_id="r", codes=bytes(range(256)) * 1000)


@pytest.fixture
def loop() -> Iterator[LoopEnds]:
    """Give both ends of both pipes."""
    loop = LoopEnds()
    yield loop
    loop.close()


def test_orders_wait_for_room_in_the_pipe_and_arrive_whole_and_in_order(loop: LoopEnds) -> None:
    assert not os.get_blocking(loop.child.orders_fd)

    loop.child.order(RUN)
    assert loop.child.is_behind
    loop.child.order(Alive())

    taken = loop.orders()
    while loop.child.is_behind:
        loop.child.flush()
        taken += loop.orders()
    assert taken + loop.orders() == [RUN, Alive()]


def test_orders_to_a_dead_loop_are_discarded(loop: LoopEnds) -> None:
    loop.read_no_more()

    loop.child.order(RUN)

    assert not loop.child.is_behind
