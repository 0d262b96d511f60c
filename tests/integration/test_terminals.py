"""A daemon whose terminal stands still (Ctrl-S), or whose output nobody reads, serves each stop."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
import termios
import threading
from collections.abc import Callable
from contextlib import suppress

import pytest

from tests.integration.driving import driven
from tests.integration.processes import WITHIN_S, Bench, wait_for


def _read(reader: int) -> None:
    with suppress(OSError):  # the terminal is closed
        while os.read(reader, 4096):
            pass


def _stopped_terminal() -> tuple[int, int]:
    reader, terminal = pty.openpty()
    threading.Thread(target=_read, args=(reader,), daemon=True).start()
    termios.tcflow(terminal, termios.TCOOFF)
    return reader, terminal


def _full_pipe() -> tuple[int, int]:
    reader, pipe = os.pipe()
    os.set_blocking(pipe, False)
    with suppress(BlockingIOError):
        while True:
            os.write(pipe, bytes(1))
    os.set_blocking(pipe, True)
    return reader, pipe


@pytest.mark.parametrize("opened", [_stopped_terminal, _full_pipe])
def test_a_stop_and_the_end_of_the_daemon_wait_for_no_terminal(
    bench: Bench, opened: Callable[[], tuple[int, int]]
) -> None:
    bench.emulate()
    reader, terminal = opened()
    daemon = subprocess.Popen(
        [sys.executable, "-m", "armrig_daemon", "run", "--config", str(bench.config)],
        stderr=terminal,
        stdout=terminal,
        env={**os.environ, "XDG_RUNTIME_DIR": str(bench.folder)},
    )
    try:
        wait_for(lambda: bench.phase() == "safe")
        with driven(bench), bench.rig() as other:
            other.note("this line waits")
            other.stop()
            wait_for(lambda: bench.volts() == 0)
            wait_for(lambda: (last := other.status().last_run) is not None and last.finished)
            assert (last := other.status().last_run) is not None
            assert last.code == "stopped"
        daemon.terminate()
        assert daemon.wait(WITHIN_S) == 0
    finally:
        daemon.kill()
        daemon.wait()
        os.close(terminal)
        os.close(reader)


def test_ctrl_c_stops_a_run_whose_own_terminal_stands_still(bench: Bench) -> None:
    bench.emulate()
    bench.serve()
    reader, terminal = pty.openpty()
    threading.Thread(target=_read, args=(reader,), daemon=True).start()
    client = subprocess.Popen(
        [sys.executable, "-m", "armrig", "collect", "step", "--connect", bench.endpoint],
        stdin=terminal,
        stderr=terminal,
        stdout=terminal,
        env={**os.environ, "XDG_RUNTIME_DIR": str(bench.folder)},
    )
    try:
        wait_for(lambda: bench.volts() > 0)
        termios.tcflow(terminal, termios.TCOOFF)
        client.send_signal(signal.SIGINT)
        wait_for(lambda: bench.volts() == 0)
    finally:
        client.kill()
        client.wait()
        os.close(terminal)
        os.close(reader)
