"""What this host is, by the kernel's files, and what the kernel grants here.

Run as a program with a priority it tries SCHED_FIFO and mlockall, and prints what was granted as
`1 0`: neither can be asked about without getting it.
"""

from __future__ import annotations

import ctypes
import os
import re
import subprocess
import sys
from pathlib import Path

PRIORITY = 80
"""SCHED_FIFO priority of the daemon's loop where its configuration says no other."""
_MCL_CURRENT_AND_FUTURE = 3  # <sys/mman.h>


def granted() -> tuple[bool, bool]:
    """Return whether SCHED_FIFO and mlockall are granted, tried in a process of its own."""
    program = [sys.executable, "-m", "armrig.lab.host", str(PRIORITY)]
    printed = subprocess.run(program, capture_output=True, check=True, text=True).stdout.split()
    return printed[0] == "1", printed[1] == "1"


def set_fifo(priority: int) -> bool:
    """Ask for SCHED_FIFO, which knows no priority 0; return whether it was granted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    return True


def lock_memory() -> bool:
    """Keep all memory in place; return whether that was granted."""
    return bool(ctypes.CDLL(None).mlockall(_MCL_CURRENT_AND_FUTURE) == 0)


def text(path: Path) -> str:
    """Return a file of the kernel in one line, or nothing where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def preemption(root: Path) -> str:
    """Return the preemption model: PREEMPT_RT, full, lazy, voluntary, none or unknown."""
    version = text(root / "proc/sys/kernel/version") or text(root / "proc/version")
    if text(root / "sys/kernel/realtime") == "1" or "PREEMPT_RT" in version:
        return "PREEMPT_RT"
    for where, pattern in (
        ("sys/kernel/debug/sched/preempt", r"\((\w+)\)"),
        ("proc/cmdline", r"(?:^|\s)preempt=(\w+)"),
    ):
        if found := re.search(pattern, text(root / where)):
            return found[1]
    if "PREEMPT_DYNAMIC" in version:
        return "unknown (PREEMPT_DYNAMIC, chosen when it starts)"
    return "full" if "PREEMPT" in version else "unknown"


def governors(root: Path) -> list[str]:
    """Return the frequency governors in use; none where the kernel scales no frequency."""
    files = (root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    return sorted({text(file) for file in files} - {""})


def virtual(root: Path) -> bool:
    """Return whether a hypervisor is below."""
    return re.search(r"^flags\s*:.*\bhypervisor\b", cpuinfo(root), re.MULTILINE) is not None


def load(root: Path) -> float:
    """Return the mean load of the last minute; NaN where it is not told."""
    return float((text(root / "proc/loadavg").split() or ["nan"])[0])


def cpuinfo(root: Path) -> str:
    """Return what the kernel says of the processors."""
    return text(root / "proc/cpuinfo")


if __name__ == "__main__":
    print(int(set_fifo(int(sys.argv[1]))), int(lock_memory()))
