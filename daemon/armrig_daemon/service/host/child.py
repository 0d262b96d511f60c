"""The service's side of the loop's process: the pipes, the orders and the end of the process."""

from __future__ import annotations

import contextlib
import fcntl
import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from concurrent.futures import Future

import msgspec
from armrig_core.process.signal_pipe import block_signals

from armrig_daemon.loop.process import LoopSettings
from armrig_daemon.pipe import Orders, Record, record_bytes, take_records

EXIT_S = 1.0
"""Longest time for the loop to stop the motor and end, in s."""
_F_SETPIPE_SZ = 1031  # <linux/fcntl.h>
_PIPE_BYTES = 1 << 20
_READ = 1 << 16


class LoopChild:
    """Process of a running loop."""

    def __init__(self, starter: Starter, orders_fd: int, records_fd: int) -> None:
        """Take the descriptors of both pipes."""
        self.starter = starter
        """Thread whose end the kernel signals to the loop."""
        self.records_fd = records_fd
        self._process = starter.process
        self.orders_fd = orders_fd
        os.set_blocking(orders_fd, False)
        self._unsent = bytearray()
        self._pending = bytearray()

    def order(self, order: Orders) -> None:
        """Send an order to the loop; if the loop has ended, `records` reports the end."""
        self._unsent += record_bytes(order)
        self.flush()

    @property
    def is_behind(self) -> bool:
        """True while orders wait for the loop to read earlier orders."""
        return bool(self._unsent)

    def flush(self) -> None:
        """Write waiting orders as far as the pipe accepts them; never wait for a frozen loop."""
        try:
            while self._unsent:
                del self._unsent[: os.write(self.orders_fd, self._unsent)]
        except BlockingIOError:
            return
        except BrokenPipeError:
            self._unsent.clear()

    def records(self) -> list[bytes | Record] | None:
        """Return the new records of the loop, or None if the loop has ended."""
        data = os.read(self.records_fd, _READ)
        if not data:
            return None
        self._pending += data
        return take_records(self._pending)

    def kill(self) -> None:
        """Kill a loop that does not end by itself; the device's watchdog then stops the motor."""
        self._process.kill()

    def end(self) -> int:
        """Close the pipes, so that the loop ends; return the loop's exit code."""
        os.close(self.orders_fd)
        try:
            code = self._process.wait(EXIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        os.close(self.records_fd)
        self.starter.end()
        return code


class Starter(threading.Thread):
    """Thread that starts the loop's process and waits for its end.

    When a thread ends, the kernel sends a signal to the processes that this thread has started. The
    starter only waits, and may therefore keep a real-time priority. If the service is killed, the
    starter ends at once. A thread of ordinary priority would end only when a processor is free.
    """

    def __init__(
        self, program: Sequence[str], fds: Sequence[int], stderr_fd: int | None = None
    ) -> None:
        super().__init__(name="starter", daemon=True)
        self._program, self._fds, self._stderr_fd = program, fds, stderr_fd
        self._process: Future[subprocess.Popen[bytes]] = Future()
        self._over = threading.Event()

    def run(self) -> None:
        """Start the process; wait until it has ended."""
        try:
            with block_signals():
                process = subprocess.Popen(
                    self._program, pass_fds=self._fds, stderr=self._stderr_fd
                )
            self._process.set_result(process)
        except OSError as err:
            self._process.set_exception(err)
            return
        self._over.wait()

    @property
    def process(self) -> subprocess.Popen[bytes]:
        """Process of the loop; the property is available after the start of the process."""
        return self._process.result()

    @property
    def number(self) -> int:
        """Kernel's id of this thread; available after the start of the process."""
        self._process.result()
        assert self.native_id is not None  # noqa: S101 - the thread has begun
        return self.native_id

    def end(self) -> None:
        """End the thread of a process that has ended."""
        self._over.set()
        self.join()


def start(settings: LoopSettings, stderr_fd: int) -> LoopChild:
    """Start the loop. The caller must not have opened a session, which the loop would inherit.

    `stderr_fd` is the loop's standard error. It must not be a terminal, for which a loop that fails
    would have to wait. The descriptor is closed here.
    """
    orders_out, orders_in = os.pipe()
    records_out, records_in = os.pipe()
    for fd in (orders_in, records_in):
        with contextlib.suppress(OSError):  # a smaller pipe holds the records of fewer seconds
            fcntl.fcntl(fd, _F_SETPIPE_SZ, _PIPE_BYTES)
    arguments = [str(orders_out), str(records_in), msgspec.json.encode(settings).decode()]
    program = [sys.executable, "-m", "armrig_daemon.loop.process", *arguments]
    starter = Starter(program, (orders_out, records_in), stderr_fd)
    starter.start()
    try:
        return LoopChild(starter, orders_in, records_out)
    finally:
        for fd in (orders_out, records_in, stderr_fd):
            os.close(fd)
