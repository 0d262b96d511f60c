"""Lines for a terminal, the journal or a pipe, which may be slow or stand still (Ctrl-S)."""

from __future__ import annotations

import os
import queue
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import count

from armrig_core.process.printable import plural, printable

QUEUE = 1000
"""Number of waiting lines above which further lines are dropped and counted."""
_MOST_CHARACTERS = 4096  # of a line of another process; a longer line is written as several
_FREE_LINES, _BREATH_S = 200, 0.02  # of another process; then 50 lines a second, and it must wait
CLOSE_S = 0.3
"""Longest time at the end for lines that still wait, in s."""


def print_error(line: str) -> None:
    """Print a line on standard error; a closed standard error is no failure."""
    with suppress(OSError):
        print(line, file=sys.stderr, flush=True)


class LineWriter:
    """Thread that writes lines, so that no caller waits for a terminal.

    Lines that find no room in the queue are dropped; as soon as there is room again, a line states
    their number.

    Parameters
    ----------
    write : callable
        Function that prints a line, by default on standard error. It may wait.

    Examples
    --------
    >>> from armrig_core.process.line_writer import LineWriter
    >>> lines = LineWriter(print)
    >>> lines.put("ready")
    >>> lines.close()
    ready
    """

    def __init__(self, write: Callable[[str], None] = print_error) -> None:
        self._write = write
        self._waiting: queue.Queue[Callable[[], None] | None] = queue.Queue(QUEUE)
        self._dropped = 0
        self._relays: list[threading.Thread] = []
        self._thread = threading.Thread(target=self._write_all, name="log", daemon=True)
        self._thread.start()

    def put(self, line: str) -> None:
        """Write a line later; drop it if too many lines wait."""
        self.call(partial(self._write, line))

    def call(self, write: Callable[[], None]) -> None:
        """Call a function that writes a line, in the thread of the writer."""
        try:
            self._waiting.put_nowait(write)
        except queue.Full:
            self._dropped += 1

    def relay(self) -> int:
        """Return a descriptor for the lines of another process; the caller closes it."""
        lines, end = os.pipe()
        relay = threading.Thread(target=self._relay, args=(lines,), name="relay", daemon=True)
        self._relays.append(relay)
        relay.start()
        return end

    def close(self, timeout: float = CLOSE_S) -> None:
        """Wait for the waiting lines, but for at most `timeout` s each: a terminal may stand still.

        First the processes whose lines are relayed must have ended.
        """
        for relay in self._relays:
            relay.join(timeout)
        with suppress(queue.Full):
            self._waiting.put(None, timeout=timeout)
            self._thread.join(timeout)

    def _write_all(self) -> None:
        while (write := self._waiting.get()) is not None:
            write()
            if self._waiting.empty():
                self._tell_dropped()
        self._tell_dropped()

    def _tell_dropped(self) -> None:
        dropped, self._dropped = self._dropped, 0
        if dropped:
            lines = plural(dropped, "line was", "lines were")
            self._write(f"{lines} dropped, because the output stood still")

    def _relay(self, lines: int) -> None:
        with open(lines, encoding="utf-8", errors="replace") as text:
            for number in count():
                line = text.readline(_MOST_CHARACTERS)
                if not line:
                    return
                self.put(printable(line.rstrip("\n")))
                if number >= _FREE_LINES:
                    time.sleep(_BREATH_S)
