"""Stalls of an emulated rig's process: reported, and in the recording."""

from __future__ import annotations

import os
import re
import signal
import time
from pathlib import Path

from tests.integration.processes import Bench, Process, freeze, wait_for


def _emulated(bench: Bench) -> tuple[Process, int]:
    """Start the daemon with an emulator; return the emulator's process id, too."""
    bench.config.write_text(f'[recording]\ndirectory = "{bench.recordings}"\n')
    daemon = bench.start("armrig_daemon", "run", "--emulate", "--config", str(bench.config))
    wait_for(lambda: bench.phase() == "safe", 30.0)
    children = Path(f"/proc/{daemon.popen.pid}/task/{daemon.popen.pid}/children")
    words = {int(p): Path(f"/proc/{p}/cmdline").read_bytes() for p in children.read_text().split()}
    (pid,) = [pid for pid, text in words.items() if b"\0emulate\0" in text]
    return daemon, pid


def _stop(pid: int, seconds: float) -> None:
    freeze(pid)
    time.sleep(seconds)
    os.kill(pid, signal.SIGCONT)


def _held_up_ms(said: str) -> list[int]:
    return [int(ms) for ms in re.findall(r"emulator held up (\d+) ms", said)]


def test_the_daemon_reports_the_length_of_a_stall(bench: Bench) -> None:
    """20 ms may count as a wait or as lateness."""
    daemon, pid = _emulated(bench)

    _stop(pid, 0.4)

    wait_for(lambda: max(_held_up_ms(daemon.said), default=0) >= 380)
    assert daemon.popen.poll() is None
