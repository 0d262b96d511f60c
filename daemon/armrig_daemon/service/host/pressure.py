"""Load of this machine.

The load is published with the timing. The outcome of a run states the load if the load may be the
cause.
"""

from __future__ import annotations

import contextlib
import os
from math import nan
from pathlib import Path
from time import monotonic_ns

from armrig_core.commands.codes import Ending, OutcomeCode, RefusalCode
from armrig_core.commands.commands import Refused, build_refusal
from armrig_core.process.printable import plural
from armrig_protocol.messages import Cause

from armrig_daemon.decisions.faults import Id
from armrig_daemon.pipe import State, Timing

CPU = Path("/proc/pressure/cpu")
MAX_LATENESS_MS = 100
"""Largest lateness at which arming is allowed, in ms.

The lateness is the 99th percentile of the ticks in the last second. A longer watchdog tolerates a
stall during a run, but does not permit arming on a late host.
"""
_OF_LOAD = (Id.STALE, Id.PAUSE, Id.MISSED)


class Pressure:
    """Reader of the processors' pressure stall information, and of the run queue."""

    def __init__(self, path: Path = CPU) -> None:
        """Start to count the waiting time now."""
        self._path = path
        self._last = (monotonic_ns(), self._stall_us())

    def read(self) -> tuple[float, int]:
        """Return the share of waiting time, in percent, and the number of runnable tasks.

        The share is the part of the time since the last call during which at least one task waited
        for a processor. The values are NaN and -1 if this kernel does not report them.
        """
        now_ns, stalled_us = monotonic_ns(), self._stall_us()
        (then_ns, before_us), self._last = self._last, (now_ns, stalled_us)
        share = nan
        if stalled_us is not None and before_us is not None and now_ns > then_ns:
            share = 100 * (stalled_us - before_us) * 1000 / (now_ns - then_ns)
        return share, _runnable()

    def _stall_us(self) -> int | None:
        """Return the waiting time so far in µs: N in the line `some … total=N`; None if unknown."""
        with contextlib.suppress(OSError, ValueError, IndexError):
            some = self._path.read_text(encoding="ascii").splitlines()[0]
            return int(some.rsplit("total=", 1)[1])
        return None


def _runnable() -> int:
    with contextlib.suppress(OSError, ValueError, IndexError):
        fields = Path("/proc/loadavg").read_text(encoding="ascii").split()
        return int(fields[3].split("/")[0])
    return -1


def load(path: Path = CPU) -> str:
    """Return the load of the processors, as text for a person."""
    try:
        mean, cpus = os.getloadavg()[0], len(os.sched_getaffinity(0))
    except OSError:
        return "load not reported by this kernel"
    processors = plural(cpus, "processor")
    text = f"load {mean:.1f} on {processors}"
    with contextlib.suppress(OSError, ValueError, IndexError):
        share = float(path.read_text(encoding="ascii").split()[1].removeprefix("avg10="))
        text += f", a task waited for a processor in {share:.0f} % of the last 10 s"
    return text


def untimely(timing: Timing | None, watchdog_ms: int, load: str) -> Refused | None:
    """Return the refusal of an arming if the host was too late in the last second, or None."""
    # One late tick among a hundred is no reason for a refusal, but a repeated pause is.
    late_ms = timing.wake_lateness_us.p99 / 1e3 if timing else 0.0
    most_ms = min(watchdog_ms, MAX_LATENESS_MS)
    if late_ms <= most_ms:
        return None
    return build_refusal(
        RefusalCode.LATE,
        f"the host was up to {late_ms:.0f} ms late in the last second, at most {most_ms} ms are "
        f"allowed ({load}; see `armrig doctor`): try again",
        late_ms=round(late_ms),
        most_ms=most_ms,
    )


def with_load(ended: Ending, state: State, load: str) -> Ending:
    """Return the outcome of a run; its sentence states the load if the load may be the cause."""
    is_late = state.fault in _OF_LOAD or state.device_cause == Cause.WATCHDOG
    # A fault after the end of a run did not end the run.
    if not is_late or ended.code != OutcomeCode.FAULT:
        return ended
    return ended._replace(text=f"{ended.text} ({load}; see `armrig doctor`)")
