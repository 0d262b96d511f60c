"""Properties of this host, from the kernel's files, and rights that the kernel grants.

The kernel grants or refuses SCHED_FIFO and mlockall only on request.
"""

from __future__ import annotations

import grp
import json
import os
import re
import shutil
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from armrig_core.recording_file.recording_directory import (
    configuration_files,
    directory_of,
    recording_directory,
)

if TYPE_CHECKING:
    from armrig_core.commands.commands import StatusReport

Level = Literal["good", "note", "bad"]
PRIORITY = 80
"""Default SCHED_FIFO priority of the daemon's loop."""


_REQUEST = f"""
import json
from armrig_core.process.realtime import prepare
print(json.dumps(prepare({PRIORITY}, None)))
"""


def probe_rights() -> tuple[bool, bool]:
    """Return whether SCHED_FIFO and mlockall are granted to a child process, as to the loop."""
    program = [sys.executable, "-c", _REQUEST]
    rights = json.loads(subprocess.run(program, capture_output=True, check=True).stdout)
    return rights["fifo"] == PRIORITY, rights["mlockall"]


def text(path: Path) -> str:
    """Return a kernel file's text without spaces at its ends; "" if the file cannot be read."""
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
        if match := re.search(pattern, text(root / where)):
            return match[1]
    if "PREEMPT_DYNAMIC" in version:
        return "unknown (PREEMPT_DYNAMIC, chosen when the kernel starts)"
    return "full" if "PREEMPT" in version else "unknown"


def governors(root: Path) -> list[str]:
    """Return the frequency governors in use; an empty list if the kernel scales no frequency."""
    files = (root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    return sorted({text(file) for file in files} - {""})


def virtual(root: Path) -> bool:
    """Return True if the processors report a hypervisor."""
    cpuinfo = text(root / "proc/cpuinfo")
    return re.search(r"^flags\s*:.*\bhypervisor\b", cpuinfo, re.MULTILINE) is not None


def load(root: Path) -> float:
    """Return the mean load of the last minute; NaN if the system does not report it."""
    return float((text(root / "proc/loadavg").split() or ["nan"])[0])


@dataclass(frozen=True, slots=True, kw_only=True)
class Granted:
    """Rights and resources of this user, as determined by a trial."""

    fifo: bool
    """True if SCHED_FIFO at the loop's priority is granted."""
    memory_lock: bool
    """True if mlockall is granted."""
    is_root: bool
    groups: frozenset[str]
    """Names of this user's groups."""
    cpus: int
    """Number of processors that this process may use."""
    recordings: Path
    """Folder of the recordings."""
    free_bytes: int
    """Free space in the folder, in B."""


def probe(recordings: Path | None = None) -> Granted:
    """Determine this user's rights by a trial; `recordings` is by default the configured folder."""
    fifo, memory_lock = probe_rights()
    directory = recordings or directory_of("")
    if recordings is None:
        with suppress(ValueError):  # the daemon reports the error
            directory = recording_directory(configuration_files(), os.environ)
    # If this user may not enter the folder, the disk of the nearest accessible parent is examined.
    there = next(path for path in (directory, *directory.parents) if os.access(path, os.F_OK))
    names = set()
    for gid in {os.getegid(), *os.getgroups()}:
        with suppress(KeyError):  # a group without a name
            names.add(grp.getgrgid(gid).gr_name)
    return Granted(
        fifo=fifo,
        memory_lock=memory_lock,
        is_root=os.geteuid() == 0,
        groups=frozenset(names),
        cpus=len(os.sched_getaffinity(0)),
        recordings=directory,
        free_bytes=shutil.disk_usage(there).free,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class HostCheck:
    """Result of one check of the host."""

    name: str
    level: Level
    """bad: an effect on timing; note: a small or unknown effect, or no remedy; good: no effect."""
    found: str
    costs: str = ""
    """Effect on timing; "" for a good result."""
    mend: str = ""
    """Remedy."""

    def __str__(self) -> str:
        """Return the result in one line of text."""
        parts = [f"{self.level:4}  {self.name}: {self.found}", self.costs, self.mend]
        return "; ".join(part for part in parts if part)


@dataclass(frozen=True, slots=True, kw_only=True)
class InspectedHost:
    """A host: the root of its files, its rights, and the report of its daemon."""

    root: Path
    granted: Granted
    daemon: StatusReport | None = None
    """Status of this machine's daemon; if None, the rights of this user are examined instead."""
    silent: str = ""
    """Reason why this machine's service does not answer; if it is not "", no right is examined."""
