"""Thread for calls that may wait, such as those of the file system; the service waits for none."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

T = TypeVar("T")


class Worker:
    """Thread that calls functions, one after the other, and hands their results back."""

    def __init__(self, name: str, changed: Callable[[], None]) -> None:
        """Start the thread, which calls `changed` after each function."""
        self._changed = changed
        self._asked: queue.SimpleQueue[tuple[Callable[[], Any], Callable[[Any], None]]]
        self._asked = queue.SimpleQueue()
        self._done: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._waiting = 0
        threading.Thread(target=self._work, name=name, daemon=True).start()

    @property
    def waiting(self) -> int:
        """Number of functions whose results were not handed back yet."""
        return self._waiting

    def call(self, function: Callable[[], T], then: Callable[[T | Exception], None]) -> None:
        """Call a function in the thread; `hand_back` passes its result, or exception, to `then`."""
        self._waiting += 1
        self._asked.put((function, then))

    def hand_back(self) -> None:
        """Pass the new results on, in the thread of the caller."""
        while not self._done.empty():
            self._waiting -= 1
            self._done.get()()

    def _work(self) -> None:
        while True:
            function, then = self._asked.get()
            try:
                result = function()
            except Exception as err:
                result = err
            self._done.put(partial(then, result))
            self._changed()
