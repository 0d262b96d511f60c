"""Properties of this host, from the kernel's files, and rights that the kernel grants.

The kernel grants or refuses SCHED_FIFO and mlockall only on request. If this module is run as a
program with a priority as its argument, the module requests both rights. It prints 1 for each
granted right and 0 for each refused right, such as `1 0`.
"""

from __future__ import annotations

import ctypes
import grp
import os
import re
import shutil
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import platformdirs
from armrig_core.process.bounded import CONFIGURATION_LIMIT
from armrig_core.process.toml_file import read_toml

if TYPE_CHECKING:
    from armrig_core.commands.commands import StatusReport

Level = Literal["good", "note", "bad"]
PRIORITY = 80
"""Default SCHED_FIFO priority of the daemon's loop."""
_MCL_CURRENT_AND_FUTURE = 3  # <sys/mman.h>


def granted() -> tuple[bool, bool]:
    """Return whether SCHED_FIFO and mlockall are granted; a child process requests both rights."""
    program = [sys.executable, "-m", "armrig.lab.host", str(PRIORITY)]
    printed = subprocess.run(program, capture_output=True, check=True, text=True).stdout.split()
    return printed[0] == "1", printed[1] == "1"


def set_fifo(priority: int) -> bool:
    """Request SCHED_FIFO with a priority above 0; return True if it was granted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    return True


def lock_memory() -> bool:
    """Request to lock all memory; return True if the lock was granted."""
    return bool(ctypes.CDLL(None).mlockall(_MCL_CURRENT_AND_FUTURE) == 0)


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
        if found := re.search(pattern, text(root / where)):
            return found[1]
    if "PREEMPT_DYNAMIC" in version:
        return "unknown (PREEMPT_DYNAMIC, chosen when the kernel starts)"
    return "full" if "PREEMPT" in version else "unknown"


def governors(root: Path) -> list[str]:
    """Return the frequency governors in use; an empty list if the kernel scales no frequency."""
    files = (root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    return sorted({text(file) for file in files} - {""})


def virtual(root: Path) -> bool:
    """Return True if the processors report a hypervisor."""
    return re.search(r"^flags\s*:.*\bhypervisor\b", cpuinfo(root), re.MULTILINE) is not None


def load(root: Path) -> float:
    """Return the mean load of the last minute; NaN if the system does not report it."""
    return float((text(root / "proc/loadavg").split() or ["nan"])[0])


def cpuinfo(root: Path) -> str:
    """Return the kernel's description of the processors."""
    return text(root / "proc/cpuinfo")


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
    fifo, memory_lock = granted()
    user = Path(platformdirs.user_config_dir("armrig"))
    directory = recordings or recordings_directory(Path("/"), user)
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


def recordings_directory(root: Path, user: Path) -> Path:
    """Return the configured folder of recordings; without a configuration, the default folder."""
    chosen = ""
    for path in (root / "etc/armrig/armrig.toml", user / "armrig.toml"):
        with suppress(OSError, ValueError, AttributeError):  # the daemon reports the error
            tables = read_toml(path, CONFIGURATION_LIMIT)
            chosen = tables.get("recording", {}).get("directory", "") or chosen
    if chosen:
        return Path(chosen).expanduser().absolute()
    return Path(platformdirs.user_data_dir("armrig")) / "recordings"


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
class Host:
    """A host: the root of its files, its rights, and the report of its daemon."""

    root: Path
    granted: Granted
    daemon: StatusReport | None = None
    """Status of this machine's daemon; if None, the rights of this user are examined instead."""
    silent: str = ""
    """Reason why this machine's service does not answer; if it is not "", no right is examined."""


if __name__ == "__main__":
    print(int(set_fifo(int(sys.argv[1]))), int(lock_memory()))
