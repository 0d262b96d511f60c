"""A command that goes on until it is told to end, and then ends in order."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Event


@contextmanager
def until_signal() -> Iterator[Event]:
    """Give what Ctrl-C sets, or another signal that ends us; a second one interrupts.

    The first does not, as it may come between a message that was received and its file.
    """
    ended, received = Event(), []

    def note(number: int, _: object) -> None:
        if ended.is_set():
            raise KeyboardInterrupt
        received.append(number)
        ended.set()

    # Not every system has SIGHUP; and what nohup ignores stays ignored.
    numbers = [getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP")]
    before = {
        number: handler
        for number in numbers
        if number is not None and callable(handler := signal.getsignal(number))
    }
    for number in before:
        signal.signal(number, note)
    try:
        yield ended
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in received:
            if number != signal.SIGINT:  # the way to end it; of the others the exit code tells
                with suppress(KeyboardInterrupt):
                    before[number](number, None)
