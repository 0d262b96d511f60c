"""The loop's process as the service holds it: its pipes, its orders, its end."""

from __future__ import annotations

import contextlib
import fcntl
import os
import subprocess
import sys

import msgspec
from armrig_core.signal_pipe import held_back

from armrig_daemon.loop.process import Settings
from armrig_daemon.pipe import Orders, Record, record_bytes, take_records

EXIT_S = 1.0
"""How long the loop may take to stop the motor and end, in s."""
_F_SETPIPE_SZ = 1031  # <linux/fcntl.h>
_PIPE_BYTES = 1 << 20
_READ = 1 << 16


class LoopChild:
    """A running loop."""

    def __init__(self, process: subprocess.Popen[bytes], orders_fd: int, records_fd: int) -> None:
        """Take over both pipes."""
        self.records_fd = records_fd
        self._process = process
        self.orders_fd = orders_fd
        os.set_blocking(orders_fd, False)
        self._unsent = bytearray()
        self._pending = bytearray()

    def order(self, order: Orders) -> None:
        """Ask something of the loop; once it is gone, its end is seen at its records."""
        self._unsent += record_bytes(order)
        self.flush()

    @property
    def is_behind(self) -> bool:
        """Whether orders wait for the loop to read those before them."""
        return bool(self._unsent)

    def flush(self) -> None:
        """Hand over what waits, as far as the pipe takes it; a frozen loop must not freeze us."""
        try:
            while self._unsent:
                del self._unsent[: os.write(self.orders_fd, self._unsent)]
        except BlockingIOError:
            return
        except BrokenPipeError:
            self._unsent.clear()

    def records(self) -> list[bytes | Record] | None:
        """Return what the loop has said, or None where it has ended."""
        data = os.read(self.records_fd, _READ)
        if not data:
            return None
        self._pending += data
        return take_records(self._pending)

    def kill(self) -> None:
        """End a loop that does not end by itself: the device's watchdog stops the motor."""
        self._process.kill()

    def end(self) -> int:
        """Close the pipes, which ends the loop too, and return its exit code."""
        os.close(self.orders_fd)
        try:
            code = self._process.wait(EXIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        os.close(self.records_fd)
        return code


def start(settings: Settings) -> LoopChild:
    """Start the loop; before any thread or session exists, for it inherits what there is."""
    orders_out, orders_in = os.pipe()
    records_out, records_in = os.pipe()
    for fd in (orders_in, records_in):
        with contextlib.suppress(OSError):  # a smaller pipe only holds fewer seconds
            fcntl.fcntl(fd, _F_SETPIPE_SZ, _PIPE_BYTES)
    arguments = [str(orders_out), str(records_in), msgspec.json.encode(settings).decode()]
    program = [sys.executable, "-m", "armrig_daemon.loop.process", *arguments]
    try:
        with held_back():
            process = subprocess.Popen(program, pass_fds=(orders_out, records_in))
    finally:
        os.close(orders_out)
        os.close(records_in)
    return LoopChild(process, orders_in, records_out)
