"""The loop's real ports in virtual time, with a system whose n-th call of a kind fails.

`ProcessPorts` and `Link` are the product's. The system calls below them are replaced: the clock is
a number, the line ends in the emulated device, and the service's two pipes end in the test.
"""

from __future__ import annotations

import errno
import os
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import contextmanager
from select import EPOLLIN
from types import SimpleNamespace
from typing import Any
from unittest import mock

from armrig_daemon.config import Config
from armrig_daemon.emulator.board import Change
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.loop import link, process
from armrig_daemon.loop.loop import Loop
from armrig_daemon.pipe import Record, record_bytes, take_records

_LINE, _ORDERS, _RECORDS = 100, 101, 102
_MOST_CALLS = 100_000
_CALL_NS = 200_000
WAYS = {
    "read": (errno.EIO, "end of file"),
    "write": (errno.EIO, errno.EAGAIN, "short"),
    "open": (errno.EBUSY,),
    "put": (errno.EAGAIN, errno.EPIPE),
    "orders": (errno.EAGAIN, "end of file"),
}
"""Failures of each kind of call."""


class World:
    """A device, its line and two pipes; the `n`-th call of `kind` fails, or each from there on."""

    def __init__(
        self, config: Config, kind: str = "", n: int = 0, way: int | str = 0, *, on: bool = False
    ) -> None:
        rules = config.rules()
        settings = EmulatorSettings(boot_ms=0.0, baud=rules.baud)
        self.now_ns = 0
        self.changes: list[Change] = []
        self.device = Device(settings, 0, self.changes.append)
        self.calls: Counter[str] = Counter()
        self.failed_ns = -1
        self.written_ns = 0
        self.lost_ns = -1
        self._kind, self._n, self._way, self._on = kind, n, way, on
        self._line: deque[tuple[int, bytes]] = deque()
        self._orders: deque[tuple[int, bytes]] = deque()
        self._records = bytearray()
        self._opened = False
        with self._installed():
            port = process.LoopSettings(
                rules=rules, port="tty", baud=rules.baud, priority=0, cpu=None, spin_ns=0
            )
            self.loop = Loop(rules, process.ProcessPorts(port, _ORDERS, _RECORDS))

    def order(self, at_ns: int, order: Any) -> None:
        """Let the service send an order at a time, not before earlier orders."""
        self._orders.append((at_ns, record_bytes(order)))

    def run_until(self, until_ns: int) -> list[bytes | Record]:
        """Let the loop run; return the service's records. A loop that hangs is an assertion."""
        with self._installed():
            while self.now_ns < until_ns and not self.loop.ended:
                self.loop.turn()
        self._advance(until_ns)
        return take_records(self._records)

    # -- what the product calls ------------------------------------------------------------

    @contextmanager
    def _installed(self) -> Iterator[None]:
        clock = SimpleNamespace(now_ns=lambda: self.now_ns)
        calls = SimpleNamespace(read=self._read, write=self._write)
        serial = SimpleNamespace(Serial=self._open)
        idle = SimpleNamespace(collect=int, freeze=int, get_stats=list)
        with (
            mock.patch.multiple(
                process,
                realtime=clock,
                os=calls,
                gc=idle,
                sleep_until=self._sleep_until,
                Waiter=lambda: _Waiter(self),
            ),
            mock.patch.multiple(
                link, os=calls, serial=serial, _distinguish_empty_from_end=lambda _: None
            ),
        ):
            yield

    def _fails(self, kind: str) -> int | str:
        """Count a call; return how it fails, or 0."""
        self.calls[kind] += 1
        assert self.calls.total() < _MOST_CALLS, f"a loop without end: {self.calls}"
        n = self.calls[kind]
        if kind != self._kind or n < self._n or (n > self._n and not self._on):
            return 0
        if self.failed_ns < 0:
            self.failed_ns = self.now_ns
        self._advance(self.now_ns + _CALL_NS)  # else one that fails for ever stops the clock
        if isinstance(self._way, int):
            raise OSError(self._way, os.strerror(self._way))
        return self._way

    def _open(self, *_: Any, **__: Any) -> Any:
        self._fails("open")
        if self._opened:
            self.device.reset(self.now_ns)
            self._line.clear()
        self._opened = True
        return SimpleNamespace(
            fileno=lambda: _LINE, set_low_latency_mode=lambda _: None, close=self._close
        )

    def _close(self) -> None:
        self.lost_ns = self.now_ns if self.lost_ns < 0 else self.lost_ns

    def _read(self, fd: int, _: int) -> bytes:
        of = self._line if fd == _LINE else self._orders
        if self._fails("read" if fd == _LINE else "orders"):
            return b""
        data = b""
        while of and of[0][0] <= self.now_ns:
            data += of.popleft()[1]
        if not data:
            raise BlockingIOError
        return data

    def _write(self, fd: int, data: bytes) -> int:
        if fd == _RECORDS:
            self._fails("put")
            self._records += data
            return len(data)
        sent = len(data) // 2 if self._fails("write") else len(data)
        self.device.receive(self.now_ns, data[:sent])
        self.written_ns = self.now_ns
        return sent

    def wait_until(self, sources: set[int], until_ns: int) -> list[tuple[int, int]]:
        """Let time pass until one of the descriptors can be read, or until a time."""
        while True:
            queues = {_LINE: self._line, _ORDERS: self._orders}
            due = {fd: q[0][0] for fd, q in queues.items() if q and fd in sources}
            ready = [fd for fd in sources if due.get(fd, self.now_ns + 1) <= self.now_ns]
            if ready or self.now_ns >= until_ns:
                return [(fd, EPOLLIN) for fd in sorted(ready)]
            self._advance(max(self.now_ns, min(until_ns, self.device.next_ns(), *due.values())))

    def _sleep_until(self, deadline_ns: int, _: int = 0) -> int:
        self._advance(max(self.now_ns, deadline_ns))
        return self.now_ns

    def _advance(self, to_ns: int) -> None:
        self.now_ns = max(self.now_ns, to_ns)
        self._line.extend(self.device.advance(self.now_ns))


class _Waiter:
    """Replacement of the product's waiter, in virtual time."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._sources: set[int] = set()
        self.watch = self.watch_terminal = self._sources.add
        self.forget = self._sources.remove

    def ready(self) -> list[tuple[int, int]]:
        return self.wait_until(0)

    def wait_until(self, deadline_ns: int) -> list[tuple[int, int]]:
        return self._world.wait_until(self._sources, deadline_ns)
