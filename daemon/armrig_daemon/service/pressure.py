"""What else this machine was doing, told beside the timing and where it may have ended a run."""

from __future__ import annotations

import contextlib
import os
from math import nan
from pathlib import Path
from time import monotonic_ns

from armrig_core.codes import RefusalCode
from armrig_core.commands import Refused, refused
from armrig_protocol.messages import Cause

from armrig_daemon.decisions.faults import Id
from armrig_daemon.pipe import State, Timing

CPU = Path("/proc/pressure/cpu")
LATENESS_MOST_MS = 100
"""A host that wakes later than this again and again is not to drive a motor, in ms.

A longer watchdog bears a stall in a run that has begun; it is no leave to begin one on such a host.
"""
_OF_LOAD = (Id.STALE, Id.PAUSE, Id.MISSED)


class Pressure:
    """Pressure stall information of the processors, and the run queue."""

    def __init__(self, path: Path = CPU) -> None:
        """Begin to count now."""
        self._path = path
        self._last = (monotonic_ns(), self._stalled_us())

    def read(self) -> tuple[float, int]:
        """Return two figures; NaN and -1 where this kernel does not tell.

        The share of the time since the last call in which some task waited for a processor, in
        percent, and how many tasks are runnable now.
        """
        now_ns, stalled_us = monotonic_ns(), self._stalled_us()
        (then_ns, before_us), self._last = self._last, (now_ns, stalled_us)
        share = nan
        if stalled_us is not None and before_us is not None and now_ns > then_ns:
            share = 100 * (stalled_us - before_us) * 1000 / (now_ns - then_ns)
        return share, _runnable()

    def _stalled_us(self) -> int | None:
        """Return the total of the line `some … total=N`."""
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
    """Return how busy the processors are, for a person."""
    try:
        mean, cpus = os.getloadavg()[0], len(os.sched_getaffinity(0))
    except OSError:
        return "load not told by this kernel"
    processors = "1 processor" if cpus == 1 else f"{cpus} processors"
    text = f"load {mean:.1f} on {processors}"
    with contextlib.suppress(OSError, ValueError, IndexError):
        share = float(path.read_text(encoding="ascii").split()[1].removeprefix("avg10="))
        text += f", some task waited for one {share:.0f} % of the last 10 s"
    return text


def untimely(timing: Timing | None, watchdog_ms: int, load: str) -> Refused | None:
    """Return why a host whose last second was like this is not to drive a motor, or None."""
    # One late tick among a hundred is no reason: only a pause that comes again and again.
    late_ms = timing.wake_lateness_us.p99 / 1e3 if timing else 0.0
    most_ms = min(watchdog_ms, LATENESS_MOST_MS)
    if late_ms <= most_ms:
        return None
    return refused(
        RefusalCode.LATE,
        f"the host woke up to {late_ms:.0f} ms late in the last second, at most {most_ms} ms are "
        f"allowed ({load}; see `armrig doctor`): try again",
        late_ms=round(late_ms),
        most_ms=most_ms,
    )


def outcome(ended: str, state: State, load: str) -> str:
    """Return how a run ended, with the load behind a fault that it may have caused."""
    is_late = state.fault in _OF_LOAD or (
        state.fault == Id.DEVICE and Cause.WATCHDOG.name in state.reason
    )
    # A run that was over before the fault was not ended by it.
    if not is_late or ended != state.reason:
        return ended
    return f"{ended} ({load}; see `armrig doctor`)"
