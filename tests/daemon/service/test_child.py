"""The loop as a process of its own: its ends, by real pipes and a real pseudo-terminal."""

from __future__ import annotations

import fcntl
import os
import select
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from armrig_daemon.config import Config
from armrig_daemon.loop.process import LoopSettings
from armrig_daemon.pipe import Host, Record, record_bytes
from armrig_daemon.service.host import child as child_module
from armrig_daemon.service.host.child import LoopChild, start
from armrig_protocol.decoder import Received, feed
from armrig_protocol.messages import Estop

WITHIN_S = 30.0


@pytest.fixture
def child(terminal: tuple[int, str]) -> Iterator[LoopChild]:
    """Return a loop that ticks."""
    child = _started(terminal[1])
    yield child
    child.kill()
    child.end()


def _started(port: str) -> LoopChild:
    rules = Config().rules()
    child = start(
        LoopSettings(rules=rules, port=port, baud=rules.baud, priority=0, cpu=None, spin_ns=0),
        os.dup(2),
    )
    _heard(child, Host)
    return child


def _said(child: LoopChild) -> list[bytes | Record] | None:
    assert select.select([child.records_fd], [], [], WITHIN_S)[0], "the loop says nothing"
    return child.records()


def _heard(child: LoopChild, kind: type) -> None:
    """Read on until a record of a kind has come."""
    records: list[bytes | Record] = []
    while not any(isinstance(record, kind) for record in records):
        said = _said(child)
        assert said is not None, "the loop has ended"
        records = said


def _has_ended(child: LoopChild) -> None:
    """Read on until the pipe ends."""
    until = time.monotonic() + WITHIN_S
    while _said(child) is not None:
        assert time.monotonic() < until, "the loop goes on"


def _frames_of(master: int, least: int) -> list[Received]:
    """Return the bytes of a line, as soon as so many frames have come."""
    pending, frames = b"", []
    while len(frames) < least or select.select([master], [], [], 0)[0]:
        assert select.select([master], [], [], WITHIN_S)[0], "the line is silent"
        pending, received = feed(pending, os.read(master, 1 << 16))
        frames += received
    return frames


def test_a_signal_to_the_loop_ends_it_in_good_order(child: LoopChild) -> None:
    child._process.send_signal(signal.SIGHUP)

    _has_ended(child)
    assert child._process.wait(WITHIN_S) == 0


def test_a_failing_loop_sends_estop_three_times_and_dies(
    child: LoopChild, terminal: tuple[int, str]
) -> None:
    master, _ = terminal

    os.write(child.orders_fd, record_bytes(Host(granted={})))
    _has_ended(child)

    assert child._process.wait(WITHIN_S) == 1
    assert _frames_of(master, 3)[-3:] == [Estop(0, seq) for seq in range(3)]


def test_both_pipes_of_the_loop_are_nonblocking(child: LoopChild) -> None:
    """L2: a loop that waited for the service would miss its ticks."""
    arguments = Path(f"/proc/{child._process.pid}/cmdline").read_bytes().split(b"\0")
    module = arguments.index(b"armrig_daemon.loop.process")

    for name in arguments[module + 1 : module + 3]:
        told = Path(f"/proc/{child._process.pid}/fdinfo/{name.decode()}").read_text()
        assert int(told.split("flags:")[1].split()[0], 8) & os.O_NONBLOCK


def test_an_unresponsive_loop_is_killed(
    terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(child_module, "EXIT_S", 0.01)
    child = _started(terminal[1])
    child._process.send_signal(signal.SIGSTOP)

    try:
        code = child.end()
    finally:
        child.kill()

    assert code == -signal.SIGKILL


def test_the_pipes_of_the_loop_have_1_mib(child: LoopChild) -> None:
    """1 MiB, or what the kernel allows this user."""
    out, into = os.pipe()
    with suppress(OSError):
        fcntl.fcntl(into, fcntl.F_SETPIPE_SZ, 1 << 20)

    sizes = {fcntl.fcntl(fd, fcntl.F_GETPIPE_SZ) for fd in (child.orders_fd, child.records_fd)}

    assert sizes == {fcntl.fcntl(out, fcntl.F_GETPIPE_SZ)}
    os.close(out)
    os.close(into)
