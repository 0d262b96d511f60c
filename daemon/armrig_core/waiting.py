"""Waiting, exact to the kernel's timers: until a deadline, and for descriptors besides.

`select` and `poll` ask each terminal anew at every call, and a terminal without input answers only
after a kernel worker of ordinary priority has run (docs/timing.md): a loop at real-time priority
would wait for it. Here a terminal is watched by edges: the kernel asks it when it has woken us.

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
_MOST_READY = 8
_IN, _OUT, _ET = select.EPOLLIN, select.EPOLLOUT, select.EPOLLET


class _Timespec(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long))


class _Itimerspec(ctypes.Structure):
    _fields_ = (("it_interval", _Timespec), ("it_value", _Timespec))


# ctypes gives up the interpreter lock during the call; the standard library has no such sleep, and
# the timer only from Python 3.13 on.
_libc = ctypes.CDLL(None, use_errno=True)
_clock_nanosleep, _timerfd_settime = _libc.clock_nanosleep, _libc.timerfd_settime
_until = _Timespec()
_until_at = ctypes.byref(_until)


def sleep_until(deadline_ns: int, spin_ns: int = 0) -> int:
    """Sleep until shortly before the deadline, spin the rest, and return the time it then is."""
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
    """Descriptors to be waited for, and a timer of the monotonic clock; one thread's."""

    def __init__(self) -> None:
        """Begin with no descriptor.

        Raises
        ------
        OSError
            The process may open no more descriptors.
        """
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
        """Watch a descriptor: it is told for as long as it can be read."""
        self._epoll.register(fd, _IN)

    def watch_terminal(self, fd: int) -> None:
        """Watch a terminal or a socket: it is told once, each time that bytes have come.

        Who is told of a terminal reads at least `TERMINAL_BYTES`, or until a read gives less than
        it asked for; of a socket, until then. What is left is not told again.
        """
        self._epoll.register(fd, _IN | _ET)

    def watch_room(self, fd: int, *, wanted: bool) -> None:
        """Be told, or no more, once a terminal or socket that is watched takes bytes again."""
        self._epoll.modify(fd, _IN | _ET | (_OUT if wanted else 0))

    def forget(self, fd: int) -> None:
        """Watch a descriptor no more; before it is closed."""
        self._epoll.unregister(fd)

    def ready(self) -> list[tuple[int, int]]:
        """Return at once what `wait_until` would return."""
        return self._but_timer(self._epoll.poll(0, _MOST_READY))

    def wait_until(self, deadline_ns: int) -> list[tuple[int, int]]:
        """Return descriptors that are ready, each with its `EPOLL…` flags; none at the deadline.

        Parameters
        ----------
        deadline_ns : int
            On the monotonic clock, in 64 bits; for one that has passed nobody waits.
        """
        if deadline_ns != self._due_ns:  # a loop waits for one deadline many times
            self._due_ns = deadline_ns
            due = self._set.it_value
            due.tv_sec, due.tv_nsec = divmod(max(deadline_ns, 1), 1_000_000_000)
            _timerfd_settime(self._timer, _TFD_TIMER_ABSTIME, self._set_at, None)
        return self._but_timer(self._epoll.poll(-1, _MOST_READY))

    def close(self) -> None:
        """Give the timer and the set back."""
        self._epoll.close()
        os.close(self._timer)

    def _but_timer(self, ready: list[tuple[int, int]]) -> list[tuple[int, int]]:
        timer = self._timer
        return [one for one in ready if one[0] != timer]


TERMINAL_BYTES = 4096
"""What a terminal's line discipline holds at most, in bytes (N_TTY_BUF_SIZE)."""
