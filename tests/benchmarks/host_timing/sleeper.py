"""A program: wake at each deadline, and with a port write a request and read the answer.

Without a port and spin it replaces cyclictest; with both it is the bare loop. It does nothing else,
so any further time of the daemon's loop is the daemon's own work.
"""

from __future__ import annotations

import os
import sys
import time

import msgspec
from armrig_core.waiting import TERMINAL_BYTES, Waiter, sleep_until

from tests.benchmarks.host_timing.echo import ANSWER_LENGTH, REQUEST_LENGTH
from tests.benchmarks.host_timing.kernel import be_punctual, end_with_parent

ANSWER_NS = 1_000_000_000
"""Longest wait for an answer, in ns."""
MARGIN_NS = 90_000
"""Time between the end of the loop's first wait and the spin, in ns."""
WARM_UP = 2
"""Ticks before those that count: the first call of each function takes longer."""
WINDOW_NS = 100_000_000
"""Over how long processor time is counted, in ns."""


class Task(msgspec.Struct, frozen=True, kw_only=True):
    """Task of the program."""

    period_ns: int
    count: int
    priority: int
    """SCHED_FIFO priority; 0 is the ordinary policy."""
    spin_ns: int = 0
    port: str = ""
    """Port for a request and an answer at each tick; empty for none."""


class Done(msgspec.Struct, frozen=True, kw_only=True):
    """Result of the task."""

    fifo: bool
    late_ns: list[int]
    """Wake-up less deadline; deadlines missed meanwhile are skipped, as cyclictest does."""
    trip_ns: list[int]
    """From before the write to after the read."""
    cpu_ns: list[float]
    """Processor time per tick, over windows of `WINDOW_NS`."""


def play(task: Task, *, fifo: bool) -> Done:
    """Tick as often as the task requires."""
    line = Line(task.port) if task.port else None
    late: list[int] = []
    trips: list[int] = []
    cpu: list[float] = []
    spin_ns = task.spin_ns if fifo else 0
    due = time.monotonic_ns() + task.period_ns
    window = due, 0, 0
    for n in range(-WARM_UP, task.count + 1):
        if line is not None:
            line.wait_until(due - spin_ns - MARGIN_NS)
        now = sleep_until(due, spin_ns)
        if n > 0:
            late.append(now - due)
        due += task.period_ns * (1 + max(0, now - due) // task.period_ns)
        if line is not None:
            trip = line.exchange(now, due - spin_ns - MARGIN_NS)
            if n > 0:
                trips.append(trip)
        if n == 0:
            window = now, time.thread_time_ns(), 0
        elif n > 0 and (now - window[0] >= WINDOW_NS or n == task.count):
            used = time.thread_time_ns()
            cpu.append((used - window[1]) / (n - window[2]))
            window = now, used, n
    return Done(fifo=fifo, late_ns=late, trip_ns=trips, cpu_ns=cpu)


class Line:
    """A pseudo-terminal that answers, waited for as the daemon's loop waits for its own."""

    def __init__(self, port: str) -> None:
        self._fd = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._waiter = Waiter()
        self._waiter.watch_terminal(self._fd)

    def wait_until(self, deadline_ns: int) -> None:
        """Wait until shortly before a tick."""
        self._waiter.wait_until(deadline_ns)

    def exchange(self, began_ns: int, until_ns: int) -> int:
        """Write a request and read the answer; return how long it took, in ns."""
        os.write(self._fd, bytes(REQUEST_LENGTH))
        received = 0
        while received < ANSWER_LENGTH:
            if self._waiter.wait_until(until_ns):
                received += len(os.read(self._fd, TERMINAL_BYTES))
            elif until_ns < began_ns + ANSWER_NS:
                until_ns = began_ns + ANSWER_NS
            else:
                raise SystemExit(f"no answer within {ANSWER_NS / 1e9:g} s")
        return time.monotonic_ns() - began_ns


def main() -> None:
    """Do the task in the first argument and print the result."""
    end_with_parent()
    task = msgspec.json.decode(sys.argv[1], type=Task)
    fifo = be_punctual(task.priority, lock=True)
    sys.stdout.buffer.write(msgspec.json.encode(play(task, fifo=fifo)))


if __name__ == "__main__":
    main()
