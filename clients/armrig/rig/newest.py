"""The newest of what came: a queue with a bound, in number and in bytes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from threading import Lock
from typing import Generic, TypeVar

_T = TypeVar("_T")


class Newest(Generic[_T]):
    """Forgets the oldest where there is too much; one thread may add while another takes."""

    def __init__(self, most: int, most_bytes: int) -> None:
        """Keep at most so many, and of so many B together."""
        self._most, self._most_bytes = most, most_bytes
        self._kept: deque[tuple[_T, int]] = deque()
        self._size = 0
        self._lock = Lock()

    def __len__(self) -> int:
        """Return how many are kept."""
        return len(self._kept)

    def __iter__(self) -> Iterator[_T]:
        """Give those that are kept, the oldest first; none is to be added meanwhile."""
        return (value for value, _ in self._kept)

    def add(self, value: _T, size: int) -> None:
        """Add one of `size` B; one longer than all may be is forgotten at once."""
        with self._lock:
            self._kept.append((value, size))
            self._size += size
            while len(self._kept) > self._most or self._size > self._most_bytes:
                self._forget_oldest()

    def take(self) -> list[_T]:
        """Return all, the oldest first, and forget them."""
        with self._lock:
            kept, self._kept, self._size = self._kept, deque(), 0
        return [value for value, _ in kept]

    def forget_while(self, is_over: Callable[[_T], bool]) -> None:
        """Forget the oldest up to one that is not over."""
        with self._lock:
            while self._kept and is_over(self._kept[0][0]):
                self._forget_oldest()

    def _forget_oldest(self) -> None:
        _, size = self._kept.popleft()
        self._size -= size
