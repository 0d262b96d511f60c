"""Run in control for the page: its reference, its law, and shares of its decisions."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from itertools import islice
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from armrig_core.commands.commands import StatusReport
from armrig_core.control.control_law import ControlLaw
from armrig_core.errors import ArmrigError
from armrig_core.process.printable import with_degrees
from armrig_core.rig.volts import U_MAX_V

from armrig.dashboard.bins import WIDTH_S, Rows, Signal, coarser
from armrig.recordings.decisions import DecisionCounts
from armrig.recordings.files.control_run import law_of
from armrig.recordings.files.loading import beginning

_LOOK_S = 0.25  # between two looks for the law of a run
_MOST_LOOKS = 8  # the file of a new run may not be on the disk yet
_TEXT_S = 0.5  # numbers that change more often cannot be read
_R = (Signal(key="r", label="r", unit="", kind="value"),)


class ControlFeed:
    """Decisions of the runs in control; the lock of `Feed` protects it."""

    def __init__(self) -> None:
        """Begin without decisions."""
        self._rows: deque[Rows] = deque()  # t in s, r and r
        self.pieces = 0
        """Number of pieces of rows so far, to be passed to `rows`."""
        self._newest_ns = self._began_ns = -1
        self._counts = DecisionCounts()
        self._law: ControlLaw | None = None
        self._first_ns: int | None = None  # start of the first run of the law; None before a run
        self._is_known, self._looks, self._looked_s = False, 0, -inf
        self._text, self._told_s = "", -inf

    def begin(self, t_ns: int) -> None:
        """Begin a run at `t_ns` on the clock of the samples."""
        self._began_ns, self._counts, self._text = t_ns, DecisionCounts(), ""
        self._is_known, self._looks = False, 0

    def add(self, decisions: Sequence[Any], kept_s: float) -> None:
        """Add decisions in order, and forget those that are older by more than `kept_s`."""
        fresh = [d for d in decisions if d.t_host_ns > self._newest_ns]
        if not fresh:
            return
        self._newest_ns = fresh[-1].t_host_ns
        self._counts = self._counts.with_messages(d for d in fresh if d.t_host_ns >= self._began_ns)
        made = np.array([(d.t_host_ns / 1e9, d.r, d.r) for d in fresh], np.float64)
        self._rows.append(coarser(made, WIDTH_S, _R))
        self.pieces += 1
        while self._rows[0][-1, 0] < self._newest_ns / 1e9 - kept_s:
            self._rows.popleft()

    @property
    def wants_law(self) -> bool:
        """True if a run in control has begun, and it is time to look for its law."""
        is_due = time.monotonic() - self._looked_s >= _LOOK_S
        return bool(not self._is_known and self._counts.decisions and is_due)

    def take_law(self, law: ControlLaw | None) -> None:
        """Take the law of the run; None if it is not known yet, or the client sets each voltage."""
        self._looked_s, self._looks = time.monotonic(), self._looks + 1
        if law is None and self._looks < _MOST_LOOKS:
            return
        if self._first_ns is None or law != self._law:
            self._first_ns = self._began_ns
        self._law, self._is_known = law, True

    def rows(self, after: int = 0) -> Rows:
        """Return t in s, and r twice in the unit of the law, since a number of pieces."""
        fresh = [*islice(reversed(self._rows), max(0, self.pieces - after))][::-1]
        return np.concatenate([np.zeros((0, 3)), *fresh])

    def facts(self, *, is_going: bool) -> dict[str, Any] | None:
        """Return law and shares for the page; None without a run in control.

        The limits of the law are in force only while the input is driven (`is_going`).
        """
        if self._first_ns is None:
            return None
        now_s, law = time.monotonic(), self._law
        if self._counts.decisions and (not is_going or now_s - self._told_s > _TEXT_S):
            self._told_s = now_s
            self._text = (
                self._counts.limits_text if law else f"input {self._counts.at_limit} of samples"
            )
        facts: dict[str, Any] = {"first_s": self._first_ns / 1e9, "shares": self._text}
        if law is None:
            return facts
        r, is_limited = law.reference, bool(is_going and self._counts.decisions)
        facts |= {"name": r.name, "unit": with_degrees(r.unit), "span": r.high - r.low or 1.0}
        limits = law.lo or -inf, law.hi if law.hi < U_MAX_V else inf
        return facts | {
            "law": law.sha256,
            "output": law.outputs[0].name,
            "limits": limits if is_limited else (-inf, inf),
        }


def law_of_run(status: StatusReport | None) -> ControlLaw | None:
    """Return the law of the newest run from its recording; None without a law that can be read."""
    try:
        path = Path(status.last_run.recording) if status and status.last_run else None
        return law_of(beginning(path)[1].attachments) if path else None
    except (ArmrigError, OSError):
        return None
