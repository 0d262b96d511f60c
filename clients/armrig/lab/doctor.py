"""Checks of the properties of this host that affect timing, with a remedy for each.

The doctor reads the kernel's files below a root folder; a test uses a folder of its own. If a
daemon runs on this machine, its status contains the rights of its loop. If no daemon runs, a trial
(`Granted`) determines the rights of this user. The doctor changes nothing.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from armrig_core.errors import InputError
from armrig_core.process.printable import plural

from armrig.lab.host import (
    PRIORITY,
    HostCheck,
    InspectedHost,
    Level,
    governors,
    load,
    preemption,
    probe,
    text,
    virtual,
)

if TYPE_CHECKING:
    from armrig_core.commands.commands import StatusReport


MAX_IDLE_WAKE_US = 20
"""Longest wake-up time of an idle state, in µs, that does not affect the lateness of ticks."""
MAX_STEAL_SHARE = 0.01
"""Largest acceptable steal time: fraction of time that the hypervisor takes from this machine."""
MIN_FREE_BYTES = 1 << 30
"""Least free space for recordings, in B; a recording at 2 kHz needs about 15 MB per minute."""
MAX_REMEDIES = 4
"""Largest number of effects that are shown with their remedies in a brief text."""
_PRIORITY_FIELD = 15
"""Index of the priority among the fields after the process's name, see proc_pid_stat(5).

A negative priority is a real-time priority.
"""
_SOCKET = "unixsock-stream/"
_BUSY_COSTS = "any busy program delays ticks by milliseconds"
_PAGE_COSTS = "a page that was swapped out delays a tick by milliseconds"
_Found = tuple[Level, str, str, str]
"""Level, what was found, its effect on timing, and the remedy."""
_LIMITS = "/etc/security/limits.d/armrig.conf, then log in again"


def doctor(rig: str = "1", connect: str | None = None) -> list[HostCheck]:
    """Examine this host, and the rig's daemon if the daemon answers.

    Raises ValueError if `connect` is not a socket of this machine.
    """
    daemon, silent = _daemon_of(rig, connect)
    granted = probe(Path(daemon.recordings) if daemon else None)
    return examine(InspectedHost(root=Path("/"), granted=granted, daemon=daemon, silent=silent))


def _daemon_of(rig: str, connect: str | None) -> tuple[StatusReport | None, str]:
    """Return the status of this machine's daemon, or the reason why there is no status."""
    from armrig.rig.client import Rig
    from armrig.rig.session import RigError, client_endpoint, is_served, local_rigs

    where = connect or client_endpoint(rig)
    if not where.startswith(_SOCKET):
        if connect:
            raise InputError(
                f"--connect {connect}: the doctor examines only this machine; give {_SOCKET}PATH"
            )
        return None, ""  # `[client]` names another machine
    is_expected = bool(connect) or is_served(rig)
    if not is_expected and rig not in local_rigs():
        return None, ""
    try:
        with Rig(rig, connect=connect) as opened:
            status = opened.status()
    except RigError as err:
        return None, str(err) if is_expected else ""
    return (status, "") if status.host else (None, "the daemon has not reported yet: try again")


def examine(host: InspectedHost) -> list[HostCheck]:
    """Examine a host with all checks."""
    return [
        HostCheck(name=name, level=level, found=finding, costs=costs, mend=mend)
        for name, check in _CHECKS.items()
        for level, finding, costs, mend in check(host)
    ]


def is_well(checks: Iterable[HostCheck]) -> bool:
    """Return True if no check found an effect on timing (level bad)."""
    return not any(check.level == "bad" for check in checks)


def brief(checks: Sequence[HostCheck]) -> str:
    """Return the effects on timing, with remedies unless there are many, and the other checks."""
    bad = [f"bad   {c.name}: {c.found}" for c in checks if c.level == "bad"]
    if len(bad) <= MAX_REMEDIES:
        bad = [f"bad   {c.name}: {c.found}; {c.mend}" for c in checks if c.level == "bad"]
    lines = [f"{len(bad) or 'none'} of {len(checks)} checks found an effect on the timing", *bad]
    for level in ("note", "good"):
        names = ", ".join(c.name for c in checks if c.level == level)
        lines += [f"{level}  {names}"] if names else []
    return "\n".join(lines)


def _daemon(host: InspectedHost) -> list[_Found]:
    if host.silent:
        return _note("does not answer", host.silent)
    if host.daemon is None:
        return []
    return _good(f"rig {host.daemon.rig} at {host.daemon.endpoint}")


def _remedy(daemon: StatusReport, right: str) -> str:
    """Return the remedy for a right that the daemon's loop lacks; "" if the right was granted."""
    # The daemon reports a refused right by its name, followed by the remedy in brackets.
    reported = daemon.host.get("refused", [])
    lines = [str(line) for line in (reported if isinstance(reported, list) else [reported])]
    line = next((line for line in lines if line.startswith(right)), "")
    return line.partition("(")[2].removesuffix(")") or line


def _fifo(host: InspectedHost) -> list[_Found]:
    if host.silent:
        return []
    if host.daemon is not None:
        fifo = host.daemon.host.get("fifo")
        if not fifo:
            way = _remedy(host.daemon, "SCHED_FIFO") or "[timing] priority is 0"
            return _bad("the daemon has none", _BUSY_COSTS, way)
        if way := _remedy(host.daemon, "priority"):
            costs = "programs with a higher priority delay ticks"
            return _note(f"the daemon has priority {fifo}", costs, way)
        return _good(f"the daemon has priority {fifo}")
    if host.granted.fifo:
        return _good(f"allowed at priority {PRIORITY}")
    return _bad(
        f"not allowed at priority {PRIORITY}",
        _BUSY_COSTS,
        f"`@dialout - rtprio 95` in {_LIMITS}; or LimitRTPRIO=95 in systemd's unit",
    )


def _memory_lock(host: InspectedHost) -> list[_Found]:
    if host.silent:
        return []
    if host.daemon is not None:
        if way := _remedy(host.daemon, "mlockall"):
            return _bad("refused to the daemon", _PAGE_COSTS, way)
        return _good("the daemon has it")
    if host.granted.memory_lock:
        return _good("allowed")
    return _bad(
        "not allowed",
        _PAGE_COSTS,
        f"`@dialout - memlock unlimited` in {_LIMITS}; or LimitMEMLOCK=infinity in the unit",
    )


def _governor(host: InspectedHost) -> list[_Found]:
    names = governors(host.root)
    if not names:
        return _good("the kernel scales no frequency")
    named = ", ".join(names)
    if names == ["performance"]:
        return _good(named)
    return _bad(
        named,
        "a processor is slow after idle time: each tick is tens of µs late",
        "`cpupower frequency-set -g performance`",
    )


def _idle(host: InspectedHost) -> list[_Found]:
    deepest, name = 0, ""
    for state in (host.root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpuidle/state[0-9]*"):
        latency = text(state / "latency")
        if latency.isdigit() and text(state / "disable") != "1" and int(latency) > deepest:
            deepest, name = int(latency), text(state / "name")
    if deepest <= MAX_IDLE_WAKE_US:
        return _good(f"waking takes at most {deepest} µs")
    if host.silent:
        costs = "a loop that can write /dev/cpu_dma_latency keeps the processors awake"
        return _note(f"{name} takes {deepest} µs to wake from", costs)
    if not (way := _idle_right(host)):
        return _good(f"the loop prevents {name}, {deepest} µs to wake from")
    return _bad(
        f"{name} takes {deepest} µs to wake from",
        f"each tick is up to {deepest} µs late: /dev/cpu_dma_latency is not writable",
        f"{way}, or `cpupower idle-set -D {MAX_IDLE_WAKE_US}`",
    )


def _idle_right(host: InspectedHost) -> str:
    """Return how the daemon's loop, or this user, could prevent idle states; "" if it can."""
    if host.daemon is not None:
        return _remedy(host.daemon, "/dev/cpu_dma_latency")
    if os.access(host.root / "dev/cpu_dma_latency", os.W_OK):
        return ""
    return 'the udev rule `KERNEL=="cpu_dma_latency", GROUP="dialout", MODE="0660"`'


def _swap(host: InspectedHost) -> list[_Found]:
    rows = [row.split() for row in text(host.root / "proc/swaps").splitlines()[1:]]
    used_kb = sum(int(row[3]) for row in rows if len(row) > 3 and row[3].isdigit())
    if not used_kb:
        return _good("exists, but is not used" if rows else "none")
    return _bad(
        f"{used_kb / 1024:.0f} MB in use",
        "memory that is not locked, such as the service's, waits for the disk",
        "end programs, then `swapoff -a`",
    )


def _preemption(host: InspectedHost) -> list[_Found]:
    model = preemption(host.root)
    if model == "PREEMPT_RT":
        return _good(model)
    if model in ("none", "voluntary"):
        return _bad(
            model,
            "a long call of the kernel delays a tick by up to milliseconds",
            "`preempt=full` on the kernel's command line, or Debian's linux-image-rt-amd64",
        )
    return _note(
        model, "the worst case has no bound", "Debian's linux-image-rt-amd64, if p99.9 matters"
    )


def _ftdi(host: InspectedHost) -> list[_Found]:
    files = sorted((host.root / "sys/bus/usb-serial/devices").glob("*/latency_timer"))
    checks: list[_Found] = []
    for file in files:
        ms, port = text(file), file.parent.name
        if not ms.isdigit() or int(ms) <= 1:
            checks += _good(f"{port} {ms or '?'} ms")
            continue
        checks += _bad(
            f"{port} {ms} ms",
            f"an answer may wait {ms} ms in the adapter",
            f"`echo 1 > /{file.relative_to(host.root)}`, or `setserial /dev/{port} low_latency`"
            " (armrigd sets it, too)",
        )
    return checks or _good("no such port here")


def _kernel_workers(host: InspectedHost) -> list[_Found]:
    ordinary = total = 0
    for process in (host.root / "proc").glob("[0-9]*"):
        name, _, fields = text(process / "stat").rpartition(") ")
        if "(kworker/u" in name:
            total += 1
            ordinary += int(fields.split()[_PRIORITY_FIELD]) >= 0
    if not total:
        return _note("not visible from here")
    if not ordinary:
        return _good("real-time priority")
    return _note(
        f"{ordinary} of {total} have ordinary priority",
        "they transfer a serial port's bytes: under load, answers are late and runs stop",
        f"`for p in $(pgrep kworker/u); do sudo chrt -f -p {PRIORITY - 1} $p; done`, at each "
        "start (docs/timing.md)",
    )


def _throttling(host: InspectedHost) -> list[_Found]:
    kernel = host.root / "proc/sys/kernel"
    runtime, period = text(kernel / "sched_rt_runtime_us"), text(kernel / "sched_rt_period_us")
    if not re.fullmatch(r"-?\d+", runtime):
        return _note("not reported by this kernel")
    if int(runtime) < 0:
        return _good("off")
    share = int(runtime) / int(period) if period.isdigit() and int(period) else 0.0
    if share >= 0.9:
        return _good(f"above {share:.0%} of a processor; the loop uses less")
    return _bad(
        f"real-time programs may use {share:.0%} of a processor",
        "above this share the loop is stopped until the period ends",
        "`sysctl kernel.sched_rt_runtime_us=950000`",
    )


def _virtual(host: InspectedHost) -> list[_Found]:
    fields = (text(host.root / "proc/stat").splitlines() or [""])[0].split()[1:9]
    ticks = [int(f) for f in fields if f.isdigit()]
    total = sum(ticks)
    steal = ticks[7] / total if len(ticks) == 8 and total else 0.0
    if steal > MAX_STEAL_SHARE:
        return _bad(
            f"{steal:.1%} of the time since the start was used by the physical host",
            "ticks are late by whole time slices",
            "run the daemon on real hardware, or give this machine processors of its own",
        )
    if virtual(host.root):
        return _note(
            f"yes; {steal:.1%} of the time since the start was used by the physical host",
            "each wake-up passes through the physical host, so the worst case has no bound",
            "run the daemon on real hardware",
        )
    return _good("no")


def _load(host: InspectedHost) -> list[_Found]:
    mean, cpus = load(host.root), host.granted.cpus
    if not mean > cpus:  # NaN is not reported
        return _good(f"{mean:g} on {plural(cpus, 'processor')}")
    return _bad(
        f"{mean:g} on {plural(cpus, 'processor')}",
        "service and subscribers wait for a processor; without FIFO the loop waits, too",
        "end other programs (`top` names them)",
    )


def _serial_group(host: InspectedHost) -> list[_Found]:
    if host.silent or host.daemon is not None:
        return []  # only the daemon's user must open the port
    ours = sorted(host.granted.groups & {"dialout", "uucp"})
    if ours or host.granted.is_root:
        return _good(f"member of {', '.join(ours)}" if ours else "root")
    return _bad(
        "this user is not in dialout",
        "the rig's port cannot be opened",
        "`usermod -aG dialout $USER`, then log in again",
    )


def _disk(host: InspectedHost) -> list[_Found]:
    free, where = host.granted.free_bytes, host.granted.recordings
    if free >= MIN_FREE_BYTES:
        return _good(f"{free / 2**30:.1f} GiB free in {where}")
    return _bad(
        f"{free / 2**20:.0f} MiB free in {where}",
        "a full disk ends the recording",
        "make room, or set [recording] directory",
    )


_CHECKS: dict[str, Callable[[InspectedHost], list[_Found]]] = {
    "daemon": _daemon,
    "SCHED_FIFO": _fifo,
    "mlockall": _memory_lock,
    "governor": _governor,
    "idle states": _idle,
    "swap": _swap,
    "preemption": _preemption,
    "FTDI latency timer": _ftdi,
    "kernel workers": _kernel_workers,
    "RT throttling": _throttling,
    "virtual machine": _virtual,
    "load": _load,
    "serial ports": _serial_group,
    "disk": _disk,
}
"""Function of each check, by the name of the check."""


def _good(finding: str) -> list[_Found]:
    return [("good", finding, "", "")]


def _note(finding: str, costs: str = "", mend: str = "") -> list[_Found]:
    return [("note", finding, costs, mend)]


def _bad(finding: str, costs: str, mend: str) -> list[_Found]:
    return [("bad", finding, costs, mend)]
