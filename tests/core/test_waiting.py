"""Waiting by the kernel's own timers and descriptors."""

from __future__ import annotations

import os
import time
import tty
from collections.abc import Iterator
from contextlib import closing, suppress

import pytest
from armrig_core.process.waiting import TERMINAL_BYTES, Waiter, sleep_until

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


def test_a_wait_never_ends_before_its_deadline(waiter: Waiter) -> None:
    """A wait that ends early would make the loop spin; the timer counts in ns."""
    for wait_ns in (1, 999, 50_123, 1_500_001):
        due = now_ns() + wait_ns
        assert waiter.wait_until(due) == []
        assert now_ns() >= due


def test_a_wait_for_a_past_deadline_returns_at_once(waiter: Waiter) -> None:
    assert waiter.wait_until(now_ns() - LONG_NS) == []
    assert waiter.wait_until(-1) == []


def test_a_wait_can_be_repeated_for_the_same_deadline(
    waiter: Waiter, pipe: tuple[int, int]
) -> None:
    reader, writer = pipe
    waiter.watch(reader)
    due = now_ns() + 20 * MS
    os.write(writer, b"x")
    assert [fd for fd, _ in waiter.wait_until(due)] == [reader]
    os.read(reader, 1)

    assert waiter.wait_until(due) == []
    assert now_ns() >= due
    assert waiter.wait_until(due) == []


def test_a_pipe_is_ready_for_as_long_as_it_can_be_read(
    waiter: Waiter, pipe: tuple[int, int]
) -> None:
    reader, writer = pipe
    waiter.watch(reader)
    assert waiter.ready() == []
    os.write(writer, b"xy")
    for _ in range(2):
        assert [fd for fd, _ in waiter.wait_until(now_ns() + LONG_NS)] == [reader]
        assert [fd for fd, _ in waiter.ready()] == [reader]
    waiter.forget(reader)
    assert waiter.ready() == []


def test_a_terminal_is_reported_ready_once_per_arrival(
    waiter: Waiter, terminal: tuple[int, int]
) -> None:
    """A second wait would wait for the kernel's worker."""
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
    master, slave = terminal
    os.set_blocking(master, False)
    waiter.watch_terminal(slave)
    sent = os.write(master, bytes(3 * TERMINAL_BYTES))
    assert sent > TERMINAL_BYTES
    come = 0
    while come < sent:
        assert waiter.wait_until(now_ns() + LONG_NS), f"{come} of {sent} bytes were told"
        come += len(os.read(slave, TERMINAL_BYTES))


def test_room_on_a_terminal_is_reported_on_request(
    waiter: Waiter, terminal: tuple[int, int]
) -> None:
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
    for spin_ns in (0, 50_000):
        due = now_ns() + MS
        assert sleep_until(due, spin_ns) >= due
    past = now_ns() - MS
    assert sleep_until(past) > past
