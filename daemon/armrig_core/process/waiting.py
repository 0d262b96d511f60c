"""Waiting for a deadline and for file descriptors, with the precision of the kernel's timers.

`select` and `poll` query each terminal at every call. A terminal without input answers only after a
kernel worker of ordinary priority has run (docs/timing.md), so a loop at real-time priority would
wait for this worker. Here a terminal is watched edge-triggered: the kernel queries the terminal
only after new bytes have woken the process.

References
----------
.. [1] Linux man-pages, epoll(7), section "Level-triggered and edge-triggered"; timerfd_create(2).
"""

from __future__ import annotations

import ctypes
import os
import select
import time

_TIMER_ABSTIME = 1  # <time.h>
_TFD_TIMER_ABSTIME = 1  # <sys/timerfd.h>
_MAX_EVENTS = 8
_IN, _OUT, _ET = select.EPOLLIN, select.EPOLLOUT, select.EPOLLET


class _Timespec(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long))


class _Itimerspec(ctypes.Structure):
    _fields_ = (("it_interval", _Timespec), ("it_value", _Timespec))


# ctypes releases the interpreter lock during the call. The standard library has no such sleep, and
# has the timer only from Python 3.13 on.
_libc = ctypes.CDLL(None, use_errno=True)
_clock_nanosleep, _timerfd_settime = _libc.clock_nanosleep, _libc.timerfd_settime
_until = _Timespec()
_until_at = ctypes.byref(_until)


def sleep_until(deadline_ns: int, spin_ns: int = 0) -> int:
    """Sleep, then spin for the last `spin_ns` before a deadline; return the final time, in ns."""
    now = time.monotonic_ns()
    wake = deadline_ns - spin_ns
    if now < wake:
        _until.tv_sec, _until.tv_nsec = divmod(wake, 1_000_000_000)
        while _clock_nanosleep(time.CLOCK_MONOTONIC, _TIMER_ABSTIME, _until_at, None):
            pass  # interrupted by a signal; the deadline is absolute
    while (now := time.monotonic_ns()) < deadline_ns:
        pass
    return now


class Waiter:
    """A set of watched descriptors and a timer of the monotonic clock, for use by one thread."""

    def __init__(self) -> None:
        """Watch no descriptor yet; raise OSError if the process may open no more descriptors."""
        self._epoll = select.epoll()
        self._timer: int = _libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        if self._timer < 0:
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))
        self._epoll.register(self._timer, _IN)
        self._set = _Itimerspec()
        self._set_at = ctypes.byref(self._set)
        self._due_ns = 0

    def watch(self, fd: int) -> None:
        """Watch a descriptor: it is reported as long as it is readable."""
        self._epoll.register(fd, _IN)

    def watch_terminal(self, fd: int) -> None:
        """Watch a terminal or a socket: it is reported once each time that bytes arrive.

        From a terminal, the caller must read at least `TERMINAL_BYTES`, or until a read returns
        fewer bytes than requested. From a socket, the caller must read until a read returns fewer
        bytes than requested. Unread bytes are not reported again.
        """
        self._epoll.register(fd, _IN | _ET)

    def watch_room(self, fd: int, *, wanted: bool) -> None:
        """Select whether a watched terminal or socket is also reported when it accepts bytes."""
        self._epoll.modify(fd, _IN | _ET | (_OUT if wanted else 0))

    def forget(self, fd: int) -> None:
        """Stop watching a descriptor; call this before it is closed."""
        self._epoll.unregister(fd)

    def ready(self) -> list[tuple[int, int]]:
        """Return the descriptors that are ready now, as `wait_until` does, but without waiting."""
        return self._but_timer(self._epoll.poll(0, _MAX_EVENTS))

    def wait_until(self, deadline_ns: int) -> list[tuple[int, int]]:
        """Return the ready descriptors, each with its `EPOLL…` flags; [] at the deadline.

        `deadline_ns` is a time on the monotonic clock, in ns; if this time is past, the call
        returns at once.
        """
        if deadline_ns != self._due_ns:  # a loop waits for the same deadline many times
            self._due_ns = deadline_ns
            due = self._set.it_value
            due.tv_sec, due.tv_nsec = divmod(max(deadline_ns, 1), 1_000_000_000)
            _timerfd_settime(self._timer, _TFD_TIMER_ABSTIME, self._set_at, None)
        return self._but_timer(self._epoll.poll(-1, _MAX_EVENTS))

    def close(self) -> None:
        """Close the timer and the set."""
        self._epoll.close()
        os.close(self._timer)

    def _but_timer(self, ready: list[tuple[int, int]]) -> list[tuple[int, int]]:
        timer = self._timer
        return [event for event in ready if event[0] != timer]


TERMINAL_BYTES = 4096
"""Capacity of a terminal's line discipline, in B (N_TTY_BUF_SIZE)."""
