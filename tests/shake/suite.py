"""The processes of a run of the suite, also those that left the tree of the command."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

MARK: Final = "SHAKE_RUN"
"""Environment variable that marks the processes of a run; the daemon refuses unknown ARMRIG_…."""
_NEVER: Final = b"stalls/monitor.py"
"""The monitor measures the stalls of the host, which a stop of the monitor is not."""


def processes(run: str) -> list[int]:
    """Return the processes of a run that may be stopped."""
    mark = f"{MARK}={run}".encode()
    return [
        int(folder.name)
        for folder in Path("/proc").iterdir()
        if folder.name.isdecimal()
        and mark in _read(folder / "environ").split(b"\0")
        and _NEVER not in _read(folder / "cmdline")
    ]


def ancestors(pid: int) -> Iterator[int]:
    """Give a process, its parent, and so on."""
    while pid > 1:
        yield pid
        fields = _read(Path(f"/proc/{pid}/stat")).rpartition(b")")[2].split()
        pid = int(fields[1]) if fields else 0


def kill(run: str) -> int:
    """Kill all processes of a run; return how many there were."""
    killed = 0
    while left := processes(run):
        for pid in left:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        killed = max(killed, len(left))
    return killed


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:  # the process has ended, or is another user's
        return b""
