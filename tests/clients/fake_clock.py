"""A clock that advances only in sleep."""

from __future__ import annotations


class FakeClock:
    """Has the functions of `time` that a client waits by; the last of `most_sleeps` is Ctrl-C."""

    def __init__(self, most_sleeps: int = 10**6) -> None:
        self.now_s, self.slept, self.most_sleeps = 100.0, list[float](), most_sleeps

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now_s += seconds
        if len(self.slept) == self.most_sleeps:
            raise KeyboardInterrupt
