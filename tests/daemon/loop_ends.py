"""The loop's ends of both pipes in a test's hands: what the service orders is read, not done."""

from __future__ import annotations

import os

from armrig_daemon.pipe import Orders, take_orders
from armrig_daemon.service.host.child import LoopChild, Starter


class LoopEnds:
    """Pipes as `loop_child.start` makes them, with a silent process at their end."""

    def __init__(self) -> None:
        self.orders_fd, orders_in = os.pipe()
        records_out, self.records_fd = os.pipe()
        os.set_blocking(self.orders_fd, False)
        starter = Starter(["true"], ())
        starter.start()
        self.child = LoopChild(starter, orders_in, records_out)
        self._pending = bytearray()

    def orders(self) -> list[Orders]:
        """Take what has come since the last call."""
        try:
            self._pending += os.read(self.orders_fd, 1 << 16)
        except BlockingIOError:
            return []
        return take_orders(self._pending)

    def read_no_more(self) -> None:
        """Close the end at which orders come."""
        os.close(self.orders_fd)
        self.orders_fd = -1

    def close(self) -> None:
        """Close the open ends."""
        self.child._process.wait(30)
        assert self.child.end() == 0
        os.close(self.records_fd)
        if self.orders_fd >= 0:
            os.close(self.orders_fd)
