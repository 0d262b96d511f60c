"""The loop waits for its deadline and for its descriptors, and nowhere else: as strace sees it.

What it calls is looked at, not how long that takes: under strace nothing is punctual.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
from pathlib import Path

import pytest

from tests.integration.driving import driven
from tests.integration.processes import Bench, wait_for
from tests.tools import require

pytestmark = pytest.mark.timed
WAITS = {"epoll_wait", "epoll_pwait", "clock_nanosleep"}
"""Calls that may wait: on the set of descriptors with its timer, and to the deadline."""
NEVER_WAIT = {"timerfd_settime", "rt_sigreturn", "gettimeofday", "clock_gettime", "brk"}
"""Calls that return at once; brk is the allocator's, which moves the end of the heap by pages."""
TRANSFERS = {"read", "write"}
"""Calls that do not wait on a non-blocking descriptor."""
_CALL = re.compile(r"^(?:\d+ +)?(\w+)\((?:(\d+)[,)])?")


def traced(pid: int, log: Path) -> subprocess.Popen[bytes]:
    """Attach strace to a process; skips where that is refused."""
    require("strace")
    process = subprocess.Popen(
        ["strace", "-p", str(pid), "-o", str(log)], stderr=subprocess.PIPE, start_new_session=True
    )
    assert process.stderr is not None
    said = process.stderr.readline().decode()
    if "attached" not in said:
        process.wait()
        pytest.skip(f"strace may not look at a process: {said.strip()}")
    return process


def calls(log: Path) -> list[tuple[str, int]]:
    """Return the calls, with the first argument if it is a number, else -1."""
    found = [_CALL.match(line) for line in log.read_text(errors="replace").splitlines()]
    return [(m[1], int(m[2] or -1)) for m in found if m]


def does_not_block(pid: int, fd: int) -> bool:
    """Return whether a descriptor of a process answers at once."""
    text = Path(f"/proc/{pid}/fdinfo/{fd}").read_text()
    return bool(int(text.split("flags:")[1].split()[0], 8) & os.O_NONBLOCK)


@pytest.mark.parametrize(
    ("pacing", "terminal"), [("exchange", True), ("scheduled", True), ("exchange", False)]
)
def test_the_loop_waits_for_its_deadline_and_its_descriptors_only(
    bench: Bench, pacing: str, terminal: bool
) -> None:
    """No `select`, which asks the terminal at each call; nothing that takes a lock or a disk."""
    if terminal:
        bench.use_terminal()
    bench.configure(watchdog_ms=250)
    bench.emulate()
    loop_pid = bench.loop_pid(bench.serve())
    log = bench.folder / "strace"
    with driven(bench, samples=3000, pacing=pacing, Ts=0.02):
        strace = traced(loop_pid, log)
        wait_for(lambda: log.exists() and len(calls(log)) > 1000)
        of_transfers = {fd for name, fd in calls(log) if name in TRANSFERS}
        blocking = {fd for fd in of_transfers if not does_not_block(loop_pid, fd)}
        strace.send_signal(signal.SIGINT)
        strace.communicate()

    names = {name for name, _ in calls(log)}
    assert names & WAITS
    assert names <= WAITS | NEVER_WAIT | TRANSFERS
    assert not blocking
