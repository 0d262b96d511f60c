"""What this host is, by the kernel's files, and what the kernel grants here.

Run as a program with a priority it tries SCHED_FIFO and mlockall, and prints what was granted as
`1 0`: neither can be asked about without getting it.
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
from armrig_core.bounded import CONFIGURATION_LIMIT
from armrig_core.toml_file import read_toml

if TYPE_CHECKING:
    from armrig_core.commands import StatusReport

Level = Literal["good", "note", "bad"]
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
    """Return the mean load of the last minute; NaN if the system does not report it."""
    return float((text(root / "proc/loadavg").split() or ["nan"])[0])


def cpuinfo(root: Path) -> str:
    """Return what the kernel says of the processors."""
    return text(root / "proc/cpuinfo")


if __name__ == "__main__":
    print(int(set_fifo(int(sys.argv[1]))), int(lock_memory()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Granted:
    """What only a trial tells."""

    fifo: bool
    """SCHED_FIFO at the loop's priority."""
    memory_lock: bool
    """mlockall."""
    is_root: bool
    groups: frozenset[str]
    """Names of this user's groups."""
    cpus: int
    """Processors that this process may use."""
    recordings: Path
    """Where recordings go."""
    free_bytes: int
    """Free space there."""


def probe(recordings: Path | None = None) -> Granted:
    """Try, in a process of its own, what only a trial tells; the folder is the installed one."""
    fifo, memory_lock = granted()
    user = Path(platformdirs.user_config_dir("armrig"))
    directory = recordings or recordings_directory(Path("/"), user)
    # Of a folder that this user may not enter the one above it tells.
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
    """Return where the installed configuration, or none, lets recordings go."""
    chosen = ""
    for path in (root / "etc/armrig/armrig.toml", user / "armrig.toml"):
        with suppress(OSError, ValueError, AttributeError):  # the daemon says what is wrong with it
            tables = read_toml(path, CONFIGURATION_LIMIT)
            chosen = tables.get("recording", {}).get("directory", "") or chosen
    if chosen:
        return Path(chosen).expanduser().absolute()
    return Path(platformdirs.user_data_dir("armrig")) / "recordings"


@dataclass(frozen=True, slots=True, kw_only=True)
class HostCheck:
    """One thing that was examined, and what was found."""

    name: str
    level: Level
    """bad: it costs timing here; note: it costs little, or cannot be told or mended here; good."""
    found: str
    costs: str = ""
    """What it costs; empty where it is good."""
    mend: str = ""
    """How to mend it."""

    def __str__(self) -> str:
        """Return the line for a person."""
        parts = [f"{self.level:4}  {self.name}: {self.found}", self.costs, self.mend]
        return "; ".join(part for part in parts if part)


@dataclass(frozen=True, slots=True, kw_only=True)
class Host:
    """One host: its files and what it grants."""

    root: Path
    granted: Granted
    daemon: StatusReport | None = None
    """What the daemon of this machine reports; it is judged in place of the user who calls."""
    silent: str = ""
    """Why the service of this machine does not answer; the user who calls will start none."""
