"""Signals as bytes on a pipe, for a program that waits until it must end.

A signal writes to the pipe at once, in C (`signal.set_wakeup_fd`). Python runs a signal's handler
later, in the main thread, between any two instructions. A handler that takes a lock may therefore
deadlock with its own thread. If a handler only sets a flag, and the program begins an endless wait
just after this, the wait does not end.
"""

from __future__ import annotations

import select
import signal
import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress

ENDING: list[signal.Signals] = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]
"""The signals that end a program; not every system has SIGHUP."""
_READ_BYTES = 1 << 16


class SignalPipe:
    """A pipe that becomes readable at a signal; it has the interface of a threading.Event."""

    def __init__(
        self,
        numbers: Iterable[signal.Signals] = ENDING,
        handler: Callable[[int, object], None] = lambda number, frame: None,
    ) -> None:
        """Catch the signals `numbers` from now on; only the main thread may create a pipe.

        The main thread calls `handler` for each signal; the function must take no lock.
        """
        # Sockets: recording over a network also runs on Windows, whose select accepts only sockets.
        self._reader, self._waker = socket.socketpair()
        self._reader.setblocking(False)
        self._waker.setblocking(False)
        self.fd = self._reader.fileno()
        self._is_woken = False
        self._fd_before = signal.set_wakeup_fd(self._waker.fileno(), warn_on_full_buffer=False)
        self._before = {number: signal.signal(number, handler) for number in numbers}
        if hasattr(signal, "pthread_sigmask"):  # the parent may have blocked them
            signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)

    def wake(self) -> None:
        """Make the pipe readable, as a signal does; any thread may call this."""
        if self._is_woken:
            return  # a pipe full of zeros would have no room for a signal
        self._is_woken = True
        with suppress(OSError):  # a full pipe is readable, and nobody reads a closed one
            self._waker.send(b"\0")

    def read(self) -> set[int]:
        """Return the numbers of the signals since the last call, and empty the pipe."""
        numbers: set[int] = set()
        with suppress(BlockingIOError):
            numbers = {*self._reader.recv(_READ_BYTES)} - {0}
        # Reset after the read, because the read may take a byte that another thread has just sent.
        self._is_woken = False
        return numbers

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for a signal for at most `timeout` seconds; return whether a signal came."""
        ready, _, _ = select.select(
            [self._reader], [], [], None if timeout is None else max(0.0, timeout)
        )
        return bool(ready)

    def is_set(self) -> bool:
        """Return whether a signal came."""
        return self.wait(0)

    def close(self, *, ignores: bool = False) -> None:
        """Restore the previous handlers, or ignore the signals from now on.

        During its exit, Python restores each default handler, and a second signal would then kill
        the process. A process therefore ignores the signals at its end.
        """
        for number, before in self._before.items():
            signal.signal(number, signal.SIG_IGN if ignores else before)
        signal.set_wakeup_fd(self._fd_before)
        self._reader.close()
        self._waker.close()


@contextmanager
def until_signal() -> Iterator[SignalPipe]:
    """Yield a pipe for the first signal of `ENDING`; a second signal raises KeyboardInterrupt.

    The first signal interrupts nothing, so that a received message is still written to the file. A
    signal that nohup ignores stays ignored.
    """
    received: list[int] = []

    def note(number: int, _: object) -> None:
        received.append(number)
        if len(received) > 1:
            raise KeyboardInterrupt

    ended = SignalPipe([n for n in ENDING if callable(signal.getsignal(n))], note)
    try:
        yield ended
    finally:
        ended.close()
        for number in received[:1]:
            # Ctrl-C is the usual end; the exit code reports the other signals.
            if number != signal.SIGINT:
                with suppress(KeyboardInterrupt):
                    signal.raise_signal(number)


@contextmanager
def block_signals() -> Iterator[None]:
    """Block the signals of `ENDING` in a `with` block; a process started there inherits the mask.

    The new process unblocks the signals when it creates its `SignalPipe`. A Ctrl-C reaches all
    processes of a terminal. Without the mask, a new process could lose the Ctrl-C while it imports
    modules: if a callback of the import system raises KeyboardInterrupt, Python only prints it.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
