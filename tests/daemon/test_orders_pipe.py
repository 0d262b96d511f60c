"""The service's ends of the loop's pipes: nothing is lost, nothing torn, nobody waited for."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator

import pytest
from armrig_daemon.loop_child import LoopChild
from armrig_daemon.records import Alive, Host, Log, Orders, Play, record_bytes, take_orders

PLAY = Play(lease="a" * 32, n=1, run_id="r", codes=bytes(range(256)) * 1000)


class Loop:
    """The loop's ends of both pipes, in our hands."""

    def __init__(self) -> None:
        self.orders_fd, orders_in = os.pipe()
        records_out, self.records_fd = os.pipe()
        os.set_blocking(self.orders_fd, False)
        self.child = LoopChild(subprocess.Popen(["true"]), orders_in, records_out)
        self._pending = bytearray()

    def orders(self) -> list[Orders]:
        """Take what there is."""
        try:
            self._pending += os.read(self.orders_fd, 1 << 16)
        except BlockingIOError:
            return []
        return take_orders(self._pending)


@pytest.fixture
def loop() -> Iterator[Loop]:
    """Give both ends of both pipes."""
    loop = Loop()
    yield loop
    assert loop.child.end() == 0
    os.close(loop.records_fd)
    if loop.orders_fd >= 0:
        os.close(loop.orders_fd)


def test_orders_that_find_no_room_wait_and_come_whole_and_in_order(loop: Loop) -> None:
    """A long experiment is more than the pipe holds; a frozen loop does not freeze us."""
    assert not os.get_blocking(loop.child.orders_fd)

    loop.child.order(PLAY)
    assert loop.child.is_behind
    loop.child.order(Alive())

    taken = loop.orders()
    while loop.child.is_behind:
        loop.child.flush()
        taken += loop.orders()
    assert taken + loop.orders() == [PLAY, Alive()]


def test_orders_to_a_loop_that_is_gone_wait_for_nothing(loop: Loop) -> None:
    """Its end is seen at its records; what is not taken must not keep us awake."""
    os.close(loop.orders_fd)
    loop.orders_fd = -1

    loop.child.order(PLAY)

    assert not loop.child.is_behind


def test_records_come_whole_however_the_pipe_cuts_them(loop: Loop) -> None:
    """Each once, as soon as its last byte is there; then the end of the pipe, once it ends."""
    records = [Log(t_host_ns=1, level="info", message="a word"), Host(granted={"fifo": 1})]
    data = b"".join(map(record_bytes, records))

    taken = []
    for byte in data:
        os.write(loop.records_fd, bytes([byte]))
        said = loop.child.records()
        assert said is not None
        taken += said

    assert taken == records
