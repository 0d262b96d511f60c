"""What the machine is, read from the kernel's files under a root that a test can make up."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

PRIORITY = 80
"""SCHED_FIFO priority of the daemon's loop where its configuration says no other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """One host, as figures of timing must name it."""

    kernel: str
    preemption: str
    """Kernel's preemption model; "unknown" where nothing tells it."""
    cpus: int
    """Processors that this process may use."""
    processor: str
    governor: str
    """Frequency governors, or that the kernel scales no frequency."""
    virtual: bool
    """A hypervisor is below."""
    fifo: bool
    """SCHED_FIFO at `PRIORITY` was granted to a process of this user."""
    memory_lock: bool
    """mlockall was granted."""
    load: float
    """Processes that wanted to run, mean of the last minute."""


def machine(root: Path = Path("/")) -> Machine:
    """Return what this machine is."""
    fifo, lock = granted()
    return Machine(
        kernel=text(root / "proc/sys/kernel/osrelease") or "unknown",
        preemption=preemption(root),
        cpus=len(os.sched_getaffinity(0)),
        processor=_processor(root),
        governor=", ".join(governors(root)) or "none: the kernel scales no frequency",
        virtual=virtual(root),
        fifo=fifo,
        memory_lock=lock,
        load=load(root),
    )


def granted() -> tuple[bool, bool]:
    """Return whether SCHED_FIFO and mlockall are granted, tried in a process of its own."""
    program = [sys.executable, "-m", "armrig.rig.bench.granted", str(PRIORITY)]
    printed = subprocess.run(program, capture_output=True, check=True, text=True).stdout.split()
    return printed[0] == "1", printed[1] == "1"


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
    return re.search(r"^flags\s*:.*\bhypervisor\b", _cpuinfo(root), re.MULTILINE) is not None


def load(root: Path) -> float:
    """Return the mean load of the last minute; NaN where it is not told."""
    return float((text(root / "proc/loadavg").split() or ["nan"])[0])


def _processor(root: Path) -> str:
    found = re.search(r"^(?:model name|Model)\s*:\s*(.+)$", _cpuinfo(root), re.MULTILINE)
    return found[1] if found else "unknown"


def _cpuinfo(root: Path) -> str:
    return text(root / "proc/cpuinfo")
