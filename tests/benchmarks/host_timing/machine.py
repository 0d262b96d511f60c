"""Description of the machine, which figures of timing must name."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

from armrig.lab.host import cpuinfo, governors, granted, load, preemption, text, virtual


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """One host, which numbers of timing must name."""

    kernel: str
    preemption: str
    """Preemption model of the kernel; "unknown" if the kernel does not report it."""
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


def _processor(root: Path) -> str:
    found = re.search(r"^(?:model name|Model)\s*:\s*(.+)$", cpuinfo(root), re.MULTILINE)
    return found[1] if found else "unknown"
