"""Waiting by the kernel's own timers and descriptors."""

from __future__ import annotations

import os
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from types import SimpleNamespace

import numpy as np
import pytest
from armrig_core import waiting
from armrig_core.waiting import TERMINAL_BYTES, Sleeper, Waiter

MS = 1_000_000
LONG_NS = 10_000 * MS


@pytest.fixture
def waiter() -> Iterator[Waiter]:
    """Give a waiter, and close it."""
    with closing(Waiter()) as waiter:
        yield waiter


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """Give master and slave of a raw pseudo-terminal, which do not block."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(slave, False)
    yield master, slave
    for fd in (master, slave):
        os.close(fd)


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    """Give a pipe."""
    ends = os.pipe()
    yield ends
    for fd in ends:
        os.close(fd)


def now_ns() -> int:
    """Return the time."""
    return time.monotonic_ns()


def test_nothing_comes_and_the_deadline_ends_the_wait_never_early(waiter: Waiter) -> None:
    """The timer counts in ns: a wait that ends early would have the loop turn on the spot."""
    for wait_ns in (1, 999, 50_123, 1_500_001):
        due = now_ns() + wait_ns
        assert waiter.wait_until(due) == []
        assert now_ns() >= due


def test_a_deadline_that_has_passed_is_not_waited_for(waiter: Waiter) -> None:
    """Nor one before the clock began."""
    assert waiter.wait_until(now_ns() - LONG_NS) == []
    assert waiter.wait_until(-1) == []


def test_the_same_deadline_can_be_waited_for_again(waiter: Waiter, pipe: tuple[int, int]) -> None:
    """Something came before it: the rest of the wait is as long as it was."""
    reader, writer = pipe
    waiter.watch(reader)
    due = now_ns() + 20 * MS
    os.write(writer, b"x")
    assert [fd for fd, _ in waiter.wait_until(due)] == [reader]
    os.read(reader, 1)

    assert waiter.wait_until(due) == []
    assert now_ns() >= due
    assert waiter.wait_until(due) == []


def test_a_pipe_is_told_for_as_long_as_it_can_be_read(
    waiter: Waiter, pipe: tuple[int, int]
) -> None:
    """And at once, where nobody is to wait."""
    reader, writer = pipe
    waiter.watch(reader)
    assert waiter.ready() == []
    os.write(writer, b"xy")
    for _ in range(2):
        assert [fd for fd, _ in waiter.wait_until(now_ns() + LONG_NS)] == [reader]
        assert [fd for fd, _ in waiter.ready()] == [reader]
    waiter.forget(reader)
    assert waiter.ready() == []


def test_a_terminal_is_told_once_for_all_that_it_holds(
    waiter: Waiter, terminal: tuple[int, int]
) -> None:
    """One read takes it; asked again, the kernel would have to look, and wait for its worker."""
    master, slave = terminal
    waiter.watch_terminal(slave)
    for text in (b"one", b"another"):
        os.write(master, text)
        assert [fd for fd, _ in waiter.wait_until(now_ns() + LONG_NS)] == [slave]
        assert waiter.ready() == []
        assert os.read(slave, TERMINAL_BYTES) == text
        assert waiter.wait_until(now_ns() + MS) == []


def test_a_terminal_never_holds_more_than_one_read_takes(
    waiter: Waiter, terminal: tuple[int, int]
) -> None:
    """What its line discipline had no room for comes with a word of its own."""
    master, slave = terminal
    os.set_blocking(master, False)
    waiter.watch_terminal(slave)
    sent = os.write(master, bytes(3 * TERMINAL_BYTES))
    assert sent > TERMINAL_BYTES
    come = 0
    while come < sent:
        assert waiter.wait_until(now_ns() + LONG_NS), f"{come} of {sent} bytes were told"
        come += len(os.read(slave, TERMINAL_BYTES))


def test_room_on_a_terminal_is_told_where_it_is_wanted(
    waiter: Waiter, terminal: tuple[int, int]
) -> None:
    """Its reader was slow, and has read."""
    master, slave = terminal
    os.set_blocking(master, False)
    waiter.watch_terminal(master)
    with suppress(BlockingIOError):
        while True:
            os.write(master, bytes(TERMINAL_BYTES))
    waiter.ready()
    waiter.watch_room(master, wanted=True)
    waiter.ready()
    come = 1
    while come:
        try:
            come = len(os.read(slave, TERMINAL_BYTES))
        except BlockingIOError:
            come = 0
    assert [fd for fd, _ in waiter.wait_until(now_ns() + LONG_NS)] == [master]
    waiter.watch_room(master, wanted=False)


def test_a_sleep_ends_at_its_deadline_or_later() -> None:
    """With a spin before it and without."""
    for most_ns in (0, 50_000):
        due = now_ns() + MS
        assert Sleeper(most_ns).sleep_until(due) >= due
    past = now_ns() - MS
    assert Sleeper(50_000).sleep_until(past) > past


class Host:
    """A host that wakes late, in virtual time: now and the sleep."""

    def __init__(self, late_ns: Callable[[], int]) -> None:
        self.now = 0
        self._late_ns = late_ns

    def monotonic_ns(self) -> int:
        """Return the time; a spin makes it pass."""
        self.now += 2_000
        return self.now

    def sleep(self, *_: object) -> int:
        """Sleep until the time that was asked for, and longer."""
        wake_ns = waiting._until.tv_sec * 1_000_000_000 + waiting._until.tv_nsec
        self.now = max(self.now, wake_ns + self._late_ns())
        return 0


@pytest.mark.parametrize("scale_us", [5.0, 20.0, 60.0])
def test_the_spin_follows_how_late_this_host_wakes(
    monkeypatch: pytest.MonkeyPatch, scale_us: float
) -> None:
    """One deadline in 200 is missed, whatever the host; and nobody spins longer than he may."""
    rng = np.random.default_rng(1)
    host = Host(lambda: round(1000 * rng.exponential(scale_us)))
    clock = SimpleNamespace(monotonic_ns=host.monotonic_ns, CLOCK_MONOTONIC=1)
    monkeypatch.setattr(waiting, "time", clock)
    monkeypatch.setattr(waiting, "_clock_nanosleep", host.sleep)
    sleeper = Sleeper(500_000)
    late, spins = 0, []
    for k in range(1, 20_001):
        late += sleeper.sleep_until(k * MS) > k * MS + 2_000
        spins.append(sleeper.spin_ns)

    assert 0.002 < late / k < 0.008
    median_us = np.median(spins[4000:]) / 1000
    assert 0.7 < median_us / (scale_us * np.log(200)) < 1.3  # the quantile of that distribution

    bounded = Sleeper(20_000)
    for k in range(20_001, 21_000):
        bounded.sleep_until(k * MS)
        assert 0 <= bounded.spin_ns <= 20_000
