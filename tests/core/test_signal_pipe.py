"""Signals as bytes on a pipe: none is lost, and none is waited for in a handler."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Timer

import armrig_core
import pytest
from armrig_core.process.signal_pipe import ENDING, SignalPipe, block_signals, until_signal

WITHIN_S = 30.0
SIGNALS = 300
_ROUNDS = """
import sys
from armrig_core.process.signal_pipe import until_signal
for _ in range(int(sys.argv[1])):
    with until_signal() as ended:
        print("waits", flush=True)
        while not ended.wait(0):
            pass
"""
_ONE = """
from armrig_core.process.signal_pipe import SignalPipe
signals = SignalPipe()
signals.wait()
print(sorted(signals.read()))
"""


@contextmanager
def running(program: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Give a Python program, which is killed if the block takes longer than `WITHIN_S`."""
    with subprocess.Popen(
        [sys.executable, "-c", program, *arguments],
        env={"PYTHONPATH": str(Path(armrig_core.__file__).parents[1])},
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        late = Timer(WITHIN_S, process.kill)
        late.start()
        try:
            yield process
        finally:
            late.cancel()
            process.kill()


def test_a_signal_at_any_moment_ends_the_wait() -> None:
    draw = random.Random(1)

    with running(_ROUNDS, str(SIGNALS)) as process:
        assert process.stdout is not None
        for waits in process.stdout:
            assert waits == "waits\n"
            until_s = time.perf_counter() + draw.uniform(0.0, 2e-4)
            while time.perf_counter() < until_s:
                pass
            process.send_signal(signal.SIGINT)
        code = process.wait()

    assert code == 0


def test_a_signal_before_the_wait_ends_it() -> None:
    with until_signal() as ended:
        assert not ended.is_set()
        signal.raise_signal(signal.SIGINT)

        assert ended.wait(WITHIN_S)
        assert ended.is_set()


def test_a_second_signal_interrupts() -> None:
    with until_signal() as ended:
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)

        assert ended.is_set()


def test_sigterm_reaches_the_previous_handler_after_the_wait() -> None:
    received: list[int] = []
    before = {
        signal.SIGTERM: signal.signal(signal.SIGTERM, lambda number, _: received.append(number)),
        signal.SIGHUP: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    }
    try:
        with until_signal() as ended:
            signal.raise_signal(signal.SIGHUP)
            assert not ended.is_set()
            signal.raise_signal(signal.SIGTERM)
            assert ended.is_set()
            assert received == []
        assert received == [signal.SIGTERM]
        assert signal.set_wakeup_fd(-1) == -1
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_a_read_returns_signals_and_not_the_wakeups_of_threads() -> None:
    pipe = SignalPipe()
    try:
        pipe.wake()
        assert (pipe.is_set(), pipe.read(), pipe.is_set()) == (True, set(), False)
        signal.raise_signal(signal.SIGTERM)
        pipe.wake()
        assert (pipe.read(), pipe.read()) == ({signal.SIGTERM}, set())
    finally:
        pipe.close()


@pytest.mark.parametrize("number", ENDING)
def test_a_signal_waits_for_a_starting_process(number: signal.Signals) -> None:
    with block_signals(), running(_ONE) as process:
        process.send_signal(number)
        assert process.stdout is not None
        said = process.stdout.read()

    assert said == f"[{number.value}]\n"
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, []) & {*ENDING}
