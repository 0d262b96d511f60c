"""The loop as a program, which the service starts: `python -m armrig_daemon.loop.process FD FD`.

The program has a single Python thread, so that it never waits for the interpreter's lock. It
imports no large modules.
"""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sys
from select import EPOLLIN

import msgspec
from armrig_core.process import realtime
from armrig_core.process.signal_pipe import SignalPipe
from armrig_core.process.waiting import Waiter, sleep_until
from armrig_protocol.frame import encode
from armrig_protocol.messages import Estop

from armrig_daemon.decisions.state import (
    Event,
    LinkDown,
    LinkUp,
    Ordered,
    Received,
    Rules,
    ServiceGone,
)
from armrig_daemon.loop.link import Link, LinkError, NoPortError, latency_timer_ms, open_link
from armrig_daemon.loop.loop import Loop
from armrig_daemon.pipe import Host, Log, Quit, record_bytes, take_orders

NO_PORT = 2
"""Exit code if the port could not be opened; the reason has been reported."""
REOPEN_NS = 500_000_000
_READ = 65536
# After the long sleep in `wait` the processor's caches are cold; after a short second sleep they
# are not.
_MARGIN_NS = 90_000


class LoopSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Settings that the service passes to this program as an argument."""

    rules: Rules
    port: str
    baud: int
    priority: int
    cpu: int | None
    spin_ns: int


class ProcessPorts:
    """Ports of the real daemon: the monotonic clock, the serial line, the service's pipes."""

    def __init__(self, settings: LoopSettings, orders_fd: int, records_fd: int) -> None:
        """Take the pipes and open the line if its port exists; raise LinkError if this fails."""
        self._settings = settings
        self._orders_fd = orders_fd
        self._records_fd = records_fd
        self._orders = bytearray()
        self._link: Link | None = None
        self._reopen_ns = 0
        self._reopen_error = ""
        self._waiter = Waiter()
        self._waiter.watch(orders_fd)
        try:
            self._link = open_link(settings.port, settings.baud)
            self._link.watch(self._waiter)
        except NoPortError as err:
            self._reopen_error = str(err)
        self._is_hung_up = self._is_unread = False
        self._first = True
        self._has_no_reader = False
        self._signals: SignalPipe | None = None
        self.spin_ns = 0
        self.now_ns = realtime.now_ns  # an attribute: one call less at each wait

    def end_at(self, signals: SignalPipe) -> None:
        """Let the core quit as soon as one of these signals arrives."""
        self._signals = signals
        self._waiter.watch(signals.fd)

    @property
    def margin_ns(self) -> int:
        """Return the duration of the spin and of the short sleep before the spin, in ns."""
        return self.spin_ns + _MARGIN_NS

    @property
    def collections(self) -> int:
        """Return the number of garbage collections, which take place only between runs."""
        return sum(generation["collections"] for generation in gc.get_stats())

    def sleep_until(self, deadline_ns: int) -> int:
        """Sleep, then spin, until the deadline; return the current time."""
        return sleep_until(deadline_ns, self.spin_ns)

    def wait(self, until_ns: int) -> list[Event]:
        """Wait for the line, the service or a signal until `until_ns`; return the events."""
        if self._first:
            self._first = False
            return [LinkUp() if self._link is not None else LinkDown(self._reopen_error)]
        events = self._open_again() if self._link is None else self._read_again()
        waiter = self._waiter
        for fd, flags in waiter.ready() if events else waiter.wait_until(until_ns):
            if fd == self._orders_fd:
                events += self._read_orders()
            elif self._signals is not None and fd == self._signals.fd:
                names = (signal.Signals(number).name for number in self._signals.read())
                events += [Ordered(Quit(reason=name)) for name in names]
            elif self._link is not None:
                # Each arrival is reported once. The bytes of a line that hung up are read first.
                self._is_hung_up = bool(flags & ~EPOLLIN)
                if events and isinstance(events[0], Received):
                    self._is_unread = True  # a step handles one piece of at most `READ` bytes
                else:
                    events += self._read()
        return events

    def write(self, data: bytes) -> Event | None:
        """Send bytes to the device; return a failure as an event."""
        if self._link is None:
            return None
        try:
            self._link.write(data)
        except LinkError as err:
            return self._drop_link(err)[0]
        return None

    def put(self, text: bytes) -> bool:
        """Write one record completely or not at all: a pipe accepts 4096 bytes atomically."""
        if self._has_no_reader:
            return False
        try:
            return os.write(self._records_fd, text) == len(text)
        except BlockingIOError:
            return False
        except BrokenPipeError:
            # The pipe of the orders reports the end of the service, and must still be read.
            self._has_no_reader = True
            return False

    def tidy(self) -> None:
        """Collect the garbage of the last run, so that no collection delays the next run."""
        gc.collect()
        gc.freeze()

    def stop_hard(self) -> None:
        """Send ESTOP three times, because the loop itself has failed."""
        if self._link is None:
            return
        with contextlib.suppress(LinkError):
            for seq in range(3):
                self._link.write(b"\0" + encode(Estop(0, seq)))

    def _open_again(self) -> list[Event]:
        """Try to open a lost line, at intervals; report each reason of a failure once."""
        now = self.now_ns()
        if now < self._reopen_ns:
            return []
        self._reopen_ns = now + REOPEN_NS
        try:
            self._link = open_link(self._settings.port, self._settings.baud)
        except LinkError as err:
            if str(err) != self._reopen_error:
                self._reopen_error = str(err)
                return [LinkDown(self._reopen_error)]
            return []
        self._reopen_error = ""
        self._link.watch(self._waiter)
        return [LinkUp()]

    def _drop_link(self, err: OSError) -> list[Event]:
        if self._link is not None:
            self._waiter.forget(self._link.fd)
            self._link.close()
            self._link = None
            self._is_hung_up = self._is_unread = False
        self._reopen_ns = self.now_ns() + REOPEN_NS
        self._reopen_error = str(err)
        return [LinkDown(self._reopen_error)]

    def _read_again(self) -> list[Event]:
        """Read the bytes that the last read did not return; their arrival is not reported again."""
        if self._link is not None and self._link.has_rest:
            return self._read()
        more = self._is_hung_up or self._is_unread
        self._is_unread = False
        return self._read() if more else []

    def _read(self) -> list[Event]:
        if self._link is None:
            return []
        try:
            data = self._link.read()
        except LinkError as err:
            return self._drop_link(err)
        return [Received(data)] if data else []

    def _read_orders(self) -> list[Event]:
        try:
            data = os.read(self._orders_fd, _READ)
        except BlockingIOError:
            return []
        if not data:
            self._waiter.forget(self._orders_fd)
            return [ServiceGone()]
        self._orders += data
        return [Ordered(order) for order in take_orders(self._orders)]


def _line(level: str, message: str) -> bytes:
    return record_bytes(Log(t_host_ns=realtime.now_ns(), level=level, message=message))


def main(arguments: list[str]) -> int:
    """Run the loop with the pipes and the settings in the arguments; return the exit code."""
    orders_fd, records_fd = (int(text) for text in arguments[:2])
    settings = msgspec.json.decode(arguments[2], type=LoopSettings)
    os.set_blocking(orders_fd, False)
    os.set_blocking(records_fd, False)
    try:
        ports = ProcessPorts(settings, orders_fd, records_fd)
    except LinkError as err:
        os.write(records_fd, _line("error", str(err)))
        return NO_PORT
    timer = latency_timer_ms(settings.port)
    if timer is not None and timer > 1:
        ports.put(
            _line(
                "warning",
                f"{settings.port}: latency timer {timer} ms, 1 ms is wanted: see `armrig doctor`",
            )
        )
    ports.end_at(SignalPipe())
    # The end of the pipes may be late: if the service is killed while its disk is slow, it keeps
    # the pipes open until the disk has answered.
    realtime.end_with_parent()
    granted = realtime.prepare(settings.priority, settings.cpu)
    if granted["fifo"]:  # otherwise a spin only takes time from processes for which the loop waits
        ports.spin_ns = settings.spin_ns
    ports.put(record_bytes(Host(granted=granted)))
    try:
        Loop(settings.rules, ports).run()
    except BaseException:
        ports.stop_hard()
        raise
    realtime.ignore_signals()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
